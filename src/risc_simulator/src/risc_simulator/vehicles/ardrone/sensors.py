"""What the sensors of an AR.Drone 2.0 read, from the true state of a vehicle, with seeded noise.

Axes are the aircraft's: x nose, y right, z down; pitch + nose up, roll + right side down, yaw + clockwise from above.
"""

import math
from typing import NamedTuple

from risc_lab.frames import GRAVITY_M_S2
from risc_simulator.models.noise import normal_numbers

# One standard deviation of each reading.
ATTITUDE_NOISE_DEG = 0.05
ATTITUDE_BIAS_DEG = 0.3  # of the level, per vehicle; a flat trim removes it
ACCELERATION_NOISE_MG = 8.0
GYRO_NOISE_DEG_S = 0.2
GYRO_OFFSET_DEG_S = 0.5  # removed by the firmware, reported in gyros_offsets
ALTITUDE_NOISE_M = 0.004  # filtered
ULTRASOUND_NOISE_M = 0.010  # raw
VELOCITY_NOISE_M_S = 0.03  # optical flow; 0 on the ground
MAGNETIC_NOISE_MG = 2.0  # milligauss
PRESSURE_NOISE_PA = 2.0

FIELD_NORTH_MG = 210.0  # earth's field [milligauss]; the lab's x axis is taken as magnetic north
FIELD_DOWN_MG = 470.0
ULTRASOUND_LEAST_M = 0.24  # shortest distance measured: a vehicle on the ground reads this
ODOMETRY_GAP_S = 0.5  # a longer pause of the readings is not added to the way
GROUND_PRESSURE_PA = 85800.0  # a lab at 1400 m
PRESSURE_PER_METRE_PA = 10.4
TEMPERATURE_TENTHS_C = 435  # inside the hull

_DEG = 180.0 / math.pi


class Flow(NamedTuple):
    """Velocity as the bottom camera measures it: scale * true one + bias."""

    scale: float = 1.0
    bias_forward_m_s: float = 0.0
    bias_right_m_s: float = 0.0


class Reading(NamedTuple):
    """One set of readings, in body axes unless marked as levelled."""

    roll_deg: float
    pitch_deg: float
    yaw_deg: float  # in (-180, 180]
    heading_unwrapped_deg: float  # the same without jumps
    acceleration_mg: tuple[float, float, float]  # milli-g; at rest z is -1000
    rates_deg_s: tuple[float, float, float]
    altitude_m: float  # above the height at which it stands
    altitude_raw_m: float  # the same by ultrasound
    velocity_m_s: tuple[float, float, float]  # forward, right, down, levelled
    turned_deg: float  # since the first reading
    way_m: tuple[
        float, float
    ]  # flown since the first reading, along its forward and right axes then: integrated velocity, which drifts
    magnetic_mg: tuple[float, float, float]  # milligauss
    pressure_pa: float
    battery_pct: float
    battery_mv: float
    motor_pwm: tuple[int, int, int, int]


