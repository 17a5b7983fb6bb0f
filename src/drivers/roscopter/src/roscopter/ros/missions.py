"""Waypoints of the services -> items of a mission."""

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from roscopter.msg import Waypoint
from roscopter.orders import Item

_WITH_PLACE = (Waypoint.TYPE_NAV,)
_WITH_ALTITUDE = (Waypoint.TYPE_NAV, Waypoint.TYPE_CONDITION_CHANGE_ALT, Waypoint.TYPE_TAKEOFF)
_MOST_LATITUDE, _MOST_LONGITUDE = 900_000_000, 1_800_000_000  # [1e-7 deg]


def mission_items(waypoints, options):
    """Return the `Item`s of a list of Waypoints. Raises ValueError that says which waypoint is invalid, and why."""
    return [_item(waypoint, "waypoint %d" % number, options) for number, waypoint in enumerate(waypoints, 1)]


def _item(waypoint, name, options):
    kind = waypoint.waypoint_type
    altitude_m = waypoint.altitude / 1000.0
    yaw_deg = waypoint.yaw_from / 1000.0
    least, most = options.minimum_waypoint_altitude, options.maximum_altitude
    if kind in _WITH_ALTITUDE and not least <= waypoint.altitude <= most:
        raise ValueError("%s: altitude %d mm is not within %d .. %d mm" % (name, waypoint.altitude, least, most))
    if kind in _WITH_PLACE and (abs(waypoint.latitude) > _MOST_LATITUDE or abs(waypoint.longitude) > _MOST_LONGITUDE):
        text = "%s: latitude %d, longitude %d are out of range, in 1e-7 deg"
        raise ValueError(text % (name, waypoint.latitude, waypoint.longitude))
    if kind == Waypoint.TYPE_NAV:
        return Item(
            mavlink.MAV_CMD_NAV_WAYPOINT,
            param1=waypoint.hold_time / 1000.0,
            param2=waypoint.pos_acc / 1000.0,
            param4=yaw_deg,
            latitude=waypoint.latitude,
            longitude=waypoint.longitude,
            altitude_m=altitude_m,
        )
    if kind == Waypoint.TYPE_CONDITION_YAW:
        return Item(mavlink.MAV_CMD_CONDITION_YAW, param1=yaw_deg % 360.0)
    if kind == Waypoint.TYPE_CONDITION_CHANGE_ALT:
        return Item(mavlink.MAV_CMD_CONDITION_CHANGE_ALT, altitude_m=altitude_m)
    if kind == Waypoint.TYPE_TAKEOFF:
        return Item(mavlink.MAV_CMD_NAV_TAKEOFF, altitude_m=altitude_m)
    raise ValueError("%s: its type %d is not a constant of roscopter/Waypoint" % (name, kind))
