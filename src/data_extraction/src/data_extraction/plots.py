"""Plots of a flight, as used in a report. Writes PNG files or SVG texts; needs no display."""

import io
import itertools
import math
import pathlib
import time

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt  # noqa: E402  (the backend must be chosen first)
import numpy as np  # noqa: E402
from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: E402
from matplotlib.backends.backend_svg import FigureCanvasSVG  # noqa: E402
from matplotlib.ticker import MultipleLocator  # noqa: E402

from data_extraction.flight_metrics import HOPS  # noqa: E402
from data_extraction.report.drops import cell_edges  # noqa: E402
from data_extraction.segments import ANGLES, DESIRED_ANGLES, DESIRED_POSITION, POSITION, VELOCITY_ERROR  # noqa: E402
from risc_control.safety import FailsafeLevel  # noqa: E402
from risc_lab.lab.yaml_reader import package_file  # noqa: E402

_HEIGHT_M = 2.5  # of the arena, as far as it is shown
_MOST_POINTS = 2500  # of one line: more cannot be told apart on paper
_MARGIN_M = 0.15  # outside the net, that a plan shows
_FEW = 6  # most vehicles that a legend lists one by one
_WORST = 3  # of more vehicles, the plot of errors lists this many
COURSE_LIMITS_M = ((-2.0, 2.0), (-2.0, 2.0), (0.0, 2.0))  # axes of a course's path, as in the original release
_ROOM_M = 0.1  # added where a path leaves these limits
_GAP_S = 0.25  # a line is broken where values are missing for longer
_STILL_DEG = 2.0  # axes of angles span at least +- this
COLOURS = ("#0b6e99", "#d1495b", "#3a7d44", "#8f5db7", "#c98a1b", "#4b4e6d")
LEVEL_COLOURS = {FailsafeLevel.OK: "#cfe3d4", FailsafeLevel.HOLD: "#e0a526", FailsafeLevel.LAND: "#b3261e"}
DESIRED, ACTUAL = COLOURS[1], COLOURS[0]
FAULT = "#b3261e"
_LEGEND_OUTSIDE = "constrained"  # the layout with room for a legend; it takes twice as long as the usual one


def style():
    """Context in which figures are drawn and saved: the look of all plots."""
    return plt.style.context(package_file("data_extraction", "templates/figures.mplstyle"))


def draw_all(flight, folder, title, faults=()):
    """Draw every plot of a flight into a folder. Returns the list of the files' paths.

    faults: as `report.faults.Faults.marks` gives them.
    """
    folder = pathlib.Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    with style():
        for name, figure in _figures(flight, title, faults):
            files.append(folder / (name + ".png"))
            save_png(figure, files[-1])
    return files


def _figures(flight, title, faults):
    """(name, figure) of every plot, each drawn when the generator reaches it."""
    yield "paths", paths(flight, title)
    for name, vehicle in flight.vehicles.items():
        yield "axes_" + name, axes_over_time(name, vehicle, title, faults)
    yield "errors", errors(flight, title, faults)
    if any(len(values) for values in flight.latency_s.values()):
        yield "latency", latency(flight, title)
    if flight.bearings is not None and flight.bearings.has_judged:
        yield "bearings", bearings(flight.bearings, title)


def save_png(figure, path):
    """Write a figure to a PNG file and close it. `savefig` would draw it twice."""
    FigureCanvasAgg(figure).print_png(path)
    plt.close(figure)


def as_svg(figure):
    """Return a figure as SVG text, reproducibly, and close it."""
    stream = io.StringIO()
    FigureCanvasSVG(figure).print_svg(stream, metadata={"Date": None, "Creator": None})
    plt.close(figure)
    return stream.getvalue()


