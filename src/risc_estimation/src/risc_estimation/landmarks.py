"""Positions of landmarks from whichever of their markers are in view."""

import numpy as np

_LEARNING_GAIN = 0.02  # per frame in full view: averages the markers' noise over about 50 frames


class LandmarkTracker(object):
    """Centre of each landmark: mean over its visible markers of (marker - that marker's offset from the centre).

    With all markers in view this is their mean, as in the original release. The offsets are the template's until
    the landmark has once been in full view and are then those seen, so that a landmark mounted at another angle
    than the template says does not jump when one of its markers is hidden.
    """

    def __init__(self, residual_max_m):
        """residual_max_m: a partial view whose markers fit the offsets worse than this (rms, [m]) is refused."""
        self._residual_max_m = float(residual_max_m)
        self.names = []
        self._offsets = np.zeros((0, 0, 3))
        self._defined = np.zeros((0, 0), dtype=bool)
        self._learnt = np.zeros(0, dtype=bool)

    def add(self, name, markers_m):
        """Add a landmark with its template, (n, 3) offsets from the centre [m]; returns its row."""
        markers_m = np.asarray(markers_m, dtype=float)
        rows, widest = self._defined.shape
        width = max(widest, len(markers_m))
        offsets = np.zeros((rows + 1, width, 3))
        defined = np.zeros((rows + 1, width), dtype=bool)
        offsets[:rows, :widest] = self._offsets
        defined[:rows, :widest] = self._defined
        offsets[rows, : len(markers_m)] = markers_m
        defined[rows, : len(markers_m)] = True
        self._offsets, self._defined = offsets, defined
        self._learnt = np.append(self._learnt, False)
        self.names.append(name)
        return rows

    @property
    def defined(self):
        """(landmarks, markers) bool: which entries of the padded array the templates define."""
        return self._defined

    def update(self, measured, seen):
        """One frame. measured: (landmarks, markers, 3) [m], cortex frame, 0 where unseen; seen: bool, same rows.

        Returns positions (landmarks, 3) [m] and visible (landmarks,) bool; a position counts only where visible.
        """
        counts = seen.sum(axis=1)
        wanted = self._defined.sum(axis=1)
        full = counts == wanted
        offsets_seen = measured - self._offsets
        weights = seen / np.maximum(counts, 1)[:, None]
        positions = (weights[:, None, :] @ offsets_seen)[:, 0]
        errors = offsets_seen - positions[:, None, :]
        gains = np.where(self._learnt, _LEARNING_GAIN, 1.0) * full
        self._offsets += (gains[:, None] * self._defined)[:, :, None] * errors
        self._learnt |= full
        visible = full
        if not full.all():
            residuals_m = np.sqrt((weights[:, None, :] @ (errors * errors)).sum(axis=2)[:, 0])
            visible = full | ((counts >= np.minimum(2, wanted)) & (residuals_m <= self._residual_max_m))
        return positions, visible
