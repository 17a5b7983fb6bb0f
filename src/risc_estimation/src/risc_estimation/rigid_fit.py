"""Pose of many rigid bodies from their markers (least-squares rigid fit, all bodies in one go).

For each body the rotation R and translation p minimise  sum_i |m_i - (R t_i + p)|^2  over the visible markers,
t_i being the template's marker and m_i the measured one (Kabsch's solution: singular value decomposition of the
cross-covariance). No axis is singled out, so there is no attitude at which the fit degenerates.
"""

from typing import NamedTuple

import numpy as np

MIN_MARKERS = 3


class RigidFit(NamedTuple):
    """Result of `fit_rigid`, one row per body."""

    rotations: np.ndarray  # (bodies, 3, 3) template frame -> measured frame
    positions: np.ndarray  # (bodies, 3) template origin in the measured frame [m]
    residuals_m: np.ndarray  # (bodies,) rms distance of the used markers from the fitted template [m]
    spreads_m: np.ndarray  # (bodies,) second principal extent of the used markers [m]; 0 = on one line


class TemplateStack(object):
    """Templates of several bodies padded to one array, with what the full-view fit needs precomputed."""

    def __init__(self, markers_list):
        """markers_list: one (n_i, 3) array per body: template markers [m]."""
        widest = max([len(markers) for markers in markers_list] + [MIN_MARKERS])
        self.markers = np.zeros((len(markers_list), widest, 3))
        self.defined = np.zeros((len(markers_list), widest), dtype=bool)
        for body, markers in enumerate(markers_list):
            self.markers[body, : len(markers)] = markers
            self.defined[body, : len(markers)] = True
        self.full = _weigh(self.markers, self.defined)

    @property
    def shape(self):
        """(bodies, markers) of the padded array."""
        return self.defined.shape


class _Weighed(NamedTuple):
    """Templates reduced to the visible markers, one row per body."""

    weights: np.ndarray  # (bodies, 1, n) 1 / number of visible markers, 0 where not visible
    centroids: np.ndarray  # (bodies, 1, 3) [m]
    arms: np.ndarray  # (bodies, 3, n) visible markers about their centroid [m], 0 where not visible


def _weigh(markers, visible):
    weights = visible[:, None, :] / np.maximum(visible.sum(axis=1), 1)[:, None, None]
    centroids = weights @ markers
    return _Weighed(weights, centroids, ((markers - centroids) * visible[:, :, None]).transpose(0, 2, 1))


def fit_rigid(stack, measured, visible=None, bodies=None):
    """Fit templates to measured markers.

    stack: TemplateStack.   measured: (b, n, 3) [m], any right-handed frame; invisible markers must be finite (0).
    visible: (b, n) bool, None = every defined marker.   bodies: rows of the stack that `measured` holds, None = all.
    Returns RigidFit with b rows. A row with fewer than 3 visible markers or markers on one line has a spread of
    (nearly) zero: its rotation is meaningless, and the caller is to look at the spread before using it.
    """
    markers = stack.markers if bodies is None else stack.markers[bodies]
    if visible is None:
        weighed = stack.full if bodies is None else _Weighed(*[part[bodies] for part in stack.full])
    else:
        weighed = _weigh(markers, visible)
    weights, centroids, arms = weighed
    centroids_measured = weights @ measured
    u, singular, vt = np.linalg.svd(arms @ measured)  # arms sum to zero: no need to centre the measured markers
    rotations_t = u @ vt
    mirrored = np.linalg.det(rotations_t) < 0.0
    if mirrored.any():
        vt[mirrored, 2] *= -1.0  # a flat template fits its mirror image as well: take the rotation
        rotations_t = u @ vt
    positions = centroids_measured - centroids @ rotations_t
    errors = markers @ rotations_t
    errors += positions
    errors -= measured
    np.multiply(errors, errors, out=errors)
    residuals_m = np.sqrt((weights @ errors).sum(axis=2)[:, 0])
    return RigidFit(rotations_t.transpose(0, 2, 1), positions[:, 0], residuals_m, np.sqrt(singular[:, 1]))


def fit_without_worst(stack, body, measured, visible):
    """Fit one body once without each visible marker in turn and return the best: (RigidFit of one row, marker).

    A swapped or ghost marker spoils the fit of all; without it the rest fits again. measured: (n, 3) [m],
    visible: (n,) bool with at least 4 set, else ValueError. The marker left out is returned as its index.
    """
    candidates = np.flatnonzero(visible)
    if candidates.size < MIN_MARKERS + 1:
        raise ValueError("leaving a marker out needs %d visible markers, got %d" % (MIN_MARKERS + 1, candidates.size))
    tries = np.repeat(visible[None], candidates.size, axis=0)
    tries[np.arange(candidates.size), candidates] = False
    fit = fit_rigid(stack, np.where(tries[:, :, None], measured[None], 0.0), tries, np.full(candidates.size, body))
    best = int(fit.residuals_m.argmin())
    return RigidFit(*[part[best : best + 1] for part in fit]), int(candidates[best])
