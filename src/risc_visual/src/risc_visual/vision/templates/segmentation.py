"""Thresholds and segmentation by colour: every pixel is painted as one of 24 hues, black or white.

Hue bins count from 1 as in the original release: red 1, orange 2-3, yellow 5, green 8-12, blue 14-19, pink 24.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from risc_lab.settings import Settings, between

BINS = 24
BLACK, WHITE = 0, 255  # values of `hue_bins` beside 1..24


@dataclass(frozen=True)
class SegmentationSettings(Settings):
    """Settings of the segmentation; the defaults are those of the original release."""

    saturation_high: between(0, 255) = 255  # of what counts as coloured
    saturation_low: between(0, 255) = 0
    value_high: between(0, 255) = 255
    value_low: between(0, 255) = 0
    blur: between(0, 100) = 0  # [px] radius of a box blur before everything else
    first_bin: between(1, BINS) = 24  # of the mask; a range may go over the end: 24 to 2 is pink, red and orange
    last_bin: between(1, BINS) = 24


def hue_bins(picture, settings):
    """Bin of every pixel, (h, w) uint8: 1..24 by hue, BLACK when too dark, WHITE when too pale or too bright."""
    if settings.blur:
        picture = cv2.blur(picture, (2 * settings.blur + 1, 2 * settings.blur + 1))
    hue, saturation, value = cv2.split(cv2.cvtColor(picture, cv2.COLOR_BGR2HSV))
    bins = _BIN_OF_HUE[hue]
    pale = (saturation < settings.saturation_low) | (saturation > settings.saturation_high)
    bins[pale | (value > settings.value_high)] = WHITE
    bins[value < settings.value_low] = BLACK
    return bins


def paint(bins):
    """Picture (h, w, 3) of `hue_bins`."""
    return _PAINTS[bins]


def mask_of_bins(bins, first, last):
    """(h, w) uint8: 255 where the bin is in first..last, which may go over the end (24..2)."""
    inside = (bins >= first) & (bins <= last) if first <= last else (bins >= first) | (bins <= last)
    return np.where(inside & (bins >= 1) & (bins <= BINS), 255, 0).astype(np.uint8)


_BIN_OF_HUE = (np.arange(256) * BINS // 180 + 1).clip(1, BINS).astype(np.uint8)
_PAINTS = np.zeros((256, 3), np.uint8)
_PAINTS[WHITE] = 255
_MIDDLES = [(int((k + 0.5) * 180.0 / BINS), 255, 255) for k in range(BINS)]  # HSV of each bin
_PAINTS[1 : BINS + 1] = cv2.cvtColor(np.uint8([_MIDDLES]), cv2.COLOR_HSV2BGR)[0]
