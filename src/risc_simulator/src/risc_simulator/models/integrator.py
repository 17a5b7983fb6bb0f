"""Steps of coupled systems: a vehicle, the on-board code of its type, and the body attached to it.

The functions here are plain Python in terms of the equations of one kind of system: `slope`, `couple`, `before_step`
and `after_step`. `integrator` compiles copies for a kind, in which these names stand for that kind's own functions, so
that the compiler can optimise across all of them and a new kind costs the others nothing. With NUMBA_DISABLE_JIT=1 the
same copies run as plain Python.
"""

import functools
import hashlib
import inspect
import math
import pathlib
import types
from typing import NamedTuple

import numpy as np

from risc_lab.compiled import compiled
from risc_simulator.models.quadrotor import U, X, slope

REST_HEIGHT_M = 0.08  # of a vehicle's centre above the floor when it stands
_TOUCH_M2 = 1e-12  # rounding error of the square of a distance

# --- the equations of one kind of system -----------------------------------------------------------------------------

ROWS = len(X)  # of its state: the vehicle's twelve, then those of the attached body


@compiled
def couple(x, vehicle, x_dot):
    """The attached body (vehicle.body: its record): its rows of x_dot, and its force on the rows of the vehicle."""


@compiled
def before_step(x, inputs, vehicle):
    """What runs on board at the beginning of a step, in state x: may change the commands in inputs (9,)."""


@compiled
def after_step(inputs, climb_m_s, vehicle, step_s):
    """What runs on board at the end of a step that began with this climb rate, while the motors run."""


# --- the same for all kinds ------------------------------------------------------------------------------------------


def system_slope(x, inputs, vehicle, x_dot):
    """x_dot (ROWS,) of the vehicle and of what is attached to it. Returns the demanded thrust [N]."""
    thrust_n = slope(x, inputs, vehicle, x_dot)
    couple(x, vehicle, x_dot)
    return thrust_n


def runge_kutta(x, inputs, vehicle, step_s, work):
    """One step of the classical fourth-order method, inputs held: x (ROWS,) is changed in place.

    work: (5, ROWS), overwritten. Returns h' at the start of the step [m/s].
    """
    at, k1, k2, k3, k4 = work[0], work[1], work[2], work[3], work[4]
    for j in range(ROWS):
        at[j] = x[j]
    system_slope(at, inputs, vehicle, k1)
    for j in range(ROWS):
        at[j] = x[j] + 0.5 * step_s * k1[j]
    system_slope(at, inputs, vehicle, k2)
    for j in range(ROWS):
        at[j] = x[j] + 0.5 * step_s * k2[j]
    system_slope(at, inputs, vehicle, k3)
    for j in range(ROWS):
        at[j] = x[j] + step_s * k3[j]
    system_slope(at, inputs, vehicle, k4)
    for j in range(ROWS):
        x[j] += step_s / 6.0 * (k1[j] + 2.0 * (k2[j] + k3[j]) + k4[j])
    return k1[X.H]


def advance(x, u, flags, columns, vehicles, step_s, net_m):
    """One step of all systems of this kind. Returns whether one of them touches floor or net.

    x (rows, n), u (9, n), flags (2, n; lifted and touches): of all vehicles, those of this kind in `columns` (k,).
    vehicles (k,): their records.  net_m: half its extent in x and in y, and its height.
    """
    lifted, touches = flags[0], flags[1]
    work = np.empty((5, ROWS))
    anyone_touches = False
    for c in range(len(columns)):
        i = columns[c]
        inputs, vehicle = u[:, i], vehicles[c]
        touches[i] = False
        if lifted[i]:
            state = x[:, i]
            before_step(state, inputs, vehicle)
            climb_m_s = runge_kutta(state, inputs, vehicle, step_s, work)
            if inputs[U.MOTORS] != 0.0:
                after_step(inputs, climb_m_s, vehicle, step_s)
            touches[i] = is_beyond(state, net_m)
            anyone_touches |= touches[i]
    return anyone_touches


def differentiate(x, u, columns, vehicles, x_dot, thrust_n):
    """Write x_dot (rows, n) and the demanded thrusts thrust_n (n,) [N] of the systems of this kind."""
    at, k = np.empty(ROWS), np.empty(ROWS)
    for c in range(len(columns)):
        i = columns[c]
        for j in range(ROWS):
            at[j] = x[j, i]
        thrust_n[i] = system_slope(at, u[:, i], vehicles[c], k)
        for j in range(ROWS):
            x_dot[j, i] = k[j]


@compiled
def is_beyond(x, net_m):
    """Whether a vehicle is below the height at which it stands, or beyond the net (half x, half y, height)."""
    half_x_m, half_y_m, top_m = net_m
    height_m = x[X.H] - 0.5 * (REST_HEIGHT_M + top_m)
    return (
        x[X.P_N] ** 2 - half_x_m**2 > _TOUCH_M2
        or x[X.P_E] ** 2 - half_y_m**2 > _TOUCH_M2
        or height_m**2 - (0.5 * (top_m - REST_HEIGHT_M)) ** 2 > _TOUCH_M2
    )


@compiled
def closest(x, lifted, radius_m):
    """(least squared distance of two vehicles in the air [m^2], inf when there are no two; whether two touch).

    radius_m: (n,) of each, in any direction.
    """
    least_m2, touch = math.inf, False
    for i in range(x.shape[1]):
        if lifted[i]:
            for j in range(i):
                if lifted[j]:
                    north, east, up = x[X.P_N, i] - x[X.P_N, j], x[X.P_E, i] - x[X.P_E, j], x[X.H, i] - x[X.H, j]
                    square = north * north + east * east + up * up
                    least_m2 = min(least_m2, square)
                    touch |= square < (radius_m[i] + radius_m[j]) ** 2
    return least_m2, touch


# --- compiling a kind ------------------------------------------------------------------------------------------------


class Integrator(NamedTuple):
    """`advance` and `differentiate` of one kind, compiled."""

    advance: object
    differentiate: object


@functools.cache
def integrator(name="quadrotor", size=0, **functions):
    """Integrator of a kind of system. size: rows of the attached body. functions: replacements by name.

    The compiled code is cached by the name and the text of the files that the functions come from.
    """
    namespace = {**globals(), **functions, "ROWS": len(X) + size}
    paths = sorted({inspect.getsourcefile(getattr(f, "py_func", f)) for f in functions.values()})
    text = b"".join(pathlib.Path(path).read_bytes() for path in paths)
    label = "%s_%s" % (name, hashlib.sha256(text).hexdigest()[:8])
    for function in (system_slope, runge_kutta, advance, differentiate):
        copy = types.FunctionType(function.__code__, namespace, function.__name__)
        copy.__qualname__ = "%s_%s" % (function.__name__, label)
        namespace[function.__name__] = compiled(copy)
    return Integrator(namespace["advance"], namespace["differentiate"])
