"""Desired and actual states of a vehicle, as a table for each segment of a flight. Needs no ROS.

The 16 columns are those of the course's logger in the original release, in its order; here every name says its unit.
"""

import itertools
import math
import time
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from msgspec import Meta

from data_extraction.recording import COMMANDS, ON_COURSE, REFERENCES, STATES, Recording
from risc_control.vehicles import adapter_class
from risc_lab.clock_guard import ClockGuard, Step
from risc_lab.command_history import Channel, CommandHistory, command_of
from risc_lab.lab.vehicle_types import DEFAULT_TYPE, load_vehicle_type
from risc_lab.phases import OperatorPhase
from risc_lab.settings import Positive, Settings

SENT, PHASES, OPERATOR = "/commands_sent", "/trajectory_phase", "/operator/phase"
TOPICS = (STATES, REFERENCES, COMMANDS, SENT, PHASES, OPERATOR)
POSITION = ("x_m", "y_m", "z_m")  # cortex frame, as all positions and velocities here
DESIRED_POSITION = ("x_desired_m", "y_desired_m", "z_desired_m")
DESIRED_ANGLES = ("phi_desired_deg", "theta_desired_deg", "psi_desired_deg")
ANGLES = ("phi_deg", "theta_deg", "psi_deg")
VELOCITY_ERROR = ("u_error_m_s", "v_error_m_s", "w_error_m_s")  # desired less actual
COLUMNS = POSITION + DESIRED_POSITION + DESIRED_ANGLES + ANGLES + VELOCITY_ERROR + ("time_s",)
_FIELDS = {
    STATES: ("x", "y", "z", "u", "v", "w", "phi", "theta", "psi"),
    REFERENCES: ("x", "y", "z", "xdot", "ydot", "zdot", "psi"),
    COMMANDS: ("phi", "theta"),
}

PLOT_BUTTON = 3  # of the original release

_DELAY_S = 0.5  # a state waits this long for the references and commands around it
_GAP_S = 0.25  # longer gaps are not interpolated, and no command holds for longer
_SENT_ROWS = 2**17  # the longest segment at 200 Hz


@dataclass(frozen=True)
class PlotParams(Settings):
    """Settings of DF_Plots."""

    rate_hz: Positive = 20.0  # [Hz] how often a state is logged; what arrives in between is not even deserialised
    plot_button: int = -1  # of a joystick, asks for the plots; negative: /plot_button, else 3 as in the original
    euler_angle_max: Annotated[float, Meta(le=math.pi / 2.0)] = -1.0  # [rad] tilt at a fraction of 1 on /controls;
    # negative: /euler_angle_max, else that of the vehicle's type
    vehicle_type: str = ""  # ardrone or iris: what the fractions on /controls mean; "" = the fleet's, else ardrone
    vehicles: tuple[str, ...] = ()  # which ones, by template or namespace; () = all
    joysticks: tuple[str, ...] = ()  # topics whose button counts; () = joy, and /<namespace>/joy of the whole /fleet
    folder: str = ""  # for the files; "" = df_plots_<date>-<time> in the working directory (of roslaunch: ~/.ros)
    pdf: bool = True  # every page as PDF, too
    skip_phases: tuple[str, ...] = ("hold",)  # that get no page; hold = the reference is where the vehicle is
    min_s: Annotated[float, Meta(ge=1.0)] = 1.0  # [s] a shorter segment gets no page; files are named by its second
    max_s: Positive = 600.0  # [s] a longer one is cut in two
    keep_s: Positive = 3600.0  # [s] of each vehicle; older segments are forgotten (their files stay)

    def __post_init__(self):
        super().__post_init__()
        if self.min_s >= self.max_s:
            raise ValueError("'min_s' must be less than max_s, found %r and %r" % (self.min_s, self.max_s))
        if self.euler_angle_max == 0.0:
            raise ValueError("'euler_angle_max' must be an angle, or negative: that of the vehicle's type; found 0")


@dataclass(frozen=True)
class Segment:
    """A stretch of one vehicle's flight in which course and phase stay the same."""

    vehicle: str
    course: str  # "" when its name is unknown
    phase: str  # word of /trajectory_phase or /operator/phase; "" when unknown
    table: np.ndarray  # (n, 16) as in COLUMNS; a desired roll and pitch that was not commanded is NaN

    def columns(self, names):
        """(n, len(names)) columns by their names."""
        return self.table[:, [COLUMNS.index(name) for name in names]]

    @property
    def start_s(self):
        return float(self.table[0, -1])

    @property
    def duration_s(self):
        return float(self.table[-1, -1] - self.table[0, -1])

    @property
    def position_error_m(self):
        """(n, 3) desired less actual position, cortex frame."""
        return self.columns(DESIRED_POSITION) - self.columns(POSITION)

    @property
    def position_rmse_m(self):
        return float(np.sqrt(np.mean(np.sum(self.position_error_m**2, axis=1))))

    @property
    def label(self):
        """Text: course and phase."""
        words = [self.course] if self.course else []
        if self.phase and not (self.course and self.phase == ON_COURSE):
            words.append(self.phase)
        return " ".join(words) or "flight"

    @property
    def clock(self):
        """Time of day at the start, in this computer's time zone."""
        return time.localtime(self.start_s)


