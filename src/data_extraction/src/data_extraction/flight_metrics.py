"""Metrics of a flight from its bag: tracking errors, lag, latency of every hop, frames lost."""

import math
from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np

from data_extraction.bearing_errors import BearingCollector, BearingStatistics
from data_extraction.flatten import seconds
from data_extraction.recording import ON_COURSE, REFERENCES, STATES, TRUTH, Recording, Series, best_shift
from data_extraction.report.recorded_topics import Collector, vehicle_of
from data_extraction.samples import Arrivals
from risc_control.safety import FailsafeLevel
from risc_control.vehicles import adapter_class
from risc_lab.lab.arena import Arena
from risc_lab.lab.fleet import laboratory_vehicles
from risc_lab.phases import OperatorPhase

SETTLED_ERROR_M = 0.05  # settled: the position error stays below this ...
SETTLED_HOLD_S = 1.0  # ... for this long
GRID_HZ = 200.0
MOST_ROWS = 360_000  # of one vehicle's positions: half an hour at 200 Hz; longer bags are thinned out evenly
PATH_ROWS = 5000  # of a path that is only drawn

# The hops, in order: each is the time from receipt of the datagram to the arrival, at a subscriber, of the message that
# answers the frame; for commands, to their sending, by the clock of the computer that flies.
# `exposure_to_datagram` is the camera system's own delay.
HOPS = {
    "exposure_to_datagram": "exposure to datagram (the camera system itself)",
    "datagram_to_mocap_data": "datagram to /mocap_data",
    "datagram_to_cortex_raw": "datagram to /cortex_raw",
    "datagram_to_controls": "datagram to /controls",
    "datagram_to_cmd_vel": "datagram to the command sent to the vehicle",  # on cmd_vel, of an AR.Drone
}
_ANSWERS = ("/mocap_data", STATES, "/controls")
_POSE = ("x", "y", "z", "psi")
PERCENTS = {"p50": 50, "p99": 99, "max": 100}


@dataclass
class VehicleFlight:
    """One vehicle: desired and actual path, on one time grid."""

    t_s: np.ndarray  # (n,) [s] since the first reference
    desired_m: np.ndarray  # (n, 3) cortex frame
    actual_m: np.ndarray  # (n, 3) cortex frame
    desired_psi_rad: np.ndarray  # (n,)
    actual_psi_rad: np.ndarray  # (n,)
    course: np.ndarray  # (n,) bool: on the course, neither going there nor home
    settle_s: float | None = None  # [s] from the start of the course; None = never settled
    position_rmse_m: float | None = None  # over the course after settling
    position_max_m: float | None = None
    yaw_rmse_rad: float | None = None
    lag_s: float | None = None  # delay of the actual path that explains it best

    @property
    def error_m(self):
        """(n,) distance [m] between the desired and the actual position at the same time."""
        return np.linalg.norm(self.actual_m - self.desired_m, axis=1)

    @property
    def judged(self):
        """(n,) bool: on the course and settled; what the figures are computed from."""
        if self.settle_s is None or not self.course.any():
            return np.zeros(len(self.t_s), dtype=bool)
        return self.course & (self.t_s >= self.t_s[self.course][0] + self.settle_s)


@dataclass
class Mocap:
    """Frames of the motion capture stream."""

    frames_sent: int = 0  # from the frame numbers of the stream
    frames_received: int = 0
    frames_estimated: int = 0  # frames that have their states on /cortex_raw
    rate_hz: float = 0.0


@dataclass
class Flight:
    """Everything the figures and plots are made from."""

    start_s: float | None  # ROS time of the first reference; None = there was none
    vehicles: dict[str, VehicleFlight]
    latency_s: dict[str, np.ndarray]  # {hop: (n,) [s]}
    mocap: Mocap
    judged_against: str  # "ground truth" or "mocap"
    bearings: BearingStatistics | None = None  # None without bearings
    paths: dict[str, Series] = field(default_factory=dict)  # x, y, z [m], yaw [rad] of all that was seen, for drawing
    landmarks: dict[str, np.ndarray] = field(default_factory=dict)  # (3,) [m] cortex frame
    command_latency_s: dict[str, np.ndarray] = field(default_factory=dict)  # {topic of commands: (n,) [s]}
    arena: Arena = Arena()
    notes: list[str] = field(default_factory=list)  # what could not be evaluated, and why


