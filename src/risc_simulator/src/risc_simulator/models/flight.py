"""Orders to a vehicle and its states: the types shared by hosts, world and on-board logic."""

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
    other: str = ""  # namespace of the vehicle that it touched


class Firmware:
    """On-board logic of one vehicle: turns actions into the commands of its loops. The world calls it.

    phase: FlightPhase.   command: four numbers, the first rows of the input (enum U, or as the type's own loops
    understand them).   motors_on: rotors turn.   lifted: they carry the vehicle; False while it stands.
    wake_s: from this time on wake() is called at the start of every step.
    A type overrides what it does otherwise; it must override apply().
    """

    phase = FlightPhase.LANDED
    command = (0.0, 0.0, 0.0, 0.0)
    motors_on = lifted = False
    wake_s = math.inf
    STOPS_WITH_A_MOTOR = False  # it watches the motors, and stops them all when one stops

    def __init__(self, vehicle_type, rng, perturbed, rest_height_m):
        """vehicle_type: VehicleType. rng: Generator of this vehicle alone. rest_height_m: of its centre, standing."""

    def configure(self, record):
        """Write the constants of this vehicle into its record, an array (1,) with the FIELDS of the type; keep it."""

    def tell(self):
        """Write the decisions into the record. Returns the command to be obeyed; None keeps the inputs as they are."""
        return self.command

    def apply(self, action, time_s, vertical_motion):
        """Obey a Setpoint or a FlightAction, as far as the phase allows it; the rest is ignored, as on the vehicle.

        vertical_motion: function that gives height [m] and climb rate [m/s] at time_s.
        """
        raise NotImplementedError

    def wake(self, time_s, vertical_motion):
        """Called at the start of every step from wake_s on."""

    def touch_down(self, time_s, impact_m_s):
        """Handle contact with the floor at this downward speed. Returns why it is a crash, or "" if it is none."""
        if self.phase is not FlightPhase.FLYING:
            self.lifted = False
        return ""

    def crash(self, time_s):
        """Handle a collision: motors off. The vehicle falls until touch_down()."""
        self.phase, self.motors_on = FlightPhase.EMERGENCY, False

    def fly_at(self, time_s, height_m):
        """Start in the air (offline studies)."""
        self.phase, self.motors_on, self.lifted = FlightPhase.FLYING, True, True

    def battery_pct(self, time_s):
        """Charge in percent at this time, never below 0."""
        return 100.0

    def set_battery_pct(self, pct, time_s):
        """Fit another battery, with this charge."""

    def weaken_battery(self, pct, time_s):
        """Set the charge, as by a fault of the fitted battery."""
        self.set_battery_pct(pct, time_s)

    def power_cycle(self, time_s):
        """Fit a full battery and start over, as if just switched on. The vehicle stands."""
        self.phase, self.motors_on, self.lifted = FlightPhase.LANDED, False, False
        self.command, self.wake_s = (0.0, 0.0, 0.0, 0.0), math.inf
        self.set_battery_pct(100.0, time_s)

    def see_floor(self, sees):
        """Set whether the floor below has a texture, for a vehicle whose bottom camera needs one."""

    def fly_by_hand(self, sticks, time_s):
        """Let a pilot fly it with its own transmitter, if it has one. sticks: roll, pitch, yaw as fractions of full
        scale, + right, nose up, clockwise, and lift in multiples of the weight; None ends it.
        """

    def check_battery(self, time_s):
        """Called about once a second: an empty battery lands the vehicle."""
