"""Separation of the vehicles of a fleet: which must hold, and where they move to avoid others. No ROS.

Every vehicle node takes the states of all vehicles (/cortex_raw) and the references of all (/trajectory), and works out
for all of them which hold. The same messages give the same result in every node: vehicles that fly together stop
together, and of two that are too near one climbs and the other one sinks.

A vehicle holds when a neighbour
- is nearer than `separation_m`, or will be within `separation_lookahead_s` at present velocities; of two that follow
  their references within `separation_follow_s`, and by the accelerations of the references as well,
- is or will be nearer than `separation_stray_m` and has left its course: it followed its reference and will be farther
  than `separation_course_m` from it within `separation_follow_s`,
- is or will be as near as that and has not been seen for `state_land_s`, so that its own ladder lands it,
- is or will be as near as that and holds. One vehicle of a fleet that stops is in the way of the next, and so on.
  Nodes know it at once (`tell`): each hears the safety topics of the others' vehicles. If one is not heard (an older
  node, a lost network), its hold is noticed from its states half a second later.

A vehicle that is not seen is assumed to stay where it was seen last, for `separation_forget_s`, and anywhere below,
since it comes down there; it may also have flown on for a while. One that is not seen, and reports that it stands, is
on the floor. A vehicle on the floor makes no other hold; landing on it is prevented separately (`Look.above`).

Distances are between centres, and set for two AR.Drones. Vehicles that reach farther (`radius_m` of the type) are kept
as much farther apart: everywhere here a distance is reduced by what the two reach farther (`wider_m`), so that the same
gap is left between their hulls. Two IRIS+ hold at `separation_m` + 0.30 m.

Positions and velocities: cortex frame, z up. Times: one monotonic clock.
"""

import enum
import math
from typing import NamedTuple

import numpy as np

from risc_lab.compiled import compiled, record
from risc_lab.states import AIRBORNE_M, S

_REFERENCE_S = 0.5  # [s] a reference older or newer than the position by more is not compared with it
_LEVEL_M = 0.05  # vehicles whose heights differ by less: the order of the fleet decides which is the upper one
_PIECES = 4  # straight pieces of a curved path
_FLOOR_M = AIRBORNE_M + 0.2  # no vehicle is sent down below this
_STOPS_S = 0.5  # times the speed of moving apart: margin to the room's sides within which none is sent on
_STILL = (0.0, 0.0, 0.0)
_TURNS_RAD = tuple(math.radians(turn_deg) for turn_deg in (0.0, 45.0, -45.0, 90.0, -90.0))  # of ways aside
_BESIDE = 1.4  # times separation_m (of two AR.Drones): distance from a vehicle below at which one may land


class Cause(enum.IntEnum):
    """Why a vehicle holds, by the state of its neighbour."""

    NEAR, STRAYS, UNSEEN, HOLDS = range(4)


_TEXTS = {
    Cause.NEAR: "{distance:.2f} m from {name}",
    Cause.STRAYS: "{distance:.2f} m from {name}, which has left its course",
    Cause.UNSEEN: "{distance:.2f} m from {name}, not seen for {unseen:.1f} s",
    Cause.HOLDS: "{distance:.2f} m from {name}, which holds",
}

_VEHICLE = record(
    ("position_m", float, (3,)),
    ("velocity_m_s", float, (3,)),
    ("seen_s", float),  # -inf: never
    ("reference_m", float, (3,)),
    ("reference_m_s", float, (3,)),
    ("reference_m_s2", float, (3,)),
    ("referred_s", float),  # -inf: never
    ("order", int),  # in the fleet
    ("wider_m", float),  # than an AR.Drone, from its centre
    ("on_course", bool),  # it has been at its reference since the reference last jumped
    ("follows", bool),
    ("strays", bool),
    ("holds", bool),
    ("told", bool),  # its own node holds or lands it, for a reason other than its neighbours
    ("stands", bool),  # by its own report
    ("neighbour", int),  # that makes it hold: the one that is inside its limit by most
    ("cause", int),
)
_OF_SAFETY = (  # fields of SafetyLimits
    *("state_hold_s", "state_land_s", "separation_m", "separation_stray_m", "separation_course_m"),
    *("separation_lookahead_s", "separation_follow_s", "separation_forget_s", "separation_speed_m_s"),
)
# These fields, and the room to move in.
_LIMITS = record(" ".join(_OF_SAFETY), ("low_m", float, (3,)), ("high_m", float, (3,)))


