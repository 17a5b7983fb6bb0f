"""What the sensors of an IRIS+'s autopilot read, from the true state of a vehicle, with seeded noise.

Axes are the aircraft's: x nose, y right, z down; roll + right side down, pitch + nose up, yaw + clockwise from above.
"""

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

from risc_lab.lab.yaml_reader import load_yaml, package_file
from risc_lab.settings import NotNegative, Positive, Settings, settings_from
from risc_simulator.models.noise import normal_numbers

FIELD_NORTH_MG, FIELD_DOWN_MG = 210.0, 470.0  # earth's field [milligauss]; the lab's x axis is magnetic north
GROUND_PRESSURE_PA = 85800.0  # a lab at 1400 m
PRESSURE_PER_METRE_PA = 10.4
TEMPERATURE_C = 38.0
EMPTY_MV, MV_PER_PCT = 10500.0, 21.0  # three LiPo cells: 12.6 V full
CAPACITY_AH = 3.5


@dataclass(frozen=True)
class SensorErrors(Settings):
    """Content of config/iris_sensors.yaml, which explains each field."""

    attitude_noise_rad: NotNegative
    heading_error_rad: NotNegative
    gyro_noise_rad_s: NotNegative
    acceleration_noise_m_s2: NotNegative
    barometer_noise_m: NotNegative
    barometer_noise_s: Positive
    barometer_drift_m: NotNegative
    barometer_drift_s: Positive
    rotor_wash_m: NotNegative
    climb_noise_m_s: NotNegative
    climb_error_m_s: NotNegative
    climb_error_s: Positive
    magnetic_noise_mg: NotNegative
    voltage_noise_mv: NotNegative
    delay_spread_s: NotNegative
    jitter_s: NotNegative


@functools.cache
def sensor_errors():
    """SensorErrors of every IRIS+. Raises ValueError that names the file and the key."""
    path = package_file("risc_simulator", "config/iris_sensors.yaml")
    return settings_from(SensorErrors, load_yaml(path), str(path))


class Reading(NamedTuple):
    """One set of readings."""

    roll_rad: float
    pitch_rad: float
    yaw_rad: float  # in (-pi, pi], from the lab's x axis
    rates_rad_s: tuple[float, float, float]
    acceleration_m_s2: tuple[float, float, float]  # at rest (0, 0, -g)
    magnetic_mg: tuple[float, float, float]
    altitude_m: float  # of the barometer, above the place where it was switched on
    climb_m_s: float
    pressure_pa: float
    battery_pct: float
    battery_mv: float
    current_a: float
    thrust_fraction: float  # of the greatest thrust, 0 while the rotors stand
    motor_us: tuple[int, int, int, int]  # commands to the motor controllers


class IrisSensors:
    """Sensors of one vehicle."""

    def __init__(self, vehicle, rng, noise=1.0):
        """vehicle: world.Vehicle.  rng: numpy Generator of these sensors.  noise: factor, 0 gives exact readings."""
        self._vehicle, self._rest_height_m = vehicle, vehicle.height_m if not vehicle.firmware.lifted else 0.0
        self._normal, self._errors = normal_numbers(rng, noise), sensor_errors()
        e = self._errors
        self._heading_rad = self._noise(e.heading_error_rad)
        self._wash_m = noise * e.rotor_wash_m
        self._barometer_m = _Wander(self._normal, e.barometer_noise_m, e.barometer_noise_s)
        self._drift_m = _Wander(self._normal, e.barometer_drift_m, e.barometer_drift_s)
        self._climb_m_s = _Wander(self._normal, e.climb_error_m_s, e.climb_error_s)

    def _noise(self, std):
        return std * next(self._normal)

    def read(self, time_s):
        """Reading at a time [s] that must not decrease."""
        n, vehicle, errors = self._noise, self._vehicle, self._errors
        state, plant = vehicle.state, vehicle.plant
        a, g, m = errors.acceleration_noise_m_s2, errors.gyro_noise_rad_s, errors.magnetic_noise_mg
        fx, fy, fz = state.specific_force_m_s2.tolist()
        sin_phi, cos_phi = math.sin(state.phi), math.cos(state.phi)
        sin_theta, cos_theta = math.sin(state.theta), math.cos(state.theta)
        # R(phi, theta, psi) takes NED to body: the field is (north, 0, down)
        north1, east1 = FIELD_NORTH_MG * math.cos(state.psi), -FIELD_NORTH_MG * math.sin(state.psi)
        down2 = sin_theta * north1 + cos_theta * FIELD_DOWN_MG
        height_m = float(state.position_m[2]) - self._rest_height_m
        thrust_fraction = (state.motor_pwm[0] / 255.0) ** 2
        altitude_m = height_m + self._drift_m.at(time_s) + self._barometer_m.at(time_s) - self._wash_m * thrust_fraction
        flies = vehicle.firmware.armed
        return Reading(
            roll_rad=state.phi - plant.roll_level_rad + n(errors.attitude_noise_rad),
            pitch_rad=state.theta - plant.pitch_level_rad + n(errors.attitude_noise_rad),
            yaw_rad=math.remainder(state.psi + self._heading_rad + n(errors.attitude_noise_rad), 2.0 * math.pi),
            rates_rad_s=(state.p + n(g), state.q + n(g), state.r + n(g)),
            acceleration_m_s2=(fx + n(a), fy + n(a), fz + n(a)),
            magnetic_mg=(
                cos_theta * north1 - sin_theta * FIELD_DOWN_MG + n(m),
                cos_phi * east1 + sin_phi * down2 + n(m),
                -sin_phi * east1 + cos_phi * down2 + n(m),
            ),
            altitude_m=altitude_m,
            climb_m_s=float(state.velocity_m_s[2]) + self._climb_m_s.at(time_s) + n(errors.climb_noise_m_s),
            pressure_pa=GROUND_PRESSURE_PA - PRESSURE_PER_METRE_PA * altitude_m,
            battery_pct=state.battery_pct,
            battery_mv=EMPTY_MV + MV_PER_PCT * state.battery_pct + n(errors.voltage_noise_mv),
            current_a=36.0 * CAPACITY_AH * vehicle.firmware.drain_pct_s,
            thrust_fraction=thrust_fraction,
            motor_us=tuple(round(1000 + 1000 * motor / 255.0) for motor in state.motor_pwm) if flies else (1000,) * 4,
        )


class _Wander:
    """An error that varies slowly around 0."""

    def __init__(self, normal, std, time_constant_s):
        """normal: iterator of normal numbers."""
        self._normal, self._std, self._time_constant_s = normal, std, time_constant_s
        self._value, self._time_s = std * next(normal), None

    def at(self, time_s):
        """Its value at a time [s] that must not decrease."""
        if self._time_s is not None:
            keep = math.exp(-max(0.0, time_s - self._time_s) / self._time_constant_s)
            self._value = keep * self._value + self._std * math.sqrt(1.0 - keep * keep) * next(self._normal)
        self._time_s = time_s
        return self._value