class FlightCollector(Collector):
    """Takes the messages of a bag one by one, keeps what `Flight` needs: 8 bytes a number, up to a limit."""

    topics = ("/mocap_time", "/operator/phase", "/operator/result", REFERENCES, TRUTH, *_ANSWERS)
    ends = ("/commands_sent", "/cmd_vel_stamped", "/trajectory_phase", "/safety")

    def __init__(self, fleet=None, bearing_delay_s=0.0, with_bearings=True):
        """fleet: risc_lab.lab.Fleet, None = the original laboratory's. Raises ValueError, from BearingCollector.

        bearing_delay_s: how much later than their exposure pictures are stamped. with_bearings: False saves the memory
        for every pose when the bag is known to hold no bearings.
        """
        self._arena = fleet.arena if fleet else Arena()
        self._bearings = BearingCollector(fleet)
        self._bearing_delay_s = bearing_delay_s
        self._with_bearings = with_bearings
        self._recording = Recording(dict.fromkeys((REFERENCES, STATES, TRUTH), _POSE), MOST_ROWS)
        # The estimator repeats its last stamp, invisible, when the cameras fall silent: the first arrival counts.
        self._arrivals = {topic: Arrivals() for topic in _ANSWERS}
        self._commands = defaultdict(Arrivals)  # topic of commands -> stamps of the states that they answer, when sent
        vehicles = fleet.vehicles if fleet else laboratory_vehicles()
        self._namespaces = {vehicle.template: vehicle.namespace for vehicle in vehicles}
        self._sent_on = {v.template: "/%s/%s" % (v.namespace, adapter_class(v.vehicle_type).COMMANDS) for v in vehicles}
        self._landed_s = {}  # namespace -> when its ladder began to land it
        self._receipts = Arrivals()  # of the datagrams
        self._frames = Arrivals()  # the same stamps with frame numbers in place of receipts
        # Programs start before the operator's first phase that is not waiting, and end after its result.
        self._begun_s, self._over_s, self._waited_s = -np.inf, np.inf, -np.inf

    def __call__(self, topic, receipt_s, message):
        """Take one message; topics that are not needed are ignored."""
        if self._with_bearings or topic not in (STATES, TRUTH):
            self._bearings(topic, receipt_s, message)
        if topic in self._recording.topics:
            self._recording.add(topic, receipt_s, seconds(message.header.stamp), message.Obj)
        if topic in _ANSWERS:
            self._arrivals[topic].append(message.header.stamp, receipt_s)
        elif topic == "/mocap_time":
            self._receipts.append(message.header.stamp, seconds(message.receipt))
            self._frames.append(message.header.stamp, message.frame)
        elif topic == "/commands_sent":
            for command in message.commands:
                if command.answers.sec:
                    topic = self._sent_on.get(command.name) or "/%s/cmd_vel" % command.name
                    self._commands[topic].append(command.answers, seconds(command.sent))
        elif topic.endswith("/cmd_vel_stamped"):  # in older bags: the stamp answered, and the time of receipt
            if message.header.stamp.sec:
                self._commands[topic].append(message.header.stamp, receipt_s)
        elif topic.endswith("/safety"):
            if message.level == FailsafeLevel.LAND:
                self._landed_s.setdefault(vehicle_of(topic), receipt_s)
        elif topic.endswith("trajectory_phase"):
            self._recording.phases(receipt_s, message)
        elif topic == "/operator/phase":
            if message.phase == OperatorPhase.WAITING:  # earlier phases are of another flight
                self._begun_s, self._over_s, self._waited_s = -np.inf, np.inf, seconds(message.header.stamp)
            elif self._begun_s == -np.inf:
                self._begun_s = receipt_s
        elif topic == "/operator/result" and seconds(message.header.stamp) >= self._waited_s:
            self._over_s = min(self._over_s, receipt_s)

    def wants(self, topic):
        """Whether messages of this topic are used."""
        return super().wants(topic) or self._bearings.wants(topic)

    def flight(self, strict=True):
        """Evaluate what was collected. Raises ValueError when the bag holds no flight.

        strict: False = accept any bag; what cannot be evaluated is left out and named in the notes.
        """
        recording, notes = self._recording, []
        source = TRUTH if recording.parts(TRUTH) else STATES
        states = recording.parts(source)
        references = recording.parts(REFERENCES, states)
        if not references:
            notes.append("there is no /trajectory in the bag, so the errors of the vehicles are unknown: record it")
        unknown = sorted(set(references) - set(states))
        if unknown:
            notes.append("%s never shows %s, which /trajectory names" % (source, ", ".join(unknown)))
        if strict and notes:
            raise ValueError("; ".join(notes))
        every = max((samples.every for [(_, samples)] in states.values()), default=1)
        if every > 1:
            notes.append("the bag is long: one of %d positions was used" % every)
        if recording.by_place(REFERENCES, states) and not unknown:
            notes.append(
                "/trajectory names courses, not vehicles (%s): references go to vehicles by their place, as in the "
                "original release" % ", ".join(sorted({label for parts in references.values() for label, _ in parts}))
            )
        if recording.unstamped:
            topics = ", ".join(sorted(recording.unstamped))
            notes.append("%s has no stamps: times are those of receipt, of the positions too" % topics)
        known = {name: references[name] for name in states if name in references}
        firsts = (samples.first[recording.clock] for parts in known.values() for _, samples in parts)
        start_s = min(firsts, default=None)
        whole = not strict and not recording.has_phases
        vehicles, paths = {}, {}
        for name, parts in sorted(states.items()):  # one at a time, so that only one is in memory as a whole
            actual = recording.series(parts)
            actual.values[:, 3] = np.unwrap(np.radians(actual.values[:, 3]))
            paths[name] = actual.thinned(PATH_ROWS)
            if name not in known:
                continue
            desired = recording.series(known[name])
            desired.values[:, 3] = np.unwrap(desired.values[:, 3])
            try:
                vehicles[name] = evaluate(desired, actual, None if whole else self._on_course(name), start_s)
            except ValueError as error:
                if strict:
                    raise
                notes.append("%s: %s" % (name, error))
        if vehicles and whole:
            notes.append("there is no /trajectory_phase in the bag: all of the time with a reference was judged")
        stamps_ns, receipts_s = self._receipts.first()
        hops_s = {"exposure_to_datagram": receipts_s - 1e-9 * stamps_ns}
        for topic, arrivals in self._arrivals.items():
            hops_s["datagram_to_" + topic.strip("/")] = arrivals.since_s(self._receipts)
        commands_s = {topic: self._commands[topic].since_s(self._receipts) for topic in sorted(self._commands)}
        hops_s["datagram_to_cmd_vel"] = np.concatenate([np.zeros(0), *commands_s.values()])
        return Flight(
            start_s=start_s,
            vehicles=vehicles,
            latency_s=hops_s,
            command_latency_s=commands_s,
            mocap=self._mocap(),
            judged_against="ground truth" if source == TRUTH else "mocap",
            bearings=self._bearings.statistics(self._bearing_delay_s),
            paths=paths,
            landmarks=self._bearings.landmarks(),
            arena=self._arena,
            notes=notes,
        )

    def _on_course(self, name):
        """Function of times (n,): True where the trajectory node says that the vehicle is on its course and its ladder
        has not begun to land it.
        """
        landed_s = self._landed_s.get(self._namespaces.get(name, name), np.inf)
        return lambda t_s: (self._recording.told(name, t_s)[1] == ON_COURSE) & (t_s < landed_s)

    def _mocap(self):
        """Count frames from the beginning of the flight to its result only: outside it nodes start and stop."""
        stamps_ns, numbers = self._frames.first()
        estimated_ns, _ = self._arrivals[STATES].first()
        estimated_ns = estimated_ns[(estimated_ns >= 1e9 * self._begun_s) & (estimated_ns < 1e9 * self._over_s)]
        if not len(estimated_ns):
            return Mocap()
        within = (stamps_ns >= estimated_ns[0]) & (stamps_ns <= estimated_ns[-1])
        stamps_ns, numbers = stamps_ns[within], numbers[within]
        if len(stamps_ns) < 2:
            return Mocap(frames_received=len(stamps_ns))
        span = int(numbers.max() - numbers.min())
        return Mocap(
            frames_sent=span + 1,
            frames_received=len(np.unique(numbers)),
            frames_estimated=int(np.isin(stamps_ns, estimated_ns, assume_unique=True).sum()),
            rate_hz=1e9 * span / float(stamps_ns[-1] - stamps_ns[0]),
        )


