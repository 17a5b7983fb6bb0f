"""A virtual checkerboard that is moved in front of a virtual camera, so that the camera can be calibrated.

The board goes from one posture to the next and is held still there for a moment, as a person does. Board axes: x
along a row of inner corners, y along a column, z away from the viewer; the origin is the board's middle.
"""

import itertools

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from risc_simulator.video.scene import CORNERS, Board, subdivided

# The postures: everywhere in the picture, turned to every side, near and far. Near and strongly tilted boards separate
# the principal point from a rotation of the camera, upright ones in the corners determine the distortion.
_ENDS = (0.0, 0.5, 1.0)  # fractions of the picture's width and height
_SIZES = ((1.0, 50.0), (0.7, 55.0), (0.35, 25.0))  # board's width / picture's width, tilt [deg]
POSTURES = [  # (place, direction of the axis of the tilt [deg] from the picture's x to its y, width, tilt [deg])
    (place, about + 45.0 * (k % 2), *size)
    for k, (place, about, size) in enumerate(itertools.product(itertools.product(_ENDS, _ENDS), (0.0, 180.0), _SIZES))
]
POSTURES += [((x, y), 0.0, 0.2, 0.0) for x in (0.0, 1.0) for y in (0.0, 1.0)]
POSTURES += [((0.5, 0.5), 0.0, width, 0.0) for width in (0.5, 0.9)]
_SMALLER = 0.93 ** np.arange(24)  # a board that does not fit is shown smaller, down to a sixth,
_PULLS = np.linspace(1.0, 0.0, 26)  # and nearer to the middle
_FACING = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # board to camera axes, squarely in front


HOLD_S = 0.6  # a posture is held
MOVE_S = 0.8  # from one to the next


class CheckerboardMotion:
    """The motion of one board in front of one camera; it repeats after `period_s`. Held, it is entirely in view."""

    def __init__(self, camera, columns=8, rows=6, square_m=0.025):
        """camera: risc_lab.camera.Camera. columns, rows: inner corners. ValueError when a posture does not fit."""
        self._camera = camera
        self._shape = (columns, rows, square_m)
        centres, turns = zip(*self._postures())
        self._count = len(centres)
        self._centres = np.array(centres + centres[:1])  # back to the first at the end
        self._slerp = Slerp(np.arange(self._count + 1), Rotation.from_matrix(turns + turns[:1]))

    @property
    def period_s(self):
        """Time of one round [s]."""
        return self._count * (HOLD_S + MOVE_S)

    def posture(self, time_s):
        """Centre (3,) [m] and rotation (3, 3) from board to camera axes at a time [s] since the start."""
        step, within_s = divmod(time_s % self.period_s, HOLD_S + MOVE_S)
        part = max(0.0, (within_s - HOLD_S) / MOVE_S)
        part = part**3 * (10.0 - 15.0 * part + 6.0 * part**2)  # no jerk at either end
        index = int(step)
        centre = self._centres[index] + part * (self._centres[index + 1] - self._centres[index])
        return centre, self._slerp(index + part).as_matrix()

    def board(self, time_s, pose):
        """scene.Board at a time [s] since the start in front of a camera at scene.CameraPose `pose`."""
        centre, turn = self.posture(time_s)
        columns, rows, square_m = self._shape
        return Board(
            columns=columns,
            rows=rows,
            square_m=square_m,
            centre_m=pose.position_m + pose.R_camera_to_cortex @ centre,
            R_board_to_cortex=pose.R_camera_to_cortex @ turn,
        )

    def _outline(self):
        """Points (n, 3) [m] around the squares, board axes."""
        columns, rows, square_m = self._shape
        points = square_m * subdivided(0.5 * CORNERS * (columns + 1.0, rows + 1.0))
        return np.column_stack((points, np.zeros(len(points))))

    def _postures(self):
        """Yield centre (3,) [m] and rotation (3, 3) from board to camera axes of every posture."""
        for place, about_deg, width, tilt_deg in POSTURES:
            about_rad = np.radians(about_deg)
            axis = np.array([0.0, np.cos(about_rad), np.sin(about_rad)])
            turn = Rotation.from_rotvec(np.radians(tilt_deg) * axis).as_matrix() @ _FACING
            yield self._fitting(np.array(place), width, turn), turn

    def _fitting(self, place, width, turn):
        """Centre (3,) [m] of the largest board, and then the outermost, that is entirely in the picture."""
        camera, (columns, _, square_m) = self._camera, self._shape
        size = np.array([camera.width_px, camera.height_px])
        focal_px = np.sqrt(camera.K[0, 0] * camera.K[1, 1])
        fills_m = focal_px / camera.width_px * (columns + 1) * square_m  # distance at which it fills the width
        outline = self._outline() @ turn.T
        rays = camera.rays((0.5 + _PULLS[:, None] * (place - 0.5)) * size)
        for smaller, ray in itertools.product(_SMALLER, rays):
            centre = ray * fills_m / (smaller * width)
            if camera.in_picture(camera.project(outline + centre)).all():
                return centre
        raise ValueError("the board cannot be shown to camera %s: make it smaller" % camera.calibration.name)
