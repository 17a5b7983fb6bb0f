"""Is the mocap frame the one that the nodes believe in: x forward, y left, z up, metres, the origin on the floor?

Two ways to tell. Standing still: a vehicle's markers against its template give scale, handedness and the way up. By
hand: move a vehicle along +x, +y, +z and see what motion capture makes of it (`judge_moves`).
"""

import itertools

import numpy as np
from scipy.spatial.transform import Rotation

from risc_doctor.findings import green, red, yellow
from risc_lab.frames import frd_to_flu

AXES = "xyz"
WAYS = {"x": "forward", "y": "to the left", "z": "up"}
_SCALE_TOLERANCE = 0.1  # of distances between markers
_THOUSAND = (300.0, 3000.0)  # what passes for a factor of 1000
_UPRIGHT = np.cos(np.radians(45.0))
_MIRROR_GAIN = 3.0  # a mirror image that fits so much better is one
_FIT_NOISE_M = 0.01  # residual that is worth judging
_FLOOR_M = -0.15  # a marker may be that far below the floor: noise, and an origin that is a little off
_MARGIN_M = 0.3  # around the net
_LEAST_MOVE_M = 0.15
_GREATEST_MOVE_M = 20.0
_OBLIQUE = np.cos(np.radians(30.0))  # a move that is less along one axis than this was along none
_TURN_TOLERANCE_RAD = np.radians(10.0)
_LEVEL = "put the L-frame on the floor with its long arm along +x (forward) and calibrate Cortex' frame again"
_SHOWN = 0.5  # fraction of the frames in which a marker must be seen


def judge_poses(fleet, templates, marker_sets):
    """Findings. marker_sets: {body: [(n, 3) markers [m] of one frame, ...]}, NaN rows for lost ones."""
    findings, good = [], []
    for vehicle in fleet.vehicles:
        if vehicle.template not in marker_sets or vehicle.template not in templates:
            continue  # `templates` says so
        markers_m, seen = templates[vehicle.template].markers_m, marker_sets[vehicle.template]
        problem = _pose_problem(vehicle.template, markers_m, seen, fleet.arena)
        if problem is None:
            good.append(vehicle.template)
        else:
            findings.append(problem)
    if good:
        text = "size, handedness, up and place are plausible: %s (--axes VEHICLE tells for sure)" % ", ".join(good)
        findings.insert(0, green("axes", text))
    if not findings:
        text = "cannot be judged: Cortex shows no vehicle of the fleet"
        findings = [yellow("axes", text, "put the vehicles into view of the cameras; see `templates`")]
    return findings


def _pose_problem(name, template_m, frames, arena):
    """The first thing that is wrong with a body, or None."""
    say = "axes"
    frames = [markers for markers in frames if markers.shape == template_m.shape]
    if not frames:
        text = "'%s' has another number of markers than its template" % name
        return yellow(say, text, "see `templates`")
    stacked = np.stack(frames)
    seen = np.isfinite(stacked).all(axis=2).mean(axis=0) > _SHOWN
    if seen.sum() < 3:
        return yellow(
            say,
            "'%s' is not seen: %d of its %d markers" % (name, seen.sum(), len(template_m)),
            "put it into view of the cameras, clean its markers, or cover what shines",
        )
    measured = np.nanmedian(stacked[:, seen], axis=0)
    template = frd_to_flu(template_m[seen])  # as a level vehicle has them in the lab
    scale = _spread(measured) / _spread(template)
    if abs(scale - 1.0) > _SCALE_TOLERANCE:
        return _scale_problem(name, scale)
    rotation, residual, mirrored_residual = fit_both_hands(template, measured)
    if residual > _FIT_NOISE_M and residual > _MIRROR_GAIN * mirrored_residual:
        return red(say, "'%s' is seen as its mirror image: Cortex' frame is left-handed" % name, _LEVEL)
    if residual > _FIT_NOISE_M:
        return yellow(
            say,
            "the markers of '%s' are up to %.0f mm from where its template has them" % (name, 1e3 * residual),
            "measure the template again, and see that its order of markers is that of templates.yaml",
        )
    up = rotation[:, 2]  # where the vehicle's upper side looks, in the mocap frame
    if up[2] < _UPRIGHT:
        towards = AXES[int(np.argmax(np.abs(up)))]
        sign = "-" if up[int(np.argmax(np.abs(up)))] < 0.0 else "+"
        return red(
            say,
            "up is %s%s according to '%s': it lies on its side, or Cortex' z axis does not point up"
            % (sign, towards, name),
            "stand it level; if it did, " + _LEVEL,
        )
    centre, lowest = measured.mean(axis=0), measured[:, 2].min()
    if lowest < _FLOOR_M:
        text = "'%s' has markers %.2f m below the floor" % (name, -lowest)
        return red(say, text, "the origin is not on the floor: " + _LEVEL)
    half = np.array([arena.half_x_m, arena.half_y_m]) + _MARGIN_M
    if (np.abs(centre[:2]) > half).any() or centre[2] > arena.height_m + _MARGIN_M:
        return red(
            say,
            "'%s' is seen at (%.2f, %.2f, %.2f) m, outside of the net" % (name, *centre),
            "carry it into the arena; if it is there, the origin is not in the middle: " + _LEVEL,
        )
    return None


