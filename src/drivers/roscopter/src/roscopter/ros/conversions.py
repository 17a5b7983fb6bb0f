"""MAVLink messages -> ROS messages. Units as in the original: see the definitions in msg/."""

from sensor_msgs.msg import NavSatFix, NavSatStatus

from roscopter import msg
from roscopter.modes import mode_name
from roscopter.orders import is_armed

_GUIDED = 8  # bit of base_mode
_FIX_3D = 3
_UNKNOWN = 65535  # of uint16 fields
_INT16_MAX = 32767
_IMU_FIELDS = [axis + quantity for quantity in ("acc", "gyro", "mag") for axis in "xyz"]


def gps(message, stamp):
    """GPS_RAW_INT -> NavSatFix; covariance from the horizontal dilution of precision, by the original's rule."""
    fix = NavSatFix(latitude=message.lat / 1e7, longitude=message.lon / 1e7, altitude=message.alt / 1e3)
    fix.header.stamp, fix.header.frame_id = stamp, "base_link"
    has_fix = message.fix_type >= _FIX_3D
    fix.status.status = NavSatStatus.STATUS_FIX if has_fix else NavSatStatus.STATUS_NO_FIX
    fix.status.service = NavSatStatus.SERVICE_GPS
    if message.eph != _UNKNOWN:
        dilution = message.eph / 100.0
        spread = ((3.04 * dilution**2) ** 2 + 3.57**2) ** 0.5
        fix.position_covariance = [spread, 0.0, 0.0, 0.0, spread, 0.0, 0.0, 0.0, spread]
        fix.position_covariance_type = NavSatFix.COVARIANCE_TYPE_APPROXIMATED
    return fix


def rc(message, _stamp):
    """RC_CHANNELS or RC_CHANNELS_RAW -> RC."""
    return msg.RC([getattr(message, "chan%d_raw" % k) for k in range(1, 9)])


def state(message, vehicle_type):
    """HEARTBEAT -> State."""
    return msg.State(is_armed(message), bool(message.base_mode & _GUIDED), mode_name(vehicle_type, message))


def status(message, stamp):
    """SYS_STATUS -> Status."""
    made = msg.Status(
        battery_voltage=min(message.voltage_battery, _INT16_MAX),
        battery_current=message.current_battery,
        battery_remaining=message.battery_remaining,
        sensors_enabled=message.onboard_control_sensors_enabled,
    )
    made.header.stamp = stamp
    return made


def filtered_position(message, stamp):
    """GLOBAL_POSITION_INT -> FilteredPosition."""
    values = (message.lat, message.lon, message.alt, message.relative_alt, message.vx, message.vy, message.vz)
    made = msg.FilteredPosition(None, *values, message.hdg)
    made.header.stamp = stamp
    return made


def controller_output(message, _stamp):
    """NAV_CONTROLLER_OUTPUT -> ControllerOutput."""
    errors = (message.alt_error, message.aspd_error, message.xtrack_error)
    return msg.ControllerOutput(message.nav_roll, message.nav_pitch, message.nav_bearing, *errors)


def current_mission(message, navigation, stamp):
    """MISSION_CURRENT, and the newest NAV_CONTROLLER_OUTPUT or None -> CurrentMission."""
    made = msg.CurrentMission(mission_num=message.seq)
    if navigation is not None:
        made.wp_dist, made.target_bearing = navigation.wp_dist, navigation.target_bearing
    made.header.stamp = stamp
    return made


def mission_item(message, stamp):
    """MISSION_ITEM or MISSION_ITEM_INT -> MissionItem."""
    scale = 1e-7 if message.get_type() == "MISSION_ITEM_INT" else 1.0
    parameters = (message.param2, message.param1, message.param3, message.param4)
    where = (message.x * scale, message.y * scale, message.z)
    made = msg.MissionItem(None, message.seq, message.current, message.autocontinue, *parameters, *where)
    made.header.stamp = stamp
    return made


def raw_imu(message, stamp):
    """RAW_IMU -> Mavlink_RAW_IMU."""
    made = msg.Mavlink_RAW_IMU(None, message.time_usec, *(getattr(message, key) for key in _IMU_FIELDS))
    made.header.stamp = stamp
    return made


def same_fields(kind):
    """Return a function that fills a message without header from one whose fields have the same names."""
    names = kind.__slots__
    return lambda message, _stamp: kind(*[getattr(message, name) for name in names])