class Look(NamedTuple):
    """What one vehicle has to do about the others."""

    holds: bool = False
    reason: str = ""  # why, in a few words, with the numbers of the moment
    climb: int = 0  # holding is not enough: +1 climb, -1 sink
    above: bool = False  # another one is straight below: it must not land now,
    aside: tuple = (0.0, 0.0)  # but go there first: unit vector (x, y); 0 where others or the net are in the way
    joins: bool = False  # it holds only because others do


ALONE = Look()


class Separation:
    """The fleet as seen by a node that flies some of its vehicles. One thread at a time."""

    def __init__(self, own, limits, fleet=(), wider_m=None):
        """own: names of the node's vehicles.  limits: SafetyLimits.  fleet: names of all vehicles in the order that
        decides ties; () when no fleet is known: every name in the states is a vehicle, in the order of the names.
        wider_m: {name: how much farther it reaches than an AR.Drone [m]}; 0 for names that are not there.
        """
        self._own, self._fleet, self._wider_m = tuple(own), tuple(fleet), wider_m or {}
        self._on = limits.ladder and limits.separation_m > 0.0
        self._course_m, self._unseen_s = limits.separation_course_m, limits.state_land_s
        self._limits = np.zeros(1, _LIMITS)  # a record would take a microsecond longer to pass
        for name in _OF_SAFETY:
            self._limits[name] = getattr(limits, name)
        margin_m = _STOPS_S * limits.separation_speed_m_s
        low_m, high_m = np.transpose(limits.room_m)
        self._limits["low_m"] = np.maximum(low_m + margin_m, (-np.inf, -np.inf, _FLOOR_M))
        self._limits["high_m"] = high_m - margin_m
        self._names, self._index = [], {}
        self._vehicles = np.zeros(0, _VEHICLE)
        self._rows = {}  # {names of a message: row of each}
        self._add([*self._fleet, *self._own])
        self._own_rows = [self._index[name] for name in self._own]
        self._alert_s = -math.inf  # when any vehicle held last
        self._alert_lasts_s = 2.0 * limits.separation_wait_s
        rows = np.zeros(0, np.int64)  # to load the compiled code
        _see(self._vehicles, rows, np.zeros(0, bool), np.zeros((0, len(S))), 0.0)
        _refer(self._vehicles, rows, np.zeros((0, 3, 4)), 0.0, 1.0)
        _judge(self._vehicles, self._apart_m, 0.0, self._limits)
        _avoid(self._vehicles, 0, 0.0, self._limits)

    def see(self, names, visible, states, seen_s):
        """States of some vehicles. visible: (n,) bool.  states: (n, 12), columns `S` (angles are not used)."""
        rows = self._rows_of(names)  # first: it may add vehicles
        _see(self._vehicles, rows, visible, states, seen_s)

    def refer(self, names, derivatives, referred_s):
        """References of some vehicles. derivatives: (n, 3, 4) position, velocity, acceleration of x, y, z, psi."""
        rows = self._rows_of(names)
        _refer(self._vehicles, rows, derivatives, referred_s, self._course_m)

    def tell(self, holding, standing=()):
        """holding: names of the vehicles that hold or land for a reason other than their neighbours, as their nodes
        report before it can be seen.  standing: of those that report that they stand.
        """
        self._vehicles["told"] = [name in holding for name in self._names]
        self._vehicles["stands"] = [name in standing for name in self._names]

    def look(self, now_s):
        """{name: Look} of the own vehicles that have to do something; the others are `ALONE`."""
        if not self._on:
            return {}
        if _judge(self._vehicles, self._apart_m, now_s, self._limits):
            self._alert_s = now_s
        if now_s - self._alert_s > self._alert_lasts_s:  # until then those that held may still be landing beside others
            return {}
        looks = {}
        for i, name in zip(self._own_rows, self._own):
            climb, above, aside = _avoid(self._vehicles, i, now_s, self._limits)
            holds = bool(self._vehicles["holds"][i])
            if holds or above:
                reason = self._reason(self._vehicles[i], now_s) if holds else ""
                joins = holds and self._vehicles["cause"][i] == Cause.HOLDS
                looks[name] = Look(holds, reason, climb, above, aside, joins)
        return looks

    def nearest(self, name, now_s):
        """(distance less what the two reach farther [m], name) of the vehicle nearest to an own one; None: none is
        seen.
        """
        one, found = self._vehicles[self._index[name]], []
        for other, its_name in zip(self._vehicles, self._names):
            if its_name != name and now_s - other.seen_s <= self._unseen_s:
                apart_m = math.dist(one["position_m"], other["position_m"]) - one["wider_m"] - other["wider_m"]
                found.append((apart_m, its_name))
        return min(found, default=None)

    def _reason(self, vehicle, now_s):
        other = self._vehicles[vehicle["neighbour"]]
        return _TEXTS[Cause(vehicle["cause"])].format(
            distance=math.dist(vehicle["position_m"], other["position_m"]),
            name=self._names[vehicle["neighbour"]],
            unseen=now_s - other["seen_s"],
        )

    def _rows_of(self, names):
        rows = self._rows.get(names)
        if rows is None:
            if not self._fleet and any(name not in self._index for name in names):
                self._add(names)
                self._rows.clear()
            if len(self._rows) > 64:  # names that change all the time are not of one flight
                self._rows.clear()
            rows = self._rows[names] = np.array([self._index.get(name, -1) for name in names], np.int64)
        return rows

    def _add(self, names):
        new = [name for name in dict.fromkeys(names) if name not in self._index]
        self._index.update({name: len(self._names) + k for k, name in enumerate(new)})
        self._names += new
        vehicles = np.zeros(len(self._names), _VEHICLE)
        vehicles["seen_s"] = vehicles["referred_s"] = -math.inf
        vehicles[: len(self._vehicles)] = self._vehicles
        vehicles["wider_m"] = [self._wider_m.get(name, 0.0) for name in self._names]
        self._vehicles = vehicles
        self._apart_m = np.zeros((len(vehicles), len(vehicles)))
        order = {name: k for k, name in enumerate(self._fleet or sorted(self._names))}
        # an own vehicle that is not in the fleet comes after those that are
        vehicles["order"] = [order.get(name, len(order) + k) for k, name in enumerate(self._names)]


