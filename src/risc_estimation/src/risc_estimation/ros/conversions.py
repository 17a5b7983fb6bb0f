"""Between messages (degrees, risc_msgs) and the estimator's values (SI units, numpy): the only place that does it."""

import math

import numpy as np
import rospy
from geometry_msgs.msg import Point, Pose, PoseWithCovariance, Quaternion
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header

from risc_lab.compiled import compiled
from risc_lab.ros.fleet_messages import CortexArrays, LandmarksArrays
from risc_lab.states import S
from risc_maap_msgs.msg import BodyPose, BodyPoses, StateCovariance, StateCovariances

FRAME_ID = "cortex"

_DEG_PER_RAD = math.degrees(1.0)  # messages hold degrees and deg/s


def frame_id_for(frame_id):
    """Frame of a message derived from one in that frame; tf2 refuses the old bags' leading slash."""
    return frame_id.lstrip("/") or FRAME_ID


def header_for(header):
    """Header of a message derived from one with `header`: same stamp."""
    return Header(stamp=header.stamp, frame_id=frame_id_for(header.frame_id))


def poses_to_msg(header, poses):
    """BodyPoses of raw `pose_fit.Poses`."""
    message = BodyPoses(header=header_for(header))
    covariances = poses.covariances().reshape(-1, 36).tolist()
    for row, name in enumerate(poses.names):
        stamp_s = poses.stamps_s[row]
        ever = np.isfinite(stamp_s)
        turn = Rotation.from_matrix(poses.rotation[row]).as_quat() if ever else (0.0, 0.0, 0.0, 1.0)
        pose = Pose(Point(*poses.position_m[row]), Quaternion(*turn))
        message.bodies.append(
            BodyPose(
                name=name,
                present=bool(poses.present[row]),
                inside=bool(poses.inside[row]),
                stamp=rospy.Time.from_sec(stamp_s) if ever else rospy.Time(),
                pose=PoseWithCovariance(pose, covariances[row]),
                residual=poses.residual_m[row],
            )
        )
    return message


def covariances_to_msg(header, names, covariances):
    """StateCovariances of (vehicles, 12, 12), SI units."""
    rows = zip(names, covariances.reshape(-1, 144).tolist())
    return StateCovariances(header_for(header), [StateCovariance(*row) for row in rows])


class EstimateMessages:
    """Cortex and Landmarks of an estimator, filled again and again: publish them before the next call."""

    def __init__(self):
        self._states = CortexArrays(())
        nobody = np.empty((0, len(S))), np.empty(0, dtype=bool)
        _fill_states(*nobody, self._states.states, self._states.visible)  # loads what is compiled
        self._landmarks = LandmarksArrays(())

    def states(self, header, estimate):
        """Cortex of a FrameEstimate: an entry per known vehicle, degrees and deg/s.

        Stamp and frame as in header, or, when it is None, as they were.
        """
        message = self._states
        if message.names != estimate.names:
            message = self._states = CortexArrays(estimate.names)
        _fill_states(estimate.states, estimate.visible, message.states, message.visible)
        return _dated(message, header)

    def landmarks(self, header, estimate):
        """Landmarks of a FrameEstimate: those seen in this frame."""
        message = self._landmarks
        if message.names != estimate.landmark_names:
            message = self._landmarks = LandmarksArrays(estimate.landmark_names)
        message.positions_m[:] = estimate.landmarks_m
        return _dated(message, header)


@compiled
def _fill_states(states, visible, numbers, flags):
    """Fill numbers (n, 12) and flags (n,) of a message from states (n, 12), columns `S`, and visible (n,)."""
    for i in range(len(visible)):
        flags[i] = visible[i]
        for k in range(states.shape[1]):
            numbers[i, k] = states[i, k] if k < S.PHI else states[i, k] * _DEG_PER_RAD


def _dated(message, header):
    if header is None:
        return message
    stamp = message.header.stamp
    stamp.secs, stamp.nsecs = header.stamp.secs, header.stamp.nsecs
    message.header.frame_id = frame_id_for(header.frame_id)
    return message
