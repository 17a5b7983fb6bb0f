"""A picture turned so that what is vertical in the world is vertical in it, however the vehicle rolls."""

import math

import cv2
import numpy as np

from risc_lab.clock import ClockGuard, Step

KEPT_S = 1.0  # how long the roll is remembered


class RollHistory:
    """Roll of the last second, so that a picture is turned by the roll at its own time."""

    def __init__(self):
        self._stamps = ClockGuard(math.inf)
        self._times_s = []
        self._rolls_rad = []

    def add(self, time_s, roll_rad):
        """A measurement; a new clock (a bag that is played again) begins anew."""
        step = self._stamps.look(time_s)
        if step is Step.REFUSED:
            return
        if step is Step.NEW_CLOCK:
            self._times_s.clear()
            self._rolls_rad.clear()
        self._times_s.append(time_s)
        self._rolls_rad.append(roll_rad)
        while self._times_s[-1] - self._times_s[0] > KEPT_S:
            del self._times_s[0], self._rolls_rad[0]

    def at(self, time_s):
        """Roll [rad] at a time, interpolated; None when nothing was measured within a second of it."""
        if not self._times_s or not self._times_s[0] - KEPT_S <= time_s <= self._times_s[-1] + KEPT_S:
            return None
        return float(np.interp(time_s, self._times_s, self._rolls_rad))


def level(picture, roll_rad):
    """Picture (h, w, 3) of a camera that is rolled (+ right side down), levelled.

    Returns a square with the longer side, the picture's centre in its middle; black where the camera saw nothing.
    """
    height, width = picture.shape[:2]
    side = max(height, width)
    turn = cv2.getRotationMatrix2D((0.5 * (width - 1), 0.5 * (height - 1)), -np.degrees(roll_rad), 1.0)
    turn[:, 2] += 0.5 * (side - width), 0.5 * (side - height)
    return cv2.warpAffine(picture, turn, (side, side))
