"""Compiled scalar code: what runs for every vehicle in every frame.

A function under `@compiled` is plain Python on floats, arrays and records, written like the equations: a loop over
vehicles with scalars inside. numba turns it into machine code, once: `./maap build` flies a second offline, which
compiles everything, and the results are kept in __pycache__ beside the sources. Nothing is compiled or loaded in
flight: every class that uses such a function calls it once in its constructor. With NUMBA_DISABLE_JIT=1 the same source
runs as plain Python; the tests compare the two.

    VEHICLE = record("phi_rad theta_rad", ("velocity_m_s", float, (3,)))

    @compiled
    def tilt(vehicles, out_rad):
        for i in range(len(vehicles)):
            v = vehicles[i]
            out_rad[i] = math.acos(math.cos(v.phi_rad) * math.cos(v.theta_rad))

A call costs 0.15 us and 0.05 us an argument (arrays and records alike), so one call a frame for the whole fleet.
"""

import numba
import numpy as np

# Divisions by zero give inf or NaN, as in numpy; the arithmetic is that of Python to the last bit (no fastmath).
# It is not called from C: without an entry point for that, compiling takes a seventh less time.
compiled = numba.njit(cache=True, error_model="numpy", no_cfunc_wrapper=True)


def record(*fields):
    """dtype of an array of records: numpy fields (name, type[, shape]) that are read as attributes, r.name.

    A string lists names of float fields.
    """
    parts = ([(name, float) for name in item.split()] if isinstance(item, str) else [item] for item in fields)
    return np.dtype((np.record, [field for part in parts for field in part]))


def with_row(array, axis=0):
    """An array with one more row of zeros along an axis."""
    shape = (*array.shape[:axis], 1, *array.shape[axis + 1 :])
    return np.concatenate([array, np.zeros(shape, dtype=array.dtype)], axis=axis)