class ArdroneSensors:
    """Sensors of one vehicle.

    rng: numpy Generator of this vehicle.  noise: factor on all noise and biases, 0 gives exact readings.
    rest_height_m: height of the vehicle's centre when it stands; altitude is measured from there.
    flow: function that gives the current Flow, by which the vehicle hovers, too.
    """

    def __init__(self, rng, noise=1.0, rest_height_m=0.0, flow=Flow):
        self._normal, self._factor, self._flow = normal_numbers(rng, noise), noise, flow
        self._rest_height_m = rest_height_m
        n = self._noise
        self._bias_deg = (n(ATTITUDE_BIAS_DEG), n(ATTITUDE_BIAS_DEG))  # roll, pitch
        self.trim_deg = (0.0, 0.0)  # subtracted by the firmware
        self.gyro_offsets_deg_s = (n(GYRO_OFFSET_DEG_S), n(GYRO_OFFSET_DEG_S), n(GYRO_OFFSET_DEG_S))
        self._last_psi = None
        self._unwrapped = self._first_heading_deg = 0.0
        self._last_s, self._way_m = -math.inf, (0.0, 0.0)

    def _noise(self, std):
        return std * next(self._normal)

    def flat_trim(self):
        """Zero the attitude readings, of a vehicle that stands level."""
        self.trim_deg = self._bias_deg

    def read(self, state, airborne, time_s):
        """Reading of a VehicleState at time_s.

        airborne: False on the ground, where velocities read 0 and the altitude has no noise.
        """
        n = self._noise
        roll_deg = state.phi * _DEG + self._bias_deg[0] - self.trim_deg[0] + n(ATTITUDE_NOISE_DEG)
        pitch_deg = state.theta * _DEG + self._bias_deg[1] - self.trim_deg[1] + n(ATTITUDE_NOISE_DEG)
        psi = state.psi
        if self._last_psi is None:
            self._unwrapped = psi
            self._first_heading_deg = psi * _DEG
        else:
            self._unwrapped += math.remainder(psi - self._last_psi, 2.0 * math.pi)
        self._last_psi = psi
        yaw_noise_deg = n(ATTITUDE_NOISE_DEG)
        heading_deg = self._unwrapped * _DEG + yaw_noise_deg
        yaw_deg = math.remainder(psi * _DEG + yaw_noise_deg, 360.0)

        fx, fy, fz = (1000.0 / GRAVITY_M_S2 * value for value in state.specific_force_m_s2.tolist())
        a = ACCELERATION_NOISE_MG
        acceleration_mg = (fx + n(a), fy + n(a), fz + n(a))
        g = GYRO_NOISE_DEG_S
        rates_deg_s = (state.p * _DEG + n(g), state.q * _DEG + n(g), state.r * _DEG + n(g))

        x, y, z = state.position_m.tolist()
        height_m = max(0.0, z - self._rest_height_m)
        altitude_m = max(0.0, height_m + n(ALTITUDE_NOISE_M)) if airborne else height_m
        altitude_raw_m = max(ULTRASOUND_LEAST_M, height_m + n(ULTRASOUND_NOISE_M) if airborne else height_m)
        sin_psi, cos_psi = math.sin(psi), math.cos(psi)
        velocity_m_s = self.velocity_m_s(state) if airborne else (0.0, 0.0, 0.0)
        turned_deg = heading_deg - self._first_heading_deg

        # R(phi, theta, psi) takes NED to body: the field is (north, 0, down)
        sin_phi, cos_phi = math.sin(state.phi), math.cos(state.phi)
        sin_theta, cos_theta = math.sin(state.theta), math.cos(state.theta)
        north1, east1 = FIELD_NORTH_MG * cos_psi, -FIELD_NORTH_MG * sin_psi
        down2 = sin_theta * north1 + cos_theta * FIELD_DOWN_MG
        m = MAGNETIC_NOISE_MG
        magnetic_mg = (
            cos_theta * north1 - sin_theta * FIELD_DOWN_MG + n(m),
            cos_phi * east1 + sin_phi * down2 + n(m),
            -sin_phi * east1 + cos_phi * down2 + n(m),
        )
        return Reading(
            roll_deg,
            pitch_deg,
            180.0 if yaw_deg == -180.0 else yaw_deg,
            heading_deg,
            acceleration_mg,
            rates_deg_s,
            altitude_m,
            altitude_raw_m,
            velocity_m_s,
            turned_deg,
            self._add_to_the_way(velocity_m_s, turned_deg, time_s),
            magnetic_mg,
            GROUND_PRESSURE_PA - PRESSURE_PER_METRE_PA * z + n(PRESSURE_NOISE_PA),
            state.battery_pct,
            10500 + 23 * state.battery_pct,  # three LiPo cells; 50 % reads 11650 mV
            state.motor_pwm,
        )

    def velocity_m_s(self, state):
        """(forward, right, down) [m/s] of a VehicleState in the air, levelled."""
        n, v, flow = self._noise, VELOCITY_NOISE_M_S, self._flow()
        sin_psi, cos_psi = math.sin(state.psi), math.cos(state.psi)
        north, west, up = state.velocity_m_s.tolist()
        scale = 1.0 + self._factor * (flow.scale - 1.0)
        return (
            scale * (cos_psi * north - sin_psi * west) + self._factor * flow.bias_forward_m_s + n(v),
            scale * (-sin_psi * north - cos_psi * west) + self._factor * flow.bias_right_m_s + n(v),
            -up + n(v),
        )

    def _add_to_the_way(self, velocity_m_s, turned_deg, time_s):
        elapsed_s, self._last_s = time_s - self._last_s, time_s
        if elapsed_s < ODOMETRY_GAP_S:
            forward, right, _ = velocity_m_s
            c, s = math.cos(turned_deg / _DEG), math.sin(turned_deg / _DEG)
            x, y = self._way_m
            self._way_m = (x + elapsed_s * (c * forward - s * right), y + elapsed_s * (s * forward + c * right))
        return self._way_m