def paths(flight, title):
    """Desired and actual paths of all vehicles in the arena, in 3-D and from above."""
    figure = plt.figure(figsize=(10.5, 5.2), layout="none")
    figure.suptitle(title)
    space = figure.add_axes((0.0, 0.0, 0.58, 0.95), projection="3d")
    plan = figure.add_axes((0.65, 0.17, 0.33, 0.72))
    for colour, (name, vehicle) in zip(itertools.cycle(COLOURS), flight.vehicles.items()):
        for axes, columns in ((space, 3), (plan, 2)):
            _draw_path(axes, vehicle, columns, colour, name)
    space.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    x, y = flight.arena.half_x_m, flight.arena.half_y_m
    space.set(xlim=(-x, x), ylim=(-y, y), zlim=(0.0, _HEIGHT_M))
    space.set_box_aspect((2 * x, 2 * y, _HEIGHT_M), zoom=1.05)
    _draw_net(plan, flight.arena)
    plan.set_title("from above (frame: net)")
    if len(flight.vehicles) > _FEW:
        _name_in_place(plan, flight.vehicles)
    else:
        plan.plot([], [], color="#777777", lw=0.8, ls="--", label="desired")
        plan.legend(loc="upper center", bbox_to_anchor=(0.45, -0.12), ncol=4)
    return figure


def _name_in_place(plan, vehicles):
    """Write the name of each vehicle where it was judged, seen from above; there are too many for a legend."""
    size = max(3.0, 20.0 / math.sqrt(len(vehicles)))
    for name, vehicle in vehicles.items():
        where = vehicle.judged if vehicle.judged.any() else slice(None)
        x_m, y_m = np.nanmean(vehicle.actual_m[where, :2], axis=0)
        plan.text(y_m, x_m, name, ha="center", va="center", fontsize=size)


def axes_over_time(name, vehicle, title, faults=()):
    """Desired and actual x, y, z and yaw of one vehicle over time; faults: as for `draw_all`."""
    figure, rows = plt.subplots(4, 1, sharex=True, figsize=(9.0, 7.0))
    figure.suptitle(_joined(title, name))
    desired = np.column_stack((vehicle.desired_m, np.degrees(vehicle.desired_psi_rad)))
    actual = np.column_stack((vehicle.actual_m, np.degrees(vehicle.actual_psi_rad)))
    some = _some(len(vehicle.t_s))
    for axes, label, want, have in zip(rows, ("x [m]", "y [m]", "z [m]", "yaw [deg]"), desired.T, actual.T):
        _shade(axes, vehicle)
        draw_both(axes, vehicle.t_s[some], want[some], have[some], 1.0)
        axes.set_ylabel(label)
        _mark_faults(axes, faults, numbered=axes is rows[0])
    rows[0].legend(loc="upper right", ncol=2, bbox_to_anchor=(1.0, 1.3))
    rows[-1].set_xlabel("time [s]    (shaded: on the course and settled; judged)")
    return figure


def draw_both(axes, t_s, desired, actual, least, **look):
    """Desired and actual values (n,) over time; least: smallest height of the axis, for values that hardly change.

    look: line style of the desired values, in place of dashes.
    """
    axes.plot(t_s, actual, color=ACTUAL, lw=1.2, label="actual")
    if not np.isnan(desired).all():
        axes.plot(t_s, desired, color=DESIRED, label="desired", **(look or {"lw": 1.0, "ls": "--"}))
    low, high = axes.dataLim.intervaly
    if high - low < least:
        middle = 0.5 * (low + high)
        axes.set_ylim(middle - 0.5 * least, middle + 0.5 * least)


def errors(flight, title, faults=()):
    """Position error of each vehicle over time, and its figures; faults: as for `draw_all`."""
    figure, axes = plt.subplots(figsize=(9.0, 3.6))
    vehicles = flight.vehicles
    if len(vehicles) > _FEW:
        _draw_spread(axes, vehicles)
        vehicles = dict(sorted(vehicles.items(), key=lambda item: -(item[1].position_rmse_m or 0.0))[:_WORST])
    for colour, (name, vehicle) in zip(itertools.cycle(COLOURS), vehicles.items()):
        figures = (vehicle.position_rmse_m, vehicle.position_max_m)
        label = name
        if None not in figures:
            label += ": RMSE %.1f mm, max %.1f mm" % tuple(1e3 * figure_m for figure_m in figures)
        t_s, error_m = _peaks(vehicle.t_s, vehicle.error_m)
        axes.plot(t_s, 1e3 * error_m, color=colour, lw=1.0, label=label)
    judged = np.concatenate([v.error_m[v.judged] for v in flight.vehicles.values()])
    everything = np.concatenate([v.error_m for v in flight.vehicles.values()])
    # The climb after take-off is metres away from any course: it would flatten what matters.
    top = 3.0 * judged.max() if len(judged) else np.nanpercentile(everything, 95)
    axes.set_ylim(0.0, 1e3 * top)
    _shade(axes, next(iter(flight.vehicles.values())))
    _mark_faults(axes, faults)
    axes.set(title=_joined(title, "distance from the desired position") or "", xlabel="time [s]", ylabel="error [mm]")
    axes.legend(loc="upper right", frameon=True, framealpha=0.85, edgecolor="none")
    return figure


