"""Hover throttle as a function of the battery charge, from a recorded flight: least squares, as in thesis 5.2.2.

For every second in which a vehicle hovers or flies slowly

    T_hover = T - ((a + g) / (g cos(phi) cos(theta)) - 1)

with the throttle T that it was sent in [-1, 1], and its vertical acceleration a and tilt from motion capture: this is
how an autopilot in STABILIZE responds to a throttle (eq. 5.5). All seconds at the same percentage of charge form one
point of the fit.
"""

import re
from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial
from scipy.stats import t as student

from data_extraction.bags import Bag, BagError
from data_extraction.progress import bar
from data_extraction.samples import Samples
from risc_lab.frames import GRAVITY_M_S2
from risc_lab.settings import Positive, Settings, between

STATES, EVERYBODYS, _AUTOPILOT = "/cortex_raw", "/controls", "/apm/status"
_CONFIDENCE = 0.95
_GAP_S = 0.1  # of the states, at most
_THROTTLE_S, _BATTERY_S = 0.5, 5.0  # older values are not used
_LOWEST = -0.99  # with a lower throttle it does not fly: it stands on something high or is held in a hand
_PCT_PER_ORDER = 5.0  # a curve of order n needs n times this range of charge
_SHOW_EVERY = 1000  # messages


@dataclass(frozen=True)
class FitParams(Settings):
    """Settings of the fit."""

    order: between(1, 8) = 4  # of the polynomial
    window_s: between(0.2, 10.0) = 1.0  # over which throttle and acceleration are averaged
    min_height_m: Positive = 0.3  # lower, it may stand or be in ground effect
    max_speed_m_s: Positive = 1.0
    max_climb_m_s: Positive = 0.2  # up or down; faster, air drag matters
    max_acceleration_m_s2: Positive = 0.3  # up or down; above, throttle and acceleration are not of the same moment


@dataclass
class HoverPoints:
    """Hover throttle at each percent of charge, in ascending order: arrays (k,)."""

    pct: np.ndarray
    throttle: np.ndarray
    spread: np.ndarray  # standard deviation over the averaged windows; NaN for a single one
    seconds: np.ndarray


@dataclass
class ThrottleFit:
    """T_hover = sum of coefficients[i] * percent^i."""

    points: HoverPoints
    coefficients: np.ndarray  # (order + 1,)
    intervals: np.ndarray  # (order + 1,) half widths, 95 %
    scaled: Polynomial  # the same curve over -1 to 1: raw powers of 100 lose digits
    covariance: np.ndarray  # of the coefficients of `scaled`
    quantile: float  # of Student's t: half width over standard deviation

    @property
    def residuals(self):
        """(k,) residuals of the points."""
        return self.points.throttle - self.scaled(self.points.pct)

    @property
    def rms(self):
        """RMS of the residuals, weighted by duration."""
        return float(np.sqrt(np.average(self.residuals**2, weights=self.points.seconds)))

    def interval(self, pct):
        """Half width of the 95 % band of the curve at percents (n,)."""
        offset, scale = self.scaled.mapparms()
        rows = np.vander(offset + scale * np.asarray(pct), len(self.coefficients), increasing=True)
        return self.quantile * np.sqrt(np.einsum("ni,ij,nj->n", rows, self.covariance, rows))


def hover_points(states, throttle, battery, params):
    """HoverPoints of a flight.

    states: (n, 6) time [s], height [m], climb rate [m/s], speed [m/s], roll, pitch [rad].  throttle: (m, 2) time, T.
    battery: (k, 2) time, percent.  All in the order of time.
    """
    found = defaultdict(list)
    edges = np.arange(states[0, 0], states[-1, 0], params.window_s)
    bounds = (np.searchsorted(states[:, 0], part) for part in (edges[:-1], edges[1:]))
    hovers = [None, *(_hover(states[begin:end], throttle, params) for begin, end in zip(*bounds)), None]
    for k, begin_s in enumerate(edges[:-1], start=1):
        if None in hovers[k - 1 : k + 2]:  # next to a take-off, a landing or a jerk it is not steady yet
            continue
        charge = _held(battery, np.array((begin_s, begin_s + params.window_s)), _BATTERY_S)
        if charge is not None and round(charge[0]) == round(charge[1]):
            found[round(charge[0])].append((charge.mean(), hovers[k]))
    windows = [np.array(found[pct]) for pct in sorted(found)]
    pct, throttle = np.array([part.mean(axis=0) for part in windows]).reshape(-1, 2).T
    spread = [part[:, 1].std(ddof=1) if len(part) > 1 else np.nan for part in windows]
    return HoverPoints(pct, throttle, np.array(spread), params.window_s * np.array([len(part) for part in windows]))


