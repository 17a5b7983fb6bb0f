"""Motions of vehicles over time, with exact derivatives to any order, and smooth ways from one into another.

A motion is a chain of links. Each link is a simple motion: the vehicle stands, coasts to rest, flies a sum of
harmonics, polynomials or a tour of points; each but the first also contains the blend into it from the links before.
Links are records, so that compiled code evaluates a whole fleet in one call. It works with Taylor series about the
requested time: sums, products and quotients of series are exact, however many derivatives there are.

The rows of a link are (k, 4) complex: a rate r [1/s] and amplitudes x, y, z [m] of terms Re(amplitude exp(r t)), or,
without a rate, the stops of a tour. Polynomials are flown one after the other, cyclically; each has a row of its start
and duration [s], and then its coefficients, lowest power first, of psi [rad], x, y, z over the fraction of its
duration.

Frame: cortex (x forward, y left, z up), metres, seconds. Yaw psi is + clockwise seen from above (NED sense), radians.
Arrays of derivatives have the order (0 = position ... 4 = snap) as their first axis, and x, y, z, psi as their last.
"""

import math
from functools import cached_property

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval

from risc_control.minimum_snap import COEFFICIENTS
from risc_control.reference_buffer import MOST_ORDER, Axis, Order
from risc_lab.compiled import compiled, record

RAMP = 0.4  # fraction of a rising blend that leads up; an equal one leads down again
LINK = record(
    ("first", int),  # of its rows in the table, and how many
    ("rows", int),
    ("epoch_s", float),  # the link's own time counts from here
    ("position_m", float, (3,)),  # added to the motion by the rows
    ("rest_s", float),  # of a tour: at each stop,
    ("move_s", float),  # and from one to the next; 0: the rows are terms, or
    ("pieces", int),  # this number of polynomials
    ("yaw_rad", float),  # at the epoch
    ("yaw_rate_rad_s", float),
    ("along_path", bool),  # the nose points along the path; the rest of the yaw is added
    ("smooth", int),  # order to which the moves of a tour, and the blend into this link, are continuous
    ("begin_s", float),  # of the blend into this link; -inf: no blend
    ("end_s", float),  # of its path
    ("yaw_end_s", float),  # of its yaw, which may take longer
    ("turn_rad", float, (6,)),  # polynomial over (time - begin_s) / (yaw_end_s - begin_s), lowest power first
    ("rise_m", float),  # rise of the blend above the line between the two motions
    ("under_way", int),  # number in `Chains.calls` during the blend,
    ("arrived", int),  # and after it
)
_NO_ROWS = np.zeros((0, 4), dtype=complex)
_PIECE_ROWS = 1 + COEFFICIENTS
_STOP_S = 1.0  # time constant with which a vehicle that drifts is brought to rest
_SLOWEST_ALONG_PATH_M_S = 0.05  # below this speed the nose does not follow the path

# [n]: coefficients, lowest power first, of the polynomial of degree 2n + 1 from 0 to 1 whose first n derivatives are 0
# at both ends. It minimises the integral of the square of derivative n: [4] is the minimum-snap step.
_STEPS = np.zeros((MOST_ORDER + 1, 2 * MOST_ORDER + 2))
for _n in range(MOST_ORDER + 1):
    for _k in range(_n + 1):
        _STEPS[_n, _n + 1 + _k] = (-1) ** _k * (2 * _n + 1) * math.comb(2 * _n, _n) * math.comb(_n, _k) / (_n + 1 + _k)


# ------------------------------------------------------------------------------------------------ compiled code


@compiled
def _expand(polynomial, at, unit_s, series):
    """Fill the Taylor series by time of a polynomial of time / unit_s, lowest power first, about at * unit_s."""
    series[:] = 0.0
    for power in range(len(polynomial) - 1, -1, -1):  # Horner's rule, with a series for the variable
        for d in range(len(series) - 1, 0, -1):
            series[d] = series[d] * at + series[d - 1]
        series[0] = series[0] * at + polynomial[power]
    scale = 1.0
    for d in range(len(series)):
        series[d] *= scale
        scale /= unit_s