def _draw_spread(axes, vehicles):
    """All errors in grey, the band of the middle half of the vehicles, and the median."""
    t_s = next(iter(vehicles.values())).t_s
    t_s = t_s[_some(len(t_s))]
    rows = [1e3 * np.interp(t_s, v.t_s, v.error_m, left=np.nan, right=np.nan) for v in vehicles.values()]
    for row in rows:
        axes.plot(t_s, row, color="#bbbbbb", lw=0.4)
    low, middle, high = np.percentile(rows, [25, 50, 75], axis=0)
    axes.fill_between(t_s, low, high, color="#777777", alpha=0.5, lw=0.0, label="half of the %d vehicles" % len(rows))
    axes.plot(t_s, middle, color="#333333", lw=1.0, label="median")


def latency(flight, title):
    """How long after the datagram each hop's message arrives: histogram on a logarithmic axis."""
    hops = {hop: 1e3 * values for hop, values in flight.latency_s.items() if len(values)}
    figure, rows = plt.subplots(len(hops), 1, sharex=True, figsize=(8.0, 1.3 * len(hops) + 1.0))
    largest = max(values.max() for values in hops.values())
    bins = np.geomspace(0.03, max(largest, 0.1), 90)
    for axes, (hop, values) in zip(np.atleast_1d(rows), hops.items()):
        p50, p99 = np.percentile(values, [50, 99])
        axes.hist(np.clip(values, bins[0], None), bins=bins, color=COLOURS[0], alpha=0.8)
        axes.axvline(p50, color="#333333", lw=0.9)
        axes.axvline(p99, color=COLOURS[1], lw=0.9, ls="--")
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter("{x:g}")
        axes.set_yticks([])
        figures = "p50 %.2f ms,  p99 %.2f ms,  max %.1f ms" % (p50, p99, values.max())
        axes.set_title("%s:  %s" % (HOPS[hop], figures), loc="left")
    np.atleast_1d(rows)[-1].set_xlabel("time [ms]    (line: p50, dashed: p99)")
    figure.suptitle(_joined(title, "latency"))
    return figure


def bearings(statistics, title):
    """Bearing errors of every vehicle: scatter of fully seen objects; RMS and detection rate of each object."""
    rows = [
        (vehicle, target, target.figures())
        for vehicle, targets in sorted(statistics.vehicles.items())
        for target in sorted(targets.values(), key=lambda item: (item.is_vehicle, item.name))
    ]
    rows = [row for row in rows if row[2]["count"]]
    figure, (cloud, bars) = plt.subplots(
        1, 2, figsize=(10.5, max(4.6, 1.6 + 0.3 * len(rows))), width_ratios=(1.0, 1.15)
    )
    earlier = ", stamps less %.0f ms" % (1e3 * statistics.delay_s) if statistics.delay_s else ""
    figure.suptitle(_joined(title, "bearings against %s (fully seen%s)" % (statistics.truth, earlier)))
    colours = dict(zip(sorted(statistics.vehicles), itertools.cycle(COLOURS)))
    errors_deg = np.vstack([target.judged_deg for _, target, _ in rows])
    reach_deg = max(0.15, 1.3 * np.percentile(np.abs(errors_deg), 98.0))
    for vehicle in colours:
        points = np.vstack([target.judged_deg for name, target, _ in rows if name == vehicle] or [np.zeros((0, 2))])
        inside = (np.abs(points) <= reach_deg).all(axis=1)
        label = vehicle if inside.all() else "%s (%d outside)" % (vehicle, (~inside).sum())
        cloud.plot(*points[inside].T, ".", color=colours[vehicle], ms=2.5, alpha=0.5, label=label)
    angles = np.linspace(0.0, 2.0 * np.pi, 100)
    cloud.plot(0.1 * np.cos(angles), 0.1 * np.sin(angles), color="#333333", lw=0.9, label="0.1 deg")
    cloud.set(xlabel="azimuth error [deg]", ylabel="elevation error [deg]", aspect="equal")
    cloud.set(xlim=(-reach_deg, reach_deg), ylim=(-reach_deg, reach_deg))
    cloud.legend(loc="upper right", markerscale=4.0)
    places = np.arange(len(rows))[::-1]
    for offset, key, alpha in ((0.19, "azimuth_rms_deg", 1.0), (-0.19, "elevation_rms_deg", 0.5)):
        widths, paints = zip(*((figures[key], colours[vehicle]) for vehicle, _, figures in rows))
        bars.barh(places + offset, widths, 0.36, color=paints, alpha=alpha)
    widths = [max(figures["azimuth_rms_deg"], figures["elevation_rms_deg"]) for _, _, figures in rows]
    widest = max(widths)
    for place, width, (_, _, figures) in zip(places, widths, rows):
        seen = "" if figures["seen_percent"] is None else ", found in %.0f %%" % figures["seen_percent"]
        paper = {"facecolor": "white", "edgecolor": "none", "pad": 1}
        text = "n %d%s" % (figures["count"], seen)
        bars.text(width + 0.03 * widest, place, text, va="center", fontsize=7, bbox=paper)
    bars.set_yticks(places, ["%s: %s" % (vehicle, target.name) for vehicle, target, _ in rows])
    bars.axvline(0.1, color="#333333", lw=0.9)  # outside the axes when all are well below it
    line = "; line: 0.1 deg" if 1.55 * widest > 0.1 else ""
    bars.set(xlabel="RMS error [deg]    (dark: azimuth, light: elevation%s)" % line, xlim=(0.0, 1.55 * widest))
    bars.set_axisbelow(True)
    bars.grid(axis="y", visible=False)
    return figure


