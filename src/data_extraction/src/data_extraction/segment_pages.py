"""The course's plots: a page for each segment of a flight, and its table. Writes files; needs no display, no ROS."""

import csv
import re
import time

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import MultipleLocator

from data_extraction.plots import ACTUAL, COLOURS, DESIRED, draw_both, style
from data_extraction.segments import ANGLES, COLUMNS, DESIRED_ANGLES, DESIRED_POSITION, POSITION, VELOCITY_ERROR

LIMITS_M = ((-2.0, 2.0), (-2.0, 2.0), (0.0, 2.0))  # of the 3-D path, as in the original release
_ROOM_M = 0.1  # beyond a path that leaves them
_TICK_M = 0.5
_GAP_S = 0.25  # a line is broken where nothing is known for longer
_STILL_DEG = 2.0  # angles that stay below this are shown on an axis of this size


class PageWriter:
    """Keeps a folder of pages and tables up to date with the segments of a flight."""

    def __init__(self, folder, pdf=True):
        """folder: pathlib.Path that exists.  pdf: write each page as PDF, too."""
        self.folder = folder
        self._suffixes = (".png", ".pdf") if pdf else (".png",)
        self._written = {}  # path without suffix -> rows

    def write(self, segments):
        """Write those that are new or have grown. Returns the list of files; tables come before the first page."""
        new = []
        for segment in segments:
            path = self.folder / file_stem(segment)
            if self._written.get(path) != len(segment.table):
                self._written[path] = len(segment.table)
                new.append((path, segment))
        files = []
        for path, segment in new:
            files.append(path.with_name(path.name + ".csv"))
            write_table(segment, files[-1])
        for path, segment in new:
            with style():
                figure = page(segment)
                for suffix in self._suffixes:
                    files.append(path.with_name(path.name + suffix))
                    figure.savefig(files[-1])
                plt.close(figure)
        return files


def file_stem(segment):
    """Name of a segment's files without suffix: vehicle, time of day at its start, what is flown."""
    text = "_".join((segment.vehicle, time.strftime("%H%M%S", segment.clock), segment.label))
    return re.sub(r"[^\w.+-]+", "_", text)


def write_table(segment, path):
    """The 16 columns as CSV, with their names."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        writer.writerows(["" if np.isnan(value) else "%.6f" % value for value in row] for row in segment.table)


def page(segment):
    """Figure with the path in space, roll and pitch, position and velocity errors of a segment."""
    figure = plt.figure(figsize=(11.0, 6.6))
    figure.suptitle(
        "%s: %s\n%s, %.0f s, position RMSE %.0f mm"
        % (
            segment.vehicle,
            segment.label,
            time.strftime("%Y-%m-%d %H:%M:%S", segment.clock),
            segment.duration_s,
            1e3 * segment.position_rmse_m,
        )
    )
    draw_path(figure.add_axes((0.005, 0.04, 0.455, 0.84), projection="3d"), segment)
    grid = figure.add_gridspec(4, 1, left=0.575, right=0.985, bottom=0.075, top=0.88, hspace=0.24)
    rows = [figure.add_subplot(grid[0])]
    rows += [figure.add_subplot(grid[k], sharex=rows[0]) for k in (1, 2, 3)]
    draw_angle(rows[0], segment, 0, "roll [deg]")
    draw_angle(rows[1], segment, 1, "pitch [deg]")
    draw_errors(rows[2], segment, segment.position_error_m, "xyz", "position\nerror [m]")
    draw_errors(rows[3], segment, segment.columns(VELOCITY_ERROR), "uvw", "velocity\nerror [m/s]")
    for axes in rows[:-1]:
        axes.tick_params(labelbottom=False)
    rows[-1].set_xlabel("time [s]    (errors: desired less actual, cortex axes)")
    rows[-1].set_xlim(0.0, segment.duration_s)
    figure.align_ylabels(rows)
    return figure


def draw_path(axes, segment):
    """Desired and actual path in space."""
    desired_m, actual_m = segment.columns(DESIRED_POSITION), segment.columns(POSITION)
    _, broken = _with_gaps(segment.table[:, -1], np.hstack((desired_m, actual_m)))
    axes.plot(*broken.T[3:], color=ACTUAL, lw=1.5, label="actual")
    axes.plot(*broken.T[:3], color=DESIRED, lw=0.9, ls="--", label="desired")
    axes.plot(*actual_m[:1].T, "o", color=ACTUAL, ms=4, label="start")
    axes.plot(*broken.T[3:5], 0.0, color="#bbbbbb", lw=0.8, label="on the floor")  # without it depth cannot be told
    limits_m = path_limits_m(np.vstack((desired_m, actual_m)))
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", xlim=limits_m[0], ylim=limits_m[1], zlim=limits_m[2])
    axes.set_box_aspect([high - low for low, high in limits_m], zoom=0.95)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MultipleLocator(_TICK_M))
    axes.legend(loc="upper center", ncol=4)


def path_limits_m(points_m):
    """Limits ((low, high) of x, y, z) of the original's plot, wider where the points (n, 3) leave them."""
    lowest, highest = points_m.min(axis=0), points_m.max(axis=0)
    return tuple(
        (low if least >= low else least - _ROOM_M, high if most <= high else most + _ROOM_M)
        for (low, high), least, most in zip(LIMITS_M, lowest, highest)
    )


def draw_angle(axes, segment, index, label):
    """Desired and actual angle over time. index: 0 roll, 1 pitch."""
    pair = segment.columns((DESIRED_ANGLES[index], ANGLES[index]))
    t_s, broken = _with_gaps(segment.table[:, -1] - segment.start_s, pair)
    # behind: the desired angle carries the noise that the vehicle's inertia takes out
    draw_both(axes, t_s, *broken.T, 2.0 * _STILL_DEG, lw=0.8, alpha=0.6, zorder=1.5)
    axes.set_ylabel(label + ("\n(no commands)" if np.isnan(pair[:, 0]).all() else ""))
    if index == 0:
        axes.legend(loc="lower right", ncol=2, bbox_to_anchor=(1.0, 0.96))


def draw_errors(axes, segment, errors, names, label):
    """Three errors (n, 3) over time."""
    t_s, broken = _with_gaps(segment.table[:, -1] - segment.start_s, errors)
    axes.axhline(0.0, color="#333333", lw=0.6)
    for name, colour, column in zip(names, COLOURS[2:], broken.T):
        axes.plot(t_s, column, color=colour, lw=1.0, label=name)
    axes.set_ylabel(label)
    axes.legend(loc="lower right", ncol=3, bbox_to_anchor=(1.0, 0.93))


def _with_gaps(t_s, values):
    """Times (n,) and values (n, k) with a NaN wherever nothing is known for a while, so that lines break there."""
    after = np.flatnonzero(np.diff(t_s) > _GAP_S) + 1
    return np.insert(t_s, after, np.nan), np.insert(values, after, np.nan, axis=0)
