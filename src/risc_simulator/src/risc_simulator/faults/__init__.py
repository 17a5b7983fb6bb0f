"""Faults: what goes wrong in the lab, as data. A fault is a seeded act on wires, on frames of motion capture, on
vehicles, hosts or programs.

It is a module here and its YAML file (config/faults/NAME.yaml), which holds the fields of `FaultSettings`. What the
module defines depends on what the fault acts on:
    datagrams, streams    make(severity, rng) -> act; act(data, now_s) -> the (later_s, data) pairs that arrive in place
                          of a datagram: none if it is lost. For a stream (TCP), data is what was written at once, and
                          the order is kept. Lost data arrives when the fault is over, as TCP sends it again; None
                          cuts the connection. In flights without sockets, data is an object in place of the bytes.
    frames                make(severity, rng, bodies) -> act, likewise for models.mocap_cameras.Observation, between the
                          cameras and Cortex. bodies: `Bodies`. act must not change its input in place.
    plant                 make(severity, rng) -> an object with any of begin(vehicle, time_s), step(vehicle, time_s)
                          (before each step of the world) and end(vehicle, time_s). vehicle: world.Vehicle.
    hosts                 likewise, with hosts, {"cortex": its host}, in place of the vehicle: they have stop(), start()
    programs              likewise, with a program of the graph, which has kill(), stop() and resume(). The lab does not
                          know programs: the program that started them applies the fault (`./maap fly`)
rng: numpy Generator of this act alone.
A fault from outside this package is faults/NAME.py and faults/NAME.yaml in a folder of RISC_MAAP_MEMBERS (see
risc_lab.registry).
"""

import functools
import math
import os
import re
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from risc_lab.lab.yaml_reader import load_yaml
from risc_lab.registry import VARIABLE, Registry
from risc_lab.settings import Count, NotNegative, Settings, settings_from

REGISTRY = Registry("faults", __name__)
EVERYONE = "*"  # in place of a vehicle: all of them
_FORM = "NAME[:ARG,...][@SECONDS]"


class Bodies(NamedTuple):
    """Bodies whose markers a fault on frames changes: names of the vehicles' templates."""

    meant: tuple[str, ...]
    others: tuple[str, ...]  # the rest of the vehicles
    markers_m: dict[str, np.ndarray]  # of all vehicles: (n, 3) markers, body axes (forward, right, down)


@dataclass(frozen=True)
class FaultDefault(Settings):
    """Values for an event that does not give them."""

    severity: float | None = None  # None: the least
    duration_s: NotNegative = math.inf


@dataclass(frozen=True)
class FaultSettings(Settings):
    """Content of the YAML file of a fault."""

    severity: tuple[float, float]  # least and greatest
    summary: str = ""  # for people, one line
    unit: str = ""  # of the severity
    acts_on: tuple[Literal["datagrams", "streams", "frames", "plant", "hosts", "programs"], ...] = ("datagrams",)
    channel: str = ""  # of the wire, unless an event names one; {vehicle}: its namespace
    cables: bool = True  # acts on a vehicle's cables, not only on its radio
    argument: Literal["severity", "duration"] = "severity"  # meaning of a number on the command line
    duration_s: tuple[NotNegative, NotNegative] = (0.0, math.inf)  # least and greatest
    default: FaultDefault = FaultDefault()
    grades: dict[str, float] = field(default_factory=dict)  # {mild, medium, severe: value of the argument}
    shared: bool = False  # one act for all channels of an event: they fall silent together
    lasts: bool = False  # its effect on the vehicle stays when it is over
    per_vehicle: bool = False  # acts on one vehicle, which the seed chooses unless the event names one
    # outcomes of a flight that count as safe with it; breach: included if nothing can prevent one
    safe: tuple[Literal["completed", "held", "landed", "breach"], ...] = ("completed", "held", "landed")

    def __post_init__(self):
        super().__post_init__()
        (low, high), (short_s, long_s) = self.severity, self.duration_s
        if low > high or short_s > long_s:
            raise ValueError("'severity' and 'duration_s' are the least and the greatest, in this order")
        if not short_s <= self.default.duration_s <= long_s:
            raise ValueError("the default of 'duration_s' must be in [%g, %g]" % self.duration_s)
        if not low <= self.default_severity <= high:
            raise ValueError("the default of 'severity' must be in [%g, %g]" % self.severity)
        least, greatest = self.argument_range
        wrong = [name for name, value in self.grades.items() if not least <= value <= greatest]
        if wrong:
            raise ValueError("'grades' must be in [%g, %g]: %s is not" % (least, greatest, wrong[0]))

    @property
    def default_severity(self):
        return self.severity[0] if self.default.severity is None else self.default.severity

    @property
    def argument_field(self):
        """Field of FaultEvent that the argument sets."""
        return "severity" if self.argument == "severity" else "duration_s"

    @property
    def argument_range(self):
        """Least and greatest value of the argument."""
        return getattr(self, self.argument_field)

    @property
    def argument_unit(self):
        return self.unit if self.argument == "severity" else "s"

    @property
    def on_programs(self):
        """True if it acts on a program of the graph, not in the lab."""
        return "programs" in self.acts_on