def arena_map(flight):
    """The arena from above: net, landmarks, desired and actual paths, also of vehicles without a reference."""
    figure, plan = plt.subplots(figsize=(6.6, 7.6), layout=_LEGEND_OUTSIDE)
    _draw_net(plan, flight.arena)
    for name, place_m in sorted(flight.landmarks.items()):
        plan.plot(place_m[1], place_m[0], "s", color="#555555", ms=6)
        towards = -1.0 if place_m[0] > 0.0 else 1.0
        plan.annotate(name, (place_m[1], place_m[0]), (0, 11.0 * towards), textcoords="offset points", fontsize=8,
                      color="#555555", ha="center", va="center")  # fmt: skip
    for colour, (name, series) in zip(itertools.cycle(COLOURS), sorted(flight.paths.items())):
        places_m = series.values[_some(len(series.t_s))]
        if name in flight.vehicles:
            _draw_path(plan, flight.vehicles[name], 2, colour, name)
        else:
            plan.plot(*_drawn(places_m, 2), color=colour, lw=1.0, label=name)
        plan.plot(places_m[0, 1], places_m[0, 0], "o", color=colour, ms=5, mfc="white")
        plan.plot(places_m[-1, 1], places_m[-1, 0], "x", color=colour, ms=6)
    if flight.vehicles:
        plan.plot([], [], color="#777777", lw=0.8, ls="--", label="desired")
    plan.plot([], [], "o", color="#777777", ms=5, mfc="white", label="begin")
    plan.plot([], [], "x", color="#777777", ms=6, label="end")
    figure.legend(loc="outside lower center", ncol=4)
    return figure


def drop_map(drops, arena):
    """Where in the arena markers were lost [%], and where vehicles became invisible. drops: report.drops.Drops."""
    edges_x_m, edges_y_m = cell_edges(arena)
    figure, plan = plt.subplots(figsize=(6.6, 6.6), layout=_LEGEND_OUTSIDE)
    total = drops.seen_map + drops.lost_map
    share = np.ma.masked_where(total < drops.least_markers, 100.0 * drops.lost_map / np.maximum(total, 1))
    top = max(1.0, float(share.max())) if share.count() else 1.0
    mesh = plan.pcolormesh(edges_y_m, edges_x_m, share, cmap="YlOrRd", vmin=0.0, vmax=top, edgecolors="white", lw=0.5)
    _draw_net(plan, arena)
    plan.grid(visible=False)
    figure.colorbar(mesh, ax=plan, label="markers lost [%]", shrink=0.75)
    if drops.lost_places_m:
        x_m, y_m = zip(*drops.lost_places_m)
        plan.plot(y_m, x_m, "x", color="#222222", ms=5, label="a vehicle became invisible")
        figure.legend(loc="outside lower center")
    return figure


