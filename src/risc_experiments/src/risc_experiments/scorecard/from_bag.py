"""Finds the faults of motion capture in a bag, as a list for offline flights.

It looks for gaps between frames, frames that came late or repeat the one before, vehicles of which too few markers
were seen, and steps from one frame to the next that no vehicle can fly: to another place or heading, to the place of
another vehicle, two markers that change places, one marker alone. A step lasts until the next one of the same vehicle.
"""

import math
from collections import defaultdict
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import yaml

from data_extraction.bags import Bag
from data_extraction.command_line import fleet_of
from data_extraction.flatten import seconds, stamp_or_receipt_s
from data_extraction.report.drops import MARKER_LIMIT_M, MOCAP
from data_extraction.report.recorded_topics import fits
from risc_lab.phases import TrajectoryPhase
from risc_simulator.faults import FaultEvent, fault_settings

_TIME, _PHASES = "/mocap_time", "/trajectory_phase"
_GAP_S = 0.05
_LATE_S = 0.02
_TOGETHER_S = 0.1  # late, blind or repeated frames that are no farther apart are one fault
_LEAST_S = 0.015  # shorter ones are noise
_LEAST_MARKERS = 3  # a pose needs so many
_STEP_M, _SPEED_M_S = 0.05, 6.0  # a marker that goes farther than both together has stepped
_RIGID_M = 0.02  # RMS residual below which the markers of a body fit as a rigid body
_TURN_RAD = math.radians(60.0)
_SAME_PLACE_M = 0.03  # of a marker
_NEAR_M = 0.2  # of a vehicle
_LONGEST_S = 5.0  # of a step, when there is no next one


@dataclass
class Recording:
    """Motion capture of a flight."""

    names: tuple[str, ...] = ()  # of the bodies
    stamps_s: list = field(default_factory=list)
    late_s: list = field(default_factory=list)  # from its stamp to its receipt; NaN: not known
    markers_m: dict = field(default_factory=lambda: defaultdict(list))  # of each body: [(n, 3)], NaN = not seen
    course_s: tuple[float, float] | None = None  # from when to when all were on the course; None: not known


class Seen(NamedTuple):
    """A fault that was found in a recording."""

    start_s: float  # stamp
    duration_s: float
    fault: str
    body: str = ""
    severity: float | None = None


def read(path, bodies, on_progress=None):
    """Recording of a bag. bodies: names of those that count; those that are never seen are left out.

    on_progress: called with the fraction that is read.  Raises BagError, and ValueError when none of them is seen.
    """
    recording, late_s, there = Recording(tuple(bodies)), {}, set()
    begin_s, end_s = None, math.inf
    with Bag(path) as bag:
        bag.require([MOCAP])
        topics = {topic for topic in (MOCAP, _TIME, _PHASES) if topic in bag.topics and fits(topic, bag.types[topic])}
        for topic, receipt_s, message in bag.messages(topics):
            if topic == MOCAP:
                recording.stamps_s.append(stamp_or_receipt_s(message, receipt_s))
                _take_markers(recording, message)
                there.update(body.name for body in message.Obj)
                if on_progress:
                    on_progress(bag.fraction(receipt_s))
            elif topic == _TIME:
                late_s[seconds(message.header.stamp)] = seconds(message.receipt) - seconds(message.header.stamp)
            else:
                on = {vehicle.phase == TrajectoryPhase.COURSE for vehicle in message.vehicles} == {True}
                if on and begin_s is None:
                    begin_s = seconds(message.header.stamp)
                elif not on and begin_s is not None:
                    end_s = min(end_s, seconds(message.header.stamp))
    recording.names = tuple(
        name for name in bodies if any(np.isfinite(markers_m).any() for markers_m in recording.markers_m[name])
    )
    if not recording.names:
        text = "%s: motion capture saw none of %s, only %s: put the fleet file of the flight beside it, as fleet.yaml"
        raise ValueError(text % (path, ", ".join(bodies), ", ".join(sorted(there)) or "nothing"))
    recording.late_s = [late_s.get(stamp_s, math.nan) for stamp_s in recording.stamps_s]
    recording.course_s = None if begin_s is None else (begin_s, end_s)
    return recording


def _take_markers(recording, message):
    found = {body.name: body.marker for body in message.Obj}
    for name in recording.names:
        markers_m = np.array([(m.x, m.y, m.z) for m in found.get(name, ())], dtype=float).reshape(-1, 3)
        markers_m[~(np.abs(markers_m) < MARKER_LIMIT_M).all(axis=1)] = np.nan
        recording.markers_m[name].append(markers_m)