@dataclass(frozen=True)
class FaultEvent(Settings):
    """A fault that acts for a time. None becomes the default of the fault. Raises ValueError for impossible values."""

    fault: str  # name of the fault
    vehicle: str = ""  # namespace; "": chosen by the seed if the fault acts on one vehicle; "*": all vehicles
    severity: float | None = None
    duration_s: NotNegative | None = None
    start_s: float = 0.0  # counted from when it is added
    # of `Wires`, e.g. risc1/navdata; * and ? match several, e.g. risc1/*, */commands; "": the default of the fault
    channel: str = ""
    program: str = ""  # role of a program in the graph, e.g. controller; faults on programs need one

    def __post_init__(self):
        super().__post_init__()
        settings = self.settings
        if settings.on_programs and not self.program:
            raise ValueError("%s: which program? Write e.g. %s:controller" % (self.fault, self.fault))
        if self.program and not settings.on_programs:
            raise ValueError("%s acts on no program: leave '%s' out" % (self.fault, self.program))
        if self.severity is None:
            object.__setattr__(self, "severity", settings.default_severity)
        if self.duration_s is None:
            object.__setattr__(self, "duration_s", settings.default.duration_s)
        for name in ("severity", "duration_s"):
            low, high = getattr(settings, name)
            if not low <= getattr(self, name) <= high:
                text = "%s: %s must be in [%g, %g], found %r"
                raise ValueError(text % (self.fault, name, low, high, getattr(self, name)))
        if not math.isfinite(self.start_s):
            raise ValueError("%s: 'start_s' must be finite, found %r" % (self.fault, self.start_s))

    @property
    def settings(self):
        """FaultSettings of the fault."""
        return fault_settings(self.fault)

    @property
    def module(self):
        """Module of the fault."""
        return REGISTRY.module(self.fault)

    @property
    def args(self):
        """Arguments as on the command line: without the name and the start."""
        settings = self.settings
        numbers = {"severity": (self.severity, settings.default_severity),
                   "duration_s": (self.duration_s, settings.default.duration_s)}  # fmt: skip
        value, _ = numbers.pop(settings.argument_field)
        least, greatest = settings.argument_range
        items = [self.program, "%g" % value if least < greatest else "", self.vehicle]
        items += ["%s=%g" % (name, value) for name, (value, default) in numbers.items() if value != default]
        items += ["channel=" + self.channel] if self.channel else []
        return ",".join(filter(None, items))

    def __str__(self):
        return "%s@%g" % (":".join(filter(None, (self.fault, self.args))), self.start_s)


def fault_settings(name):
    """FaultSettings of a fault. Raises ValueError."""
    return _settings(name, os.environ.get(VARIABLE))


@functools.cache
def _settings(name, _folders):
    return REGISTRY.settings(name, FaultSettings)


def parse_fault(text):
    """FaultEvent of a text NAME[:ARG,...][@SECONDS], e.g. mocap_blackout:0.3, jump:0.5,risc2@4, loss:severe.

    ARG: a number, the fault's argument; the name of one of its grades; a vehicle; or FIELD=VALUE of a FaultEvent. For
    faults on programs the first name is the program's, e.g. node_stop:controller,3.
    SECONDS: when it starts. Raises ValueError that names cause and cure.
    """
    rest, at, start = text.rpartition("@") if "@" in text else (text, "", "")
    name, _, arguments = rest.partition(":")
    if not name:
        raise ValueError("fault '%s' has no name: write %s" % (text, _FORM))
    settings, values = fault_settings(name), {"fault": name}

    def put(key, value):
        if key in values:
            raise ValueError("fault '%s': '%s' is there twice: write %s" % (text, key, _FORM))
        values[key] = value

    for item in filter(None, arguments.split(",")):
        key, equals, value = item.partition("=")
        if equals and key in ("severity", "duration_s"):
            put(key, _number(text, value))
        elif equals and key in ("vehicle", "channel", "program"):
            put(key, value)
        elif equals:
            known = "severity, duration_s, vehicle, channel, program"
            raise ValueError("fault '%s': no '%s'; there are %s" % (text, key, known))
        elif item in settings.grades:
            put(settings.argument_field, settings.grades[item])
        elif item == EVERYONE or re.fullmatch(r"[A-Za-z]\w*", item) and item not in ("inf", "nan"):
            put("program" if settings.on_programs and "program" not in values else "vehicle", item)
        else:
            put(settings.argument_field, _number(text, item))
    if at:
        values["start_s"] = _number(text, start)
    try:
        return FaultEvent(**values)
    except ValueError as error:
        raise ValueError("fault '%s': %s" % (text, error)) from None


def _number(text, value):
    try:
        return float(value)
    except ValueError:
        raise ValueError("fault '%s': '%s' is not a number: write %s" % (text, value, _FORM)) from None


@dataclass(frozen=True)
class FaultFile(Settings):
    """Content of a YAML file of faults."""

    faults: tuple[FaultEvent, ...]
    seed: Count | None = None  # of the flight or the lab, unless that is given another one


def load_fault_file(path):
    """FaultFile of a YAML file: its list `faults`, with the fields of FaultEvent, and `seed`. Raises ValueError."""
    return settings_from(FaultFile, load_yaml(path), str(path))


def load_faults(path):
    """FaultEvents of a YAML file of faults. Raises ValueError."""
    return load_fault_file(path).faults
