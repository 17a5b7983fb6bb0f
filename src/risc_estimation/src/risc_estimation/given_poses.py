"""Raw poses that another program fitted, in the form that filters take. Needs no ROS."""

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from risc_lab.compiled import compiled, with_row
from risc_lab.frames import euler_of_body_in_cortex


class PoseFrame(NamedTuple):
    """Raw poses of one frame, one row per body in any order. Cortex frame, SI units; as `risc_maap_msgs/BodyPose`."""

    names: tuple[str, ...]
    present: np.ndarray  # (n,) bool: the frame gave a pose; False: the rest of the row means nothing
    inside: np.ndarray  # (n,) bool: and it is inside the arena
    stamps_s: np.ndarray  # (n,) [s] of the frame that the pose is of
    positions_m: np.ndarray  # (n, 3)
    quats_xyzw: np.ndarray  # (n, 4) template axes to cortex axes, of any length but 0
    covariances: np.ndarray  # (n, 6, 6) of position [m] and of a small rotation about cortex x, y, z [rad]
    residuals_m: np.ndarray  # (n,)


class GivenPoses:
    """Counterpart of `pose_fit.Poses`, filled from a `PoseFrame` per frame. Rows: bodies in the order of `add`."""

    def __init__(self):
        self.stamp_s, self.names = -math.inf, ()
        self.flags, self.measured = np.zeros((3, 0), dtype=bool), np.zeros((2, 0, 3))
        self.stamps_s, self.residual_m = np.zeros(0), np.zeros(0)
        self.rotation, self._covariances = np.zeros((0, 3, 3)), np.zeros((0, 6, 6))
        self._has_attitude = np.zeros(0, dtype=bool)  # not of an attached body
        self._plan = None  # names of the newest frame, our rows that are in it, their rows in it
        _fill_angles(self.rotation, self.flags[0], self.measured[1])  # loads the compiled code

    @property
    def present(self):
        """(n,) bool: the newest frame gave a pose."""
        return self.flags[0]

    @property
    def inside(self):
        """(n,) bool: and it is inside the arena."""
        return self.flags[1]

    @property
    def position_m(self):
        """(n, 3) position of the template's origin [m]."""
        return self.measured[0]

    @property
    def angles_rad(self):
        """(n, 3) roll, pitch, yaw [rad], unwrapped; 0 for attached bodies."""
        return self.measured[1]

    def covariances(self):
        """(n, 6, 6), see `PoseFrame`; NaN where a body is not present."""
        return self._covariances.copy()

    def add(self, name, has_attitude):
        """Add a row for a body. has_attitude: False for an attached body, whose attitude means nothing."""
        self.names += (name,)
        self._has_attitude = np.append(self._has_attitude, has_attitude)
        self.flags, self.measured = with_row(self.flags, 1), with_row(self.measured, 1)
        self.stamps_s, self.residual_m = with_row(self.stamps_s), with_row(self.residual_m)
        self.rotation, self._covariances = with_row(self.rotation), with_row(self._covariances)
        self.stamps_s[-1], self.rotation[-1] = -math.inf, np.eye(3)
        self._plan = None

    def take(self, stamp_s, frame):
        """Take the poses of one frame (PoseFrame), exposed at stamp_s [s]. Bodies without a row are ignored. A body is
        not present if it is not in the frame, or if one of its numbers is not finite.
        """
        if self._plan is None or frame.names != self._plan[0]:
            # of two with the same name the first counts
            at = {name: row for row, name in reversed(list(enumerate(frame.names)))}
            pairs = [(row, at[name]) for row, name in enumerate(self.names) if name in at]
            self._plan = frame.names, *np.array(pairs, dtype=np.intp).reshape(-1, 2).T
        _, all_rows, all_sources = self._plan
        self.stamp_s = float(stamp_s)
        self.flags[:], self._covariances[:] = False, np.nan
        finite = np.isfinite(frame.covariances).all(axis=(1, 2)) & np.isfinite(frame.positions_m).all(axis=1)
        lengths = np.linalg.norm(frame.quats_xyzw, axis=1)
        finite &= np.isfinite(lengths) & (lengths > 0.0)
        good = (frame.present & finite)[all_sources]
        rows, sources = all_rows[good], all_sources[good]
        if len(rows) == 0:
            return
        self.flags[0, rows], self.flags[1, rows] = True, frame.inside[sources]
        self.stamps_s[rows], self.residual_m[rows] = frame.stamps_s[sources], frame.residuals_m[sources]
        self.measured[0, rows], self._covariances[rows] = frame.positions_m[sources], frame.covariances[sources]
        self.rotation[rows] = Rotation.from_quat(frame.quats_xyzw[sources]).as_matrix()
        _fill_angles(self.rotation, self.flags[0] & self._has_attitude, self.measured[1])


@compiled
def _fill_angles(rotations, present, angles_rad):
    """Fill angles (n, 3) of the bodies that are present, within half a turn of the previous ones."""
    for i in range(len(present)):
        if present[i]:
            angles = euler_of_body_in_cortex(rotations[i])
            for k in range(3):
                turns = np.rint((angles_rad[i, k] - angles[k]) / (2.0 * math.pi))
                angles_rad[i, k] = angles[k] + 2.0 * math.pi * turns
