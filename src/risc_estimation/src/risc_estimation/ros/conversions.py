"""Converts between messages (degrees, risc_msgs) and the estimator's values (SI units, numpy); nothing else does."""

import math

import numpy as np
from geometry_msgs.msg import Point, PointStamped, Twist, TwistStamped, Vector3
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header

from risc_estimation.filters import COUNTS
from risc_estimation.given_poses import PoseFrame
from risc_lab.compiled import compiled
from risc_lab.ros.fleet_messages import CortexArrays, FleetMessage, LandmarksArrays
from risc_lab.states import S
from risc_maap_msgs.msg import BodyPoses, BodyStatus, BodyStatuses, StateCovariance, StateCovariances

FRAME_ID = "cortex"

_DEG_PER_RAD = math.degrees(1.0)  # messages hold degrees and deg/s


def frame_id_for(frame_id):
    """Frame of a message derived from one in that frame; tf2 refuses the old bags' leading slash."""
    return frame_id.lstrip("/") or FRAME_ID


def header_for(header):
    """Header of a message derived from one with `header`: same stamp."""
    return Header(stamp=header.stamp, frame_id=frame_id_for(header.frame_id))


class BodyPosesArrays(FleetMessage, of=BodyPoses):
    """BodyPoses: `known` (n,) records present, inside, secs, nsecs; `numbers` (n, 44): position, quaternion xyzw,
    covariance 6 x 6, residual, as the message says.
    """

    __slots__ = ()
    _beside, _columns = "?,?,<u4,<u4", 44

    @property
    def known(self):
        return self._rest

    @property
    def numbers(self):
        return self._numbers


def poses_to_msg(header, poses):
    """BodyPoses of raw `pose_fit.Poses`, as arrays."""
    message = BodyPosesArrays(poses.names)
    message.header = header_for(header)
    ever, numbers = np.isfinite(poses.stamps_s), message.numbers
    stamps_s = np.where(ever, poses.stamps_s, 0.0)
    seconds = np.floor(stamps_s)
    columns = poses.present, poses.inside, seconds, np.floor(1e9 * (stamps_s - seconds))  # as rospy.Time.from_sec
    for name, column in zip(message.known.dtype.names, columns):
        message.known[name] = column
    numbers[:, :3] = poses.position_m
    if len(ever):
        turns = np.where(ever[:, None, None], poses.rotation, np.eye(3))  # valid up to rounding: a check takes 0.3 ms
        numbers[:, 3:7] = Rotation.from_matrix(turns, assume_valid=True).as_quat()
    numbers[:, 7:43], numbers[:, 43] = poses.covariances().reshape(-1, 36), poses.residual_m
    return message


def poses_from_msg(message):
    """`PoseFrame` of a BodyPosesArrays: views, which its next message overwrites."""
    known, numbers = message.known, message.numbers
    present, inside, seconds, nanoseconds = (known[name] for name in known.dtype.names)
    stamps_s, covariances = seconds + nanoseconds / 1e9, numbers[:, 7:43].reshape(-1, 6, 6)
    return PoseFrame(
        message.names, present, inside, stamps_s, numbers[:, :3], numbers[:, 3:7], covariances, numbers[:, 43]
    )


def statuses_to_msg(header, names, statuses, counters):
    """BodyStatuses of [Status] and (bodies,) `filters.COUNTS`, or None: the filter does not count."""
    message = BodyStatuses(header=header_for(header))
    rows = (
        [(False, *[0] * len(COUNTS))] * len(names) if counters is None else [(True, *row) for row in counters.tolist()]
    )
    message.bodies = [BodyStatus(name, status, *row) for name, status, row in zip(names, statuses, rows)]
    return message


def covariances_to_msg(header, names, covariances):
    """StateCovariances of (vehicles, 12, 12), SI units."""
    rows = zip(names, covariances.reshape(-1, 144).tolist())
    return StateCovariances(header_for(header), [StateCovariance(*row) for row in rows])


def acceleration_to_msg(header, _state, acceleration_m_s2):
    """PointStamped of an acceleration (3,) [m/s^2] in cortex axes; None if it is not known (NaN)."""
    if not np.isfinite(acceleration_m_s2).all():
        return None
    return PointStamped(header_for(header), Point(*acceleration_m_s2.tolist()))


def position_cov_to_msg(header, state, covariance):
    """TwistStamped, as the original packs it: position [m] of a state (12,) in `linear`, the variances P11, P22, P33
    [m^2] of its covariance (12, 12) in `angular`; cortex axes.
    """
    position, variances = state[: S.U].tolist(), np.diagonal(covariance)[: S.U].tolist()
    return TwistStamped(header_for(header), Twist(Vector3(*position), Vector3(*variances)))


class EstimateMessages:
    """Cortex and Landmarks of an estimator. Message objects are reused: publish them before the next call."""

    def __init__(self):
        self._states = CortexArrays(())
        nobody = np.empty((0, len(S))), np.empty(0, dtype=bool)
        _fill_states(*nobody, self._states.states, self._states.visible)  # loads the compiled code
        self._landmarks = LandmarksArrays(())

    def states(self, header, estimate):
        """Cortex of a FrameEstimate: an entry per known vehicle, degrees and deg/s.

        Stamp and frame as in header; unchanged when it is None.
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
