"""On-board code of every step, compiled: hovering by optical flow, height hold, the slow trim of the climb loop.

firmware.py decides when it runs, and with which numbers.
"""

from risc_lab.compiled import compiled
from risc_simulator.models.quadrotor import U, X, felt_climb, level_motion

HEIGHT_GAIN_1_S = 1.2  # height hold: climb rate per height error
FLOW_GAIN_RAD_PER_M_S = 0.15  # braking: tilt per velocity seen by the belly camera
FLOW_TILT_MAX_RAD = 0.2
CLIMB_INTEGRAL_1_S2 = 0.5  # slow trim of the climb loop: a thrust error is trimmed out within some 6 s
CLIMB_TRIM_LIMIT_M_S2 = 2.0

FIELDS = (
    ("holds", bool),  # it keeps its height by itself; False: the commands stay as they are
    ("height_m", float),  # to be held, with a climb rate within these limits
    ("climb_min_m_s", float),
    ("climb_max_m_s", float),
    ("brakes", bool),  # while it holds, it brakes and keeps its heading, too; False: tilt and yaw rate are as commanded
    ("flow_scale", float),  # velocity seen = scale * true one + bias
    ("flow_bias_forward_m_s", float),
    ("flow_bias_right_m_s", float),
)


@compiled
def before_step(x, inputs, vehicle):
    """Write the commands of a vehicle that holds by itself, for the step from state x (12,), into inputs (9,)."""
    if not vehicle.holds:
        return
    if vehicle.brakes:
        _, forward_m_s, right_m_s = level_motion(x)
        inputs[U.ROLL] = -_brake(right_m_s, vehicle.flow_bias_right_m_s, vehicle)
        inputs[U.PITCH] = _brake(forward_m_s, vehicle.flow_bias_forward_m_s, vehicle)
        inputs[U.YAW_RATE] = 0.0
    up_m_s = HEIGHT_GAIN_1_S * (vehicle.height_m - x[X.H])
    inputs[U.CLIMB] = min(vehicle.climb_max_m_s, max(vehicle.climb_min_m_s, up_m_s))


@compiled
def _brake(velocity_m_s, bias_m_s, vehicle):
    tilt_rad = FLOW_GAIN_RAD_PER_M_S * (vehicle.flow_scale * velocity_m_s + bias_m_s)
    return min(FLOW_TILT_MAX_RAD, max(-FLOW_TILT_MAX_RAD, tilt_rad))


@compiled
def after_step(inputs, climb_m_s, vehicle, step_s):
    """The slow integral on the climb error; climb_m_s: climb rate at the start of the step."""
    trim = inputs[U.CLIMB_TRIM] + CLIMB_INTEGRAL_1_S2 * step_s * (inputs[U.CLIMB] - felt_climb(climb_m_s, vehicle))
    inputs[U.CLIMB_TRIM] = max(-CLIMB_TRIM_LIMIT_M_S2, min(CLIMB_TRIM_LIMIT_M_S2, trim))
