"""Levels a picture by the vehicle's roll: what is vertical in the world is vertical in the picture."""

import collections
import math

import cv2
import numpy as np

from risc_lab.clock_guard import ClockGuard, Step

KEPT_S = 1.0  # how long the roll is remembered


class RollHistory:
    """Roll of the last second, so that a picture is turned by the roll at its own time."""

    def __init__(self):
        self._stamps = ClockGuard(math.inf)
        self._samples = collections.deque()  # (time [s], roll [rad])

    def add(self, time_s, roll_rad):
        """Add a measurement; a new clock (a bag that is played again) clears the earlier ones."""
        step = self._stamps.look(time_s)
        if step is Step.REFUSED:
            return
        if step is Step.NEW_CLOCK:
            self._samples.clear()
        self._samples.append((time_s, roll_rad))
        while time_s - self._samples[0][0] > KEPT_S:
            self._samples.popleft()

    def at(self, time_s):
        """Roll [rad] at a time, interpolated; None when nothing was measured within a second of it."""
        if not self._samples or not self._samples[0][0] - KEPT_S <= time_s <= self._samples[-1][0] + KEPT_S:
            return None
        return float(np.interp(time_s, *zip(*self._samples)))


def level(picture, roll_rad):
    """Picture (h, w, 3) of a camera that is rolled (+ right side down), levelled.

    Returns a square with the longer side, the picture's centre in its middle; black where the camera saw nothing.
    """
    height, width = picture.shape[:2]
    side = max(height, width)
    turn = cv2.getRotationMatrix2D((0.5 * (width - 1), 0.5 * (height - 1)), -np.degrees(roll_rad), 1.0)
    turn[:, 2] += 0.5 * (side - width), 0.5 * (side - height)
    return cv2.warpAffine(picture, turn, (side, side))