@compiled
def _see(vehicles, rows, visible, states, seen_s):
    for k in range(len(rows)):
        if rows[k] < 0 or not visible[k] or not math.isfinite(states[k, :6].sum()):
            continue
        vehicle = vehicles[rows[k]]
        vehicle.position_m[:], vehicle.velocity_m_s[:] = states[k, :3], states[k, 3:6]
        vehicle.seen_s = seen_s


@compiled
def _refer(vehicles, rows, derivatives, referred_s, course_m):
    for k in range(len(rows)):
        if rows[k] < 0 or not math.isfinite(derivatives[k, :, :3].sum()):
            continue
        vehicle = vehicles[rows[k]]
        # A vehicle that is sent elsewhere by a jump of its reference has not left its course.
        step_s, square = referred_s - vehicle.referred_s, 0.0
        for axis in range(3):
            went_m = derivatives[k, 0, axis] - vehicle.reference_m[axis]
            if 0.0 <= step_s < _REFERENCE_S:
                went_m -= 0.5 * step_s * (derivatives[k, 1, axis] + vehicle.reference_m_s[axis])
            square += went_m * went_m
        if square > 0.25 * course_m * course_m:
            vehicle.on_course = False
        vehicle.reference_m[:], vehicle.reference_m_s[:] = derivatives[k, 0, :3], derivatives[k, 1, :3]
        vehicle.reference_m_s2[:], vehicle.referred_s = derivatives[k, 2, :3], referred_s


@compiled
def _note_course(vehicle, now_s, limits):
    """Whether a vehicle follows its reference or strays, as of now."""
    vehicle.follows = False
    if now_s - vehicle.seen_s > limits.state_land_s:
        vehicle.on_course, vehicle.strays = False, True
        return
    ahead_s = vehicle.seen_s - vehicle.referred_s
    if abs(ahead_s) > _REFERENCE_S:
        vehicle.on_course = vehicle.strays = False
        return
    square, square_then = 0.0, 0.0
    for axis in range(3):
        error_m = vehicle.position_m[axis] - vehicle.reference_m[axis] - ahead_s * vehicle.reference_m_s[axis]
        error_m_s = vehicle.velocity_m_s[axis] - vehicle.reference_m_s[axis] - ahead_s * vehicle.reference_m_s2[axis]
        square += error_m**2
        square_then += (error_m + limits.separation_follow_s * error_m_s) ** 2
    square_then = max(square, square_then)
    if square_then <= 0.25 * limits.separation_course_m**2:
        vehicle.on_course = True
    vehicle.strays = vehicle.on_course and square_then > limits.separation_course_m**2
    vehicle.follows = vehicle.on_course and not vehicle.strays


@compiled
def _nearest(x, y, z, u, v, w, within_s):
    """Smallest length of the vector (x, y, z) + t (u, v, w) for t from 0 to within_s."""
    square, along = u * u + v * v + w * w, x * u + y * v + z * w
    t = min(max(-along / square, 0.0), within_s) if square > 0.0 else 0.0
    return math.sqrt((x + t * u) ** 2 + (y + t * v) ** 2 + (z + t * w) ** 2)


