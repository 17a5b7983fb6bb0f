"""Calibration of a camera from pictures of a checkerboard (thesis 4.4.3), by OpenCV. Needs no ROS and no screen.

The lens model is ROS' plumb_bob: K and k1, k2, p1, p2, k3. Pixels: x right, y down, (0, 0) is the middle of the top
left pixel, as in risc_lab.camera.
"""

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from risc_lab.lab.calibration import CameraCalibration
from risc_lab.settings import Settings, between

MIN_VIEWS = 4  # fewer are refused
GOOD_VIEWS = 15  # fewer are reported
MAX_VIEWS = 60  # that are used of all that were found: more take longer and add little
OUTLIER_RATIO, OUTLIER_FLOOR_PX = 3.0, 0.3  # a view is dropped when its error exceeds this x the median, and the floor
CORNER_REACH = 0.12  # of the picture's diagonal: a picture's corner that the board never came this near is reported
GOOD_TILT_DEG = 20.0  # views tilted less do not tell focal length from distance
SIGMA_LIMIT = 0.01  # of the focal length: a greater standard deviation of fx, fy, cx or cy is reported

_CORNER_NAMES = ("top left", "top right", "bottom left", "bottom right")
_INTRINSICS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")  # order of OpenCV's standard deviations
_CONVERGED = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-10)
_REFINED = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 0.005)
_START_FOCAL = 1.2  # of the picture's width
_MAX_STARTS = 8
_REFINE_RADIUS_PX = 9  # half window of the sub-pixel search; less where squares are small


@dataclass(frozen=True)
class Checkerboard(Settings):
    """The board: numbers of *inner* corners, and the side of a square."""

    columns: between(3, 100) = 8
    rows: between(3, 100) = 6
    square_m: between(1e-4, 10.0) = 0.025

    @classmethod
    def from_text(cls, size, square_m):
        """Board of a text like "8x6". Raises ValueError that says what the text must be."""
        columns, cross, rows = size.partition("x")
        if not (cross and columns.isdigit() and rows.isdigit()):
            raise ValueError("a board's size is COLUMNSxROWS of inner corners, e.g. 8x6; found '%s'" % size)
        return cls(int(columns), int(rows), square_m)

    def points_m(self):
        """Inner corners (rows * columns, 3) [m] in board axes (x along a row), in the order of `find_board`."""
        grid = np.mgrid[0 : self.columns, 0 : self.rows].T.reshape(-1, 2) * self.square_m
        return np.column_stack((grid, np.zeros(len(grid)))).astype(np.float32)


class View(NamedTuple):
    """The board as one picture shows it."""

    name: str
    corners_px: np.ndarray  # (rows * columns, 2)


class ViewError(NamedTuple):
    """How well one view fits."""

    name: str
    rms_px: float  # of the reprojection errors
    tilt_deg: float  # between the board's normal and the optical axis


class Calibrated(NamedTuple):
    """What `calibrate` found."""

    calibration: CameraCalibration
    rms_px: float  # reprojection error over all corners of the used views
    sigma: dict[str, float]  # standard deviations of fx, fy, cx, cy [px], k1, k2, p1, p2, k3
    used: tuple[ViewError, ...]
    dropped: tuple[ViewError, ...]  # outliers: their errors are from before they were dropped
    warnings: tuple[str, ...]  # what is weak about the pictures, and the remedy


