"""Polygons, many at once: clipping at planes, and how much of each pixel they cover; compiled scalar code."""

import math

import numpy as np

from risc_lab.compiled import compiled


@compiled
def clip_polygons(points, counts, planes):
    """Clip convex or concave polygons to the inner side of planes (Sutherland-Hodgman).

    points: (n, 3) corners, one polygon after the other. counts: (p,) corners of each; two make a line.
    planes: (k, 4) normal and offset; inside is normal . point + offset >= 0.
    Returns (points, counts): polygons with nothing left have count 0. A line's ends are the first two of its points.
    """
    room = 2 ** len(planes)  # a plane adds at most half as many corners again
    cut = np.empty((2, room * (counts.max() if len(counts) else 0), 3))
    result, new_counts = np.empty((room * len(points), 3)), np.zeros_like(counts)
    first = total = 0
    for p in range(len(counts)):
        n, old = counts[p], points[first : first + counts[p]]
        first += n
        for k in range(len(planes)):
            plane, new, m = planes[k], cut[k % 2], 0
            for i in range(n):
                a, b = old[i], old[(i + 1) % n]
                side_a = plane[0] * a[0] + plane[1] * a[1] + plane[2] * a[2] + plane[3]
                side_b = plane[0] * b[0] + plane[1] * b[1] + plane[2] * b[2] + plane[3]
                if side_a >= 0.0:
                    new[m] = a
                    m += 1
                if (side_a >= 0.0) != (side_b >= 0.0):
                    for axis in range(3):
                        new[m, axis] = a[axis] + side_a / (side_a - side_b) * (b[axis] - a[axis])
                    m += 1
            old, n = new, m
        result[total : total + n] = old[:n]
        new_counts[p] = n
        total += n
    return result[:total], new_counts


def coverage(polygons, box, weight=1.0):
    """Share (h, w) float32 of each pixel that closed polygons cover: exact areas, so that nothing is shifted or grown.

    polygons: list of (n, 2) corners [px]; pixel (0, 0) reaches from -0.5 to 0.5. Several add up.
    box: pixels x0, y0, x1, y1 (the last two outside). weight: what full coverage by one polygon counts.
    A polygon that crosses itself loses what it encloses in the opposite sense.
    """
    x0, y0, x1, y1 = box
    shares = np.zeros((y1 - y0, x1 - x0), np.float32)
    if polygons:
        counts = np.array([len(polygon) for polygon in polygons])
        _cover(np.concatenate(polygons) - (x0 - 0.5, y0 - 0.5), counts, weight, shares)
    return shares


@compiled
def _cover(points, counts, weight, shares):
    """Write the shares (h, w) of polygons whose corners (n, 2) are in cells, which begin at whole numbers.

    The signed area to the right of every edge is summed up cell by cell, then along the rows, as in font rasterisers.
    """
    height, width = shares.shape
    area = np.zeros((height, width + 1))  # one column more takes what lies to the right of the last pixel
    first = 0
    for count in counts:
        x, y = points[first : first + count, 0], points[first : first + count, 1]
        first += count
        doubled = 0.0
        for i in range(count):
            doubled += x[i - 1] * y[i] - x[i] * y[i - 1]
        for i in range(count):
            down = y[i] > y[i - 1]
            if y[i] == y[i - 1]:  # a level edge covers nothing
                continue
            top, bottom = (i - 1, i) if down else (i, i - 1)
            amount = weight if down == (doubled < 0.0) else -weight
            for row in range(max(math.floor(y[top]), 0), min(math.ceil(y[bottom]), height)):
                from_y, to_y = max(y[top], row), min(y[bottom], row + 1)
                slope = (x[bottom] - x[top]) / (y[bottom] - y[top])
                ends = x[top] + (from_y - y[top]) * slope, x[top] + (to_y - y[top]) * slope
                left = min(ends)
                right = max(max(ends), left + 1e-9)
                per_column = amount * (to_y - from_y) / (right - left)
                if left < 0.0:  # an edge to the left of the box counts for the whole row
                    area[row, 0] += per_column * (min(right, 0.0) - left)
                for column in range(max(math.floor(left), 0), min(math.ceil(right), width)):
                    a, b = max(left, column), min(right, column + 1)
                    part, beyond = per_column * (b - a), 0.5 * (a + b) - column
                    area[row, column] += part * (1.0 - beyond)
                    area[row, column + 1] += part * beyond
    for row in range(height):
        covered = 0.0
        for column in range(width):
            covered += area[row, column]
            shares[row, column] = min(max(covered, 0.0), 1.0)