def _hover(window, throttle, params):
    """Hover throttle from one window of states; None when it does not hover, or that is not known."""
    if len(window) < 4 or np.diff(window[:, 0]).max() > _GAP_S or np.ptp(window[:, 0]) < 0.8 * params.window_s:
        return None
    if window[:, 1].min() < params.min_height_m or window[:, 3].max() > params.max_speed_m_s:
        return None
    up_m_s2 = np.polyfit(window[:, 0] - window[0, 0], window[:, 2], 1)[0]
    if abs(window[:, 2].mean()) > params.max_climb_m_s or abs(up_m_s2) > params.max_acceleration_m_s2:
        return None
    sent = _held(throttle, window[:, 0], _THROTTLE_S)
    if sent is None or sent.min() < _LOWEST:
        return None
    lift_g = (1.0 + up_m_s2 / GRAVITY_M_S2) / (np.cos(window[:, 4]) * np.cos(window[:, 5]))
    return np.mean(sent - (lift_g - 1.0))


def _held(samples, times_s, most_s):
    """(n,) the newest value of samples (m, 2) at each time; None if one is missing or older than most_s."""
    rows = np.searchsorted(samples[:, 0], times_s, side="right") - 1
    if rows[0] < 0 or (times_s - samples[rows, 0]).max() > most_s:
        return None
    return samples[rows, 1]


def fit(points, order):
    """ThrottleFit of HoverPoints (at least one). Raises ValueError when they do not determine a curve of that order."""
    count = len(points.pct)
    if count < order + 2 or np.ptp(points.pct) < _PCT_PER_ORDER * order:
        text = (
            "the battery went from %.0f to %.0f %% while it hovered, in %d steps: a curve of order %d needs %g percent "
            "and %d steps. Fly longer, or ask for a lower --order"
        )
        raise ValueError(text % (*points.pct[[-1, 0]], count, order, _PCT_PER_ORDER * order, order + 2))
    domain = points.pct[[0, -1]]
    offset, scale = Polynomial([0.0], domain).mapparms()
    scaled, covariance = np.polyfit(
        offset + scale * points.pct, points.throttle, order, w=np.sqrt(points.seconds), cov=True
    )
    scaled, covariance = scaled[::-1], covariance[::-1, ::-1]
    # column j: the j-th power of the scaled percent in powers of the percent
    powers = [Polynomial([offset, scale]) ** j for j in range(order + 1)]
    to_raw = np.column_stack([np.pad(power.coef, (0, order - j)) for j, power in enumerate(powers)])
    quantile = float(student.ppf(0.5 + 0.5 * _CONFIDENCE, count - order - 1))
    intervals = quantile * np.sqrt(np.diag(to_raw @ covariance @ to_raw.T))
    return ThrottleFit(points, to_raw @ scaled, intervals, Polynomial(scaled, domain), covariance, quantile)


# ------------------------------------------------------------------------------------------------- from a bag


