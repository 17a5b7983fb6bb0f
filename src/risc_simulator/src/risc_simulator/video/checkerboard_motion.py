"""A virtual checkerboard that is waved in front of a virtual camera, so that the camera can be calibrated.

The board goes from one posture to the next and is held still there for a moment, as a person does it. Board axes: x
along a row of inner corners, y along a column, z away from who looks at the board; the origin is the board's middle.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from risc_lab.camera import CAMERA_TO_OPTICAL
from risc_lab.frames import rotation_body_to_cortex
from risc_simulator.video.renderer import Renderer
from risc_simulator.video.scene import Board, CameraPose

_OUTLINE_POINTS = 9  # to a side: the outline is curved in a distorted picture
_BATCH = 1000
_MAX_BATCHES = 50
_FACING = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # board to camera axes, squarely in front


@dataclass(frozen=True)
class WavingParams:
    """How a board is waved."""

    postures: int = 60
    candidates: int = 400  # the postures are chosen among these
    hold_s: float = 0.6  # a posture is held
    move_s: float = 0.8  # from one to the next
    widths: tuple = (0.25, 1.2)  # of the board, as fractions of the picture's width
    max_tilt_deg: float = 60.0
    roll_deg: float = 15.0  # standard deviation
    min_square: float = 0.016  # least side of a square, as a fraction of the picture's width: what detectors can see

    def __post_init__(self):
        if not 2 <= self.postures <= self.candidates or self.hold_s < 0.0 or self.move_s <= 0.0:
            raise ValueError("2 <= postures <= candidates, hold_s >= 0 and move_s > 0 are needed, found %r" % (self,))


class Waving:
    """The seeded motion of one board in front of one camera; it repeats after `period_s`.

    In every posture the whole board is in the picture. Among many random ones those are taken that together determine
    the camera best (greedy D-optimal design: the determinant of the information on fx, fy, cx, cy, k1, k2, p1, p2, with
    the boards' own positions unknown). Postures at random, or merely well spread, leave the principal point of a narrow
    lens with strong distortion twice as uncertain: a shift of it looks much like a turn of the camera with a change of
    p1 and p2, and only near and strongly tilted boards tell them apart. The postures that come nearest to the corners
    of the picture are always among them.
    """

    def __init__(self, camera, columns=8, rows=6, square_m=0.025, seed=0, params=None):
        """camera: risc_lab.camera.Camera. columns, rows: inner corners. Raises ValueError when no posture fits."""
        self.params = params or WavingParams()
        self._camera = camera
        self._shape = (columns, rows, square_m)
        rng = np.random.default_rng(seed)
        centres, turns = self._candidates(rng)
        chosen = _best_subset(self._information(centres, turns), self.params.postures, self._outermost(centres, turns))
        chosen = _short_tour(centres[chosen], turns[chosen], chosen)
        self._centres = np.concatenate((centres[chosen], centres[chosen[:1]]))  # back to the first at the end
        self._slerp = Slerp(np.arange(len(chosen) + 1), Rotation.from_matrix(turns[np.append(chosen, chosen[0])]))

    @property
    def period_s(self):
        """Time of one round [s]."""
        return self.params.postures * (self.params.hold_s + self.params.move_s)

    @property
    def held_s(self):
        """Times (postures,) [s] within the first round in the middle of each hold."""
        return np.arange(self.params.postures) * (self.params.hold_s + self.params.move_s) + 0.5 * self.params.hold_s

    def posture(self, time_s):
        """Centre (3,) [m] and rotation (3, 3) from board to camera axes at a time [s] since the start."""
        step, within_s = divmod(time_s % self.period_s, self.params.hold_s + self.params.move_s)
        part = max(0.0, (within_s - self.params.hold_s) / self.params.move_s)
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

    def corners_px(self, time_s):
        """Truth: pixels (rows * columns, 2) of the inner corners, row by row."""
        centre, turn = self.posture(time_s)
        return self._camera.project(self._corners() @ turn.T + centre)

    def _corners(self):
        """Inner corners (n, 3) [m], board axes."""
        columns, rows, square_m = self._shape
        grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
        middle = [0.5 * (columns - 1), 0.5 * (rows - 1)]
        return np.column_stack(((grid - middle) * square_m, np.zeros(len(grid))))

    def _outline(self):
        """Points (n, 3) [m] around the squares, board axes."""
        columns, rows, square_m = self._shape
        half = 0.5 * square_m * np.array([columns + 1.0, rows + 1.0])
        edge = np.linspace(-1.0, 1.0, _OUTLINE_POINTS)
        ones = np.ones(_OUTLINE_POINTS)
        sides = [(edge, ones), (edge, -ones), (ones, edge), (-ones, edge)]
        points = np.concatenate([np.column_stack(side) for side in sides]) * half
        return np.column_stack((points, np.zeros(len(points))))

    def _candidates(self, rng):
        """Postures with the whole board in the picture: centres (n, 3) [m], rotations board to camera (n, 3, 3)."""
        params, camera = self.params, self._camera
        columns, rows, square_m = self._shape
        outline, corners = self._outline(), self._corners()
        size = np.array([camera.width_px, camera.height_px])
        near_m = (
            np.sqrt(camera.K[0, 0] * camera.K[1, 1]) / camera.width_px * (columns + 1) * square_m
        )  # fills the width
        found_centres, found_turns, found = [], [], 0
        for _ in range(_MAX_BATCHES):
            width = np.exp(rng.uniform(*np.log(params.widths), _BATCH))
            centres = camera.rays(rng.uniform(0.0, size, (_BATCH, 2))) * (near_m / width)[:, None]
            tilt = np.radians(params.max_tilt_deg) * np.sqrt(rng.uniform(size=_BATCH))
            about = rng.uniform(0.0, 2.0 * np.pi, _BATCH)
            roll = np.radians(params.roll_deg) * rng.standard_normal(_BATCH)
            zero = np.zeros(_BATCH)
            tilts = Rotation.from_rotvec(np.column_stack((zero, tilt * np.cos(about), tilt * np.sin(about))))
            rolls = Rotation.from_rotvec(np.column_stack((roll, zero, zero)))
            turns = (tilts * rolls).as_matrix() @ _FACING
            seen = camera.in_picture(camera.project(_placed(outline, centres, turns))).all(axis=1)
            grid = camera.project(_placed(corners, centres, turns)).reshape(_BATCH, rows, columns, 2)
            sides = [
                np.linalg.norm(np.diff(grid, axis=axis), axis=-1).reshape(_BATCH, -1).min(axis=1) for axis in (1, 2)
            ]
            with np.errstate(invalid="ignore"):
                seen &= np.minimum(*sides) >= params.min_square * camera.width_px
            found_centres.append(centres[seen])
            found_turns.append(turns[seen])
            found += np.count_nonzero(seen)
            if found >= params.candidates:
                break
        if found < params.postures:
            raise ValueError(
                "a board of %d x %d squares of %g m cannot be shown to camera %s in %d postures: make it smaller"
                % (columns + 1, rows + 1, square_m, camera.calibration.name, params.postures)
            )
        return np.concatenate(found_centres)[: params.candidates], np.concatenate(found_turns)[: params.candidates]

    def _outermost(self, centres, turns):
        """Indices of the postures that come nearest to the corners of the picture: distortion is greatest there."""
        right, bottom = self._camera.width_px - 1, self._camera.height_px - 1
        seen = self._camera.project(_placed(self._corners(), centres, turns))
        distances = [
            np.linalg.norm(seen - end, axis=-1).min(axis=1)
            for end in ((0, 0), (right, 0), (0, bottom), (right, bottom))
        ]
        return np.unique(np.argmin(distances, axis=1))

    def _information(self, centres, turns):
        """(n, 8, 8) what each posture tells of the camera when the board's position is not known."""
        corners = self._corners()
        information = []
        for centre, turn in zip(centres, turns):
            rotation, place_m = cv2.Rodrigues(CAMERA_TO_OPTICAL @ turn)[0], CAMERA_TO_OPTICAL @ centre
            jacobian = cv2.projectPoints(corners, rotation, place_m, self._camera.K, self._camera.D)[1]
            place, lens = jacobian[:, :6], jacobian[:, 6:14]
            place = place / np.linalg.norm(place, axis=0)
            mixed = place.T @ lens
            information.append(lens.T @ lens - mixed.T @ np.linalg.solve(place.T @ place, mixed))
        return np.array(information)


@dataclass(frozen=True)
class CalibrationPicture:
    """One picture of the waved board, with its truth."""

    image: np.ndarray  # (height, width, 3) uint8, BGR
    corners_px: np.ndarray  # (rows * columns, 2)


def calibration_pictures(camera, scene, imaging, seed, count=60, waving=None):
    """Yield `count` CalibrationPicture of a board waved in front of a camera that stands in the scene.

    camera: risc_lab.camera.Camera. scene, imaging: as of scene.load_scene. waving: default that of the seed, with
    `count` postures, each shown once.
    """
    waving = waving or Waving(camera, seed=seed, params=WavingParams(postures=count, candidates=max(400, 8 * count)))
    renderer = Renderer(camera, scene, imaging, seed)
    level = rotation_body_to_cortex(0.0, 0.0, 0.0)
    pose = CameraPose(np.array([0.0, 0.0, 1.0]), level, np.zeros(3), np.zeros(3))
    for time_s in np.resize(waving.held_s, count):
        image = renderer.render(pose, boards=(waving.board(time_s, pose),))
        yield CalibrationPicture(image, waving.corners_px(time_s))


def _placed(points, centres, turns):
    """(n, k, 3) points (k, 3) of the board in camera axes, for postures of centres (n, 3) and turns (n, 3, 3)."""
    return np.einsum("nij,kj->nki", turns, points) + centres[:, None]


def _best_subset(information, count, start):
    """Indices of `count` of the (n, 8, 8) matrices, with those of `start`, whose sum has the greatest determinant.

    Greedily: one after the other that which adds most.
    """
    scale = np.sqrt(np.trace(information.sum(axis=0)) / information.shape[1])
    spread = np.sqrt(np.einsum("nii->i", information)) / scale  # parameters of very different size
    scaled = information / np.outer(spread, spread) / scale**2
    chosen = start[:count].tolist()
    total = 1e-6 * np.eye(information.shape[1]) + scaled[chosen].sum(axis=0)
    free = np.ones(len(information), dtype=bool)
    free[chosen] = False
    while len(chosen) < count:
        gain = np.where(free, np.linalg.slogdet(total + scaled)[1], -np.inf)
        chosen.append(int(np.argmax(gain)))
        free[chosen[-1]] = False
        total = total + scaled[chosen[-1]]
    return np.array(chosen)


def _short_tour(centres, turns, indices):
    """The indices (n,) in an order in which neighbours are alike: always on to the nearest that is left."""
    features = np.column_stack((centres / np.linalg.norm(centres, axis=1).mean(), turns[:, :, 2]))
    left = list(range(1, len(indices)))
    order = [0]
    while left:
        nearest = left[int(np.argmin(np.linalg.norm(features[left] - features[order[-1]], axis=1)))]
        left.remove(nearest)
        order.append(nearest)
    return indices[order]
