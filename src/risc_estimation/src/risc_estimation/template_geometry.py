"""Geometry of a marker template: measured at rest, in its own axes, and what it may be confused with. Needs no ROS."""

import math
from typing import NamedTuple

import numpy as np
import yaml
from scipy.spatial.distance import cdist

from risc_estimation.pose_fit import PoseFitParams
from risc_estimation.rigid_fit import POSE, WORK, fit_pose
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.templates import VEHICLE, TemplateSet
from risc_lab.settings import settings_from

ALIKE_M = 0.005  # rms; geometries that fit each other this closely may be confused
LEAST_FRAMES = 50
_SEEN = 0.5  # of the frames; a marker that is seen in fewer is not learnt
_NOISE_MAX_M = 0.005  # of a coordinate; a noisier marker is loose, or two markers in one
_PARTS = 5  # of the recording, whose marker positions are compared
_MOVED_M = 0.001  # in addition to what noise explains
_SIGMAS = 5.0
_OF_MEDIAN = math.sqrt(math.pi / 2.0)  # standard error of the median / that of the mean
_SIGMA_BY_MAD = 1.4826  # sigma of normal noise / median absolute deviation


class Rest(NamedTuple):
    """Markers of an object at rest."""

    markers_m: np.ndarray  # (n, 3) [m] cortex
    noise_m: np.ndarray  # (n,) 1 sigma of a coordinate of one frame
    seen: np.ndarray  # (n,) fraction of the frames


def at_rest(samples_m):
    """`Rest` of samples (frames, n, 3) [m] in the cortex frame; a lost marker is NaN or farther than any room.

    Positions are medians, and noise comes from median absolute deviations: single false frames have hardly any effect.
    Raises ValueError when there are too few frames, or a marker is seldom seen, noisy or has moved: when the median of
    a fifth of the recording differs from that of all by more than 1 mm plus 5 sigma of it.
    """
    samples_m = np.where(np.abs(samples_m) < PoseFitParams.marker_limit_m, samples_m, np.nan)
    frames, count, _ = samples_m.shape
    if frames < LEAST_FRAMES or count == 0:
        raise ValueError("%d frames of %d markers are too few, %d frames are needed" % (frames, count, LEAST_FRAMES))
    there = np.isfinite(samples_m).all(axis=2)
    rest = Rest(np.empty((count, 3)), np.empty(count), there.mean(axis=0))
    for k in range(count):
        if rest.seen[k] < _SEEN:
            raise ValueError("marker %d is seen in %.0f %% of the frames only" % (k + 1, 100.0 * rest.seen[k]))
        own_m = samples_m[there[:, k], k]
        place_m = rest.markers_m[k] = np.median(own_m, axis=0)
        deviations_m = _SIGMA_BY_MAD * np.median(np.abs(own_m - place_m), axis=0)
        rest.noise_m[k] = math.sqrt(np.mean(deviations_m**2))
        parts = np.array_split(own_m, _PARTS)
        limit_m = _MOVED_M + _SIGMAS * _OF_MEDIAN * rest.noise_m[k] / math.sqrt(len(parts[-1]))
        moved_m = max(np.linalg.norm(np.median(part, axis=0) - place_m) for part in parts)
        if moved_m > limit_m:
            raise ValueError("marker %d has moved by %.1f mm: let the object rest" % (k + 1, 1e3 * moved_m))
        if rest.noise_m[k] > _NOISE_MAX_M:
            raise ValueError("marker %d shakes: its noise is %.1f mm" % (k + 1, 1e3 * rest.noise_m[k]))
    return rest


class Match(NamedTuple):
    """One assignment of markers to others, with the best rotation and shift."""

    rms_m: float  # remaining distance
    places: tuple[int, ...]  # on which of the others each marker lies
    R: np.ndarray  # (3, 3) others = R markers + shift

    @property
    def angle_rad(self):
        """Angle of the rotation, from 0 to pi."""
        return math.acos(min(1.0, max(-1.0, 0.5 * (np.trace(self.R) - 1.0))))


