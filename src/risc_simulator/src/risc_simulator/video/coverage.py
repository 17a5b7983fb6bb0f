"""How much of each pixel a polygon covers: exact areas, so that edges are smooth and nothing is shifted or grown."""

import numpy as np

_PORTION = 8192  # pieces of edges worked on at once: they stay in the processor's cache


def coverage(points, counts, masks, weights, boxes):
    """Masks of the area that polygons cover in each pixel.

    points: (n, 2) corners [px], closed polygons one after the other; pixel (0, 0) reaches from -0.5 to 0.5.
    counts: (p,) corners of each polygon, 3 at least. masks: (p,) int, the mask that each belongs to.
    weights: (p,) what full coverage by it counts; several polygons of one mask add up.
    boxes: (m, 4) int pixels x0, y0, x1, y1 (the last two outside) that each mask reaches over.
    Returns list of m arrays (h, w) float32 in [0, 1].

    The signed area to the right of every edge is summed up cell by cell, then along the rows, as in font rasterisers.
    A polygon that crosses itself loses what it encloses in the opposite sense.
    """
    counts, masks = np.asarray(counts, dtype=np.int64), np.asarray(masks, dtype=np.int64)
    boxes = np.asarray(boxes, dtype=np.int64).reshape(-1, 4)
    widths, heights = boxes[:, 2] - boxes[:, 0], boxes[:, 3] - boxes[:, 1]
    sizes = heights * (widths + 1)  # one column more takes what lies to the right of the last pixel
    offsets = np.cumsum(sizes) - sizes
    area = np.zeros(int(sizes.sum()) + 1)
    if len(counts):
        area = _areas(points, counts, masks, weights, (boxes[:, 0], boxes[:, 1], widths, heights, offsets), len(area))
    places = list(zip(offsets.tolist(), heights.tolist(), widths.tolist()))
    for offset, h, w in places:
        rows = area[offset : offset + h * (w + 1)].reshape(h, w + 1)
        np.cumsum(rows, axis=1, out=rows)
    shares = np.clip(area, 0.0, 1.0).astype(np.float32)
    return [shares[offset : offset + h * (w + 1)].reshape(h, w + 1)[:, :w] for offset, h, w in places]


def _areas(points, counts, masks, weights, places, size):
    """Covered area (size,) to be summed up along the rows. places: x0, y0, width, height, offset (m,) of the masks."""
    ends = np.cumsum(counts)
    starts = ends - counts
    left, top, width, height, offset = (np.repeat(values[masks], counts) for values in places)
    x, y = points[:, 0] - left + 0.5, points[:, 1] - top + 0.5  # cells now begin at whole numbers
    following = np.arange(1, len(points) + 1)
    following[ends - 1] = starts
    dx, dy = x[following] - x, y[following] - y
    doubled_area = np.add.reduceat(x * dy - y * dx, starts)
    weight = np.repeat(np.where(doubled_area < 0.0, weights, -np.asarray(weights, dtype=float)), counts)

    pieces = np.floor(np.maximum(np.abs(dx), np.abs(dy))).astype(np.int64) + 1  # each shorter than a cell
    share = 1.0 / pieces
    dx, dy = dx * share, dy * share
    edges = np.stack((x, y, dx, dy, dy * weight, width, height, offset))
    cells, amounts = [], []
    portion = np.cumsum(pieces) // _PORTION
    borders = [0, *(np.flatnonzero(np.diff(portion)) + 1).tolist(), len(x)]
    for first, last in zip(borders[:-1], borders[1:]):
        cell, amount = _areas_of_pieces(np.repeat(edges[:, first:last], pieces[first:last], axis=1), pieces[first:last])
        cells += [cell, cell + 1]
        amounts += amount
    return np.bincount(np.concatenate(cells), np.concatenate(amounts), size)


def _areas_of_pieces(edges, pieces):
    """Cells (3 n,) and what n pieces of edges contribute to them (3 n,) and to their right neighbours (3 n,).

    edges: (8, n) of each piece's edge: start x, y, step of a piece x, y, weighted step y; width, height, offset of
    the mask. pieces: of each edge. A piece crosses one boundary in each direction at most: three parts, each in a cell.
    """
    x, y, dx, dy, amount, width, height, offset = edges
    number = np.arange(len(x)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    x, y = x + number * dx, y + number * dy
    cut_x, cut_y = _cut(x, dx), _cut(y, dy)
    cuts = np.stack((np.zeros_like(x), np.minimum(cut_x, cut_y), np.maximum(cut_x, cut_y), np.ones_like(x)))
    middle = 0.5 * (cuts[1:] + cuts[:-1])
    x, y = x + middle * dx, y + middle * dy
    column, row = np.floor(x), np.floor(y)
    part = np.diff(cuts, axis=0) * amount
    part *= (row >= 0.0) & (row < height) & (column < width)
    right = (x - column) * part
    right *= column >= 0.0  # an edge to the left of the mask counts for the whole row
    column = np.clip(column, 0.0, width - 1.0)
    cell = offset + np.clip(row, 0.0, height - 1.0) * (width + 1.0) + column
    return cell.astype(np.int64).ravel(), [(part - right).ravel(), right.ravel()]


def _cut(start, step):
    """Share (n,) of a step, shorter than 1, after which it crosses a whole number; 1 when it does not."""
    low, high = np.floor(start), np.floor(start + step)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (np.maximum(low, high) - start) / step
    share[low == high] = 1.0
    return np.clip(share, 0.0, 1.0, out=share)
