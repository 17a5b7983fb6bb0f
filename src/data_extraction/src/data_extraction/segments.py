"""What a vehicle should have done and what it did, as a table for each segment of a flight. Needs no ROS.

The 16 columns are those of the course's logger in the original release, in its order; here every name says its unit.
"""

import math
import time
from array import array
from collections import deque
from dataclasses import dataclass

import numpy as np

from risc_control.vehicles import adapter_class
from risc_lab.clock import ClockGuard, Step
from risc_lab.lab.vehicle_types import load_vehicle_type
from risc_lab.phases import OperatorPhase, phase_words

POSITION = ("x_m", "y_m", "z_m")  # cortex frame, as all positions and velocities here
DESIRED_POSITION = ("x_desired_m", "y_desired_m", "z_desired_m")
DESIRED_ANGLES = ("phi_desired_deg", "theta_desired_deg", "psi_desired_deg")
ANGLES = ("phi_deg", "theta_deg", "psi_deg")
VELOCITY_ERROR = ("u_error_m_s", "v_error_m_s", "w_error_m_s")  # desired less actual
COLUMNS = POSITION + DESIRED_POSITION + DESIRED_ANGLES + ANGLES + VELOCITY_ERROR + ("time_s",)

PLOT_BUTTON = 3  # of the original release
ON_COURSE = "course"  # the phase in which the course itself is flown
IRIS = "iris"
IRIS_EULER_ANGLE_MAX_RAD = 0.78537  # of the original release, for its IRIS+ controllers; the AR.Drone's is in its type

_DELAY_S = 0.5  # a state waits so long for the reference and the command before and after it
_MEMORY_S = 2.0  # references and commands are kept so long
_GAP_S = 0.25  # nothing is interpolated over a longer silence


@dataclass(frozen=True)
class PlotParams:
    """Settings of DF_Plots; config/DF_Plots.yaml explains and holds the same values."""

    rate_hz: float = 20.0
    plot_button: int = -1
    euler_angle_max: float = -1.0
    vehicle_type: str = ""
    vehicles: tuple[str, ...] = ()
    joysticks: tuple[str, ...] = ()
    folder: str = ""
    pdf: bool = True
    skip_phases: tuple[str, ...] = ("hold",)
    min_s: float = 1.0
    max_s: float = 600.0
    keep_s: float = 3600.0

    def __post_init__(self):
        for key in ("rate_hz", "max_s", "keep_s"):
            if not getattr(self, key) > 0.0:
                raise ValueError("parameter '%s' must be positive, got %r" % (key, getattr(self, key)))
        if not 1.0 <= self.min_s < self.max_s:  # files are named by the second in which their segment begins
            raise ValueError("parameter 'min_s' must be at least 1 s and less than max_s, got %r" % self.min_s)
        if self.euler_angle_max == 0.0 or not self.euler_angle_max <= math.pi / 2.0:
            raise ValueError(
                "parameter 'euler_angle_max' must be an angle in (0, 1.57] rad, or negative: that of the vehicle's "
                "type; got %r" % self.euler_angle_max
            )


