"""Motions of vehicles over time, with exact derivatives up to snap, and smooth ways from one into another.

A motion is a chain of links. The first link is a simple motion: the vehicle stands, coasts to rest, or flies a path of
a course. Each further link is another simple motion and the blend into it from the links before. Links are records, so
that compiled code evaluates a whole fleet in one call. Where a path is a Python function, the caller evaluates that
function and passes the result in (`given`).

Frame: cortex (x forward, y left, z up), metres, seconds. Yaw psi is + clockwise seen from above (NED sense), radians.
Arrays of derivatives have the order (0 = position ... 4 = snap) as their first axis.
"""

import math

import numpy as np

from risc_lab.compiled import compiled, record

ORDERS = 5  # position, velocity, acceleration, jerk, snap
YAW_ORDERS = 3  # yaw, its rate, its acceleration

COASTING, HARMONIC, TOUR, BY_FUNCTION = range(4)  # kinds of links
LINK = record(
    ("kind", int),
    ("first", int),  # row of the table, and how many: the terms of a sum of harmonics, or the stops of a tour
    ("rows", int),
    ("epoch_s", float),  # the link's own time is time - epoch_s + ahead_s
    ("ahead_s", float),
    ("position_m", float, (3,)),  # of one that coasts, at its epoch; centre of harmonics
    ("velocity_m_s", float, (3,)),  # of one that coasts, at its epoch
    ("rest_s", float),  # of a tour: at each stop,
    ("move_s", float),  # and from one to the next
    ("yaw_rad", float),
    ("yaw_rate_rad_s", float),
    ("along_path", int),  # the nose leads; the rest of the yaw is added
    ("begin_s", float),  # of the blend into this link; -inf: no blend
    ("end_s", float),  # of its path
    ("yaw_end_s", float),  # of its yaw, which may take longer
    ("blend_yaw_rad", float, (6,)),  # polynomial over (time - begin_s) / (yaw_end_s - begin_s), lowest power first
    ("rise_m", float),  # how much higher the blend leads than the line between the two motions
    ("under_way", int),  # number that `sample_fleet` reports during the blend,
    ("arrived", int),  # and after it
)
TABLE_WIDTH = 9  # harmonics: amplitude, frequency and phase of x, y, z; stops: x, y, z
NO_TABLE = np.zeros((0, TABLE_WIDTH))
NO_PATHS = np.zeros((1, 1, ORDERS, 3))  # for `given`, where no path is a Python function

RAMP = 0.4  # fraction of a rising blend that leads up; as much leads down again
_STOP_S = 1.0  # time constant with which a vehicle that drifts is brought to rest
_SLOWEST_ALONG_PATH_M_S = 0.05  # below this speed a path has no direction worth turning the nose to


# ------------------------------------------------------------------------------------------------ compiled code


@compiled
def least_snap_step(fraction, duration_s, step):
    """The least-snap way from 0 (before 0) to 1 (after 1), by time: 126 f^5 - 420 f^6 + 540 f^7 - 315 f^8 + 70 f^9."""
    f = min(max(fraction, 0.0), 1.0)
    g, d = 1.0 - f, duration_s
    step[0] = f**5 * (126.0 + f * (-420.0 + f * (540.0 + f * (-315.0 + 70.0 * f))))
    step[1] = 630.0 * (f * g) ** 4 / d
    step[2] = 2520.0 * (f * g) ** 3 * (g - f) / d**2
    step[3] = 2520.0 * (f * g) ** 2 * (3.0 - 14.0 * f * g) / d**3
    step[4] = 15120.0 * f * g * (g - f) * (1.0 - 7.0 * f * g) / d**4


@compiled
def _path_of(link, table, given, time_s, step, path):
    """Position to snap (5, 3) of a link on its own; given: the same from a Python function.

    Returns the link's own time [s].
    """
    t = time_s - link.epoch_s + link.ahead_s
    if link.kind == HARMONIC:
        for axis in range(3):
            path[0, axis] = link.position_m[axis]
            path[1, axis] = path[2, axis] = path[3, axis] = path[4, axis] = 0.0
            for row in range(link.first, link.first + link.rows):
                amplitude, w = table[row, axis], table[row, 3 + axis]
                if amplitude != 0.0:
                    phase = w * t + table[row, 6 + axis]
                    c, s = amplitude * math.cos(phase), amplitude * math.sin(phase)
                    path[0, axis] += c
                    path[1, axis] -= w * s
                    path[2, axis] -= w * w * c
                    path[3, axis] += w * w * w * s
                    path[4, axis] += w * w * w * w * c
    elif link.kind == TOUR:
        leg = math.floor(t / (link.rest_s + link.move_s))
        within_s = t - leg * (link.rest_s + link.move_s)
        here = link.first + int(leg) % link.rows
        there = link.first + int(leg + 1) % link.rows
        least_snap_step((within_s - link.rest_s) / link.move_s, link.move_s, step)
        for axis in range(3):
            for order in range(ORDERS):
                path[order, axis] = step[order] * (table[there, axis] - table[here, axis])
            path[0, axis] += table[here, axis]
    elif link.kind == COASTING:
        decay = math.exp(-max(t, 0.0) / _STOP_S)
        for axis in range(3):
            velocity = link.velocity_m_s[axis]
            path[0, axis] = link.position_m[axis] + velocity * _STOP_S * (1.0 - decay)
            for order in range(1, ORDERS):
                path[order, axis] = velocity * decay * (-1.0 / _STOP_S) ** (order - 1)
    else:
        for axis in range(3):
            for order in range(ORDERS):
                path[order, axis] = given[order, axis]
    return t


