"""Cutting many polygons and lines at planes at once. All planes pass through the camera or are given with an offset."""

import numpy as np


def clip_polygons(points, counts, planes):
    """Cut convex or concave polygons to the inner side of planes (Sutherland-Hodgman, all polygons at once).

    points: (n, 3) corners, one polygon after the other. counts: (p,) corners of each.
    planes: (k, 4) normal and offset; inside is normal . point + offset >= 0.
    Returns (points, counts): polygons with nothing left have count 0, the others 3 or more.
    """
    counts = np.asarray(counts)
    for plane in planes:
        if not len(points):
            break
        side = points @ plane[:3] + plane[3]
        inside = side >= 0.0
        if inside.all():
            continue
        ends = np.cumsum(counts)
        some = counts > 0
        following = np.arange(1, len(points) + 1)
        following[ends[some] - 1] = ends[some] - counts[some]
        crosses = inside != inside[following]
        emitted = inside.astype(np.int64) + crosses
        place = np.cumsum(emitted) - emitted
        result = np.empty((int(emitted.sum()), 3))
        result[place[inside]] = points[inside]
        start = np.flatnonzero(crosses)
        a, b = side[start], side[following[start]]
        share = (a / (a - b))[:, None]
        result[place[start] + inside[start]] = points[start] + share * (points[following[start]] - points[start])
        polygon = np.repeat(np.arange(len(counts)), counts)
        counts = np.bincount(polygon, emitted, len(counts)).astype(np.int64)
        points = result
    return points, counts


def clip_segments(ends, planes):
    """Cut lines (n, 2, 3) to the inner side of planes (k, 4). Returns (m, 2, 3): what is left of them."""
    for plane in planes:
        side = ends @ plane[:3] + plane[3]
        ends, side = ends[(side >= 0.0).any(axis=1)], side[(side >= 0.0).any(axis=1)]
        cut = np.flatnonzero((side < 0.0).any(axis=1))
        if len(cut):
            a, b = side[cut, 0], side[cut, 1]
            share = (a / (a - b))[:, None]
            crossing = ends[cut, 0] + share * (ends[cut, 1] - ends[cut, 0])
            ends[cut, np.where(a < 0.0, 0, 1)] = crossing
    return ends