@compiled
def _velocity(vehicle):
    return vehicle.velocity_m_s[0], vehicle.velocity_m_s[1], vehicle.velocity_m_s[2]


@compiled
def _wider(one, other):
    """How much farther than two AR.Drones two vehicles reach [m]: distances are reduced by it."""
    return one.wider_m + other.wider_m


@compiled
def _nearest_straight(one, velocity, other, other_velocity, is_unseen, within_s):
    """Smallest distance of two vehicles within a time at these velocities, less `_wider`; is_unseen: the other is."""
    x = other.position_m[0] - one.position_m[0]
    y = other.position_m[1] - one.position_m[1]
    z = other.position_m[2] - one.position_m[2]
    (u, v, w), (other_u, other_v, other_w) = velocity, other_velocity
    if not is_unseen:
        return _nearest(x, y, z, other_u - u, other_v - v, other_w - w, within_s) - _wider(one, other)
    # it may have stopped or flown on, and will come down
    z = min(z, 0.0)
    w = w if z < 0.0 else 0.0
    stopped_m = _nearest(x, y, z, -u, -v, -w, within_s)
    return min(stopped_m, _nearest(x, y, z, other_u - u, other_v - v, -w, within_s)) - _wider(one, other)


@compiled
def _nearest_bent(one, other, within_s):
    """As `_nearest_straight`, for two vehicles that also accelerate as their references do."""
    at, step_s, nearest_m = np.empty((2, 3)), within_s / _PIECES, np.inf
    for k in range(_PIECES + 1):
        t = k * step_s
        for axis in range(3):
            at[0, axis] = at[1, axis]
            at[1, axis] = other.position_m[axis] - one.position_m[axis]
            at[1, axis] += t * (other.velocity_m_s[axis] - one.velocity_m_s[axis])
            at[1, axis] += 0.5 * t * t * (other.reference_m_s2[axis] - one.reference_m_s2[axis])
        if k > 0:
            x, y, z = at[0]
            nearest_m = min(nearest_m, _nearest(x, y, z, at[1, 0] - x, at[1, 1] - y, at[1, 2] - z, 1.0))
    return nearest_m - _wider(one, other)


@compiled
def _is_above(one, other):
    """Whether one is the upper of two vehicles; exactly one of them is."""
    dz = one.position_m[2] - other.position_m[2]
    return dz > 0.0 if abs(dz) > _LEVEL_M else one.order < other.order


@compiled
def _flies(vehicle, is_unseen):
    """What is seen counts more than what it reports."""
    return vehicle.position_m[2] >= AIRBORNE_M and not (is_unseen and vehicle.stands)


@compiled
def _judge(vehicles, apart_m, now_s, limits_of_all):
    """Set which vehicles hold, because of which neighbour and why. Returns whether any does.

    apart_m: (n, n) to work in: `_nearest_straight` of each pair at its velocities, inf for pairs that do not matter.
    limits_of_all: (1,) _LIMITS.
    """
    n, anybody, tells, limits = len(vehicles), False, False, limits_of_all[0]
    for i in range(n):
        _note_course(vehicles[i], now_s, limits)
        tells |= vehicles[i].told
    for i in range(n):
        one, velocity, spare_m = vehicles[i], _velocity(vehicles[i]), 0.0
        one.holds = False
        apart_m[i, :] = np.inf
        if now_s - one.seen_s > limits.state_hold_s or not _flies(one, False):
            continue  # it holds or lands because it is not seen, or stands
        for j in range(n):
            other = vehicles[j]
            unseen_s = now_s - other.seen_s
            is_unseen = unseen_s > limits.state_hold_s
            if i == j or unseen_s > limits.separation_forget_s or not _flies(other, is_unseen):
                continue
            both = one, velocity, other, _velocity(other), is_unseen
            apart_m[i, j] = nearest_m = _nearest_straight(*both, limits.separation_lookahead_s)
            limit_m = limits.separation_stray_m if other.strays else limits.separation_m
            if nearest_m < limit_m and one.follows and other.follows:
                nearest_m = max(
                    _nearest_straight(*both, limits.separation_follow_s),
                    _nearest_bent(one, other, limits.separation_follow_s),
                )
            if nearest_m - limit_m < spare_m:
                spare_m = nearest_m - limit_m
                one.holds, one.neighbour, one.cause = True, j, Cause.NEAR
                if other.strays:
                    one.cause = Cause.UNSEEN if unseen_s > limits.state_land_s else Cause.STRAYS
        anybody |= one.holds
    spreads = anybody or tells
    while spreads:
        spreads = False
        for i in range(n):
            one = vehicles[i]
            if one.holds:
                continue
            nearest_m = limits.separation_stray_m
            for j in range(n):
                if (vehicles[j].holds or vehicles[j].told) and apart_m[i, j] < nearest_m:
                    nearest_m = apart_m[i, j]
                    one.neighbour, one.cause = j, Cause.HOLDS
            if nearest_m < limits.separation_stray_m:
                one.holds = spreads = anybody = True
    return anybody


