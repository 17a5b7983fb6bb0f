"""A body for tests: a ball on a spring without damping, whose other end is the vehicle's centre."""

import math

from risc_lab.compiled import compiled
from risc_lab.frames import GRAVITY_M_S2
from risc_simulator.models.quadrotor import X, push

SIZE = 6  # north, east, up [m], and their rates [m/s]
FIELDS = ("ball_mass_kg", "stiffness_n_m", "length_m")
_BALL = len(X)


@compiled
def couple(x, vehicle, x_dot):
    """m p'' = -k (|d| - l) d / |d| - m g, d: from the vehicle to the ball; the opposite force acts on the vehicle."""
    body = vehicle.body
    north, east, up = x[_BALL] - x[X.P_N], x[_BALL + 1] - x[X.P_E], x[_BALL + 2] - x[X.H]
    distance_m = math.sqrt(north * north + east * east + up * up)
    pull = body.stiffness_n_m * (distance_m - body.length_m) / distance_m
    push(x, vehicle, pull * north, pull * east, pull * up, x_dot)
    for k in range(3):
        x_dot[_BALL + k] = x[_BALL + 3 + k]
    x_dot[_BALL + 3] = -pull * north / body.ball_mass_kg
    x_dot[_BALL + 4] = -pull * east / body.ball_mass_kg
    x_dot[_BALL + 5] = -pull * up / body.ball_mass_kg - GRAVITY_M_S2


@compiled
def rest(x, vehicle):
    """State of the ball hanging at rest."""
    body = vehicle.body
    x[_BALL], x[_BALL + 1] = x[X.P_N], x[X.P_E]
    x[_BALL + 2] = x[X.H] - body.length_m - body.ball_mass_kg * GRAVITY_M_S2 / body.stiffness_n_m
    x[_BALL + 3 : _BALL + 6] = 0.0


@compiled
def place(x, vehicle, position_m, axes):
    """Position of the ball."""
    position_m[0], position_m[1], position_m[2] = x[_BALL], -x[_BALL + 1], x[_BALL + 2]
