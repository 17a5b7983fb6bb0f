"""What may be asked of a vehicle and what it says of itself: the words between hosts, world and on-board logic."""

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np


class FlightPhase(Enum):
    """What the vehicle's own logic is doing."""

    LANDED = "landed"
    TAKING_OFF = "taking off"
    HOVERING = "hovering"  # holding its place by optical flow
    FLYING = "flying"  # following setpoints
    LANDING = "landing"
    EMERGENCY = "emergency"  # motors cut


class FlightAction(Enum):
    """Orders beside setpoints."""

    TAKE_OFF = "take off"  # only from LANDED, with charge in the battery
    LAND = "land"
    CUT_MOTORS = "cut motors"
    CLEAR_EMERGENCY = "clear emergency"  # only on the ground


@dataclass(frozen=True)
class Setpoint:
    """Piloting command in NED senses, as it arrives on board. Raises ValueError for numbers that are not finite."""

    roll_rad: float = 0.0  # + right wing down
    pitch_rad: float = 0.0  # + nose up
    climb_m_s: float = 0.0  # + up
    yaw_rate_rad_s: float = 0.0  # + clockwise from above
    hover: bool = False  # level, brake, keep height and heading; the four values are not used

    def __post_init__(self):
        if not math.isfinite(self.roll_rad + self.pitch_rad + self.climb_m_s + self.yaw_rate_rad_s):
            raise ValueError("a setpoint must be finite, got %r" % (self,))


@dataclass(frozen=True)
class VehicleState:
    """The true state of one vehicle."""

    position_m: np.ndarray  # (3,) cortex frame
    velocity_m_s: np.ndarray  # (3,) cortex axes
    phi: float  # [rad] roll, + right wing down
    theta: float  # [rad] pitch, + nose up
    psi: float  # [rad] yaw, + clockwise from above, in (-pi, pi]
    p: float  # [rad/s] body rates
    q: float
    r: float
    specific_force_m_s2: np.ndarray  # (3,) body axes (forward, right, down): what ideal accelerometers measure
    motor_pwm: tuple  # 4 numbers 0..255: front left, front right, rear right, rear left
    battery_pct: float


@dataclass(frozen=True)
class Crash:
    """A flight that ended in the net, on the floor or in another vehicle."""

    time_s: float
    namespace: str
    position_m: np.ndarray  # (3,) cortex frame
    reason: str