@compiled
def _avoid(vehicles, i, now_s, limits_of_all):
    """(climb, above, aside) of a `Look`: where a vehicle that holds has to go.  limits_of_all: (1,) _LIMITS."""
    one, height_m, limits = vehicles[i], vehicles[i].position_m[2], limits_of_all[0]
    climb, above, aside = 0, False, (0.0, 0.0)
    closest_m, beside_m = limits.separation_m, _BESIDE * limits.separation_m
    for j in range(len(vehicles)):
        other = vehicles[j]
        unseen_s = now_s - other.seen_s
        if i == j or unseen_s > limits.separation_forget_s:
            continue
        x, y = one.position_m[0] - other.position_m[0], one.position_m[1] - other.position_m[1]
        level_m = math.hypot(x, y)
        if level_m - _wider(one, other) < beside_m and not _is_above(other, one):
            beside_m, above = level_m - _wider(one, other), True
            aside = (x / level_m, y / level_m) if level_m > 0.0 else (1.0, 0.0)
        is_unseen, ahead_s = unseen_s > limits.state_hold_s, limits.separation_lookahead_s
        if not _flies(other, is_unseen):
            continue
        # will the other come too near even if this one stops at once?
        alone_m = _nearest_straight(one, _STILL, other, _velocity(other), is_unseen, ahead_s)
        if alone_m < closest_m:
            closest_m = alone_m
            climb = 1 if _is_above(one, other) else -1
    if (climb > 0 and height_m > limits.high_m[2] - one.wider_m) or (climb < 0 and height_m < limits.low_m[2]):
        climb = 0
    if above:
        aside = _free_way(vehicles, i, aside, beside_m, now_s, limits)
    return climb, above, aside


@compiled
def _free_way(vehicles, i, away, level_m, now_s, limits):
    """Direction, as near to `away` as possible, in which a vehicle gets far enough from the one below it, at the
    horizontal distance `level_m` less `_wider`; (0, 0): there is none.
    """
    for turn_rad in _TURNS_RAD:
        cosine, sine = math.cos(turn_rad), math.sin(turn_rad)
        aside = cosine * away[0] - sine * away[1], sine * away[0] + cosine * away[1]
        distance_m = math.sqrt((_BESIDE * limits.separation_m) ** 2 - (level_m * sine) ** 2) - level_m * cosine
        if _is_free(vehicles, i, aside, distance_m, now_s, limits):
            return aside
    return 0.0, 0.0


@compiled
def _is_free(vehicles, i, aside, distance_m, now_s, limits):
    """Whether a vehicle can go distance_m to this side, at the speed of moving apart, stop there, and land."""
    one, speed_m_s = vehicles[i], limits.separation_speed_m_s
    for axis in range(2):
        end_m = one.position_m[axis] + distance_m * aside[axis]
        if end_m < limits.low_m[axis] + one.wider_m or end_m > limits.high_m[axis] - one.wider_m:
            return False
    velocity = speed_m_s * aside[0], speed_m_s * aside[1], 0.0
    within_s = distance_m / speed_m_s + limits.separation_lookahead_s if speed_m_s > 0.0 else 0.0
    for j in range(len(vehicles)):
        other = vehicles[j]
        unseen_s = now_s - other.seen_s
        if i == j or unseen_s > limits.separation_forget_s:
            continue
        x, y = one.position_m[0] - other.position_m[0], one.position_m[1] - other.position_m[1]
        end_m = math.hypot(x + distance_m * aside[0], y + distance_m * aside[1]) - _wider(one, other)
        if end_m < min(math.hypot(x, y) - _wider(one, other), _BESIDE * limits.separation_m) - 1e-9:
            return False
        is_unseen = unseen_s > limits.state_hold_s
        if not _flies(other, is_unseen):
            continue
        here_m = _nearest_straight(one, _STILL, other, _STILL, is_unseen, 0.0)
        nearest_m = _nearest_straight(one, velocity, other, _STILL, is_unseen, within_s)
        if nearest_m < min(here_m - 1e-9, limits.separation_stray_m):
            return False
    return True