def ladder(spans, zero_s, faults=()):
    """Levels of every vehicle's safety ladder over time; faults: as for `draw_all`.

    spans: {vehicle: [report.ladder.Span]}; zero_s: time 0.
    """
    figure, axes = plt.subplots(figsize=(9.0, 1.2 + 0.4 * len(spans)), layout=_LEGEND_OUTSIDE)
    for row, vehicle in enumerate(spans):
        for span in spans[vehicle]:
            colour, width_s = LEVEL_COLOURS[span.level], max(span.end_s - span.begin_s, 0.0)
            edge = 0.0 if span.level == FailsafeLevel.OK else 1.5  # what is shorter than a pixel must still be seen
            times_s = [(span.begin_s - zero_s, width_s)]
            axes.broken_barh(times_s, (row - 0.3, 0.6), facecolors=colour, edgecolors=colour, lw=edge)
    for level, colour in LEVEL_COLOURS.items():
        axes.plot([], [], "s", color=colour, label=level.name.lower())
    axes.set_yticks(range(len(spans)), list(spans))
    axes.set(xlabel="time [s]", ylim=(len(spans) - 0.5, -0.5))
    _mark_faults(axes, faults)
    axes.grid(axis="y", visible=False)
    figure.legend(loc="outside upper right", ncol=3)
    return figure


def battery(batteries, zero_s):
    """Charge of every vehicle over time. batteries: {vehicle: report.battery.Battery}; zero_s: time 0."""
    figure, axes = plt.subplots(figsize=(9.0, 2.8), layout=_LEGEND_OUTSIDE)
    for colour, (name, item) in zip(itertools.cycle(COLOURS), batteries.items()):
        t_s, charge_pct = item.samples.table().T
        axes.plot(t_s - zero_s, charge_pct, color=colour, lw=1.2, label=name, drawstyle="steps-post")
    lowest = min(item.samples.table()[:, 1].min() for item in batteries.values())
    axes.set(xlabel="time [s]", ylabel="battery [%]", ylim=(max(0.0, lowest - 10.0), 102.0))
    figure.legend(loc="outside upper right", ncol=5)
    return figure


def fence_margin(margins, zero_s, faults=()):
    """Distance of every vehicle from the net over time; faults: as for `draw_all`.

    margins: {vehicle: report.fence.FenceMargin}.
    """
    figure, axes = plt.subplots(figsize=(9.0, 3.2), layout=_LEGEND_OUTSIDE)
    lowest_m = 0.05
    for colour, (name, item) in zip(itertools.cycle(COLOURS), margins.items()):
        times_s, now_m, stopped_m = item.table.T
        lines = [(now_m, {"lw": 1.2, "label": name})]
        if item.type_known:
            lines.insert(0, (stopped_m, {"lw": 0.7, "alpha": 0.5}))
        lowest_m = min(lowest_m, float(lines[0][0].min()))
        for values_m, style in lines:
            t_s, closeness_m = _peaks(times_s, -values_m)
            axes.plot(t_s - zero_s, -closeness_m, color=colour, **style)
    for limit_m in sorted({item.fence.margin_m for item in margins.values() if item.type_known}):
        axes.axhline(limit_m, color="#b3261e", lw=1.0, ls="--", label="landing is ordered below %g m" % limit_m)
    axes.set(xlabel="time [s]    (pale: of where it could have stopped)", ylabel="distance from the net [m]")
    axes.set_ylim(bottom=lowest_m - 0.05)
    _mark_faults(axes, faults)
    figure.legend(loc="outside upper right", ncol=5)
    return figure