@dataclass(frozen=True)
class Segment:
    """A stretch of one vehicle's flight in which course and phase stay the same."""

    vehicle: str
    course: str  # "" when nobody says what it is called
    phase: str  # word of /trajectory_phase or /operator/phase; "" when nobody says
    table: np.ndarray  # (n, 16) as in COLUMNS; a desired roll and pitch that nobody commanded is NaN

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
        """What is flown, for people."""
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
    (risc_control.vehicles). The original's controllers knew no gains, so without a fleet it is the fraction
    of euler_angle_max and nothing else. That limit is the type's when it is not set, 20 degrees for the AR.Drone: the
    original's plots took 0.78537 rad for every vehicle, which is right for its IRIS+ only.
    """
    override = params.euler_angle_max if params.euler_angle_max > 0.0 else None

    def scale(kind, with_gains, overrides=()):
        if kind == IRIS:
            angle_rad = override or IRIS_EULER_ANGLE_MAX_RAD
            return math.degrees(angle_rad), math.degrees(angle_rad)
        limit = {"tilt_max_rad": override} if override else {}
        vehicle_type = load_vehicle_type(kind, {**dict(overrides), **limit})
        if not with_gains:
            return -math.degrees(vehicle_type.tilt_max_rad), -math.degrees(vehicle_type.tilt_max_rad)
        unit = adapter_class(vehicle_type).units(vehicle_type)
        return math.degrees(unit.roll_rad), math.degrees(unit.pitch_rad)

    of_fleet = {
        vehicle.template: scale(params.vehicle_type or vehicle.type, True, vehicle.overrides)
        for vehicle in fleet_vehicles
    }
    return of_fleet, scale(params.vehicle_type or "ardrone", False)


class Recorder:
    """Takes messages, pairs them by their stamps, keeps the tables. Not thread-safe.

    Entries are those of the messages' `Obj`, in the units of risc_msgs (rospy's or those that rosbags reads).
    Vehicles are found by name. The original release put the course's name into `Trajectory.name`, or one vehicle's
    name into all entries, and meant the place in the message; where no name is a vehicle's that is taken. It never
    stamped its trajectories: the times of receipt are used for everything then.
    """

    def __init__(self, params, fleet_vehicles=()):
        """fleet_vehicles: FleetVehicles, () = the original laboratory's. Raises ValueError for an unknown type."""
        self._params = params
        self._scales_deg, self._other_scale_deg = full_scales_deg(params, fleet_vehicles)
        template = {vehicle.namespace: vehicle.template for vehicle in fleet_vehicles}
        self._wanted = tuple(template.get(name, name) for name in params.vehicles)
        self._logs = {}  # vehicle -> _Log, in the order of their first message
        self._by_receipt = False
        self._course, self._phases, self._operator = "", {}, ""

    @property
    def vehicles(self):
        """Names of the vehicles whose states came, in the order of the message."""
        return tuple(self._logs)

    @property
    def unknown_vehicles(self):
        """Names of the parameters' vehicles whose states never came."""
        return tuple(name for name in self._wanted if name not in self._logs)

    def states(self, receipt_s, stamp_s, entries):
        """Entries of a Cortex message. Those of objects that are not visible are left out."""
        time_s = self._time(receipt_s, stamp_s)
        for entry in entries:
            log = self._logs.get(entry.name)
            if log is None:
                log = self._logs[entry.name] = _Log(entry.name, self._params)
                log.mark(receipt_s, *self._course_and_phase(entry.name))
            values = (entry.x, entry.y, entry.z, entry.u, entry.v, entry.w, entry.phi, entry.theta, entry.psi)
            if entry.visible and self._is_wanted(entry.name) and all(map(math.isfinite, values)):
                log.state(time_s, receipt_s, values)

    def references(self, receipt_s, stamp_s, entries):
        """Entries of a Trajectories message."""
        time_s = self._time(receipt_s, stamp_s)
        for owner, entry in self._owned(entries):
            values = (entry.x, entry.y, entry.z, entry.xdot, entry.ydot, entry.zdot, math.degrees(entry.psi))
            if all(map(math.isfinite, values)):
                self._logs[owner].references.add(time_s, values, "" if entry.name in self._logs else entry.name)

    def commands(self, receipt_s, stamp_s, entries):
        """Entries of a Controls message."""
        time_s = self._time(receipt_s, stamp_s)
        for owner, entry in self._owned(entries):
            phi_deg, theta_deg = self._scales_deg.get(owner, self._other_scale_deg)
            values = (phi_deg * entry.phi, theta_deg * entry.theta)
            if all(map(math.isfinite, values)):
                self._logs[owner].commands.add(time_s, values)

    def phases(self, receipt_s, message):
        """TrajectoryPhases: what the trajectory node flies, and does with each vehicle."""
        self._course = message.course
        self._phases.update(phase_words(message.vehicles))
        self._mark_all(receipt_s)

    def operator(self, receipt_s, message):
        """OperatorState: its phase is that of vehicles of which no trajectory node says anything."""
        self._operator = OperatorPhase(message.phase).name.lower()
        self._mark_all(receipt_s)

    def finish(self):
        """Use what still waits for later messages: there will be none."""
        for log in self._logs.values():
            log.settle(math.inf)

    @property
    def ended(self):
        """How many segments have ended so far, long enough or not."""
        return sum(log.ended for log in self._logs.values())

    def segments(self, growing=True):
        """List of `Segment` that are long enough and of phases that are not skipped, by vehicle and time.

        growing: also those that have not ended.
        """
        found = [segment for log in self._logs.values() for segment in log.segments(growing)]
        skipped = self._params.skip_phases
        return [s for s in found if s.duration_s >= self._params.min_s and s.phase not in skipped]

    def _is_wanted(self, name):
        return not self._wanted or name in self._wanted

    def _course_and_phase(self, name):
        return self._course, self._phases.get(name, self._operator)

    def _mark_all(self, receipt_s):
        for name, log in self._logs.items():
            log.mark(receipt_s, *self._course_and_phase(name))

    def _time(self, receipt_s, stamp_s):
        """Time of a message [s] on the one clock that all messages have."""
        if not stamp_s and not self._by_receipt:
            self._by_receipt = True
            for log in self._logs.values():
                log.restart()
        return receipt_s if self._by_receipt else stamp_s

    def _owned(self, entries):
        """[(vehicle, entry)] of entries that belong to vehicles whose states have come."""
        names = [entry.name for entry in entries]
        if len(set(names)) == len(names) and any(name in self._logs for name in names):
            owners = names
        elif len(names) == 1 and self._wanted:
            owners = self._wanted
        else:
            owners = self.vehicles
        return [
            (owner, entry) for owner, entry in zip(owners, entries) if owner in self._logs and self._is_wanted(owner)
        ]


