"""Applies faults in a lab, or in a flight without sockets: which acts where, and from when to when."""

import math
from collections import Counter
from dataclasses import dataclass, replace
from typing import NamedTuple
from zlib import crc32

import numpy as np

from risc_simulator.faults import EVERYONE, Bodies, FaultEvent
from risc_simulator.world import look_up

_ON_WIRES = {"datagrams", "streams", "frames"}


class FaultRecord(NamedTuple):
    """A fault that was added. Times are on the clock of the injector."""

    id: int  # from 1
    event: FaultEvent  # with the vehicle that was chosen; its start is no longer used
    begins_s: float
    ends_s: float  # infinite: it has no end


@dataclass
class _Act:
    """A part of a record: on the wires, which do the timing (subject None), on a vehicle or on the hosts."""

    record: FaultRecord
    subject: object = None
    member: object = None  # made by the module of its fault
    begun: bool = False

    def call(self, what, time_s):
        """Call begin, step or end of the member, if it has one."""
        function = getattr(self.member, what, None)
        if function is not None:
            function(self.subject, time_s)


class Injector:
    """All faults of a lab. One thread, which calls step() before each step of the world."""

    def __init__(self, world, wires, seed=0, hosts=None):
        """world: World.  wires: Wires.  seed: the lab's.  hosts: what faults on hosts act on; None: there are none.

        The seed of an act depends on this one, on its fault, on where it acts, and on how many such acts came before.
        """
        self._world, self._wires, self._seed, self._hosts = world, wires, seed, hosts
        self._added = Counter()
        self._acts = []  # acts that are not over
        self._wake_s = math.inf  # step() has nothing to do before this time
        self.history = []  # FaultRecord of each fault that was added
        self.changes = 0  # grows when a fault is added, begins or ends

    @property
    def active(self):
        """FaultRecords of the faults that act now."""
        return list(dict.fromkeys(act.record for act in self._acts if act.begun))

    @property
    def open(self):
        """FaultRecords of the faults that act or wait."""
        return list(dict.fromkeys(act.record for act in self._acts))

    def check(self, event):
        """Raise ValueError, which names the cause, if a FaultEvent is not possible here."""
        self._targets(event)

    def add(self, event, now_s):
        """Let a FaultEvent begin `event.start_s` after now_s. Returns its FaultRecord. Raises ValueError like `check`.

        now_s: on the clock of the wires.
        """
        vehicles = list(self._world.vehicles)
        if event.settings.per_vehicle and not event.vehicle and not event.channel and vehicles:
            event = replace(event, vehicle=vehicles[self._rng("", event.fault).integers(len(vehicles))])
        targets, acts = self._targets(event), []
        begins_s = now_s + event.start_s
        record = FaultRecord(len(self.history) + 1, event, begins_s, begins_s + event.duration_s)
        for target in targets:
            if isinstance(target, str):
                self._wires.add(replace(event, channel=target, start_s=begins_s), self._bodies(event))
            else:
                where = getattr(target, "namespace", "hosts")
                made = event.module.make(event.severity, self._rng(where, event.fault))
                acts.append(_Act(record, target, made))
        self._acts += acts or [_Act(record)]
        self.history.append(record)
        self.changes += 1
        self._wake_s = min(self._wake_s, begins_s)
        return record

    def end_all(self, now_s):
        """End the faults that act, and drop those that wait. Delayed data on a wire still arrives."""
        self._wires.clear()
        for act in self._acts:
            if act.begun:
                act.call("end", self._world.time_s)
            self.history[act.record.id - 1] = act.record._replace(ends_s=now_s)
        self.changes += 1
        self._acts, self._wake_s = [], math.inf

    def end_on(self, vehicle, now_s):
        """End the faults that act on a world.Vehicle itself; those that wait, or act on wires and frames, go on."""
        ended = [act for act in self._acts if act.begun and act.subject is vehicle]
        for act in ended:
            act.call("end", self._world.time_s)
        self._acts = [act for act in self._acts if act not in ended]
        for act in ended:
            if act.record not in self.open:
                self.history[act.record.id - 1] = act.record._replace(ends_s=now_s)
                self.changes += 1

    def step(self, now_s):
        """Begin faults that are due, end those that are over, and step those on vehicles and hosts."""
        if now_s < self._wake_s:
            return
        world_s = self._world.time_s
        for act in self._acts:
            if not act.begun and act.record.begins_s <= now_s:
                act.begun = True
                self.changes += 1
                act.call("begin", world_s)
            if act.begun and now_s < act.record.ends_s:
                act.call("step", world_s)
        for act in self._acts:
            if now_s >= act.record.ends_s:
                self.changes += 1
                act.call("end", world_s)
        self._acts = [act for act in self._acts if now_s < act.record.ends_s]
        always = any(act.begun and hasattr(act.member, "step") for act in self._acts)
        changes_s = (act.record.ends_s if act.begun else act.record.begins_s for act in self._acts)
        self._wake_s = -math.inf if always else min(changes_s, default=math.inf)

    def _rng(self, where, fault):
        key = crc32(where.encode()), crc32(fault.encode()), self._added[where, fault]
        self._added[where, fault] += 1
        return np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=key))

    def _targets(self, event):
        """Channels, vehicles or hosts that an event acts on; those of the first vehicle if none is chosen yet."""
        settings, vehicles = event.settings, self._world.vehicles
        if settings.on_programs:
            text = "fault %s acts on programs of the graph, which the lab does not know: only ./maap fly can do it"
            raise ValueError(text % event.fault)
        if event.vehicle not in ("", EVERYONE):
            look_up(vehicles, event.vehicle, "vehicle")
        names = [event.vehicle] if event.vehicle not in ("", EVERYONE) else list(vehicles)
        if not names:
            raise ValueError("fault %s: there are no vehicles" % event.fault)
        if settings.per_vehicle and not event.vehicle:
            names = names[:1]
        if not _ON_WIRES.isdisjoint(settings.acts_on):
            channel = event.channel or settings.channel
            if event.vehicle and "frames" not in settings.acts_on and "{vehicle}" not in channel:
                text = "fault %s is not one vehicle's: leave '%s' out, or name a channel"
                raise ValueError(text % (event.fault, event.vehicle))
            channels = list(dict.fromkeys(channel.replace("{vehicle}", name) for name in names))
            for channel in channels:
                self._wires.fit(event, channel)
            if "frames" in settings.acts_on:  # raises if it needs more bodies than there are
                event.module.make(event.severity, np.random.default_rng(0), self._bodies(event))
            return channels
        if event.channel:
            raise ValueError("fault %s acts on no channel: leave '%s' out" % (event.fault, event.channel))
        if "hosts" in settings.acts_on:
            if self._hosts is None:
                raise ValueError("fault %s needs hosts; there are none here" % event.fault)
            return [self._hosts]
        return [vehicles[name] for name in names]

    def _bodies(self, event):
        vehicles = self._world.vehicles
        meant = vehicles if event.vehicle in ("", EVERYONE) else [event.vehicle]
        return Bodies(
            tuple(vehicles[name].template for name in meant),
            tuple(vehicle.template for name, vehicle in vehicles.items() if name not in meant),
            {vehicle.template: vehicle.markers_m for vehicle in vehicles.values()},
        )