@compiled
def _yaw_of(link, t, path, yaw):
    """Yaw, rate, acceleration (3,) of a link on its own, at its own time and on its path (5, 3). Not wrapped."""
    yaw[0] = link.yaw_rad + link.yaw_rate_rad_s * t
    yaw[1] = link.yaw_rate_rad_s
    yaw[2] = 0.0
    if link.along_path:
        vx, vy, ax, ay, jx, jy = path[1, 0], path[1, 1], path[2, 0], path[2, 1], path[3, 0], path[3, 1]
        square = max(vx * vx + vy * vy, _SLOWEST_ALONG_PATH_M_S**2)
        cross, dot = vx * ay - vy * ax, vx * ax + vy * ay
        yaw[0] -= math.atan2(vy, vx)
        yaw[1] -= cross / square
        yaw[2] -= (vx * jy - vy * jx) / square - 2.0 * cross * dot / square**2


@compiled
def _blend(path, there, step):
    """path becomes path + s (there - path), by Leibniz' rule: derivatives (5, 3); step: (5,) s and its derivatives."""
    for axis in range(3):
        d0, d1, d2 = there[0, axis] - path[0, axis], there[1, axis] - path[1, axis], there[2, axis] - path[2, axis]
        d3, d4 = there[3, axis] - path[3, axis], there[4, axis] - path[4, axis]
        path[4, axis] += step[0] * d4 + 4.0 * step[1] * d3 + 6.0 * step[2] * d2 + 4.0 * step[3] * d1 + step[4] * d0
        path[3, axis] += step[0] * d3 + 3.0 * step[1] * d2 + 3.0 * step[2] * d1 + step[3] * d0
        path[2, axis] += step[0] * d2 + 2.0 * step[1] * d1 + step[2] * d0
        path[1, axis] += step[0] * d1 + step[1] * d0
        path[0, axis] += step[0] * d0


@compiled
def lift(fraction, duration_s, step, other):
    """How much of its rise a blend is up at a fraction of it, by time: up at its beginning, down at its end.

    step: (5,), filled.  other: (5,) to work in.
    """
    ramp_s = RAMP * duration_s
    least_snap_step(fraction / RAMP, ramp_s, step)
    least_snap_step((fraction - (1.0 - RAMP)) / RAMP, ramp_s, other)
    for order in range(ORDERS):
        step[order] -= other[order]


@compiled
def quintic(first, last, duration_s, revolutions):
    """Coefficients (6,) over the fraction of a duration between two yaws (3,) with rates and accelerations.

    The last is turned by whole revolutions to be nearest, and by so many more.
    """
    v0, v1 = first[1] * duration_s, last[1] * duration_s
    a0, a1 = 0.5 * first[2] * duration_s**2, 0.5 * last[2] * duration_s**2
    # the nose turns on meanwhile: what must be nearest is the last less that turn
    turn = last[0] - first[0]
    turn += 2.0 * math.pi * (revolutions - round((turn - 0.5 * (v0 + v1)) / (2.0 * math.pi)))
    result = np.empty(6)
    result[0], result[1], result[2] = first[0], v0, a0
    result[3] = 10.0 * turn - 6.0 * v0 - 4.0 * v1 - 3.0 * a0 + a1
    result[4] = -15.0 * turn + 8.0 * v0 + 7.0 * v1 + 3.0 * a0 - 2.0 * a1
    result[5] = 6.0 * turn - 3.0 * (v0 + v1) - a0 + a1
    return result


