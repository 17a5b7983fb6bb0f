"""The injector: target, begin, end and seed of faults; faults on frames, vehicles and hosts."""

import math
from dataclasses import replace

import numpy as np
import pytest

from risc_lab.lab import generated_fleet, load_templates, load_vehicle_type
from risc_simulator.faults import FaultEvent, parse_fault
from risc_simulator.injector import Injector
from risc_simulator.models.mocap_cameras import Observation
from risc_simulator.wires import Wires
from risc_simulator.world import World

FRAME_S = 0.005


class Lab:
    """A world of flying vehicles, its wires and an injector, in simulated time."""

    def __init__(self, vehicles=3, seed=1, kind="ardrone", gusts=False):
        fleet = generated_fleet(vehicles, 1.5)
        fleet = replace(fleet, vehicles=tuple(replace(vehicle, type=kind) for vehicle in fleet.vehicles))
        templates, types = load_templates(fleet=fleet), {kind: load_vehicle_type(kind)}
        self.world = World(fleet, types, templates, seed=seed, perturbed=False, gusts=gusts)
        for k, vehicle in enumerate(fleet.vehicles):
            self.world.vehicles[vehicle.namespace].fly_at((*vehicle.start.position_m[:2], 1.0), 0.3 * k)
        self.wires = Wires(seed)
        self.frames, self.stream = self.wires.frames("cortex/frames"), self.wires.wire("cortex/stream")
        for name in self.world.vehicles:
            self.wires.wire("%s/commands" % name)
        self.injector, self.now_s = Injector(self.world, self.wires, seed), 0.0

    def add(self, text):
        return self.injector.add(parse_fault(text), self.now_s)

    def run(self, duration_s):
        for _ in range(round(duration_s / FRAME_S)):
            self.now_s += FRAME_S
            self.injector.step(self.now_s)
            self.world.step_to(self.now_s)
            self.wires.release(self.now_s)

    def exact(self):
        return Observation(self.now_s, self.world.layout, self.world.markers_m().copy(), np.empty((0, 3)))

    def seen(self, exact=None):
        """Observations that come through cortex/frames when one is sent now."""
        found = []
        seen = self.exact() if exact is None else exact
        self.frames.carry(seen, None, self.now_s, lambda seen, *_: found.append(seen))
        return found

    def markers(self, observation, namespace):
        start = 0
        for name, count in observation.layout:
            if name == self.world.vehicles[namespace].template:
                return observation.markers_m[start : start + count]
            start += count
        raise KeyError(namespace)


def test_a_jump_moves_one_vehicle_while_it_lasts():
    lab = Lab()
    record = lab.add("jump:0.4,risc2,duration_s=0.5@1")
    assert (record.id, record.begins_s, record.ends_s) == (1, 1.0, 1.5)
    lab.run(0.9)
    exact = lab.exact()
    np.testing.assert_array_equal(lab.seen(exact)[0].markers_m, exact.markers_m)
    lab.run(0.2)
    exact = lab.exact()
    before = exact.markers_m.copy()
    (seen,) = lab.seen(exact)
    np.testing.assert_array_equal(exact.markers_m, before)  # the input is not modified
    moved_m = lab.markers(seen, "risc2") - lab.markers(exact, "risc2")
    assert np.ptp(moved_m, axis=0).max() < 1e-12
    assert math.hypot(*moved_m[0, :2]) == pytest.approx(0.4) and moved_m[0, 2] == 0.0
    for other in ("risc1", "risc3"):
        np.testing.assert_array_equal(lab.markers(seen, other), lab.markers(exact, other))
    lab.run(0.5)
    exact = lab.exact()
    np.testing.assert_array_equal(lab.seen(exact)[0].markers_m, exact.markers_m)


def test_records_tell_what_acts_and_each_change_counts():
    lab = Lab()
    first, second = lab.add("jump:0.4,risc2,duration_s=0.5@1"), lab.add("wind:1,risc1,duration_s=2@0.5")
    third = lab.add("mocap_blackout:0.3@3")
    assert lab.injector.history == [first, second, third] and lab.injector.active == []
    assert [record.id for record in lab.injector.history] == [1, 2, 3] and lab.injector.changes == 3
    found = []
    for _ in range(8):
        lab.run(0.4)
        found.append([record.event.fault for record in lab.injector.active])
    assert found == [[], ["wind"], ["jump", "wind"], ["wind"], ["wind"], ["wind"], [], ["mocap_blackout"]]
    lab.run(0.2)
    assert lab.injector.active == [] and lab.injector.changes == 9