def hover_throttle(fit, title, shipped):
    """Points, curve and 95 % band of a ThrottleFit, and its residuals.

    shipped: (name, coefficients) of another curve, to compare with.
    """
    figure, (axes, below) = plt.subplots(2, 1, sharex=True, figsize=(7.5, 6.0), height_ratios=(2.5, 1.0))
    figure.suptitle(title)
    points, pct = fit.points, np.linspace(fit.points.pct[0], fit.points.pct[-1], 200)
    axes.errorbar(points.pct, points.throttle, points.spread, fmt=".", color=COLOURS[5], ms=4, lw=0.5,
                  label="hover, mean and spread of each percent")  # fmt: skip
    axes.plot(pct, fit.scaled(pct), color=ACTUAL, label="fit of order %d" % (len(fit.coefficients) - 1))
    band = fit.interval(pct)
    axes.fill_between(pct, fit.scaled(pct) - band, fit.scaled(pct) + band, color=ACTUAL, alpha=0.25, lw=0)
    name, coefficients = shipped
    curve = np.polynomial.polynomial.polyval(pct, coefficients)
    axes.plot(pct, curve, color=DESIRED, lw=1.0, ls="--", label=name)
    axes.set_ylabel("throttle that hovers [-1, 1]")
    axes.legend()
    below.axhline(0.0, color=ACTUAL, lw=1.0)
    below.plot(points.pct, fit.residuals, ".", color=COLOURS[5], ms=4)
    below.fill_between(pct, -band, band, color=ACTUAL, alpha=0.25, lw=0)
    below.set_ylabel("residual")
    below.set_xlabel("battery [%]")
    below.invert_xaxis()  # as it drains
    return figure


def course_page(segment):
    """Figure with the path in space, roll and pitch, position and velocity errors of a segment."""
    figure = plt.figure(figsize=(11.0, 6.6), layout="none")
    when = time.strftime("%Y-%m-%d %H:%M:%S", segment.clock)
    figures = "%.0f s, position RMSE %.0f mm" % (segment.duration_s, 1e3 * segment.position_rmse_m)
    figure.suptitle("%s: %s\n%s, %s" % (segment.vehicle, segment.label, when, figures))
    _draw_course(figure.add_axes((0.005, 0.04, 0.455, 0.84), projection="3d"), segment)
    grid = figure.add_gridspec(4, 1, left=0.575, right=0.985, bottom=0.075, top=0.88, hspace=0.24)
    rows = [figure.add_subplot(grid[0])]
    rows += [figure.add_subplot(grid[k], sharex=rows[0]) for k in (1, 2, 3)]
    _draw_angle(rows[0], segment, 0, "roll [deg]")
    _draw_angle(rows[1], segment, 1, "pitch [deg]")
    _draw_errors(rows[2], segment, segment.position_error_m, "xyz", "position\nerror [m]")
    _draw_errors(rows[3], segment, segment.columns(VELOCITY_ERROR), "uvw", "velocity\nerror [m/s]")
    for axes in rows[:-1]:
        axes.tick_params(labelbottom=False)
    rows[-1].set_xlabel("time [s]    (errors: desired less actual, cortex axes)")
    rows[-1].set_xlim(0.0, segment.duration_s)
    figure.align_ylabels(rows)
    return figure


def _draw_course(axes, segment):
    """Desired and actual path in space."""
    desired_m, actual_m = segment.columns(DESIRED_POSITION), segment.columns(POSITION)
    _, broken = _with_gaps(segment.table[:, -1], np.hstack((desired_m, actual_m)))
    axes.plot(*broken.T[3:], color=ACTUAL, lw=1.5, label="actual")
    axes.plot(*broken.T[:3], color=DESIRED, lw=0.9, ls="--", label="desired")
    axes.plot(*actual_m[:1].T, "o", color=ACTUAL, ms=4, label="start")
    axes.plot(*broken.T[3:5], 0.0, color="#bbbbbb", lw=0.8, label="on the floor")  # without it depth cannot be seen
    x, y, z = course_limits_m(np.vstack((desired_m, actual_m)))
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", xlim=x, ylim=y, zlim=z)
    axes.set_box_aspect([high - low for low, high in (x, y, z)], zoom=0.95)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MultipleLocator(0.5))
    axes.legend(loc="upper center", ncol=4)


def course_limits_m(points_m):
    """(3, 2) limits of x, y, z of the original's plot, wider where the points (n, 3) leave them."""
    low, high = np.transpose(COURSE_LIMITS_M)
    least, most = points_m.min(axis=0), points_m.max(axis=0)
    return np.column_stack((np.where(least < low, least - _ROOM_M, low), np.where(most > high, most + _ROOM_M, high)))