@compiled
def _step(fraction, duration_s, smooth, series):
    """Fill the Taylor series by time of the smooth way from 0 (before fraction 0) to 1 (after 1)."""
    series[:] = 0.0
    if fraction >= 1.0:
        series[0] = 1.0
    elif fraction > 0.5:  # here the terms of the polynomial would cancel, so use 1 minus the reversed step
        _expand(_STEPS[smooth, : 2 * smooth + 2], 1.0 - fraction, -duration_s, series)
        for d in range(len(series)):
            series[d] = -series[d]
        series[0] += 1.0
    elif fraction > 0.0:
        _expand(_STEPS[smooth, : 2 * smooth + 2], fraction, duration_s, series)


@compiled
def _simple(link, table, time_s, step, series):
    """Fill the Taylor series (orders, 4) of a link on its own; its yaw is not wrapped. step: to work in."""
    t = time_s - link.epoch_s
    series[:] = 0.0
    for axis in range(3):
        series[0, axis] = link.position_m[axis]
    series[0, Axis.PSI] = link.yaw_rad + link.yaw_rate_rad_s * t
    series[1, Axis.PSI] = link.yaw_rate_rad_s
    if link.move_s > 0.0:
        leg = math.floor(t / (link.rest_s + link.move_s))
        within_s = t - leg * (link.rest_s + link.move_s)
        _step((within_s - link.rest_s) / link.move_s, link.move_s, link.smooth, step)
        for axis in range(3):
            here = table[link.first + int(leg) % link.rows, 1 + axis].real
            there = table[link.first + int(leg + 1) % link.rows, 1 + axis].real
            series[0, axis] += here
            for d in range(len(series)):
                series[d, axis] += step[d] * (there - here)
    elif link.pieces > 0:
        _piece(link, table, t, step, series)
    else:
        for row in range(link.first, link.first + link.rows):
            rate, now = table[row, 0], np.exp(table[row, 0] * t)
            for axis in range(3):
                term = table[row, 1 + axis] * now
                for d in range(len(series)):
                    series[d, axis] += term.real
                    term *= rate / (d + 1)
    if link.along_path:
        _turn_along(series)


@compiled
def _piece(link, table, t, step, series):
    """Add the polynomial of a link that is flown at its time t. step: to work in."""
    newest, before = link.pieces - 1, 0
    last = link.first + newest * _PIECE_ROWS
    period_s = table[last, 0].real + table[last, 1].real
    t -= period_s * math.floor(t / period_s)
    while before < newest:
        middle = (before + newest + 1) // 2
        if table[link.first + middle * _PIECE_ROWS, 0].real <= t:
            before = middle
        else:
            newest = middle - 1
    row = link.first + newest * _PIECE_ROWS
    begin_s, duration_s = table[row, 0].real, table[row, 1].real
    polynomial = np.empty(COEFFICIENTS)
    for column in range(4):
        for power in range(COEFFICIENTS):
            polynomial[power] = table[row + 1 + power, column].real
        _expand(polynomial, (t - begin_s) / duration_s, duration_s, step)
        for d in range(len(series)):
            series[d, column - 1] += step[d]  # psi, which comes first, is the last of a series


