"""What the sensors of an IRIS+'s autopilot read, from the true state of a vehicle, with seeded noise.

Axes are the aircraft's: x nose, y right, z down; roll + right side down, pitch + nose up, yaw + clockwise from above.
"""

import math
from typing import NamedTuple

from risc_simulator.models.noise import normal_numbers

# One standard deviation of each reading.
ATTITUDE_NOISE_RAD = math.radians(0.05)
ATTITUDE_BIAS_RAD = math.radians(0.3)  # of the level, per vehicle
HEADING_BIAS_RAD = math.radians(3.0)  # of the compass indoors, per vehicle
ACCELERATION_NOISE_M_S2 = 0.05
GYRO_NOISE_RAD_S = math.radians(0.1)
BAROMETER_NOISE_M = 0.06
BAROMETER_DRIFT_M = 0.3  # that it wanders around the truth, with this time constant
BAROMETER_DRIFT_S = 60.0
CLIMB_NOISE_M_S = 0.05
MAGNETIC_NOISE_MG = 2.0  # milligauss
VOLTAGE_NOISE_MV = 10.0

FIELD_NORTH_MG, FIELD_DOWN_MG = 210.0, 470.0  # earth's field [milligauss]; the lab's x axis is magnetic north
GROUND_PRESSURE_PA = 85800.0  # a lab at 1400 m
PRESSURE_PER_METRE_PA = 10.4
TEMPERATURE_C = 38.0
EMPTY_MV, MV_PER_PCT = 10500.0, 21.0  # three LiPo cells: 12.6 V full
CAPACITY_AH = 3.5


class Reading(NamedTuple):
    """One set of readings."""

    roll_rad: float
    pitch_rad: float
    yaw_rad: float  # in (-pi, pi], from the lab's x axis
    rates_rad_s: tuple[float, float, float]
    acceleration_m_s2: tuple[float, float, float]  # at rest (0, 0, -g)
    magnetic_mg: tuple[float, float, float]
    altitude_m: float  # of the barometer, above where it was switched on
    climb_m_s: float
    pressure_pa: float
    battery_pct: float
    battery_mv: float
    current_a: float
    thrust_fraction: float  # of the greatest, 0 while the rotors stand
    motor_us: tuple[int, int, int, int]  # what the motors' controllers are told


class IrisSensors:
    """Sensors of one vehicle."""

    def __init__(self, vehicle, rng, noise=1.0):
        """vehicle: world.Vehicle.  rng: numpy Generator of these sensors.  noise: factor, 0 gives exact readings."""
        self._vehicle, self._rest_height_m = vehicle, vehicle.height_m if not vehicle.firmware.lifted else 0.0
        self._normal = normal_numbers(rng, noise)
        self._level_rad = self._noise(ATTITUDE_BIAS_RAD), self._noise(ATTITUDE_BIAS_RAD)
        self._heading_rad = self._noise(HEADING_BIAS_RAD)
        self._drift_m, self._drift_s = 0.0, None

    def _noise(self, std):
        return std * next(self._normal)

    def read(self, time_s):
        """Reading at a time [s] that does not go back."""
        n, vehicle = self._noise, self._vehicle
        state = vehicle.state
        a, g, m = ACCELERATION_NOISE_M_S2, GYRO_NOISE_RAD_S, MAGNETIC_NOISE_MG
        fx, fy, fz = state.specific_force_m_s2.tolist()
        sin_phi, cos_phi = math.sin(state.phi), math.cos(state.phi)
        sin_theta, cos_theta = math.sin(state.theta), math.cos(state.theta)
        # R(phi, theta, psi) takes NED to body: the field is (north, 0, down)
        north1, east1 = FIELD_NORTH_MG * math.cos(state.psi), -FIELD_NORTH_MG * math.sin(state.psi)
        down2 = sin_theta * north1 + cos_theta * FIELD_DOWN_MG
        height_m = float(state.position_m[2]) - self._rest_height_m
        self._wander(time_s)
        altitude_m = height_m + self._drift_m + n(BAROMETER_NOISE_M)
        pwm = state.motor_pwm[0] / 255.0
        flies = vehicle.firmware.armed
        return Reading(
            roll_rad=state.phi + self._level_rad[0] + n(ATTITUDE_NOISE_RAD),
            pitch_rad=state.theta + self._level_rad[1] + n(ATTITUDE_NOISE_RAD),
            yaw_rad=math.remainder(state.psi + self._heading_rad + n(ATTITUDE_NOISE_RAD), 2.0 * math.pi),
            rates_rad_s=(state.p + n(g), state.q + n(g), state.r + n(g)),
            acceleration_m_s2=(fx + n(a), fy + n(a), fz + n(a)),
            magnetic_mg=(
                cos_theta * north1 - sin_theta * FIELD_DOWN_MG + n(m),
                cos_phi * east1 + sin_phi * down2 + n(m),
                -sin_phi * east1 + cos_phi * down2 + n(m),
            ),
            altitude_m=altitude_m,
            climb_m_s=float(state.velocity_m_s[2]) + n(CLIMB_NOISE_M_S),
            pressure_pa=GROUND_PRESSURE_PA - PRESSURE_PER_METRE_PA * altitude_m,
            battery_pct=state.battery_pct,
            battery_mv=EMPTY_MV + MV_PER_PCT * state.battery_pct + n(VOLTAGE_NOISE_MV),
            current_a=36.0 * CAPACITY_AH * vehicle.firmware.drain_pct_s,
            thrust_fraction=pwm * pwm,
            motor_us=tuple(round(1000 + 1000 * motor / 255.0) for motor in state.motor_pwm) if flies else (1000,) * 4,
        )

    def _wander(self, time_s):
        if self._drift_s is not None:
            keep = math.exp(-max(0.0, time_s - self._drift_s) / BAROMETER_DRIFT_S)
            self._drift_m = keep * self._drift_m + self._noise(BAROMETER_DRIFT_M * math.sqrt(1.0 - keep * keep))
        self._drift_s = time_s