def full_scales_deg(params, fleet_vehicles=()):
    """(dict vehicle -> (phi, theta), (phi, theta) of all others): angles [deg] at a fraction of 1 on /controls.

    NED sense, so for an AR.Drone they are negative: its fractions are + left and + forward. For the vehicles of a
    fleet the result is the angle that its controllers wanted: they divide it by the gain of the type's attitude loop
    (risc_control.vehicles). The original's controllers used no gains, so without a fleet it is the fraction
    of euler_angle_max alone. That limit is the type's when it is not set, 20 degrees for the AR.Drone: the
    original's plots took 0.78537 rad for every vehicle, which is right for its IRIS+ only.
    """
    override = params.euler_angle_max if params.euler_angle_max > 0.0 else None

    def scale(kind, with_gains, overrides=()):
        limit = {"tilt_max_rad": override} if override else {}
        vehicle_type = load_vehicle_type(kind, {**dict(overrides), **limit})
        unit = adapter_class(vehicle_type).units(vehicle_type)
        gains = (1.0, 1.0) if with_gains else (vehicle_type.roll.gain, vehicle_type.pitch.gain)
        return math.degrees(unit.roll_rad / gains[0]), math.degrees(unit.pitch_rad / gains[1])

    of_fleet = {
        vehicle.template: scale(params.vehicle_type or vehicle.type, True, vehicle.overrides)
        for vehicle in fleet_vehicles
    }
    return of_fleet, scale(params.vehicle_type or DEFAULT_TYPE, False)