@compiled
def _turn_along(series):
    """Turn the yaw of a Taylor series with the direction of its horizontal velocity v: psi' = -(v x v') / (v v)."""
    orders = len(series) - 1
    x, y, rate = np.empty(orders), np.empty(orders), np.empty(orders)
    for d in range(orders):
        x[d], y[d] = (d + 1) * series[d + 1, Axis.X], (d + 1) * series[d + 1, Axis.Y]
    square = max(x[0] * x[0] + y[0] * y[0], _SLOWEST_ALONG_PATH_M_S**2)
    series[0, Axis.PSI] -= math.atan2(y[0], x[0])
    for d in range(orders - 1):
        total = 0.0
        for k in range(d + 1):
            total += (k + 1) * (x[d - k] * y[k + 1] - y[d - k] * x[k + 1])
        for k in range(d):
            for j in range(d - k + 1):
                total -= rate[k] * (x[j] * x[d - k - j] + y[j] * y[d - k - j])
        rate[d] = total / square
        series[d + 1, Axis.PSI] -= rate[d] / (d + 1)
    series[orders, Axis.PSI] = 0.0  # would need one more derivative of the path


@compiled
def _motion(links, count, table, time_s, own, there, step):
    """Fill `own` with the Taylor series (orders, 4) of a chain of `count` links. Returns its `under_way` or `arrived`.

    The last order of the yaw is not right. there: (orders, 4) and step: (orders,), to work in.
    """
    newest = count - 1
    while newest > 0 and time_s < links[newest].begin_s:
        newest -= 1
    first = newest
    while first > 0 and time_s < links[first].end_s:
        first -= 1
    _simple(links[first], table, time_s, step, own)
    for k in range(first + 1, newest + 1):
        link = links[k]
        duration_s = link.end_s - link.begin_s
        fraction = (time_s - link.begin_s) / duration_s
        _simple(link, table, time_s, step, there)
        _step(fraction, duration_s, link.smooth, step)
        for axis in range(3):  # own += step (there - own), the highest order first: it needs the lower ones as they are
            for d in range(len(step) - 1, -1, -1):
                for j in range(d, -1, -1):
                    own[d, axis] += step[d - j] * (there[j, axis] - own[j, axis])
        if link.rise_m != 0.0:
            for sign, begin in ((1.0, 0.0), (-1.0, 1.0 - RAMP)):
                _step((fraction - begin) / RAMP, RAMP * duration_s, link.smooth, step)
                for d in range(len(step)):
                    own[d, Axis.Z] += sign * link.rise_m * step[d]
    link = links[newest]
    if first == newest and time_s >= link.yaw_end_s:
        return link.arrived
    duration_s = link.yaw_end_s - link.begin_s
    _expand(link.turn_rad, (time_s - link.begin_s) / duration_s, duration_s, own[:, Axis.PSI])
    return link.under_way


@compiled
def _sample(links, counts, table, times_s, derivatives, calls):
    """Chains of n vehicles at one time, or of one at k times: fill derivatives (orders, n or k, 4) and calls (n,).

    links: (n, most).  counts: (n,).  Returns whether one of the calls has changed.
    """
    orders, is_new = len(derivatives), False
    own, there, step = np.empty((orders + 1, 4)), np.empty((orders + 1, 4)), np.empty(orders + 1)
    for i in range(derivatives.shape[1]):
        k, time_s = (i, times_s[0]) if len(times_s) == 1 else (0, times_s[i])
        call = _motion(links[k], counts[k], table, time_s, own, there, step)
        is_new |= call != calls[k]
        calls[k] = call
        factorial = 1.0
        for order in range(orders):
            factorial *= max(order, 1)
            for axis in range(4):
                derivatives[order, i, axis] = factorial * own[order, axis]
    return is_new


# ------------------------------------------------------------------------------------------------------ motions


def step_values(fractions, smooth, derivative=0):
    """The smooth step from 0 to 1 at fractions of it, or its derivative by the fraction."""
    return polyval(np.clip(fractions, 0.0, 1.0), polyder(_STEPS[smooth, : 2 * smooth + 2], derivative))


def rise_values(fractions, smooth, derivative=0):
    """Share of the rise at fractions of a blend, or its derivative by the fraction."""
    up, down = (step_values((fractions - begin) / RAMP, smooth, derivative) for begin in (0.0, 1.0 - RAMP))
    return (up - down) / RAMP**derivative