def fit_bag(path, vehicle=None, params=None, progress=None):
    """(name of the vehicle, ThrottleFit) of a bag.

    vehicle: its namespace or mocap template; None = the only one that is flown by throttle.
    Raises BagError for a bag that lacks a topic, ValueError for a flight with too little data.
    """
    params = params or FitParams()
    with Bag(path) as bag:
        material = _Material(bag)
        needs = {
            STATES + " (where it was)": STATES in bag.topics,
            "NAMESPACE/controls (the throttle that it was sent)": material.throttles,
            "NAMESPACE/vehicle_status or NAMESPACE/apm/status (its battery)": material.batteries,
        }
        missing = [text for text, there in needs.items() if not there]
        if missing:
            text = "%s has no %s: record a flight of a vehicle with a throttle (IRIS+) by launch/record.launch; %s"
            raise BagError(text % (bag.path, ", no ".join(missing), bag.contents))
        for number, message in enumerate(bag.messages({STATES, *material.throttles, *material.batteries})):
            material.add(*message)
            if progress and number % _SHOW_EVERY == 0:
                progress.show("reading", bar(bag.fraction(message[1])))
    try:
        name, states, throttle, battery = material.of(vehicle)
        points = hover_points(states, throttle, battery, params)
        if not len(points.pct):
            raise ValueError(
                "in no second was %s seen higher than %g m and slower than %g m/s with a throttle and a "
                "charge: see --min-height and --max-speed" % (name, params.min_height_m, params.max_speed_m_s)
            )
        return name, fit(points, params.order)
    except ValueError as error:
        raise ValueError("%s: %s" % (path, error)) from error


class _Material:
    """Data of a bag about the vehicles that are flown by throttle. Times are those of receipt."""

    def __init__(self, bag):
        kinds = {topic: (kind or "").rpartition("/")[2] for topic, kind in bag.types.items()}
        self.batteries = {
            topic: _BATTERIES[kind, topic.split("/")[-1]]
            for topic, kind in kinds.items()
            if (kind, topic.split("/")[-1]) in _BATTERIES
        }
        self.throttles = [topic for topic, kind in kinds.items() if kind == "Controls" and topic != EVERYBODYS]
        if not self.throttles and {EVERYBODYS, _AUTOPILOT} <= set(kinds):  # the original: one vehicle, no namespace
            self.throttles = [EVERYBODYS]
        self._states, self._sent = defaultdict(lambda: Samples(6)), defaultdict(lambda: Samples(2))
        self._charges = defaultdict(lambda: Samples(2))

    def add(self, topic, receipt_s, message):
        """Take a message."""
        if topic == STATES:
            for entry in message.Obj:
                if entry.visible:
                    speed_m_s = (entry.u**2 + entry.v**2 + entry.w**2) ** 0.5
                    angles_rad = np.radians((entry.phi, entry.theta))
                    self._states[entry.name].append((receipt_s, entry.z, entry.w, speed_m_s, *angles_rad))
        elif topic in self.throttles:
            for entry in message.Obj:
                self._sent[_namespace(topic), entry.name].append((receipt_s, entry.T))
        else:
            charge = self.batteries[topic](message)
            if charge >= 0:  # NaN and -1: none was reported
                self._charges[_namespace(topic)].append((receipt_s, charge))

    def of(self, vehicle):
        """(name, states, throttle, battery) of a vehicle, None = the only one. Raises ValueError."""
        known = [key for key in self._sent if key[0] in self._charges]
        if not known:
            raise ValueError(
                "no vehicle has reported its battery level: is its battery monitor "
                "set up (ArduCopter: BATT_MONITOR, BATT_CAPACITY)?"
            )
        wanted = [key for key in known if vehicle in (None, *key)]
        names = ", ".join("%s (%s)" % (name, namespace) for namespace, name in known)
        if not wanted:
            raise ValueError("no vehicle '%s'; flown by throttle: %s" % (vehicle, names))
        if len(wanted) > 1:
            raise ValueError("which vehicle? Flown by throttle: %s; choose with --vehicle" % names)
        ((namespace, name),) = wanted
        if name not in self._states:
            raise ValueError("%s was never seen on %s" % (name, STATES))
        tables = self._states[name], self._sent[namespace, name], self._charges[namespace]
        return name, *(samples.table() for samples in tables)


# (type of message, last part of the topic) -> the charge [%]
_BATTERIES = {
    ("VehicleStatus", "vehicle_status"): lambda message: message.battery_pct,
    ("Status", "status"): lambda message: message.battery_remaining,
}


def _namespace(topic):
    """/iris1/apm/status -> iris1; /apm/status, /controls -> ""."""
    return re.sub("(controls|vehicle_status|apm/status)$", "", topic).strip("/")