class Recorder:
    """Takes messages, keeps the tables. Not thread-safe."""

    def __init__(self, params, fleet_vehicles=()):
        """fleet_vehicles: FleetVehicles, () = the original laboratory's. Raises ValueError for an unknown type."""
        self._params = params
        self._scales_deg, self._other_scale_deg = full_scales_deg(params, fleet_vehicles)
        template = {vehicle.namespace: vehicle.template for vehicle in fleet_vehicles}
        self._wanted = tuple(template.get(name, name) for name in params.vehicles)
        self._recording = Recording(_FIELDS, only=self._wanted)
        self._sent = {}  # vehicle -> CommandHistory(1)
        CommandHistory(1, _SENT_ROWS)  # loads the code compiled for this many rows now, not in flight
        self._clock = ClockGuard(math.inf)  # of the states; they may pause for long
        self._delay_s = _DELAY_S
        self._over, self._growing = {}, {}  # vehicle -> its ended Segments; the one in progress
        self._ended = 0

    @property
    def vehicles(self):
        """Names of the vehicles whose states came, in the order of the message."""
        return tuple(self._recording.order)

    @property
    def unknown_vehicles(self):
        """Names of the parameters' vehicles whose states never came."""
        return tuple(name for name in self._wanted if name not in self._recording.order)

    def take(self, topic, receipt_s, message, seconds):
        """Take a message of any topic in TOPICS. seconds: function that converts its times to [s]."""
        if topic == SENT:
            for command in message.commands:
                self.add(topic, receipt_s, command, seconds(command.sent))
        else:
            self.add(topic, receipt_s, message, seconds(message.header.stamp) if topic in _FIELDS else None)

    def add(self, topic, receipt_s, message, stamp_s=None):
        """Take a message of any topic in TOPICS; of SENT one command at a time, with its sending time as stamp.

        stamp_s: of its header, when it has one; 0 = it is not stamped.
        """
        recording = self._recording
        if topic == PHASES:
            recording.phases(receipt_s, message)
        elif topic == OPERATOR:
            recording.others_phase(receipt_s, OperatorPhase(message.phase).name.lower())
        elif topic == SENT:
            if message.name not in self._sent:
                self._sent[message.name] = CommandHistory(1, _SENT_ROWS)
            self._sent[message.name].append(0, receipt_s if recording.unstamped else stamp_s, command_of(message))
        elif topic != STATES or self._advances(receipt_s if recording.unstamped else stamp_s):
            was_stamped = not recording.unstamped
            recording.add(topic, receipt_s, stamp_s, message.Obj)
            if was_stamped and recording.unstamped:  # times are those of receipt from now on
                self._clock.forget()
                self._sent.clear()

    def finish(self):
        """Process what still waits for later messages: none will come."""
        self._delay_s = 0.0

    def ended(self):
        """How many segments have ended so far, long enough or not. Call it now and then: that bounds the memory."""
        self._collect(self._clock.newest_s - self._delay_s)
        return self._ended

    def segments(self, growing=True):
        """List of `Segment` that are long enough and of phases that are not skipped, by vehicle and time.

        growing: also those that have not ended.
        """
        self._collect(self._clock.newest_s - self._delay_s)
        found = [segment for name in self.vehicles for segment in self._over.get(name, ())]
        if growing:
            found = sorted(found + list(self._growing.values()), key=lambda s: self.vehicles.index(s.vehicle))
        skipped = self._params.skip_phases
        return [s for s in found if s.duration_s >= self._params.min_s and s.phase not in skipped]

    def _advances(self, time_s):
        step = self._clock.look(time_s)
        if step is Step.NEW_CLOCK:
            self._collect(math.inf)
            for name in list(self._growing):
                self._end(self._growing.pop(name))
            self._recording.restart()
            self._sent.clear()
        return step is not Step.REFUSED

    def _end(self, segment):
        over = self._over.setdefault(segment.vehicle, [])
        over.append(segment)
        self._ended += 1
        while sum(len(kept.table) for kept in over) > self._params.keep_s * self._params.rate_hz:
            del over[0]

    def _collect(self, until_s):
        """Pair the samples up to a time. Delete those of ended segments, and those that can no longer be paired: states
        without a reference, references of a vehicle that is not seen.
        """
        recording, order = self._recording, self._recording.order
        if not order:
            recording.restart()  # references and commands without a vehicle
            return
        told = {topic: recording.parts(topic, order) for topic in _FIELDS}
        for name in dict.fromkeys(itertools.chain(*told.values())):
            states, references, commands = (told[topic].get(name, []) for topic in _FIELDS)
            begin_s, end_s = -math.inf, -math.inf  # of the segment under way
            if states and references and (not self._wanted or name in self._wanted):
                found = list(self._paired(name, states, references, commands, until_s))
                for segment in found[:-1]:
                    self._end(segment)
                if found:
                    self._growing[name] = found[-1]
                    begin_s, end_s = found[-1].start_s, found[-1].start_s + found[-1].duration_s
            recording.forget(states, -math.inf, begin_s)
            recording.forget(references + commands, -math.inf, begin_s - _GAP_S)
            recording.forget(states + references + commands, end_s + _GAP_S, until_s - _GAP_S)

    def _paired(self, name, states, references, commands, until_s):
        """Segments of a vehicle, from its states up to a time that have a reference before and after them.

        states, references, commands: parts of the recording.
        """
        states, references = self._recording.series(states), self._recording.series(references)
        near, labels = references.near(states.t_s, _GAP_S)
        near &= states.t_s <= until_s
        t_s, have, labels = states.t_s[near], states.values[near], labels[near]
        references.values[:, 6] = np.unwrap(references.values[:, 6])
        want = references.at(t_s)
        told = np.full((len(t_s), 2), np.nan)
        if name in self._sent:
            told = np.degrees(self._sent[name].held(0, t_s, _GAP_S)[:, [Channel.PHI, Channel.THETA]])
        if commands and np.isnan(told).all():
            computed = self._recording.series(commands)
            known = computed.near(t_s, _GAP_S)[0]
            told[known] = (computed.at(t_s) * self._scales_deg.get(name, self._other_scale_deg))[known]
        psi_deg = (np.degrees(want[:, 6:]) + 180.0) % 360.0 - 180.0
        errors = want[:, 3:6] - have[:, 3:6]
        table = np.hstack((have[:, :3], want[:, :3], told, psi_deg, have[:, 6:], errors, t_s[:, None]))
        courses, phases = self._recording.told(name, states.receipts_s[near])
        courses = np.where(labels == "", courses, labels)
        changes = (courses[1:] != courses[:-1]) | (phases[1:] != phases[:-1])
        for begin, end in itertools.pairwise((0, *np.flatnonzero(changes) + 1, len(t_s))):
            cuts = np.flatnonzero(np.diff((t_s[begin:end] - t_s[begin : begin + 1]) // self._params.max_s)) + 1
            parts = np.split(table[begin:end], cuts)
            yield from (Segment(name, str(courses[begin]), str(phases[begin]), rows) for rows in parts if len(rows))
