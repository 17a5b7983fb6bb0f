"""Attitude of the aircraft in the axes of ROS, and the track integrated from its own velocity estimate."""

import math
from collections import namedtuple

# The velocity is not integrated over a longer gap: the position stays where it was.
MAX_GAP_S = 1.0


def quaternion_xyzw(roll_rad, pitch_rad, yaw_rad):
    """Quaternion (x, y, z, w) of the rotation Rz(yaw) Ry(pitch) Rx(roll)."""
    cr, sr = math.cos(roll_rad / 2.0), math.sin(roll_rad / 2.0)
    cp, sp = math.cos(pitch_rad / 2.0), math.sin(pitch_rad / 2.0)
    cy, sy = math.cos(yaw_rad / 2.0), math.sin(yaw_rad / 2.0)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


OdometryState = namedtuple("OdometryState", "position_m quaternion_xyzw velocity_m_s")


class Odometry:
    """Integrates the velocity that the aircraft estimates (optical flow) to a position.

    Frame: x, y from where the integration began, z up (height above ground); velocities x forward, y left, z up in the
    levelled body frame.
    Deviation from the original driver: the velocity is turned by the yaw angle of ROS (counter-clockwise +). The
    original used the aircraft's angle (clockwise +) without changing its sign, which mirrors the track.
    """

    def __init__(self):
        self._x_m = self._y_m = 0.0
        self._last_s = -math.inf

    def update(self, demo, received_s):
        """Return the OdometryState after one packet.

        demo: the demo option (protocol.navdata), axes and units of the aircraft.  received_s: time of reception.
        """
        roll_rad, pitch_rad, yaw_rad = (math.radians(angle * 1e-3) for angle in (demo.phi, -demo.theta, -demo.psi))
        forward, left, up = demo.vx * 1e-3, -demo.vy * 1e-3, -demo.vz * 1e-3
        dt_s, self._last_s = received_s - self._last_s, received_s
        if 0.0 < dt_s <= MAX_GAP_S:
            cos_yaw, sin_yaw = math.cos(yaw_rad), math.sin(yaw_rad)
            self._x_m += (cos_yaw * forward - sin_yaw * left) * dt_s
            self._y_m += (sin_yaw * forward + cos_yaw * left) * dt_s
        return OdometryState(
            (self._x_m, self._y_m, demo.altitude * 1e-3),
            quaternion_xyzw(roll_rad, pitch_rad, yaw_rad),
            (forward, left, up),
        )