@compiled
def _motion(links, count, table, given, time_s, scratch, path, yaw):
    """State of a chain of `count` links at a time: path (5, 3), yaw (3,). Returns its `under_way` or `arrived`.

    given: (links, 5, 3), paths that a Python function knows.  scratch: (6, 5) to work in.
    """
    newest = count - 1
    while newest > 0 and time_s < links[newest].begin_s:
        newest -= 1
    first = newest
    while first > 0 and time_s < links[first].end_s:
        first -= 1
    step, there = scratch[5], scratch[:5, :3]
    own_s = 0.0
    for k in range(first, newest + 1):
        link, target = links[k], path if k == first else there
        own_s = _path_of(link, table, given[k if len(given) > 1 else 0], time_s, step, target)
        if k > first:
            duration_s = link.end_s - link.begin_s
            least_snap_step((time_s - link.begin_s) / duration_s, duration_s, step)
            _blend(path, there, step)
            if link.rise_m != 0.0:
                lift((time_s - link.begin_s) / duration_s, duration_s, step, scratch[0])
                for order in range(ORDERS):
                    path[order, 2] += link.rise_m * step[order]
    link = links[newest]
    if first == newest and time_s >= link.yaw_end_s:
        _yaw_of(link, own_s, path, yaw)
        return link.arrived
    duration_s = link.yaw_end_s - link.begin_s
    f, c = (time_s - link.begin_s) / duration_s, link.blend_yaw_rad
    yaw[0] = c[0] + f * (c[1] + f * (c[2] + f * (c[3] + f * (c[4] + f * c[5]))))
    yaw[1] = (c[1] + f * (2.0 * c[2] + f * (3.0 * c[3] + f * (4.0 * c[4] + f * 5.0 * c[5])))) / duration_s
    yaw[2] = (2.0 * c[2] + f * (6.0 * c[3] + f * (12.0 * c[4] + f * 20.0 * c[5]))) / duration_s**2
    return link.under_way


@compiled
def _keep(own_path, own_yaw, k, path, yaw):
    """One path (5, 3) and yaw (3,) become the k-th of path (5, k, 3) and yaw (3, k)."""
    for order in range(ORDERS):
        for axis in range(3):
            path[order, k, axis] = own_path[order, axis]
    for order in range(YAW_ORDERS):
        yaw[order, k] = own_yaw[order]


@compiled
def _sample_motion(links, table, given, times_s, path, yaw):
    """One chain at times (k,): path (5, k, 3), yaw (3, k); given: (k, links, 5, 3) or NO_PATHS."""
    scratch, own_path, own_yaw = np.empty((6, 5)), np.empty((ORDERS, 3)), np.empty(YAW_ORDERS)
    for k in range(len(times_s)):
        _motion(links, len(links), table, given[k if len(given) > 1 else 0], times_s[k], scratch, own_path, own_yaw)
        _keep(own_path, own_yaw, k, path, yaw)


@compiled
def sample_fleet(links, counts, table, given, time_s, derivatives, calls):
    """Every vehicle's chain at one time, in one call.

    links: (n, most).  counts: (n,).  given: (n, most, 5, 3) or NO_PATHS.
    derivatives: (5, n, 4) x, y, z, psi, filled.  calls: (n,) `under_way` or `arrived` of each, filled. Returns whether
    one of these numbers has changed.
    """
    scratch, path, yaw = np.empty((6, 5)), np.empty((ORDERS, 3)), np.empty(YAW_ORDERS)
    is_new = False
    for i in range(len(counts)):
        call = _motion(links[i], counts[i], table, given[i if len(given) > 1 else 0], time_s, scratch, path, yaw)
        is_new = is_new or call != calls[i]
        calls[i] = call
        for order in range(ORDERS):
            for axis in range(3):
                derivatives[order, i, axis] = path[order, axis]
            derivatives[order, i, 3] = yaw[order] if order < YAW_ORDERS else 0.0
    return is_new


@compiled
def sample_paths(links, table, given, times_s, path, yaw):
    """Links of their own, each at a time of its own, or a single one at many times: path (5, k, 3), yaw (3, k).

    times_s: (k,).  given: (k, 1, 5, 3) or NO_PATHS.
    """
    step, own_path, own_yaw = np.empty(ORDERS), np.empty((ORDERS, 3)), np.empty(YAW_ORDERS)
    for k in range(len(times_s)):
        link = links[k if len(links) > 1 else 0]
        own_s = _path_of(link, table, given[k if len(given) > 1 else 0, 0], times_s[k], step, own_path)
        _yaw_of(link, own_s, own_path, own_yaw)
        _keep(own_path, own_yaw, k, path, yaw)


# ------------------------------------------------------------------------------------------------------ motions


