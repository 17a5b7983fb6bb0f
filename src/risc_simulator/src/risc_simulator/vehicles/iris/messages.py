"""Telemetry of the virtual Pixhawk: MAVLink messages made of its sensor readings.

Indoors there is no GPS: fix type 1 and no satellites.  The true position and velocity, from a fictitious origin, are
sent nevertheless, so that a ground station has something to draw; no controller reads them.
"""

import math
import time

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from risc_lab.frames import GRAVITY_M_S2
from risc_simulator.models.flight import FlightPhase
from risc_simulator.vehicles.iris.firmware import Mode
from risc_simulator.vehicles.iris.sensors import CAPACITY_AH, TEMPERATURE_C

QUADROTOR, ARDUPILOT = mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
DISARMED_BASE_MODE = 81  # custom mode, stabilized, manual input
ORIGIN_LATITUDE_DEG, ORIGIN_LONGITUDE_DEG, ORIGIN_ALTITUDE_M = 41.742, -111.808, 1400.0
EARTH_RADIUS_M = 6378137.0
SUPPLY_MV = 5000
VERSION = 4, 5, 7  # of ArduCopter, whose behaviour is simulated
CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT  # how its empty list is read
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
CHANNELS_TOLD = 18
NO_CHANNEL = 65535

_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_ANGULAR_RATE_CONTROL
    | mavlink.MAV_SYS_STATUS_SENSOR_ATTITUDE_STABILIZATION
    | mavlink.MAV_SYS_STATUS_SENSOR_YAW_POSITION
    | mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | mavlink.MAV_SYS_STATUS_AHRS
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
)
_HEIGHT, _RECEIVER, _READY = (
    mavlink.MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL,
    mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER,
    mavlink.MAV_SYS_STATUS_PREARM_CHECK,
)
_ESTIMATES = (
    mavlink.EKF_ATTITUDE
    | mavlink.EKF_VELOCITY_HORIZ
    | mavlink.EKF_VELOCITY_VERT
    | mavlink.EKF_POS_HORIZ_REL
    | mavlink.EKF_POS_VERT_ABS
)
_LANDED = {
    FlightPhase.LANDED: mavlink.MAV_LANDED_STATE_ON_GROUND,
    FlightPhase.TAKING_OFF: mavlink.MAV_LANDED_STATE_TAKEOFF,
    FlightPhase.LANDING: mavlink.MAV_LANDED_STATE_LANDING,
}
_M = mavlink
#: messages of each stream of REQUEST_DATA_STREAM, as ArduCopter has them
STREAMS = {
    _M.MAV_DATA_STREAM_RAW_SENSORS: (_M.MAVLINK_MSG_ID_RAW_IMU, _M.MAVLINK_MSG_ID_SCALED_PRESSURE),
    _M.MAV_DATA_STREAM_EXTENDED_STATUS: (
        *(_M.MAVLINK_MSG_ID_SYS_STATUS, _M.MAVLINK_MSG_ID_POWER_STATUS, _M.MAVLINK_MSG_ID_MEMINFO),
        *(_M.MAVLINK_MSG_ID_MISSION_CURRENT, _M.MAVLINK_MSG_ID_GPS_RAW_INT),
        *(_M.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT, _M.MAVLINK_MSG_ID_FENCE_STATUS),
    ),
    _M.MAV_DATA_STREAM_RC_CHANNELS: (
        *(_M.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW, _M.MAVLINK_MSG_ID_RC_CHANNELS, _M.MAVLINK_MSG_ID_RC_CHANNELS_RAW),
    ),
    _M.MAV_DATA_STREAM_POSITION: (_M.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, _M.MAVLINK_MSG_ID_LOCAL_POSITION_NED),
    _M.MAV_DATA_STREAM_EXTRA1: (_M.MAVLINK_MSG_ID_ATTITUDE, _M.MAVLINK_MSG_ID_AHRS2),
    _M.MAV_DATA_STREAM_EXTRA2: (_M.MAVLINK_MSG_ID_VFR_HUD,),
    _M.MAV_DATA_STREAM_EXTRA3: (
        *(_M.MAVLINK_MSG_ID_AHRS, _M.MAVLINK_MSG_ID_HWSTATUS, _M.MAVLINK_MSG_ID_SYSTEM_TIME),
        *(_M.MAVLINK_MSG_ID_BATTERY_STATUS, _M.MAVLINK_MSG_ID_EKF_STATUS_REPORT, _M.MAVLINK_MSG_ID_VIBRATION),
    ),
}