def find_board(grey, board):
    """Inner corners (rows * columns, 2) [px] of the board in a picture (height, width) of uint8, or None.

    Found by findChessboardCorners, or by findChessboardCornersSB where that fails (blur, bad light, strong tilt); both
    are then refined by cornerSubPix. On rendered pictures (640 x 360, noise of 2 grey levels) nearly all corners are
    right to 0.05 px RMS; those of findChessboardCornersSB alone, also with its accuracy flag, to 0.1 - 0.25 px.
    """
    size = (board.columns, board.rows)
    fast = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
    found, corners = cv2.findChessboardCorners(grey, size, flags=fast)
    if not found:
        found, corners = cv2.findChessboardCornersSB(grey, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not found:
        return None
    grid = corners.reshape(board.rows, board.columns, 2)
    spacing = min(np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min() for axis in (0, 1))
    radius = int(np.clip(0.4 * spacing, 1, _REFINE_RADIUS_PX))  # the window must hold one corner only
    corners = cv2.cornerSubPix(grey, corners.reshape(-1, 1, 2), (radius, radius), (-1, -1), _REFINED)
    return corners.reshape(-1, 2).astype(float)


def shown_board(grey):
    """(columns, rows) of inner corners of whatever checkerboard a picture shows, or None; columns >= rows."""
    flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, _, grid = cv2.findChessboardCornersSBWithMeta(grey, (3, 3), flags)
    if not found:
        return None
    return max(grid.shape[:2]), min(grid.shape[:2])


def choose_views(views, board, size_px, count):
    """The `count` views that differ most in place, size and tilt of the board, best first; all when there are fewer.

    size_px: (width, height) of the pictures.
    """
    if len(views) <= count:
        return list(views)
    features = np.array([_features(view.corners_px, board, size_px) for view in views])
    chosen = [int(np.argmax(features[:, 2]))]  # the largest board
    distance = np.full(len(views), np.inf)
    while len(chosen) < count:
        distance = np.minimum(distance, np.linalg.norm(features - features[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(distance)))
    return [views[i] for i in chosen]


def calibrate(views, board, size_px, name="camera", radial_terms=2):
    """Calibrate a camera. Returns a Calibrated; its P is that of camera_calibration's default (alpha 0: no black rims).

    views: sequence of View.   size_px: (width, height) of all pictures.   name: that of the camera, for the file.
    radial_terms: 2: k3 = 0, as camera_calibration does by default; 3: k3 too, for very wide lenses.
    Raises ValueError with cause and remedy when there are too few views or when they do not determine the camera.
    """
    if len(views) < MIN_VIEWS:
        raise ValueError(
            "the board was found in %d picture(s), at least %d are needed, %d are better: take more, with the whole "
            "board in view" % (len(views), MIN_VIEWS, GOOD_VIEWS)
        )
    kept = choose_views(views, board, size_px, MAX_VIEWS)
    dropped, guess = [], None
    while True:
        guess, sigma, errors = _solve(kept, board, size_px, radial_terms, guess)
        rms = np.array([error.rms_px for error in errors])
        fits = rms <= max(OUTLIER_RATIO * np.median(rms), OUTLIER_FLOOR_PX)
        if fits.all() or np.count_nonzero(fits) < MIN_VIEWS:
            break
        dropped += itertools.compress(errors, ~fits)
        kept = list(itertools.compress(kept, fits))
    K, D = guess
    P, _ = cv2.getOptimalNewCameraMatrix(K, D, size_px, 0.0)
    P = tuple(np.column_stack((P, np.zeros(3))).ravel().tolist())
    try:
        calibration = CameraCalibration(
            name, *size_px, tuple(K.ravel().tolist()), tuple(D.tolist()), tuple(np.eye(3).ravel().tolist()), P
        ).usable()
    except ValueError as error:
        raise ValueError("%s (%s)" % (_UNDETERMINED, error)) from error
    warnings = tuple(_warnings(kept, errors, dropped, K, sigma, size_px))
    rms_px = float(np.sqrt(np.mean(rms**2)))
    return Calibrated(calibration, rms_px, sigma, tuple(errors), tuple(dropped), warnings)


_TILT_CURE = "tilt the board to both sides and forward and back, by 30 to 50 degrees, near enough to fill the picture"
_UNDETERMINED = "the pictures do not determine the camera: " + _TILT_CURE


def _features(corners_px, board, size_px):
    """(5,) place x, y, size and two tilts of the board in a picture, each of the order of 1.

    The tilts are the relative change of the distance from one edge of the board to the other; they are the
    perspective part of the homography and need no focal length.
    """
    axes = np.linspace(-1.0, 1.0, board.columns), np.linspace(-1.0, 1.0, board.rows)
    H, _ = cv2.findHomography(np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2), corners_px)
    centre = corners_px.mean(axis=0) / size_px
    size = np.sqrt(cv2.contourArea(cv2.convexHull(corners_px.astype(np.float32))) / (size_px[0] * size_px[1]))
    return np.array([centre[0], centre[1], size, 2.0 * H[2, 0] / H[2, 2], 2.0 * H[2, 1] / H[2, 2]])


def _solve(views, board, size_px, radial_terms, guess=None):
    """(K, D), {name: standard deviation} and the list of ViewError of one calibration.

    guess: (K, D) to start from. Without one, some focal length is assumed and at first only that and the radial
    distortion are sought. OpenCV's own initial guess assumes a lens without distortion and gives some boards the wrong
    tilt; the solver then gets stuck at errors of several pixels, with a focal length that may be many times too long.
    Restarted from its own result it gets out: that is repeated until it makes no difference.
    """
    points = [board.points_m()] * len(views)
    corners = [view.corners_px.astype(np.float32).reshape(-1, 1, 2) for view in views]
    radial = cv2.CALIB_FIX_K3 if radial_terms == 2 else 0

    def start(K, D, fixed):
        flags = radial | fixed | cv2.CALIB_USE_INTRINSIC_GUESS
        given = points, corners, size_px, K.copy(), D.copy()
        try:
            solution = cv2.calibrateCameraExtended(*given, flags=flags, criteria=_CONVERGED)
        except cv2.error as error:
            raise ValueError(_UNDETERMINED) from error
        if not (np.isfinite(solution[1]).all() and np.isfinite(solution[2]).all()):
            raise ValueError(_UNDETERMINED)
        return solution

    if guess is None:
        focal_px = _START_FOCAL * size_px[0]
        K = np.array([[focal_px, 0.0, 0.5 * size_px[0]], [0.0, focal_px, 0.5 * size_px[1]], [0.0, 0.0, 1.0]])
        fixed = cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_ASPECT_RATIO
        guess = start(K, np.zeros(5), fixed)[1:3]
    last_px = np.inf
    for _ in range(_MAX_STARTS):
        rms_px, K, D, turns, _, deviations, _, errors_px = start(guess[0], guess[1], 0)
        guess = (K, D.ravel()[:5])
        if rms_px > 0.999 * last_px:
            break
        last_px = rms_px
    normals = [cv2.Rodrigues(turn)[0][2, 2] for turn in turns]
    tilts_deg = np.degrees(np.arccos(np.clip(np.abs(normals), 0.0, 1.0)))
    errors = list(map(ViewError, (view.name for view in views), errors_px.ravel().tolist(), tilts_deg.tolist()))
    return guess, dict(zip(_INTRINSICS, deviations.ravel().tolist())), errors


def _warnings(views, errors, dropped, K, sigma, size_px):
    """Yield what is weak about the pictures, each with its remedy."""
    count = len(views)
    if count < GOOD_VIEWS:
        yield "only %d views: take at least %d that differ in place, distance and tilt" % (count, GOOD_VIEWS)
    if len(dropped) > count // 4:
        text = "%d of %d views did not fit: keep board and camera still, and check that the board is flat"
        yield text % (len(dropped), count + len(dropped))
    tilted = sum(error.tilt_deg >= GOOD_TILT_DEG for error in errors)
    if tilted < max(3, count // 4):
        yield "only %d of %d views are tilted by %g degrees or more: %s" % (tilted, count, GOOD_TILT_DEG, _TILT_CURE)
    corners_px = np.concatenate([view.corners_px for view in views])
    reach_px = CORNER_REACH * np.hypot(*size_px)
    ends = [(x, y) for y in (0, size_px[1] - 1) for x in (0, size_px[0] - 1)]
    bare = [name for name, end in zip(_CORNER_NAMES, ends) if np.linalg.norm(corners_px - end, axis=1).min() > reach_px]
    if bare:
        text = "the board was never near the picture's corner(s) %s, where the lens distorts most: show it there"
        yield text % ", ".join(bare)
    limit_px = SIGMA_LIMIT * np.sqrt(K[0, 0] * K[1, 1])
    vague = ["%s +- %.1f px" % (key, sigma[key]) for key in _INTRINSICS[:4] if sigma[key] > limit_px]
    if vague:
        yield "uncertain: %s: %s" % (", ".join(vague), _TILT_CURE)