def matches(markers_m, others_m, limit_m=ALIKE_M):
    """[`Match`] of markers (n, 3) on others (>= n, 3) [m] with an rms distance of at most limit_m, the best one first.

    Every assignment that the distances between markers allow is tried: for residuals r_i with rms r the distance of
    two markers differs by at most |r_i| + |r_j| <= r sqrt(2 n).
    """
    apart_m, others_apart_m = cdist(markers_m, markers_m), cdist(others_m, others_m)
    slack_m = limit_m * math.sqrt(2.0 * len(markers_m))

    def assignments(places):
        i = len(places)
        if i == len(markers_m):
            yield places
            return
        for k in range(len(others_m)):
            off_m = np.abs(apart_m[i, :i] - others_apart_m[k, list(places)])
            if k not in places and (off_m <= slack_m).all():
                yield from assignments((*places, k))

    found = [laid_on(markers_m, others_m, places) for places in assignments(())]
    return sorted((match for match in found if match.rms_m <= limit_m), key=lambda match: match.rms_m)


def laid_on(markers_m, others_m, places):
    """`Match` of markers (n, 3): marker i is laid on others_m[places[i]]."""
    pose, visible = np.zeros(1, POSE)[0], np.ones(len(markers_m), dtype=bool)
    measured_m = np.ascontiguousarray(np.asarray(others_m, dtype=float)[list(places)])
    fit_pose(np.array(markers_m, dtype=float), measured_m, visible, np.zeros(1, WORK)[0], pose)
    return Match(float(pose.residual_m), tuple(places), pose.rotation.copy())


def symmetry(markers_m, limit_m=ALIKE_M):
    """Best `Match` of markers (n, 3) [m] on themselves with some of them exchanged; None if there is none."""
    itself = tuple(range(len(markers_m)))
    return next((match for match in matches(markers_m, markers_m, limit_m) if match.places != itself), None)


def symmetries_when_hidden(markers_m, limit_m=ALIKE_M):
    """{hidden marker: `symmetry` of the others}, where there is one and at least three are left."""
    found = {k: symmetry(np.delete(markers_m, k, axis=0), limit_m) for k in range(len(markers_m))}
    return {k: match for k, match in found.items() if match is not None and len(markers_m) > 3}


def resembling(markers_m, templates, limit_m=ALIKE_M):
    """{name: best `Match`} of templates that markers (n, 3) [m] may be confused with: the smaller set on the larger."""
    found = {}
    for name, template in templates.items():
        fewer_m, more_m = sorted((markers_m, template.markers_m), key=len)
        best = next(iter(matches(fewer_m, more_m, limit_m)), None)
        if best is not None:
            found[name] = best
    return found


def in_own_axes(markers_m, kind, origin_m=None, nose_rad=0.0):
    """Markers (n, 3) [m] at rest in the cortex frame, converted to the axes and the origin of their template.

    kind: of template.  vehicle: body axes of a vehicle that stands level with its nose at a yaw of nose_rad (0: along
    cortex x); else the cortex axes as mounted.  origin_m: (3,) cortex, None: the mean of the markers.
    """
    centred_m = markers_m - (np.mean(markers_m, axis=0) if origin_m is None else np.asarray(origin_m))
    return centred_m @ rotation_body_to_cortex(0.0, 0.0, nose_rad) if kind == VEHICLE else centred_m


def in_axes_of(markers_m, template):
    """(markers (n, 3) [m] in the axes and from the origin of a template with the same markers, `Match`).

    Raises ValueError when the template has another number of markers.
    """
    if len(markers_m) != len(template.markers_m):
        text = "%d markers are no template like %s, which has %d"
        raise ValueError(text % (len(markers_m), template.name, len(template.markers_m)))
    match = laid_on(markers_m, template.markers_m, range(len(markers_m)))
    return (markers_m - markers_m.mean(axis=0)) @ match.R.T + template.markers_m.mean(axis=0), match


def template_text(name, kind, marker_names, markers_m, notes=()):
    """Text of a template for a templates file (or the section `templates` of a fleet file), to 0.1 mm, below notes.

    Raises ValueError for an invalid template, e.g. a vehicle with its markers on one line.
    """
    places = {marker: [round(float(x), 4) + 0.0 for x in row] for marker, row in zip(marker_names, markers_m)}
    geometry = "%s_markers" % name
    content = {"geometries": {geometry: places}, "templates": {name: {"kind": kind, "geometry": geometry}}}
    settings_from(TemplateSet, content, "template %s" % name)
    comment = "".join("# %s\n" % note for note in notes)
    return comment + yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=1000)