def percentiles_ms(latency_s, percents=PERCENTS):
    """{name: percentile [ms]} of latencies [s]; None each when there are none."""
    if len(latency_s) == 0:
        return dict.fromkeys(percents)
    return dict(zip(percents, np.percentile(1e3 * latency_s, list(percents.values())).tolist()))


def best_fit_lag(t_s, desired, actual, limit_s=0.5):
    """Lag [s] for which desired(t - lag) is nearest to actual(t) in the mean square; None when nothing moves.

    t_s: (n,) uniform times [s]; desired, actual: (n, k) in any one unit.
    """
    reference = Series(t_s, desired)
    if np.all(np.ptp(desired, axis=0) < 1e-3):
        return None

    def mean_square(lag_s):
        difference = reference.at(t_s - lag_s) - actual
        return float(np.nanmean(difference**2))

    return best_shift(mean_square, np.linspace(-limit_s, limit_s, 41))[0]


def settling_time(t_s, error, limit=SETTLED_ERROR_M, hold_s=SETTLED_HOLD_S):
    """Seconds from t_s[0] until `error` stays below `limit` for `hold_s`; None when it never does.

    t_s: (n,) [s]; error: (n,) in the unit of limit.
    """
    above = np.flatnonzero(~(error < limit))
    begins = np.concatenate(([0], above + 1))
    ends = np.concatenate((above, [len(error)]))
    for begin, end in zip(begins, ends):
        if end > begin and t_s[end - 1] - t_s[begin] >= hold_s:
            return float(t_s[begin] - t_s[0])
    return None


