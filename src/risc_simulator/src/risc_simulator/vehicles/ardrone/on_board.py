"""What runs on board in every step, compiled: hovering by optical flow, height hold, the slow trim of the climb loop.

When it runs, and with which numbers, is decided by firmware.py.
"""

from risc_lab.compiled import compiled
from risc_simulator.models.quadrotor import U, X, level_motion

FIELDS = (
    ("holds", bool),  # it keeps its height by itself; False: the commands stay as they are
    ("height_m", float),  # to be held, with a climb rate within these limits
    ("climb_min_m_s", float),
    ("climb_max_m_s", float),
    ("brakes", bool),  # while it holds, it brakes and keeps its heading, too; False: tilt and yaw rate are as commanded
    ("height_gain_1_s", float),  # climb rate per height error
    ("flow_gain_rad_per_m_s", float),  # braking: tilt per velocity seen
    ("flow_tilt_max_rad", float),
    ("flow_scale", float),  # velocity seen = scale * true one + bias
    ("flow_bias_forward_m_s", float),
    ("flow_bias_right_m_s", float),
    ("climb_integral_1_s2", float),  # slow trim of the climb loop
    ("climb_trim_limit_m_s2", float),
)


@compiled
def before_step(x, inputs, vehicle):
    """Commands of a vehicle that holds by itself, for the step that starts in state x (12,), to inputs (9,)."""
    if not vehicle.holds:
        return
    if vehicle.brakes:
        _, forward_m_s, right_m_s = level_motion(x)
        inputs[U.ROLL] = -_brake(right_m_s, vehicle.flow_bias_right_m_s, vehicle)
        inputs[U.PITCH] = _brake(forward_m_s, vehicle.flow_bias_forward_m_s, vehicle)
        inputs[U.YAW_RATE] = 0.0
    up_m_s = vehicle.height_gain_1_s * (vehicle.height_m - x[X.H])
    inputs[U.CLIMB] = min(vehicle.climb_max_m_s, max(vehicle.climb_min_m_s, up_m_s))


@compiled
def _brake(velocity_m_s, bias_m_s, vehicle):
    tilt_rad = vehicle.flow_gain_rad_per_m_s * (vehicle.flow_scale * velocity_m_s + bias_m_s)
    return min(vehicle.flow_tilt_max_rad, max(-vehicle.flow_tilt_max_rad, tilt_rad))


@compiled
def after_step(inputs, climb_m_s, vehicle, step_s):
    """The slow integral on the climb error; climb_m_s: climb rate at the start of the step."""
    trim = inputs[U.CLIMB_TRIM] + vehicle.climb_integral_1_s2 * step_s * (inputs[U.CLIMB] - climb_m_s)
    inputs[U.CLIMB_TRIM] = max(-vehicle.climb_trim_limit_m_s2, min(vehicle.climb_trim_limit_m_s2, trim))
