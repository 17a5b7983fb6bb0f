"""Is the mocap frame the one that the nodes expect: x forward, y left, z up, metres, the origin on the floor?

There are two tests. At rest: a vehicle's markers, compared with its template, give scale, handedness and the up
direction. By hand: move a vehicle along +x, +y, +z, and compare with what motion capture sees (`judge_moves`).
"""

import numpy as np
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from risc_doctor.findings import Findings, finding
from risc_lab.frames import frd_to_flu

AXES = "xyz"
WAYS = {"x": "forward", "y": "to the left", "z": "up"}
_SCALE_TOLERANCE = 0.1  # of distances between markers
_THOUSAND = (300.0, 3000.0)  # taken for a factor of 1000
_UPRIGHT = np.cos(np.radians(45.0))
_MIRROR_GAIN = 3.0  # mirrored, if the mirror image fits better by this factor
_FIT_NOISE_M = 0.01  # a larger residual is judged
_FLOOR_M = -0.15  # a marker may be that far below the floor: noise, and an origin that is a little off
_MARGIN_M = 0.3  # around the net
_LEAST_MOVE_M = 0.15
_GREATEST_MOVE_M = 20.0
_OBLIQUE = np.cos(np.radians(30.0))  # a move whose largest component is less than this is along no axis
_TURN_TOLERANCE_RAD = np.radians(10.0)
_SHOWN = 0.5  # fraction of the frames in which a marker must be seen


def judge_poses(fleet, templates, marker_sets):
    """Findings. marker_sets: {body: [(n, 3) markers [m] of one frame, ...]}, NaN rows for lost ones."""
    found, problems, good = Findings("axes"), [], []
    for vehicle in fleet.vehicles:
        name = vehicle.template
        if name in marker_sets and name in templates:  # else the check `templates` reports it
            code, values = _pose_problem(templates[name].markers_m, marker_sets[name], fleet.arena)
            if code:
                problems.append(finding("axes", code, name=name, **values))
            else:
                good.append(name)
    if good:
        found.say("plausible", names=", ".join(good))
    return found + problems or found.say("no_vehicle")


def _pose_problem(template_m, frames, arena):
    """(code of the first problem of a body, values of its sentence), ("", {}) when there is none."""
    frames = [markers for markers in frames if markers.shape == template_m.shape]
    if not frames:
        return "other_count", {}
    stacked = np.stack(frames)
    seen = np.isfinite(stacked).all(axis=2).mean(axis=0) > _SHOWN
    if seen.sum() < 3:
        return "unseen", {"seen": seen.sum(), "count": len(template_m)}
    measured = np.nanmedian(stacked[:, seen], axis=0)
    template = frd_to_flu(template_m[seen])  # markers of a level vehicle in the lab frame
    scale = pdist(measured).mean() / pdist(template).mean()
    if _THOUSAND[0] < scale < _THOUSAND[1]:
        return "millimetres", {"scale": scale}
    if _THOUSAND[0] < 1.0 / scale < _THOUSAND[1]:
        return "metres", {"scale": 1.0 / scale}
    if abs(scale - 1.0) > _SCALE_TOLERANCE:
        return "size", {"scale": scale}
    arms, seen_arms = template - template.mean(axis=0), measured - measured.mean(axis=0)
    (turn, error), (_, mirrored) = (Rotation.align_vectors(seen_arms, side * arms) for side in (1.0, -1.0))
    rms_m = error / np.sqrt(len(arms))
    if rms_m > _FIT_NOISE_M:
        return "mirrored" if error > _MIRROR_GAIN * mirrored else "misfit", {"mm": 1e3 * rms_m}
    up = turn.as_matrix()[:, 2]  # the vehicle's up direction in the mocap frame
    if up[2] < _UPRIGHT:
        return "up", {"axis": _signed_axis(up)}
    x, y, z = measured.mean(axis=0)
    if measured[:, 2].min() < _FLOOR_M:
        return "below", {"depth_m": -measured[:, 2].min()}
    if abs(x) > arena.half_x_m + _MARGIN_M or abs(y) > arena.half_y_m + _MARGIN_M or z > arena.height_m + _MARGIN_M:
        return "outside", {"x": x, "y": y, "z": z}
    return "", {}


def _signed_axis(direction):
    """The signed axis nearest to a direction, e.g. "-y"."""
    strongest = int(np.argmax(np.abs(direction)))
    return ("-" if direction[strongest] < 0.0 else "+") + AXES[strongest]


def judge_moves(moves):
    """Findings from moves by hand.

    moves: {"x": (3,) displacement [m] that mocap saw when the operator moved along +x, "y": ..., "z": ...}.
    """
    found, directions, columns = Findings("axes"), {}, {}
    for axis, seen in moves.items():
        length_m = float(np.linalg.norm(seen))
        if not np.isfinite(length_m):
            found.say("move_unseen", axis=axis)
        elif length_m > _GREATEST_MOVE_M:
            found.say("move_too_large", axis=axis, length_m=length_m)
        elif length_m < _LEAST_MOVE_M:
            code = "move_in_metres" if 1e3 * length_m > 2.0 * _LEAST_MOVE_M else "move_too_small"
            found.say(code, axis=axis, length_mm=1e3 * length_m)
        else:
            directions[axis] = np.asarray(seen) / length_m
    turn_rad = _turn(directions)
    if turn_rad is not None:
        return found.say("turned", degrees=np.degrees(turn_rad))
    for axis, direction in directions.items():
        if np.abs(direction).max() < _OBLIQUE:
            found.say("oblique", axis=axis, x=direction[0], y=direction[1], z=direction[2])
            continue
        seen = _signed_axis(direction)
        columns[axis] = np.round(direction)  # one is at least cos 30 degrees, the others at most sin 30 degrees
        found.say("right" if seen == "+" + axis else "wrong", axis=axis, way=WAYS[axis], seen=seen)
    hand = np.linalg.det([columns[axis] for axis in AXES]) if len(columns) == 3 else 1.0
    if hand <= 0.0:
        found.say("left_handed" if hand else "same_axis")
    return found


def _turn(directions):
    """Angle [rad] by which x and y are both turned about z, when they agree and lie level; else None.

    None for quarter turns: they are reported axis by axis.
    """
    if not {"x", "y"} <= set(directions) or directions.get("z", [0.0, 0.0, 1.0])[2] < _OBLIQUE:
        return None
    x, y = (complex(*directions[axis][:2]) for axis in "xy")
    if min(abs(x), abs(y)) < _OBLIQUE:
        return None
    apart = np.angle(y / (1j * x))
    turn = np.angle(x * np.exp(0.5j * apart))
    beyond_quarters = abs((turn + 0.25 * np.pi) % (0.5 * np.pi) - 0.25 * np.pi)
    return None if abs(apart) > 2.0 * _TURN_TOLERANCE_RAD or beyond_quarters < _TURN_TOLERANCE_RAD else turn