def new_links(count, kind, **fields):
    """(count,) links without a blend; fields: of LINK, one value for all or one each."""
    links = np.zeros(count, LINK)
    links["kind"], links["begin_s"], links["end_s"], links["yaw_end_s"] = kind, -math.inf, -math.inf, -math.inf
    for name, value in fields.items():
        links[name] = value
    return links


class Motion:
    """Where a vehicle is at any time: a chain of links (see the module). Never changes."""

    def __init__(self, links, table=NO_TABLE, functions=None):
        """links: (k,) LINK.  functions: {link: function of times (t,) that gives (5, t, 3)} of those BY_FUNCTION."""
        self.links, self.table, self.functions = links, table, functions or {}

    def __call__(self, times_s):
        """((5, t, 3) position to snap, (3, t) yaw to its acceleration) at times (t,)."""
        path, yaw = np.empty((ORDERS, len(times_s), 3)), np.empty((YAW_ORDERS, len(times_s)))
        given = NO_PATHS
        if self.functions:
            given = np.empty((len(times_s), len(self.links), ORDERS, 3))
            for k, function in self.functions.items():
                given[:, k] = function(times_s).transpose(1, 0, 2)
        _sample_motion(self.links, self.table, given, times_s, path, yaw)
        return path, yaw

    def since(self, time_s):
        """The same motion for times from time_s on: what is over is forgotten."""
        return self._part(max([k for k, end_s in enumerate(self.links["end_s"]) if end_s <= time_s], default=0), None)

    def until(self, time_s):
        """The same motion without the blends that begin after time_s."""
        return self._part(0, max(1, int((self.links["begin_s"] <= time_s).sum())))

    def blends_after(self, time_s):
        """How many of its blends have not ended by then."""
        return int((self.links["end_s"] > time_s).sum())

    def followed_by(self, other, **fields):
        """This chain and the link of another motion after it; fields: of that link."""
        links = np.concatenate([self.links, other.links[-1:]])
        for name, value in fields.items():
            links[name][-1] = value
        if len(other.table):
            links["first"][-1] += len(self.table)
        functions = dict(self.functions)
        if other.functions:
            functions[len(links) - 1] = other.functions[len(other.links) - 1]
        return Motion(links, np.concatenate([self.table, other.table]), functions)

    def _part(self, first, end):
        if first == 0 and end in (None, len(self.links)):
            return self
        functions = {k - first: f for k, f in self.functions.items() if first <= k and (end is None or k < end)}
        return Motion(self.links[first:end], self.table, functions)


def standing(position_m, yaw_rad):
    """Motion of a vehicle that stands still at a position (3,)."""
    return coasting(position_m, np.zeros(3), yaw_rad, 0.0)


def coasting(position_m, velocity_m_s, yaw_rad, begin_s):
    """Motion of a vehicle that is at a position (3,) with a velocity (3,) at begin_s, and comes to rest."""
    link = new_links(1, COASTING, epoch_s=begin_s, yaw_rad=yaw_rad)
    link["position_m"], link["velocity_m_s"] = position_m, velocity_m_s
    return Motion(link)


class Blend(Motion):
    """Motion from one motion into another: start + s (end - start), s the least-snap step from 0 to 1.

    It has the derivatives of `start` up to snap at the beginning and those of `end` at the end, and every position in
    between lies on the line between the two (or above it, when it rises): where both are inside the (convex) arena, so
    is the way. A polynomial between two states of motion has no such bound; for the yaw, which needs none, it is the
    better way, because a vehicle need not follow a nose that turns.
    """

    def __init__(self, start, end, begin_s, duration_s, rise_m=0.0, yaw_duration_s=None, revolutions=0, calls=(0, 0)):
        """start: a motion.  end: a motion of one link, whose yaw is turned by whole revolutions to be nearest.

        rise_m: how much higher it leads, over vehicles in between.
        yaw_duration_s: of the yaw [s], at least duration_s; None = duration_s.  revolutions: further turns of the yaw.
        calls: the link's numbers (under_way, arrived).
        """
        if not duration_s > 0.0:
            raise ValueError("a blend needs a time > 0, got %r" % (duration_s,))
        begin_s, yaw_duration_s = float(begin_s), float(max(duration_s, yaw_duration_s or 0.0))
        first, last = start(np.array([begin_s]))[1][:, 0], end(np.array([begin_s + yaw_duration_s]))[1][:, 0]
        chain = start.followed_by(
            end,
            begin_s=begin_s,
            end_s=begin_s + duration_s,
            yaw_end_s=begin_s + yaw_duration_s,
            blend_yaw_rad=quintic(first, last, yaw_duration_s, revolutions),
            rise_m=rise_m,
            under_way=calls[0],
            arrived=calls[1],
        )
        super().__init__(chain.links, chain.table, chain.functions)
