"""On-board code of an IRIS+ in every step, compiled: thrust by throttle or by the climb loop, and its rotors' lag.

The attitude loops are those of models/quadrotor.py. firmware.py decides what runs when, and with which numbers.
Row CLIMB of the inputs is the wanted thrust [N] while the throttle sets it, and a climb rate [m/s] while `climbs`.
"""

import math

from risc_lab.compiled import compiled
from risc_lab.frames import GRAVITY_M_S2
from risc_simulator.models.quadrotor import U, X, climb_thrust, felt_climb, motion

ROTOR_TIME_CONSTANT_S = 0.04  # from wanted to true thrust: motors and 10-inch propellers
HEIGHT_GAIN_1_S = 1.2  # height hold: climb rate per height error
HEIGHT_HOLD_CLIMB_M_S = 0.5
CLIMB_INTEGRAL_1_S2 = 0.5  # slow trim of the climb loop
CLIMB_TRIM_LIMIT_M_S2 = 2.0
LEARNING_S = 2.0  # flown by the throttle without climbing, the trim learns the hover thrust with this lag
LEARNING_CLIMB_M_S = 0.5

FIELDS = (
    ("climbs", bool),  # the climb loop sets the thrust
    ("holds_height", bool),  # the climb loop holds this height:
    ("height_m", float),
    ("lift_m_s2", float),  # vertical acceleration of a nominal vehicle with this thrust, less g
    ("wanted_thrust_n", float),  # of the rotors
    ("rotor_thrust_n", float),  # their nominal thrust: thrust_scale makes it the true one
)


@compiled
def slope(x, inputs, vehicle, x_dot):
    """x_dot (12,) of an IRIS+. Returns the nominal thrust of its rotors [N]."""
    motion(x, inputs, vehicle, vehicle.rotor_thrust_n, x_dot)
    return vehicle.rotor_thrust_n


@compiled
def before_step(x, inputs, vehicle):
    """Set the wanted thrust of the step that starts in state x (12,)."""
    if not vehicle.climbs:
        upright = math.cos(x[X.PHI]) * math.cos(x[X.THETA])
        vehicle.lift_m_s2 = vehicle.rotor_thrust_n * upright / vehicle.nominal_mass_kg - GRAVITY_M_S2
        vehicle.wanted_thrust_n = _within(inputs[U.CLIMB], vehicle.thrust_min_n, vehicle.thrust_max_n)
        return
    if vehicle.holds_height:
        up_m_s = HEIGHT_GAIN_1_S * (vehicle.height_m - x[X.H])
        inputs[U.CLIMB] = _within(up_m_s, -HEIGHT_HOLD_CLIMB_M_S, HEIGHT_HOLD_CLIMB_M_S)
    vehicle.wanted_thrust_n = climb_thrust(x, inputs, vehicle)


@compiled
def after_step(inputs, climb_m_s, vehicle, step_s):
    """Advance the rotors' thrust and the trim of the climb loop. climb_m_s: climb rate at the start of the step."""
    share = 1.0 - math.exp(-step_s / ROTOR_TIME_CONSTANT_S)
    vehicle.rotor_thrust_n += share * (vehicle.wanted_thrust_n - vehicle.rotor_thrust_n)
    trim = inputs[U.CLIMB_TRIM]
    if vehicle.climbs:
        trim += CLIMB_INTEGRAL_1_S2 * step_s * (inputs[U.CLIMB] - felt_climb(climb_m_s, vehicle))
    elif abs(climb_m_s) < LEARNING_CLIMB_M_S and vehicle.wanted_thrust_n > vehicle.thrust_min_n:
        trim += step_s / LEARNING_S * (vehicle.lift_m_s2 - trim)
    inputs[U.CLIMB_TRIM] = _within(trim, -CLIMB_TRIM_LIMIT_M_S2, CLIMB_TRIM_LIMIT_M_S2)


@compiled
def _within(value, least, most):
    return min(max(value, least), most)