class Messages:
    """Makes the messages of one autopilot, see mavlink.py for what the autopilot must provide."""

    def __init__(self, autopilot, system_id):
        self._autopilot, self._vehicle, self._system_id = autopilot, autopilot.vehicle, system_id
        position_m = self._vehicle.state.position_m
        self._home_ned_m = _ned(position_m)
        self._reading, self._read_s = None, None
        self._makers = {
            kind.id: maker
            for kind in mavlink.mavlink_map.values()
            if (maker := getattr(self, "_" + kind.msgname.lower(), None)) is not None
        }

    def __contains__(self, message_id):
        return message_id in self._makers

    def make(self, message_id, now_s):
        """The message with this id as of lab time now_s. KeyError when there is none."""
        return self._makers[message_id](now_s)

    # ------------------------------------------------------------------ state

    def _read(self, now_s):
        """sensors.Reading, one for all messages of the same time."""
        if now_s != self._read_s:
            self._reading, self._read_s = self._autopilot.sensors.read(now_s), now_s
        return self._reading

    def _heartbeat(self, _now_s):
        armed = self._autopilot.armed
        base_mode = DISARMED_BASE_MODE | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
        status = mavlink.MAV_STATE_ACTIVE if armed else mavlink.MAV_STATE_STANDBY
        return mavlink.MAVLink_heartbeat_message(QUADROTOR, ARDUPILOT, base_mode, self._autopilot.mode, status, 3)

    def _sys_status(self, now_s):
        present = _SENSORS | _HEIGHT | _RECEIVER | _READY
        enabled = present if self._autopilot.mode in (Mode.ALT_HOLD, Mode.LAND) else present & ~_HEIGHT
        health = present | mavlink.MAV_SYS_STATUS_GEOFENCE  # there is no fence, so none is breached
        if self._autopilot.radio_failsafe:
            health &= ~_RECEIVER
        if not self._autopilot.armed and self._autopilot.arming_trouble():
            health &= ~_READY
        r = self._read(now_s)
        battery = round(r.battery_mv), _int16(100.0 * r.current_a), round(r.battery_pct)
        return mavlink.MAVLink_sys_status_message(present, enabled, health, 0, *battery, 0, 0, 0, 0, 0, 0)

    def _battery_status(self, now_s):
        r = self._read(now_s)
        used_mah = round(10.0 * CAPACITY_AH * (100.0 - r.battery_pct))
        return mavlink.MAVLink_battery_status_message(
            *(0, mavlink.MAV_BATTERY_FUNCTION_UNKNOWN, mavlink.MAV_BATTERY_TYPE_LIPO, 32767),
            [round(r.battery_mv)] + 9 * [65535],
            *(_int16(100.0 * r.current_a), used_mah, -1, round(r.battery_pct)),
        )

    def _extended_sys_state(self, _now_s):
        landed = _LANDED.get(self._vehicle.phase, mavlink.MAV_LANDED_STATE_IN_AIR)
        return mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_UNDEFINED, landed)

    def _autopilot_version(self, _now_s):
        major, minor, patch = VERSION
        version = major << 24 | minor << 16 | patch << 8 | mavlink.FIRMWARE_VERSION_TYPE_OFFICIAL
        return mavlink.MAVLink_autopilot_version_message(
            CAPABILITIES, version, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, self._system_id
        )

    def _system_time(self, now_s):
        return mavlink.MAVLink_system_time_message(int(time.time() * 1e6), _ms(now_s))

    # ------------------------------------------------------------------ attitude and place

    def _attitude(self, now_s):
        r = self._read(now_s)
        return mavlink.MAVLink_attitude_message(_ms(now_s), r.roll_rad, r.pitch_rad, r.yaw_rad, *r.rates_rad_s)

    def _attitude_quaternion(self, now_s):
        r = self._read(now_s)
        wxyz = _quaternion(r.roll_rad, r.pitch_rad, r.yaw_rad)
        return mavlink.MAVLink_attitude_quaternion_message(_ms(now_s), *wxyz, *r.rates_rad_s)

    def _ahrs(self, _now_s):
        return mavlink.MAVLink_ahrs_message(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    def _ahrs2(self, now_s):
        r = self._read(now_s)
        latitude, longitude, altitude_m = _place(_ned(self._vehicle.state.position_m))
        return mavlink.MAVLink_ahrs2_message(r.roll_rad, r.pitch_rad, r.yaw_rad, altitude_m, latitude, longitude)

    def _local_position_ned(self, now_s):
        s = self._vehicle.state
        return mavlink.MAVLink_local_position_ned_message(_ms(now_s), *_ned(s.position_m), *_ned(s.velocity_m_s))

    def _global_position_int(self, now_s):
        s = self._vehicle.state
        ned_m = _ned(s.position_m)
        latitude, longitude, altitude_m = _place(ned_m)
        above_home_m = self._home_ned_m[2] - ned_m[2]
        velocity_cm_s = (round(100.0 * v) for v in _ned(s.velocity_m_s))
        heading_cdeg = round(100.0 * _heading_deg(self._read(now_s))) % 36000
        heights_mm = round(1e3 * altitude_m), round(1e3 * above_home_m)
        return mavlink.MAVLink_global_position_int_message(
            _ms(now_s), latitude, longitude, *heights_mm, *velocity_cm_s, heading_cdeg
        )

    def _vfr_hud(self, now_s):
        r = self._read(now_s)
        north, east, _ = _ned(self._vehicle.state.velocity_m_s)
        speed_m_s = math.hypot(north, east)
        heading_deg, throttle_pct = int(_heading_deg(r)) % 360, round(100.0 * r.thrust_fraction)
        altitude_m = ORIGIN_ALTITUDE_M - self._home_ned_m[2] + r.altitude_m
        return mavlink.MAVLink_vfr_hud_message(speed_m_s, speed_m_s, heading_deg, throttle_pct, altitude_m, r.climb_m_s)

    def _gps_raw_int(self, now_s):
        unknown = 65535
        return mavlink.MAVLink_gps_raw_int_message(
            _us(now_s), mavlink.GPS_FIX_TYPE_NO_FIX, 0, 0, 0, unknown, unknown, 0, unknown, 0
        )

    def _home_position(self, now_s):
        latitude, longitude, altitude_m = _place(self._home_ned_m)
        q = [1.0, 0.0, 0.0, 0.0]
        return mavlink.MAVLink_home_position_message(
            latitude, longitude, round(1e3 * altitude_m), *self._home_ned_m, q, 0.0, 0.0, 0.0, _us(now_s)
        )

    def _gps_global_origin(self, now_s):
        latitude, longitude, altitude_m = _place((0.0, 0.0, 0.0))
        return mavlink.MAVLink_gps_global_origin_message(latitude, longitude, round(1e3 * altitude_m), _us(now_s))

    def _nav_controller_output(self, _now_s):
        roll_deg, pitch_deg = map(math.degrees, self._vehicle.firmware.command[:2])
        return mavlink.MAVLink_nav_controller_output_message(roll_deg, pitch_deg, 0, 0, 0, 0.0, 0.0, 0.0)

    # ------------------------------------------------------------------ sensors, motors, channels

    def _raw_imu(self, now_s):
        r = self._read(now_s)
        accelerations_mg = [1e3 / GRAVITY_M_S2 * a for a in r.acceleration_m_s2]
        rates_mrad_s = [1e3 * rate for rate in r.rates_rad_s]
        values = (_int16(value) for value in (*accelerations_mg, *rates_mrad_s, *r.magnetic_mg))
        return mavlink.MAVLink_raw_imu_message(_us(now_s), *values)

    def _scaled_pressure(self, now_s):
        pressure_hpa = 0.01 * self._read(now_s).pressure_pa
        return mavlink.MAVLink_scaled_pressure_message(_ms(now_s), pressure_hpa, 0.0, round(100.0 * TEMPERATURE_C))

    def _servo_output_raw(self, now_s):
        front_left, front_right, rear_right, rear_left = self._read(now_s).motor_us
        motors = front_right, rear_left, front_left, rear_right  # ArduCopter's numbers 1 to 4 of an X
        return mavlink.MAVLink_servo_output_raw_message(_us(now_s) & 0xFFFFFFFF, 0, *motors, 0, 0, 0, 0)

    def _rc_channels(self, now_s):
        channels_us = self._autopilot.channels_us
        told = [*channels_us, *(CHANNELS_TOLD * [NO_CHANNEL])][:CHANNELS_TOLD]
        return mavlink.MAVLink_rc_channels_message(_ms(now_s), len(channels_us), *told, 255)

    def _rc_channels_raw(self, now_s):
        told = [*self._autopilot.channels_us, *(8 * [NO_CHANNEL])][:8]
        return mavlink.MAVLink_rc_channels_raw_message(_ms(now_s), 0, *told, 255)

    def _power_status(self, _now_s):
        return mavlink.MAVLink_power_status_message(SUPPLY_MV, 0, mavlink.MAV_POWER_STATUS_BRICK_VALID)

    def _hwstatus(self, _now_s):
        return mavlink.MAVLink_hwstatus_message(SUPPLY_MV, 0)

    def _meminfo(self, _now_s):
        return mavlink.MAVLink_meminfo_message(0, 65535, 100000)

    def _vibration(self, now_s):
        return mavlink.MAVLink_vibration_message(_us(now_s), 0.0, 0.0, 0.0, 0, 0, 0)

    def _ekf_status_report(self, _now_s):
        return mavlink.MAVLink_ekf_status_report_message(_ESTIMATES, 0.0, 0.0, 0.0, 0.0, 0.0)

    def _mission_current(self, _now_s):
        return mavlink.MAVLink_mission_current_message(0, 0, mavlink.MISSION_STATE_NO_MISSION)

    def _fence_status(self, _now_s):
        return mavlink.MAVLink_fence_status_message(0, 0, mavlink.FENCE_BREACH_NONE, 0)


def _quaternion(phi, theta, psi):
    """(w, x, y, z) of Euler angles."""
    cf, sf = math.cos(0.5 * phi), math.sin(0.5 * phi)
    ct, st = math.cos(0.5 * theta), math.sin(0.5 * theta)
    cp, sp = math.cos(0.5 * psi), math.sin(0.5 * psi)
    return (
        cf * ct * cp + sf * st * sp,
        sf * ct * cp - cf * st * sp,
        cf * st * cp + sf * ct * sp,
        cf * ct * sp - sf * st * cp,
    )


def _ned(cortex):
    """North, east, down of a vector (3,) in cortex axes."""
    x, y, z = cortex.tolist()
    return x, -y, -z


def _place(ned_m):
    """(latitude [1e-7 deg], longitude [1e-7 deg], altitude [m]) of a place (north, east, down) from the origin."""
    north, east, down = ned_m
    latitude_deg = ORIGIN_LATITUDE_DEG + math.degrees(north / EARTH_RADIUS_M)
    parallel_m = EARTH_RADIUS_M * math.cos(math.radians(ORIGIN_LATITUDE_DEG))
    longitude_deg = ORIGIN_LONGITUDE_DEG + math.degrees(east / parallel_m)
    return round(1e7 * latitude_deg), round(1e7 * longitude_deg), ORIGIN_ALTITUDE_M - down


def _heading_deg(reading):
    return math.degrees(reading.yaw_rad) % 360.0


def _int16(value):
    return max(-32768, min(32767, round(value)))


def _ms(now_s):
    return int(1e3 * now_s) & 0xFFFFFFFF


def _us(now_s):
    return int(1e6 * max(now_s, 0.0))
