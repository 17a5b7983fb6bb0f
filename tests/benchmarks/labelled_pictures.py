"""Seeded sets of pictures with known content, to measure detectors on.

Every sample has a generator of its own, made from (seed, index): the same seed gives the same pictures, whatever
their number. The landmarks hang anywhere in a hall that is larger than the arena, so that distance, place in the
picture and obliqueness are drawn independently of each other.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from picture_truth import LabelledRenderer, Truth, corners_px, held_s

from risc_lab.camera import Camera
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.calibration import CameraCalibration
from risc_simulator.video.checkerboard_motion import CheckerboardMotion
from risc_simulator.video.renderer import noise_tile, to_camera
from risc_simulator.video.scene import CameraPose, Prop, Scene, VehiclePose, bgr_of_hsv, load_style, plane_axes

SIZE_PX = (640, 360)
CALIBRATIONS = {  # focal lengths, centre [px], k1, k2, p1, p2, k3; the first four are those of the original laboratory
    "fluffy_II": ((977.994066, 975.285107), (357.362844, 160.919363), (-1.455445, 1.626447, 0.014496, -0.028790, 0.0)),
    "albatross": ((587.475731, 584.474852), (332.151306, 198.136356), (-0.629084, 0.388896, -0.002180, 0.001088, 0.0)),
    "Raven": ((663.931413, 670.012130), (385.105531, 182.633137), (-0.684161, 0.288271, 0.008015, -0.044440, 0.0)),
    "albatross_2": ((587.4757, 584.4749), (332.1513, 198.1364), (-0.5338055, 0.2820190, -0.0013371, 0.0071128, 0.0)),
    "wide": ((455.0, 455.0), (322.0, 176.0), (-0.28, 0.08, 0.0, 0.0, 0.0)),  # gives the smallest discs
    "pinhole": ((580.0, 580.0), (319.5, 179.5), (0.0, 0.0, 0.0, 0.0, 0.0)),  # as a rectified picture
}
DISTANCE_M = (0.7, 4.0)
OBLIQUENESS_RAD = (0.0, math.radians(70.0))
GAIN = (0.3, 2.0)  # log-uniform
BLUR_PX = (0.0, 6.0)  # of the picture's middle; near and off the axis a little more

_HALL_HALF_M = 6.5
_COUNT_SHARES = (0.12, 0.26, 0.26, 0.18, 0.18)  # of pictures with 0, 1, ... 4 landmarks
_PLACE_TRIES = 60
_WHOLE_SHARE = 0.65  # of landmarks that are put wholly into the picture; the others may be cut by its border
_BEYOND_BORDER = 0.06  # of the picture: how far outside their centres may be
_HUES = {"green": 66.0, "blue": 98.0, "pink": 167.0, "orange": 15.0}


@dataclass(frozen=True)
class Sample:
    """One picture of a set."""

    image: np.ndarray  # (h, w, 3) uint8 BGR
    camera: Camera
    pose: CameraPose
    truths: tuple[Truth, ...]
    conditions: dict  # what was drawn, plain numbers and texts: see landmark_set


def landmark_set(seed, count):
    """Iterator over `count` Samples.

    Distance 0.7-4 m, obliqueness 0-70 degrees, motion blur 0-6 px, brightness 0.3-2; views cut by the border, things
    of similar colours behind, beside and before the landmarks, other vehicles, 0-4 landmarks (each at most once).

    conditions: index, calibration, gain, blur_px (the greatest motion of a landmark during the exposure; without
    landmarks that of the picture's middle), exposure_s, defocus_px, read_noise, shot_noise, vignette, temperature_k,
    landmarks, panels, balls, occluders, vehicles (how many were put up; not all need be in the picture).
    """
    style = load_style()
    cameras = {
        name: Camera(CameraCalibration.from_intrinsics(name, SIZE_PX, *values)) for name, values in CALIBRATIONS.items()
    }
    noise = noise_tile(np.random.SeedSequence((seed, 1)))
    for index in range(count):
        yield _sample(np.random.SeedSequence((seed, 0, index)), index, style, cameras, noise)


def _sample(sequence, index, style, cameras, noise):
    rng = np.random.default_rng(sequence)
    name = str(rng.choice(sorted(cameras)))
    camera = cameras[name]
    imaging = replace(
        style.imaging,
        exposure_s=float(rng.uniform(0.004, 0.016)),
        defocus_px=float(rng.uniform(0.3, 0.9)),
        vignette=float(rng.uniform(0.0, 0.35)),
        temperature_k=float(rng.uniform(5500.0, 7800.0)),
        read_noise=float(rng.uniform(0.5, 2.5)),
        shot_noise=float(rng.uniform(0.05, 0.25)),
    )
    gain = float(np.exp(rng.uniform(*np.log(GAIN))))
    pose = _camera_pose(rng, camera, imaging.exposure_s)
    discs = _discs(rng, style, camera, pose)
    props, counts, forbidden = _props(rng, style, discs, pose)
    vehicles = _vehicles(rng, discs, pose, len(style.hulls.colours))
    style = replace(style, imaging=imaging, room=_hall(rng, style.room, forbidden))
    renderer = LabelledRenderer(camera, Scene(style, tuple(discs), props=tuple(props)), sequence.spawn(1)[0], noise)
    conditions = {
        "index": index,
        "calibration": name,
        "gain": gain,
        "blur_px": _blur_px(renderer, pose, discs),
        "exposure_s": imaging.exposure_s,
        "defocus_px": imaging.defocus_px,
        "read_noise": imaging.read_noise,
        "shot_noise": imaging.shot_noise,
        "vignette": imaging.vignette,
        "temperature_k": imaging.temperature_k,
        "landmarks": len(discs),
        "vehicles": len(vehicles),
    }
    conditions.update(counts)
    image = renderer.render(pose, vehicles, gain=gain)
    return Sample(image, camera, pose, tuple(renderer.truth(pose, vehicles)), conditions)


def _camera_pose(rng, camera, exposure_s):
    """A random CameraPose in the arena, any heading; it turns so that the picture's middle moves by 0-6 px."""
    position = np.array([rng.uniform(-1.6, 1.6), rng.uniform(-1.3, 1.3), rng.uniform(0.7, 1.8)])
    R = rotation_body_to_cortex(*(rng.uniform(-1.0, 1.0, 3) * (0.12, 0.15, math.pi)))
    blur_px = rng.uniform(*BLUR_PX) if rng.random() < 0.7 else 0.0
    direction = rng.uniform(0.0, 2.0 * math.pi)
    turn = blur_px / (camera.K[0, 0] * exposure_s)
    rate = np.array([rng.normal(0.0, 0.15) if blur_px else 0.0, turn * math.sin(direction), turn * math.cos(direction)])
    velocity = rng.normal(0.0, 0.1, 3) if blur_px else np.zeros(3)
    return CameraPose(position, R, velocity, rate)


def _discs(rng, style, camera, pose):
    """Landmarks in or at the border of the picture that do not hide one another."""
    count = rng.choice(len(_COUNT_SHARES), p=_COUNT_SHARES)
    discs, circles_px = [], []
    for template in rng.permutation([kind.name for kind in style.catalogue.landmarks])[:count]:
        distance_m = math.sqrt(rng.uniform(DISTANCE_M[0] ** 2, DISTANCE_M[1] ** 2))  # uniform over an area
        obliqueness = rng.uniform(*OBLIQUENESS_RAD)
        leaning = rng.uniform(0.0, 2.0 * math.pi) if rng.random() < 0.3 else rng.choice((0.0, math.pi))
        reach_px = 0.6 * style.catalogue.discs.ring_diameter_m * camera.K[0, 0] / distance_m
        margin_px = np.array(SIZE_PX) * -_BEYOND_BORDER
        if rng.random() < _WHOLE_SHARE:
            margin_px = np.minimum(reach_px, 0.45 * np.array(SIZE_PX))
        for _ in range(_PLACE_TRIES):
            pixel = rng.uniform(margin_px, SIZE_PX - margin_px)
            ray = np.asarray(pose.R_camera_to_cortex) @ camera.rays(pixel)
            centre = pose.position_m + distance_m * ray
            free = all(np.hypot(*(pixel - other)) > reach_px + reach for other, reach in circles_px)
            if free and 0.1 < centre[2] < 3.4:
                across, upward = plane_axes(-ray)
                side = math.cos(leaning) * across + math.sin(leaning) * upward
                normal = -math.cos(obliqueness) * ray + math.sin(obliqueness) * side
                discs.append(style.disc(str(template), centre, normal / np.linalg.norm(normal)))
                circles_px.append((pixel, reach_px))
                break
    return discs


def _props(rng, style, discs, pose):
    """(Props, how many of each kind, hues that no panel may have).

    No ball of a centre's colour is put before a panel in the colour of the ring that belongs to it: that would look
    like a landmark.
    """
    position = np.asarray(pose.position_m)
    balls = [str(rng.choice(sorted(_HUES))) for _ in range(rng.choice(3, p=(0.6, 0.28, 0.12)))]
    forbidden = {kind.ring for kind in style.catalogue.landmarks if kind.centre in balls}
    props = []
    panels = occluders = 0
    for disc in discs:
        ray = np.asarray(disc.centre_m) - position
        distance_m = np.linalg.norm(ray)
        ray = ray / distance_m
        across, upward = plane_axes(-ray)
        if rng.random() < 0.35:  # behind
            depth_m = distance_m + rng.uniform(0.25, 1.2)
            shift = rng.uniform(-0.3, 0.3, 2)
            place = position + depth_m * ray + shift[0] * across + shift[1] * upward
            props.append(_panel(rng, place, -ray, rng.uniform(0.4, 1.3, 2), _hsv(rng, forbidden)))
            panels += 1
        if rng.random() < 0.3:  # beside
            angle = rng.uniform(0.0, 2.0 * math.pi)
            offset_m = rng.uniform(0.35, 0.7)
            place = np.asarray(disc.centre_m) + offset_m * (math.cos(angle) * across + math.sin(angle) * upward)
            props.append(_panel(rng, place, -ray, rng.uniform(0.08, 0.35, 2), _hsv(rng, forbidden)))
            panels += 1
        if rng.random() < 0.07:  # before it, hiding a part
            angle = rng.uniform(0.0, 2.0 * math.pi)
            share = rng.uniform(0.5, 0.9)
            place = position + share * distance_m * ray
            place = place + share * rng.uniform(0.15, 0.3) * (math.cos(angle) * across + math.sin(angle) * upward)
            props.append(_panel(rng, place, -ray, rng.uniform(0.15, 0.3, 2), _hsv(rng, forbidden)))
            occluders += 1
    heading = np.asarray(pose.R_camera_to_cortex)
    for _ in range(rng.integers(0, 3)):  # anywhere
        place, ray = _anywhere(rng, position, heading)
        props.append(_panel(rng, place, -ray, rng.uniform(0.15, 0.9, 2), _hsv(rng, forbidden)))
        panels += 1
    for hue in balls:
        place, ray = _anywhere(rng, position, heading)
        hsv = (_HUES[hue] + rng.uniform(-4.0, 4.0), rng.uniform(110.0, 200.0), rng.uniform(130.0, 230.0))
        props.append(_ball(place, -ray, rng.uniform(0.05, 0.15), hsv))
    return props, {"panels": panels, "balls": len(balls), "occluders": occluders}, forbidden


def _vehicles(rng, discs, pose, hulls):
    """Other vehicles: somewhere in view, now and then before a landmark."""
    position, heading = np.asarray(pose.position_m), np.asarray(pose.R_camera_to_cortex)
    vehicles = []
    for number in range(rng.choice(3, p=(0.6, 0.3, 0.1))):
        place, _ = _anywhere(rng, position, heading)
        if discs and rng.random() < 0.3:
            share = rng.uniform(0.5, 0.85)
            place = position + share * (np.asarray(discs[0].centre_m) - position) + rng.uniform(-0.3, 0.3, 3)
        if np.linalg.norm(place - position) < 0.6:
            continue
        attitude = rng.uniform(-1.0, 1.0, 3) * (0.15, 0.15, math.pi)
        R = rotation_body_to_cortex(*attitude)
        vehicles.append(VehiclePose("vehicle%d" % (number + 1), place, R, int(rng.integers(hulls))))
    return vehicles


def _anywhere(rng, position, R_camera_to_cortex):
    """A place (3,) in the field of view or a little beyond, and the unit vector towards it."""
    ray = R_camera_to_cortex @ np.array([1.0, rng.uniform(-0.6, 0.6), rng.uniform(-0.35, 0.35)])
    ray /= np.linalg.norm(ray)
    return position + rng.uniform(1.5, 5.0) * ray, ray


def _panel(rng, place, normal, size_m, hsv):
    """A rectangle, turned a little out of the line of sight."""
    normal = normal + rng.uniform(-0.4, 0.4, 3)
    across, upward = plane_axes(normal / np.linalg.norm(normal))
    cuts = np.linspace(-0.5, 0.5, 5)[:-1]
    u = np.concatenate((cuts, np.full(4, 0.5), -cuts, np.full(4, -0.5)))
    v = np.roll(u, 4)
    return Prop(place + size_m[0] * u[:, None] * across + size_m[1] * v[:, None] * upward, bgr_of_hsv(hsv))


def _ball(place, normal, radius_m, hsv):
    across, upward = plane_axes(normal)
    angle = np.arange(32)[:, None] * (2.0 * math.pi / 32)
    return Prop(place + radius_m * (np.cos(angle) * across + np.sin(angle) * upward), bgr_of_hsv(hsv))


def _hsv(rng, forbidden):
    """A colour that is often close to a paint, but to none of the forbidden ones (keys of _HUES)."""
    while True:
        if rng.random() < 0.6:
            hue = _HUES[str(rng.choice(sorted(_HUES)))] + rng.uniform(-10.0, 10.0)
        else:
            hue = rng.uniform(0.0, 180.0)
        hue %= 180.0
        if all(abs((hue - _HUES[name] + 90.0) % 180.0 - 90.0) > 20.0 for name in forbidden):
            return hue % 179.5, rng.uniform(40.0, 220.0), rng.uniform(60.0, 230.0)


def _hall(rng, room, forbidden):
    """The room, larger and in other shades, without things on the walls when a ball could stand before them."""
    return replace(
        room,
        half_x_m=_HALL_HALF_M,
        half_y_m=_HALL_HALF_M,
        tile_m=1.0,
        shade=rng.uniform(0.7, 1.1),
        panels=() if forbidden else room.panels,
    )


def _blur_px(renderer, pose, discs):
    """Greatest motion [px] of a landmark's centre during the exposure, or of the middle of the picture."""
    half_s = 0.5 * renderer.imaging.exposure_s
    if discs:
        points = np.array([disc.centre_m for disc in discs])
    else:
        points = (np.asarray(pose.position_m) + 3.0 * np.asarray(pose.R_camera_to_cortex)[:, 0])[None]
    first, last = (renderer.camera.project(to_camera(pose, points, time_s)) for time_s in (-half_s, half_s))
    motion = np.linalg.norm(last - first, axis=1)
    return float(np.nanmax(motion)) if np.isfinite(motion).any() else 0.0


@dataclass(frozen=True)
class CalibrationPicture:
    """One picture of the moving board, with its truth."""

    image: np.ndarray  # (height, width, 3) uint8, BGR
    corners_px: np.ndarray  # (rows * columns, 2)


def calibration_pictures(camera, seed, count=60):
    """Yield `count` CalibrationPicture of a board in front of a camera that stands in the room, one of each posture.

    camera: risc_lab.camera.Camera. seed: of the pictures' noise.
    """
    motion, renderer = CheckerboardMotion(camera), LabelledRenderer(camera, Scene(load_style()), seed)
    level = rotation_body_to_cortex(0.0, 0.0, 0.0)
    pose = CameraPose(np.array([0.0, 0.0, 1.0]), level, np.zeros(3), np.zeros(3))
    for time_s in np.resize(held_s(), count):
        image = renderer.render(pose, boards=(motion.board(time_s, pose),))
        yield CalibrationPicture(image, corners_px(motion, camera, time_s))
