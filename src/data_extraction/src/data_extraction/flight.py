"""What a bag says about a flight: tracking errors, lag, latency of every hop, frames lost."""

from dataclasses import dataclass, field
from typing import Dict, List, Optional

import numpy as np
from scipy.optimize import minimize_scalar

from data_extraction.bearings import BearingCollector, BearingStatistics
from data_extraction.flatten import seconds

SETTLED_ERROR_M = 0.05  # settled: the position error stays below this ...
SETTLED_HOLD_S = 1.0  # ... for this long
GRID_HZ = 200.0

# Order and meaning of the hops: each is the time from the datagram's receipt to the arrival of the message that
# answers the frame, at a subscriber of that topic. `exposure_to_datagram` is the camera system's own delay.
HOPS = ("exposure_to_datagram", "datagram_to_mocap_data", "datagram_to_cortex_raw", "datagram_to_controls",
        "datagram_to_cmd_vel")  # fmt: skip


@dataclass
class Series:
    """Samples of one quantity over time."""

    t_s: np.ndarray  # (n,) [s]
    values: np.ndarray  # (n, k)

    def at(self, t_s):
        """Values interpolated at times t_s (m,). Returns (m, k); NaN outside the recorded time."""
        return np.column_stack(
            [np.interp(t_s, self.t_s, column, left=np.nan, right=np.nan) for column in self.values.T]
        )


@dataclass
class VehicleFlight:
    """One vehicle: where it should have been and where it was, on one time grid."""

    t_s: np.ndarray  # (n,) [s] since the first reference
    desired_m: np.ndarray  # (n, 3) cortex frame
    actual_m: np.ndarray  # (n, 3) cortex frame
    desired_psi_rad: np.ndarray  # (n,)
    actual_psi_rad: np.ndarray  # (n,)
    course: np.ndarray  # (n,) bool: on the course, neither going there nor home
    settle_s: Optional[float] = None  # [s] from the start of the course; None = never settled
    position_rmse_m: Optional[float] = None  # over the course after settling
    position_max_m: Optional[float] = None
    yaw_rmse_rad: Optional[float] = None
    lag_s: Optional[float] = None  # delay of the actual path that explains it best

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

    frames_sent: int = 0  # from the wire's frame numbers
    frames_received: int = 0
    frames_estimated: int = 0  # frames that have their states on /cortex_raw
    rate_hz: float = 0.0


@dataclass
class Flight:
    """Everything the figures and plots are made from."""

    start_s: float  # ROS time of the first reference
    vehicles: Dict[str, VehicleFlight]
    latency_s: Dict[str, np.ndarray]  # {hop: (n,) [s]}
    mocap: Mocap
    judged_against: str  # "ground truth" or "mocap"
    events: List[str] = field(default_factory=list)
    bearings: Optional[BearingStatistics] = None  # None when nothing looked