def test_the_seed_chooses_the_vehicle_and_the_act():
    def act(seed, text="jump:0.4"):
        lab = Lab(seed=seed)
        vehicle = lab.add(text).event.vehicle
        exact = lab.exact()
        return vehicle, lab.seen(exact)[0].markers_m - exact.markers_m

    chosen = {seed: act(seed) for seed in range(12)}
    assert {vehicle for vehicle, _ in chosen.values()} == {"risc1", "risc2", "risc3"}
    for seed in (1, 2):
        np.testing.assert_array_equal(chosen[seed][1], act(seed)[1])
    (one, moved_m), (same, otherwise_m) = act(1, "jump:0.4,risc1"), act(2, "jump:0.4,risc1")
    assert one == same == "risc1" and not np.array_equal(moved_m, otherwise_m)
    lab = Lab()
    assert len({lab.add("jump:0.4").event.vehicle for _ in range(20)}) == 3, "the second is drawn anew"


def test_a_star_means_each_vehicle():
    lab = Lab()
    lab.add("jump:0.4,*")
    exact = lab.exact()
    moved_m = lab.seen(exact)[0].markers_m - exact.markers_m
    count = sum(len(vehicle.markers_m) for vehicle in lab.world.vehicles.values())
    assert (np.abs(moved_m[:count]).max(axis=1) > 0.0).all() and not moved_m[count:].any()
    assert lab.injector.history[0].event.vehicle == "*"


@pytest.mark.parametrize(
    "text, message",
    [
        ("jump:risc9", "'risc9'; .* risc1, risc2, risc3"),
        ("wind:risc9", "vehicle 'risc9'"),
        ("wind:channel=risc1/commands", "wind .* no channel"),
        ("jump:channel=cortex/stream", "jump .* frames; cortex/stream: datagrams"),
        ("drop:risc1", "drop .*vehicle"),
        ("drop:channel=risc9/*", r"'risc9/\*'; .* cortex/frames"),
        ("wrong_reply", "channel 'cortex/replies'"),
    ],
)
def test_what_cannot_happen_is_refused_and_leaves_no_trace(text, message):
    lab = Lab()
    for refuse in (lab.injector.check, lambda event: lab.injector.add(event, 0.0)):
        with pytest.raises(ValueError, match=message):
            refuse(parse_fault(text))
    assert lab.injector.history == [] and lab.injector.changes == 0
    assert lab.frames.acting == lab.stream.acting == ()


@pytest.mark.parametrize("gusts", [False, True])
def test_wind_is_the_mean_velocity_of_the_air(gusts):
    """Only for the chosen vehicle. Held level, it is dragged along until it drifts with the air."""
    calm, windy = Lab(gusts=gusts), Lab(gusts=gusts)
    windy.add("wind:2,risc1,duration_s=3@0.5")
    found = []
    for lab in (calm, windy):
        lab.run(2.0)
        felt = lab.world._u[6:9].copy()
        lab.run(2.0)
        found.append((felt, lab.world._u[6:9].copy()))
    blown = found[1][0] - found[0][0]
    assert math.hypot(*blown[:2, 0]) == pytest.approx(2.0) and blown[2, 0] == pytest.approx(0.0)
    assert not blown[:, 1:].any()
    np.testing.assert_allclose(found[1][1], found[0][1], atol=1e-12)
    assert np.abs(found[0][0]).max() == 0.0 or gusts


def test_gusts_come_on_top_of_a_wind_and_leave_it_as_it_was():
    lab = Lab()
    lab.add("wind:2,risc1,duration_s=3")
    lab.add("gust:1,risc1,duration_s=1@1")
    lab.run(0.9)
    steady, found = lab.world._u[6:9, 0].copy(), []
    for _ in range(10):
        lab.run(0.1)
        found.append(np.linalg.norm(lab.world._u[6:9, 0] - steady))
    assert np.linalg.norm(steady) == pytest.approx(2.0) and 0.3 < max(found) <= 1.0
    lab.run(0.5)
    np.testing.assert_allclose(lab.world._u[6:9, 0], steady, atol=1e-12)
    lab.run(1.0)
    np.testing.assert_allclose(lab.world._u[6:9, 0], 0.0, atol=1e-12)


def test_while_nothing_acts_nothing_is_touched():
    lab = Lab()
    lab.add("jump:0.4,risc1,duration_s=0.1")
    lab.run(0.2)
    assert lab.injector._wake_s == math.inf
    exact = lab.exact()
    assert lab.seen(exact)[0].markers_m is exact.markers_m


def test_events_count_from_when_they_are_added():
    lab = Lab()
    lab.run(1.0)
    record = lab.injector.add(FaultEvent("wind", "risc1", 1.0, 0.5, 0.25), lab.now_s)
    assert (record.begins_s, record.ends_s) == pytest.approx((1.25, 1.75))