def seen_faults(recording):
    """[Seen] of a recording, in order of time."""
    order = np.argsort(recording.stamps_s, kind="stable")
    stamps_s = np.array(recording.stamps_s)[order]
    late_s = np.array(recording.late_s)[order]
    if len(stamps_s) < 2:
        return []
    bodies = {name: [recording.markers_m[name][k] for k in order] for name in recording.names}
    found = [
        Seen(stamp_s, gap_s, "mocap_blackout") for stamp_s, gap_s in zip(stamps_s, np.diff(stamps_s)) if gap_s > _GAP_S
    ]
    late_s = late_s - (np.nanpercentile(late_s, 10) if np.isfinite(late_s).any() else 0.0)
    found += [
        Seen(stamps_s[first], stamps_s[last] - stamps_s[first], "delay", "", float(np.median(late_s[first : last + 1])))
        for first, last in _stretches(stamps_s, late_s > _LATE_S)
    ]
    repeated = [False] + [
        any(len(frames[k]) for frames in bodies.values())
        and all(np.array_equal(frames[k], frames[k - 1], equal_nan=True) for frames in bodies.values())
        for k in range(1, len(stamps_s))
    ]
    found += [Seen(stamps_s[first], stamps_s[last] - stamps_s[first], "freeze")
              for first, last in _stretches(stamps_s, repeated)]  # fmt: skip
    for name, frames in bodies.items():
        lost = np.array([np.isnan(markers_m[:, 0]).mean() if len(markers_m) else 1.0 for markers_m in frames])
        left = np.array([np.count_nonzero(~np.isnan(markers_m[:, 0])) for markers_m in frames])
        found += [
            Seen(
                stamps_s[first],
                stamps_s[last] - stamps_s[first],
                "occlusion",
                name,
                float(lost[first : last + 1].max()),
            )
            for first, last in _stretches(stamps_s, left < _LEAST_MARKERS)
        ]
    return sorted(found + _steps(stamps_s, bodies))


def _stretches(stamps_s, flags):
    """(first, last) index of each stretch of set flags. Short breaks are bridged, short stretches left out as noise."""
    found = []
    for k in np.flatnonzero(flags):
        if found and stamps_s[k] - stamps_s[found[-1][1]] <= _TOGETHER_S:
            found[-1][1] = k
        else:
            found.append([k, k])
    return [(first, last) for first, last in found if stamps_s[last] - stamps_s[first] >= _LEAST_S]


def _steps(stamps_s, bodies):
    """[Seen] of the steps that no vehicle can fly."""
    begun, found = {}, []  # {body: (fault, severity, since)}
    for k in range(1, len(stamps_s)):
        step_s = stamps_s[k] - stamps_s[k - 1]
        if not 0.0 < step_s <= _GAP_S:
            continue
        pairs = {name: (frames[k - 1], frames[k]) for name, frames in bodies.items()}
        stepped = {name: pair for name, pair in pairs.items() if _has_stepped(*pair, step_s)}
        for name, fault in _kinds(stepped).items():
            if name in begun:  # it steps back, or on: only the first step is reported
                was, severity, since_s = begun.pop(name)
                found.append(Seen(since_s, stamps_s[k] - since_s, was, name, severity))
            elif fault is not None:
                begun[name] = (*fault, stamps_s[k])
    for name, (fault, severity, since_s) in begun.items():
        found.append(Seen(since_s, min(stamps_s[-1] - since_s, _LONGEST_S), fault, name, severity))
    exchanges = [seen for seen in found if seen.fault == "name_exchange"]
    twice = {seen for seen in exchanges for other in exchanges
             if seen.start_s == other.start_s and seen.body > other.body}  # fmt: skip
    return [seen for seen in found if seen not in twice]


def _common(before_m, after_m):
    """Markers of a body that are seen in both frames."""
    if before_m.shape != after_m.shape:
        return before_m[:0], after_m[:0]
    both = ~np.isnan(before_m[:, 0] + after_m[:, 0])
    return before_m[both], after_m[both]


def _has_stepped(before_m, after_m, step_s):
    before_m, after_m = _common(before_m, after_m)
    return len(before_m) > 0 and np.linalg.norm(after_m - before_m, axis=1).max() > _STEP_M + _SPEED_M_S * step_s


