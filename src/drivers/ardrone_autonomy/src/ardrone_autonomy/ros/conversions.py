"""Navdata packets -> ROS messages: axes x forward, y left, z up, except in the navdata_* messages (as on the wire).

`packet` is a protocol.navdata.Navdata.  An option that the packet lacks leaves its fields zero.
"""

import math

import rospy
from geometry_msgs.msg import Point, Quaternion, Transform, TransformStamped, Vector3, Vector3Stamped
from nav_msgs.msg import Odometry as OdometryMsg
from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from ardrone_autonomy import msg as messages
from ardrone_autonomy.attitude import quaternion_xyzw
from ardrone_autonomy.protocol.navdata import Tag, time_to_seconds

STANDARD_GRAVITY_M_S2 = 9.8  # value of the original driver
MIN_FIELD_NORM = 1e-9  # a weaker magnetic field has no direction
_MICROSECONDS = 0x1FFFFF  # low bits of the time option

# Pose of the cameras on the vehicle: position [m], roll, pitch, yaw; optical frames (z forward, x right, y down).
FRONT_CAMERA = ((0.21, 0.0, 0.0), (-math.pi / 2.0, 0.0, -math.pi / 2.0))
BOTTOM_CAMERA = ((0.0, -0.02, 0.0), (math.pi, 0.0, math.pi / 2.0))


def navdata_message(packet, header):
    """Return the Navdata message (the `ardrone/navdata` topic)."""
    message = messages.Navdata(header=header)
    demo = packet.option(Tag.DEMO)
    if demo is not None:
        message.batteryPercent = demo.vbat_flying_percentage
        message.state = demo.ctrl_state >> 16
        message.rotX, message.rotY, message.rotZ = demo.phi * 1e-3, -demo.theta * 1e-3, -demo.psi * 1e-3
        message.altd = demo.altitude
        message.vx, message.vy, message.vz = demo.vx, -demo.vy, -demo.vz
    magneto = packet.option(Tag.MAGNETO)
    if magneto is not None:
        message.magX, message.magY, message.magZ = magneto.mx, magneto.my, magneto.mz
    pressure = packet.option(Tag.PRESSURE_RAW)
    if pressure is not None:
        message.pressure, message.temp = pressure.Pression_meas, pressure.Temperature_meas
    wind = packet.option(Tag.WIND_SPEED)
    if wind is not None:
        message.wind_speed, message.wind_angle = wind.wind_speed, wind.wind_angle
        message.wind_comp_angle = wind.wind_compensation_phi
    physical = packet.option(Tag.PHYS_MEASURES)
    if physical is not None:
        x, y, z = physical.phys_accs
        message.ax, message.ay, message.az = x * 1e-3, -y * 1e-3, -z * 1e-3
    pwm = packet.option(Tag.PWM)
    if pwm is not None:
        message.motor1, message.motor2, message.motor3, message.motor4 = pwm.motor1, pwm.motor2, pwm.motor3, pwm.motor4
    tags = packet.option(Tag.VISION_DETECT)
    if tags is not None:
        message.tags_count = count = min(tags.nb_detected, len(tags.type))
        message.tags_type = tags.type[:count]
        message.tags_xc, message.tags_yc = tags.xc[:count], tags.yc[:count]
        message.tags_width, message.tags_height = tags.width[:count], tags.height[:count]
        message.tags_orientation = tags.orientation_angle[:count]
        message.tags_distance = [float(distance) for distance in tags.dist[:count]]
    time = packet.option(Tag.TIME)
    if time is not None:
        message.tm = float((time.time & _MICROSECONDS) + (time.time >> 21) * 1000000)
    return message


def imu_message(packet, navdata, covariances):
    """Return the sensor_msgs/Imu of a packet and the Navdata made from it.

    covariances: (acceleration, angular velocity, orientation), 9 numbers each.
    """
    message = Imu(header=navdata.header)
    message.linear_acceleration = Vector3(*[a * STANDARD_GRAVITY_M_S2 for a in (navdata.ax, navdata.ay, navdata.az)])
    angles_rad = map(math.radians, (navdata.rotX, navdata.rotY, navdata.rotZ))
    message.orientation = Quaternion(*quaternion_xyzw(*angles_rad))
    physical = packet.option(Tag.PHYS_MEASURES)
    if physical is not None:
        x, y, z = physical.phys_gyros  # deg/s
        message.angular_velocity = Vector3(math.radians(x), -math.radians(y), -math.radians(z))
    (message.linear_acceleration_covariance, message.angular_velocity_covariance, message.orientation_covariance) = (
        covariances
    )
    return message


def mag_message(navdata):
    """Return a geometry_msgs/Vector3Stamped of length 1 along the magnetic field, None when there is no field."""
    field = (navdata.magX, navdata.magY, navdata.magZ)
    norm = math.hypot(*field)
    if norm < MIN_FIELD_NORM:
        return None
    return Vector3Stamped(header=navdata.header, vector=Vector3(*[value / norm for value in field]))


def odometry_message(state, stamp, base_frame):
    """Return the nav_msgs/Odometry of an attitude.OdometryState; its frame is always `odom`, as in the original."""
    message = OdometryMsg(child_frame_id=base_frame)
    message.header.stamp, message.header.frame_id = stamp, "odom"
    message.pose.pose.position = Point(*state.position_m)
    message.pose.pose.orientation = Quaternion(*state.quaternion_xyzw)
    message.twist.twist.linear = Vector3(*state.velocity_m_s)
    return message


def transform_message(parent, child, translation_m, quaternion, stamp=None):
    """geometry_msgs/TransformStamped; quaternion as x, y, z, w."""
    transform = Transform(Vector3(*translation_m), Quaternion(*quaternion))
    return TransformStamped(Header(stamp=stamp or rospy.Time(), frame_id=parent), child, transform)


def camera_transform(parent, child, camera):
    """Return the fixed transform of FRONT_CAMERA or BOTTOM_CAMERA, without stamp."""
    translation_m, roll_pitch_yaw = camera
    return transform_message(parent, child, translation_m, quaternion_xyzw(*roll_pitch_yaw))


class OptionConverter:
    """Converts one option to its navdata_<name> message, values as on the wire."""

    def __init__(self, name):
        """name: of the option, e.g. "demo"."""
        self.name, self.tag = name, int(Tag[name.upper()])
        self.message_type = getattr(messages, "navdata_" + name)
        fields = zip(self.message_type.__slots__[4:], self.message_type._slot_types[4:])
        self._copies = [(field, _maker(ros_type)) for field, ros_type in fields]

    def convert(self, packet, header):
        """Return the message; None when the packet lacks the option or has another one under its number."""
        option = packet.option(self.tag)
        if option is None:
            return None
        message = self.message_type(header=header, tag=self.tag, size=packet.size_of(self.tag))
        time = packet.option(Tag.TIME)
        if time is not None:
            message.drone_time = time_to_seconds(time.time)
        for field, make in self._copies:
            value = getattr(option, field, None)
            if value is None:  # GPS under the number of zimmu_3000
                return None
            setattr(message, field, value if make is None else make(value))
        return message


def _maker(ros_type):
    """Return a function that makes a nested value (or a list of them) from a flat tuple; None for plain fields."""
    package, _, type_name = ros_type.rstrip("[]").rpartition("/")
    if not package:
        return None
    nested = getattr(messages, type_name)
    length = len(nested.__slots__)
    if not ros_type.endswith("[]"):
        return lambda values: nested(*values)
    return lambda values: [nested(*values[i : i + length]) for i in range(0, len(values), length)]