def evaluate(desired, actual, on_course, start_s):
    """Return the VehicleFlight of a desired and an actual Series of x, y, z [m], yaw [rad].

    on_course: function of times (n,) that says whether the vehicle is on its course; None = always.
    start_s: time [s] that becomes 0. Raises ValueError when the two have no time in common.
    """
    begin_s, end_s = max(desired.t_s[0], actual.t_s[0]), min(desired.t_s[-1], actual.t_s[-1])
    step_s = max(1.0 / GRID_HZ, (end_s - begin_s) / MOST_ROWS)
    # not np.arange(begin, end, step): it rounds the step to the precision of the stamps, and the error adds up
    grid_s = begin_s + step_s * np.arange(max(0, math.floor((end_s - begin_s) / step_s) + 1))
    grid_s = grid_s[grid_s <= end_s]
    if len(grid_s) < 2:
        raise ValueError("the bag is too short: at no time are both a reference and a position known")
    want, have = desired.at(grid_s), actual.at(grid_s)
    course = np.ones(len(grid_s), dtype=bool) if on_course is None else on_course(grid_s)
    vehicle = VehicleFlight(grid_s - start_s, want[:, :3], have[:, :3], want[:, 3], have[:, 3], course)
    if course.any():
        vehicle.settle_s = settling_time(vehicle.t_s[course], vehicle.error_m[course])
    judged = vehicle.judged
    if judged.any():
        vehicle.position_rmse_m = float(np.sqrt(np.mean(vehicle.error_m[judged] ** 2)))
        vehicle.position_max_m = float(vehicle.error_m[judged].max())
        yaw_error = np.angle(np.exp(1j * (want[judged, 3] - have[judged, 3])))
        vehicle.yaw_rmse_rad = float(np.sqrt(np.mean(yaw_error**2)))
        vehicle.lag_s = best_fit_lag(vehicle.t_s[judged], vehicle.desired_m[judged], vehicle.actual_m[judged])
    return vehicle