class _Track:
    """Samples over time of one thing, of which the newest are kept."""

    def __init__(self):
        self._samples = deque()  # (time [s], values, tag)

    def add(self, time_s, values, tag=""):
        samples = self._samples
        if not samples or time_s > samples[-1][0]:
            samples.append((time_s, values, tag))
            while time_s - samples[0][0] > _MEMORY_S:
                samples.popleft()

    def clear(self):
        self._samples.clear()

    def around(self, time_s):
        """The samples before and after a time, the same twice for one just then; None when it is not in between.

        Times must not decrease from call to call: what is before them is forgotten.
        """
        samples = self._samples
        while len(samples) > 1 and samples[1][0] <= time_s:
            samples.popleft()
        if not samples or samples[0][0] > time_s:
            return None
        if samples[0][0] == time_s:
            return samples[0], samples[0]
        if len(samples) < 2 or samples[1][0] - samples[0][0] > _GAP_S or samples[0][2] != samples[1][2]:
            return None
        return samples[0], samples[1]


class _Growing:
    """The rows of a segment that may still grow."""

    def __init__(self, vehicle, course, phase):
        self.key = vehicle, course, phase
        self.rows = array("d")

    def __len__(self):
        return len(self.rows) // len(COLUMNS)

    @property
    def start_s(self):
        return self.rows[len(COLUMNS) - 1]


class _Log:
    """Everything of one vehicle."""

    def __init__(self, name, params):
        self._name = name
        self._max_s, self._max_rows = params.max_s, int(params.keep_s * params.rate_hz)
        self._waiting = deque()  # (time [s], receipt [s], values) of states
        self._stamps = ClockGuard(math.inf)  # theirs; a vehicle may be out of sight for long
        self.references, self.commands = _Track(), _Track()
        self._marks = deque()  # (receipt [s], course, phase) from then on
        self._growing = []
        self._rows = 0
        self.ended = 0
        self._broken = True  # the next row begins a segment

    def mark(self, receipt_s, course, phase):
        if not self._marks or self._marks[-1][1:] != (course, phase):
            self._marks.append((receipt_s, course, phase))

    def restart(self):
        """Forget all that waits: another clock, or the same one turned back."""
        self._stamps.forget()
        self._waiting.clear()
        self.references.clear()
        self.commands.clear()
        last = list(self._marks)[-1:]
        self._marks.clear()
        self._marks.extend((-math.inf,) + mark[1:] for mark in last)
        self._broken = True

    def state(self, time_s, receipt_s, values):
        step = self._stamps.look(time_s)
        if step is Step.REFUSED:
            return
        if step is Step.NEW_CLOCK:
            self.restart()
            self._stamps.look(time_s)
        self._waiting.append((time_s, receipt_s, values))
        self.settle(time_s - _DELAY_S)

    def settle(self, until_s):
        """Make rows of the states up to a time."""
        while self._waiting and self._waiting[0][0] <= until_s:
            time_s, receipt_s, state = self._waiting.popleft()
            while len(self._marks) > 1 and self._marks[1][0] <= receipt_s:
                self._marks.popleft()
            around = self.references.around(time_s)
            if around is None:
                continue
            course = around[0][2] or self._marks[0][1]
            reference = _between(time_s, *around, wrapped=len(around[0][1]) - 1)
            around = self.commands.around(time_s)
            command = _between(time_s, *around) if around else (math.nan, math.nan)
            errors = [want - have for want, have in zip(reference[3:6], state[3:6])]
            row = [*state[:3], *reference[:3], *command, reference[6], *state[6:], *errors, time_s]
            self._append((self._name, course, self._marks[0][2]), row)

    def _append(self, key, row):
        if self._broken or self._growing[-1].key != key or row[-1] - self._growing[-1].start_s >= self._max_s:
            self.ended += bool(self._growing)
            self._growing.append(_Growing(*key))
            self._broken = False
        self._growing[-1].rows.extend(row)
        self._rows += 1
        while self._rows > self._max_rows and len(self._growing) > 1:
            self._rows -= len(self._growing.pop(0))

    def segments(self, growing):
        kept = self._growing if growing else self._growing[:-1]
        return [Segment(*grown.key, np.array(grown.rows).reshape(-1, len(COLUMNS))) for grown in kept]


def _between(time_s, before, after, wrapped=None):
    """Values at a time between two samples; `wrapped`: index of an angle [deg], given back in [-180, 180)."""
    (before_s, first, _), (after_s, last, _) = before, after
    share = (time_s - before_s) / (after_s - before_s) if after_s > before_s else 0.0
    values = [a + share * (b - a) for a, b in zip(first, last)]
    if wrapped is not None:
        turn = (last[wrapped] - first[wrapped] + 180.0) % 360.0 - 180.0
        values[wrapped] = (first[wrapped] + share * turn + 180.0) % 360.0 - 180.0
    return values