def _scale_problem(name, scale):
    if _THOUSAND[0] < scale < _THOUSAND[1]:
        text = "'%s' is %.0f times too large: Cortex sends millimetres and says that they are metres" % (name, scale)
    elif _THOUSAND[0] < 1.0 / scale < _THOUSAND[1]:
        text = "'%s' is %.0f times too small: Cortex sends metres where millimetres are due" % (name, 1.0 / scale)
    else:
        text = "'%s' is %.2f times as large as its template" % (name, scale)
        cure = "calibrate Cortex with the wand's right length, or correct the template"
        return red("axes", text, cure)
    return red("axes", text, "set Cortex' units to millimetres (and ask for them: Settings, Units)")


def _spread(points):
    """Mean distance between two of the points."""
    return float(np.mean([np.linalg.norm(a - b) for a, b in itertools.combinations(points, 2)]))


def fit_both_hands(template, measured):
    """(rotation template -> measured, its rms residual, rms residual of the best fit of the mirrored template)."""
    arms, seen = template - template.mean(axis=0), measured - measured.mean(axis=0)
    (turn, distance), (_, mirrored) = (Rotation.align_vectors(seen, side * arms) for side in (1.0, -1.0))
    root = np.sqrt(len(arms))
    return turn.as_matrix(), distance / root, mirrored / root


def judge_moves(moves):
    """Findings from moves by hand.

    moves: {"x": (3,) displacement [m] that mocap saw when the operator moved along +x, "y": ..., "z": ...}.
    """
    findings, directions = [], {}
    for axis, seen in moves.items():
        length = float(np.linalg.norm(seen))
        if not np.isfinite(length):
            text = "+%s: the vehicle was not seen" % axis
            findings.append(yellow("axes", text, "keep it in view of the cameras, and move it again"))
        elif length > _GREATEST_MOVE_M:
            text = "+%s: moved by %.0f m: millimetres are taken for metres" % (axis, length)
            findings.append(red("axes", text, "set Cortex' units to millimetres, and ask for them"))
        elif length < _LEAST_MOVE_M:
            units = length > 0.0 and 1e3 * length > 2.0 * _LEAST_MOVE_M
            text = "+%s: seen to move by %.1f mm only%s" % (axis, 1e3 * length, _if_small(units))
            findings.append(yellow("axes", text, "move it by half a metre, and put it down before you press Enter"))
        else:
            directions[axis] = np.asarray(seen) / length
    if directions:
        findings += _judge_directions(directions)
    return findings


def _if_small(units):
    return " (or Cortex sends metres where millimetres are due)" if units else ""


def _judge_directions(directions):
    """Findings from unit vectors of the moves that were long enough."""
    findings = []
    turn_rad = _turn(directions)
    if turn_rad is not None and abs(turn_rad) > _TURN_TOLERANCE_RAD:
        text = "the frame is turned about the vertical by %.0f degrees, + counter-clockwise from above" % np.degrees(
            turn_rad
        )
        return [red("axes", text, _LEVEL)]
    columns = {}
    for axis, direction in directions.items():
        strongest = int(np.argmax(np.abs(direction)))
        if abs(direction[strongest]) < _OBLIQUE:
            text = "+%s is seen as (%.2f, %.2f, %.2f): along no axis" % (axis, *direction)
            findings.append(yellow("axes", text, "move it along the axis only, then: " + _LEVEL))
            continue
        sign = 1.0 if direction[strongest] > 0.0 else -1.0
        columns[axis] = (strongest, sign)
        seen = "%s%s" % ("+" if sign > 0 else "-", AXES[strongest])
        if seen == "+" + axis:
            findings.append(green("axes", "+%s (%s) is seen as +%s" % (axis, WAYS[axis], axis)))
        else:
            findings.append(red("axes", "+%s (%s) is seen as %s" % (axis, WAYS[axis], seen), _LEVEL))
    if len(columns) == 3:
        matrix = np.zeros((3, 3))
        for axis, (strongest, sign) in columns.items():
            matrix[strongest, AXES.index(axis)] = sign
        hand = np.linalg.det(matrix)
        if hand == 0.0:
            text = "two of the moves are seen along the same axis"
            findings.append(yellow("axes", text, "do it again, along +x, +y and +z"))
        elif hand < 0.0:
            text = "Cortex' frame is left-handed: one axis is mirrored, or two are swapped"
            findings.append(red("axes", text, _LEVEL))
    return findings


def _turn(directions):
    """Angle [rad] by which x and y are both turned about z, when they agree and lie level; else None."""
    if "x" not in directions or "y" not in directions:
        return None
    if "z" in directions and directions["z"][2] < _OBLIQUE:
        return None
    turns = []
    for axis, nominal in (("x", 0.0), ("y", 0.5 * np.pi)):
        direction = directions[axis]
        if np.hypot(direction[0], direction[1]) < _OBLIQUE:
            return None
        turns.append(np.angle(np.exp(1j * (np.arctan2(direction[1], direction[0]) - nominal))))
    apart = abs(np.angle(np.exp(1j * (turns[0] - turns[1]))))
    quarter = abs(turns[0]) % (0.5 * np.pi)
    whole = min(quarter, 0.5 * np.pi - quarter) < _TURN_TOLERANCE_RAD
    if apart > 2.0 * _TURN_TOLERANCE_RAD or (whole and abs(turns[0]) > _TURN_TOLERANCE_RAD):
        return None  # quarter turns are told axis by axis
    return turns[0] + 0.5 * np.angle(np.exp(1j * (turns[1] - turns[0])))