class Motion:
    """Motion of a vehicle over time: a chain of links (see the module). Immutable."""

    def __init__(self, links, rows):
        """links: (k,) LINK.  rows: [rows of each link]."""
        self.links, self.rows = links, rows

    @cached_property
    def _chain(self):
        return Chains([self])

    def at(self, times_s, order=Order.SNAP):
        """(order + 1, t, 4) at times (t,)."""
        return self._chain.at(times_s, order)

    def since(self, time_s):
        """The same motion for times from time_s on, without the links that are over."""
        first = max([k for k, end_s in enumerate(self.links["end_s"]) if end_s <= time_s], default=0)
        return Motion(self.links[first:], self.rows[first:])

    def until(self, time_s):
        """The same motion without the blends that begin after time_s."""
        end = max(1, int((self.links["begin_s"] <= time_s).sum()))
        return Motion(self.links[:end], self.rows[:end])

    def followed_by(self, other, **fields):
        """This chain, followed by the last link of another motion; fields: of that link."""
        chain = Motion(np.concatenate([self.links, other.links[-1:]]), [*self.rows, other.rows[-1]])
        return chain.with_fields(**fields)

    def faster(self, factor):
        """The same path of a single link, flown `factor` times as fast; its position at time 0 is unchanged."""
        links = self.links.copy()
        for key in ("epoch_s", "rest_s", "move_s"):
            links[key] /= factor
        links["yaw_rate_rad_s"] *= factor
        rows = self.rows[0].copy()
        if links["pieces"][0]:
            rows[::_PIECE_ROWS, :2] /= factor
        elif not links["move_s"][0] > 0.0:
            rows[:, 0] *= factor
        return Motion(links, [rows])

    def with_yaw(self, yaw_rad, yaw_rate_rad_s, along_path):
        """The same path of a single link with another yaw; the yaw of polynomials is removed."""
        rows = self.rows[0].copy()
        for power in range(COEFFICIENTS if self.links["pieces"][0] else 0):
            rows[1 + power :: _PIECE_ROWS, 0] = 0.0
        motion = Motion(self.links, [rows])
        return motion.with_fields(yaw_rad=yaw_rad, yaw_rate_rad_s=yaw_rate_rad_s, along_path=along_path)

    def with_fields(self, **fields):
        """The same motion with other values in its last link."""
        links = self.links.copy()
        for name, value in fields.items():
            links[name][-1] = value
        return Motion(links, self.rows)


class Chains:
    """Motions of n vehicles in arrays for compiled code."""

    def __init__(self, motions):
        self._counts = np.array([len(motion.links) for motion in motions])
        self.links = np.zeros((len(motions), self._counts.max()), LINK)  # (n, most)
        tables, end = [_NO_ROWS], 0
        for chain, motion in zip(self.links, motions):
            chain[: len(motion.links)] = motion.links
            for link, rows in zip(chain, motion.rows):
                link["first"], link["rows"] = end, len(rows)
                tables.append(rows)
                end += len(rows)
        self._table = np.concatenate(tables)
        self.calls = np.full(len(motions), -1)  # (n,) `under_way` or `arrived` of each, at the newest sample,
        self.is_new = False  # and whether one of them has changed

    def at(self, times_s, order=Order.SNAP):
        """(order + 1, n, 4) at one time (1,), or (order + 1, t, 4) of a single vehicle at times (t,)."""
        derivatives = np.empty((order + 1, max(len(self.links), len(times_s)), 4))
        self.is_new = _sample(self.links, self._counts, self._table, times_s, derivatives, self.calls)
        return derivatives


def simple_motion(rows=_NO_ROWS, **fields):
    """Motion of one link.  rows: see the module.  fields: of LINK."""
    links = np.zeros(1, LINK)
    links["smooth"], links["begin_s"], links["end_s"], links["yaw_end_s"] = Order.SNAP, *3 * [-math.inf]
    return Motion(links, [rows]).with_fields(**fields)