def _kinds(stepped):
    """{body: (fault, severity), or None if of no known kind} of bodies that stepped at the same time."""
    kinds, places = {}, {name: tuple(np.nanmean(m, axis=0) for m in pair) for name, pair in stepped.items()}
    for name, pair in stepped.items():
        exchanged = any(
            np.linalg.norm(places[name][1] - places[other][0]) < _NEAR_M
            and np.linalg.norm(places[other][1] - places[name][0]) < _NEAR_M
            for other in stepped
            if other != name
        )
        kinds[name] = ("name_exchange", None) if exchanged else _kind(*_common(*pair))
    return kinds


def _kind(before_m, after_m):
    """(fault, severity) of a body that stepped by itself; None: of no known kind."""
    steps_m = np.linalg.norm(after_m - before_m, axis=1)
    far = np.flatnonzero(steps_m > _STEP_M)
    middle_m = after_m.mean(axis=0) - before_m.mean(axis=0)
    if len(before_m) >= _LEAST_MARKERS:
        turn = _turn(before_m, after_m)
        fitted_m = (before_m - before_m.mean(axis=0)) @ turn.T + after_m.mean(axis=0)
        if math.sqrt(((fitted_m - after_m) ** 2).sum(axis=1).mean()) < _RIGID_M:
            yaw_rad = math.atan2(turn[1, 0], turn[0, 0])
            if abs(yaw_rad) > _TURN_RAD:
                return "flip", round(-math.degrees(yaw_rad), 1)
            return "jump", round(float(np.linalg.norm(middle_m)), 3)
    if len(far) == 2:
        i, j = far
        crossed_m = np.linalg.norm([after_m[i] - before_m[j], after_m[j] - before_m[i]], axis=1)
        if crossed_m.max() < _SAME_PLACE_M:
            return "marker_swap", None
    if len(far) == 1 and len(before_m) > 1:
        return "ghost_marker", round(float(steps_m[far[0]]), 3)
    return None


def _turn(before_m, after_m):
    """(3, 3) rotation that brings markers before to those after (Kabsch)."""
    left, _, right = np.linalg.svd((after_m - after_m.mean(axis=0)).T @ (before_m - before_m.mean(axis=0)))
    return left @ np.diag((1.0, 1.0, np.linalg.det(left @ right))) @ right


def events_of(recording, seen, vehicles):
    """(FaultEvents, how many were before or after the course). Times count from when the course is reached, or from
    the first frame of a bag that does not say. vehicles: {body: namespace}; for other bodies the seed chooses one.
    """
    begin_s, end_s = recording.course_s or (min(recording.stamps_s, default=0.0), math.inf)
    inside = [item for item in seen if begin_s <= item.start_s < end_s]
    events = [_event(item, vehicles.get(item.body, ""), item.start_s - begin_s) for item in inside]
    return events, len(seen) - len(inside)


def _event(item, vehicle, start_s):
    """FaultEvent of a Seen; severity and duration are limited to what the fault's member allows."""
    settings = fault_settings(item.fault)
    severity, duration_s = (
        None if value is None else round(min(max(value, low), high), 4)
        for value, (low, high) in ((item.severity, settings.severity), (item.duration_s, settings.duration_s))
    )
    return FaultEvent(item.fault, vehicle, severity, duration_s, round(start_s, 4))


def make_script(bag_path, path, vehicles, on_progress=None):
    """Write the faults of a bag as a YAML file. vehicles: of the flights that will use it, {body: namespace}.

    The bag's own vehicles are those of the fleet file beside it. Returns (FaultEvents, how many lie outside of the
    course). Raises ValueError for a bag that lacks what is needed.
    """
    fleet = fleet_of(bag_path)
    names = [vehicle.template for vehicle in fleet.vehicles] if fleet else list(vehicles)
    recording = read(bag_path, names, on_progress)
    places = list(vehicles.values())
    known = {name: vehicles.get(name, places[k % len(places)]) for k, name in enumerate(names)}
    events, outside = events_of(recording, seen_faults(recording), known)
    rows = [
        {key: getattr(event, key) for key in ("fault", "vehicle", "severity", "duration_s", "start_s")}
        for event in events
    ]
    text = "# What %s shows; seconds since the course was reached\n" % bag_path.name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text + yaml.safe_dump({"faults": rows}, sort_keys=False, default_flow_style=None), encoding="utf-8")
    return events, outside