class FlightCollector:
    """Takes the messages of a bag one by one, keeps what `Flight` needs."""

    def __init__(self, fleet=None, bearing_delay_s=0.0):
        """fleet: risc_control.lab.Fleet, None = the original laboratory's. Raises ValueError, from BearingCollector.

        bearing_delay_s: how much later than their exposure pictures are stamped.
        """
        self._bearings = BearingCollector(fleet)
        self._bearing_delay_s = bearing_delay_s
        self._desired = {}
        self._states = {"/cortex_raw": {}, "/ground_truth": {}}
        # First arrival of each stamp: the estimator repeats its last one, invisible, when the cameras fall silent.
        self._arrival = {"/mocap_data": {}, "/cortex_raw": {}, "/controls": {}, "cmd_vel": {}}
        self._receipt = {}  # {exposure stamp: receipt of the datagram}
        self._frames = {}  # {exposure stamp: frame number}
        self._phases = []
        self._events = []

    def __call__(self, topic, receipt_s, message):
        """Take one message; topics that are of no interest are passed over."""
        self._bearings(topic, receipt_s, message)
        if topic == "/trajectory":
            stamp = seconds(message.header.stamp)
            for reference in message.Obj:
                row = (stamp, reference.x, reference.y, reference.z, reference.psi)
                self._desired.setdefault(reference.name, []).append(row)
        elif topic in self._states:
            stamp = seconds(message.header.stamp)
            for state in message.Obj:
                if state.visible:
                    row = (stamp, state.x, state.y, state.z, np.radians(state.psi))
                    self._states[topic].setdefault(state.name, []).append(row)
            if topic in self._arrival:
                self._arrival[topic].setdefault(_key(message), receipt_s)
        elif topic in self._arrival:
            self._arrival[topic].setdefault(_key(message), receipt_s)
        elif topic == "/mocap_time":
            self._receipt[_key(message)] = seconds(message.time_ref)
            self._frames[_key(message)] = int(message.source)
        elif topic.endswith("/cmd_vel_stamped"):
            if _key(message) != (0, 0):
                self._arrival["cmd_vel"].setdefault((topic, _key(message)), receipt_s)
        elif topic.endswith("trajectory_phase"):
            self._phases.append((receipt_s, message.data))
        elif topic == "/operator/phase" or topic.endswith("/safety"):
            self._events.append("%.3f %s %s" % (receipt_s, topic, message.data))

    def flight(self):
        """Evaluate what was collected. Raises ValueError when the bag holds no flight."""
        if not self._desired:
            raise ValueError("there is no /trajectory in the bag: nothing was to be flown")
        source = "/ground_truth" if self._states["/ground_truth"] else "/cortex_raw"
        states = self._states[source]
        missing = sorted(set(self._desired) - set(states))
        if missing:
            raise ValueError("%s never shows %s, which /trajectory names" % (source, ", ".join(missing)))
        start_s = min(rows[0][0] for rows in self._desired.values())
        vehicles = {
            name: _evaluate(_series(rows), _series(states[name]), self._course_spans(name), start_s)
            for name, rows in sorted(self._desired.items())
        }
        return Flight(
            start_s=start_s,
            vehicles=vehicles,
            latency_s=self._latencies(),
            mocap=self._mocap(),
            judged_against="ground truth" if source == "/ground_truth" else "mocap",
            events=self._events,
            bearings=self._bearings.statistics(self._bearing_delay_s),
        )

    def _course_spans(self, name):
        """[(begin, end)] of receipt times during which the trajectory node said that the vehicle is on its course."""
        spans, begin = [], None
        for receipt_s, text in self._phases:
            phase = dict(_phase_entries(text)).get(name)
            if phase == "course" and begin is None:
                begin = receipt_s
            elif phase is not None and phase != "course" and begin is not None:
                spans.append((begin, receipt_s))
                begin = None
        if begin is not None:
            spans.append((begin, np.inf))
        return spans

    def _latencies(self):
        receipt = self._receipt
        latency = {"exposure_to_datagram": [time - (s + 1e-9 * ns) for (s, ns), time in receipt.items()]}
        for hop, topic in zip(HOPS[1:4], ("/mocap_data", "/cortex_raw", "/controls")):
            latency[hop] = [time - receipt[key] for key, time in self._arrival[topic].items() if key in receipt]
        latency["datagram_to_cmd_vel"] = [
            time - receipt[key] for (_, key), time in self._arrival["cmd_vel"].items() if key in receipt
        ]
        return {hop: np.array(values) for hop, values in latency.items()}

    def _mocap(self):
        """Frames from the first to the last that was estimated: before and after, the nodes come and go."""
        estimated = self._arrival["/cortex_raw"]
        first, last = min(estimated, default=(0, 0)), max(estimated, default=(0, 0))
        frames = {key: number for key, number in self._frames.items() if first <= key <= last}
        if len(frames) < 2:
            return Mocap(frames_received=len(frames))
        numbers = np.array(list(frames.values()))
        stamps = np.array([s + 1e-9 * ns for s, ns in frames])
        span = int(numbers.max() - numbers.min())
        return Mocap(
            frames_sent=span + 1,
            frames_received=len(np.unique(numbers)),
            frames_estimated=sum(key in estimated for key in frames),
            rate_hz=span / float(stamps.max() - stamps.min()),
        )


def percentiles_ms(latency_s):
    """{'p50', 'p99', 'max'} [ms] of latencies [s]; None each when there are none."""
    if len(latency_s) == 0:
        return {"p50": None, "p99": None, "max": None}
    p50, p99, largest = np.percentile(1e3 * latency_s, [50, 99, 100])
    return {"p50": float(p50), "p99": float(p99), "max": float(largest)}


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

    lags_s = np.linspace(-limit_s, limit_s, 41)
    start = lags_s[int(np.argmin([mean_square(lag_s) for lag_s in lags_s]))]
    step = lags_s[1] - lags_s[0]
    return float(minimize_scalar(mean_square, bounds=(start - step, start + step), method="bounded").x)


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


def _key(message):
    return message.header.stamp.sec, message.header.stamp.nanosec


def _phase_entries(text):
    """('fluffy_II', 'course'), ... of 'fluffy_II: course; Raven: hold' (also one a line)."""
    for entry in text.replace("\n", ";").split(";"):
        name, _, phase = entry.partition(":")
        if phase:
            yield name.strip(), phase.strip()


def _series(rows):
    """Series of (stamp, x, y, z, psi) rows, in the order of time, yaw unwrapped."""
    table = np.array(rows)
    _, first = np.unique(table[:, 0], return_index=True)
    table = table[first]
    table[:, 4] = np.unwrap(table[:, 4])
    return Series(table[:, 0], table[:, 1:])


def _evaluate(desired, actual, spans, start_s):
    grid_s = np.arange(max(desired.t_s[0], actual.t_s[0]), min(desired.t_s[-1], actual.t_s[-1]), 1.0 / GRID_HZ)
    if len(grid_s) < 2:
        raise ValueError("the bag is too short: there is no time at which both a reference and a position are known")
    want, have = desired.at(grid_s), actual.at(grid_s)
    course = np.zeros(len(grid_s), dtype=bool)
    for begin_s, end_s in spans:
        course |= (grid_s >= begin_s) & (grid_s < end_s)
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