def polynomials(coefficients, durations_s):
    """Motion cyclically along pieces (m, 8, 4), x, y, z, psi, of durations_s (m,). See `minimum_snap`."""
    rows = np.zeros((len(durations_s), _PIECE_ROWS, 4), dtype=complex)
    rows[:, 0, 0], rows[:, 0, 1] = np.cumsum(durations_s) - durations_s, durations_s
    rows[:, 1:] = np.roll(coefficients, 1, axis=2)
    return simple_motion(rows.reshape(-1, 4), pieces=len(durations_s))


def standing(position_m, yaw_rad):
    """Motion of a vehicle that stands still at a position (3,)."""
    return simple_motion(position_m=position_m, yaw_rad=yaw_rad)


def coasting(position_m, velocity_m_s, yaw_rad, begin_s):
    """Motion of a vehicle that is at a position (3,) with a velocity (3,) at begin_s, and comes to rest."""
    way_m = _STOP_S * np.asarray(velocity_m_s)
    rows = np.array([[-1.0 / _STOP_S, *-way_m]], dtype=complex)
    return simple_motion(rows, epoch_s=begin_s, position_m=position_m + way_m, yaw_rad=yaw_rad)


def blend(start, end, begin_s, duration_s, rise_m=0.0, yaw_duration_s=None, revolutions=0, calls=(0, 0)):
    """Motion from one motion into another: start + s (end - start), s the smooth step from 0 to 1.

    It has the derivatives of `start` at the beginning and those of `end` at the end, to the order `smooth` of the last
    link of `end` (by default snap); those of the yaw to its acceleration. Every position in between lies on the line
    between the two (or above it, if it rises): where both are inside the (convex) arena, so is the way. A polynomial
    between two states of motion has no such bound; for the yaw, which needs none, it is better, because the vehicle
    need not follow a yaw that keeps turning.

    end: its yaw is taken in the nearest revolution.  rise_m: rise above the line, over vehicles in between.
    yaw_duration_s: of the yaw [s], at least duration_s; None = duration_s.  revolutions: further turns of the yaw.
    calls: numbers (under_way, arrived).
    """
    if not duration_s > 0.0:
        raise ValueError("a blend needs a time > 0, got %r" % (duration_s,))
    begin_s, yaw_duration_s = float(begin_s), float(max(duration_s, yaw_duration_s or 0.0))
    first, last = (
        motion.at(np.array([time_s]), Order.ACCELERATION)[:, 0, Axis.PSI]
        for motion, time_s in ((start, begin_s), (end, begin_s + yaw_duration_s))
    )
    return start.followed_by(
        end,
        begin_s=begin_s,
        end_s=begin_s + duration_s,
        yaw_end_s=begin_s + yaw_duration_s,
        turn_rad=turn(first, last, yaw_duration_s, revolutions),
        rise_m=rise_m,
        under_way=calls[0],
        arrived=calls[1],
    )


def turn(first, last, duration_s, revolutions):
    """Coefficients (6,) over the fraction of a duration between two yaws (3,) with rates and accelerations.

    The last yaw is taken in the nearest revolution, and turned by `revolutions` more.
    """
    v0, v1 = first[1] * duration_s, last[1] * duration_s
    a0, a1 = 0.5 * first[2] * duration_s**2, 0.5 * last[2] * duration_s**2
    # the yaw rates turn the nose meanwhile: nearest is meant without that turn
    way = last[0] - first[0]
    way += 2.0 * math.pi * (revolutions - round((way - 0.5 * (v0 + v1)) / (2.0 * math.pi)))
    return np.array(
        [
            first[0],
            v0,
            a0,
            10.0 * way - 6.0 * v0 - 4.0 * v1 - 3.0 * a0 + a1,
            -15.0 * way + 8.0 * v0 + 7.0 * v1 + 3.0 * a0 - 2.0 * a1,
            6.0 * way - 3.0 * (v0 + v1) - a0 + a1,
        ]
    )