def _draw_angle(axes, segment, index, label):
    """Desired and actual angle over time. index: 0 roll, 1 pitch."""
    pair = segment.columns((DESIRED_ANGLES[index], ANGLES[index]))
    t_s, broken = _with_gaps(segment.table[:, -1] - segment.start_s, pair)
    # drawn behind: the desired angle carries noise that the vehicle's inertia filters out
    draw_both(axes, t_s, *broken.T, 2.0 * _STILL_DEG, lw=0.8, alpha=0.6, zorder=1.5)
    axes.set_ylabel(label + ("\n(no commands)" if np.isnan(pair[:, 0]).all() else ""))
    if index == 0:
        axes.legend(loc="lower right", ncol=2, bbox_to_anchor=(1.0, 0.96))


def _draw_errors(axes, segment, errors, names, label):
    """Three errors (n, 3) over time."""
    t_s, broken = _with_gaps(segment.table[:, -1] - segment.start_s, errors)
    axes.axhline(0.0, color="#333333", lw=0.6)
    for name, colour, column in zip(names, COLOURS[2:], broken.T):
        axes.plot(t_s, column, color=colour, lw=1.0, label=name)
    axes.set_ylabel(label)
    axes.legend(loc="lower right", ncol=3, bbox_to_anchor=(1.0, 0.93))


def _with_gaps(t_s, values):
    """Times (n,) and values (n, k) with a NaN wherever values are missing for a while, so that lines break there."""
    after = np.flatnonzero(np.diff(t_s) > _GAP_S) + 1
    return np.insert(t_s, after, np.nan), np.insert(values, after, np.nan, axis=0)


def _joined(title, text):
    """Heading of a figure; None without a title, when a caption says what the figure shows."""
    return "%s: %s" % (title, text) if title else None


def _some(count):
    """Slice that leaves no more points than a line needs."""
    return slice(None, None, max(1, count // _MOST_POINTS))


def _peaks(t_s, values):
    """Times and values (n,), thinned out so that the largest values stay."""
    width = _some(len(t_s)).step
    count = len(t_s) // width * width
    return t_s[:count:width], values[:count].reshape(-1, width).max(axis=1)


def _draw_path(axes, vehicle, columns, colour, name):
    """One vehicle's desired path (dashed), its whole path (pale) and what was judged of it."""
    some = _some(len(vehicle.t_s))
    desired_m = np.where(vehicle.course[:, None], vehicle.desired_m, np.nan)[some]
    judged_m = np.where(vehicle.judged[:, None], vehicle.actual_m, np.nan)[some]
    axes.plot(*_drawn(desired_m, columns), color="#777777", lw=0.8, ls="--")
    axes.plot(*_drawn(vehicle.actual_m[some], columns), color=colour, lw=0.6, alpha=0.45)
    axes.plot(*_drawn(judged_m, columns), color=colour, lw=1.4, label=name)


def _draw_net(plan, arena):
    """The net seen from above with x up and y to the left, as one stands in the arena looking forward."""
    x, y = arena.half_x_m, arena.half_y_m
    plan.add_patch(plt.Rectangle((-y, -x), 2 * y, 2 * x, fill=False, color="#999999"))
    plan.set(xlabel="y [m]", ylabel="x [m]", aspect="equal")
    plan.set(xlim=(y + _MARGIN_M, -y - _MARGIN_M))
    plan.set(ylim=(-x - _MARGIN_M, x + _MARGIN_M))


def _drawn(position_m, columns):
    """Columns to plot: (x, y, z) in space, (y, x) on the plan."""
    return position_m.T if columns == 3 else position_m.T[[1, 0]]


def _shade(axes, vehicle):
    judged = vehicle.judged
    if judged.any():
        t_s = vehicle.t_s[judged]
        axes.axvspan(t_s[0], t_s[-1], color="#f0f4e8", zorder=0)


def _mark_faults(axes, faults, numbered=True):
    """Mark when faults acted, with their numbers above; the limits of the time axis stay."""
    low_s, high_s = axes.get_xlim()
    for number, (begin_s, end_s) in enumerate(faults, start=1):
        axes.axvspan(begin_s, min(end_s, high_s), color=FAULT, alpha=0.15, lw=0.0, zorder=0.5)
        axes.axvline(begin_s, color=FAULT, lw=0.9, zorder=0.6)
        if numbered:
            axes.annotate(number, (begin_s, 1.0), (0, 2), xycoords=("data", "axes fraction"), color=FAULT, fontsize=7,
                          textcoords="offset points", ha="center", va="bottom", annotation_clip=True)  # fmt: skip
    axes.set_xlim(low_s, high_s)
