"""Decides whether a flight succeeded, from the figures of its bag."""

from dataclasses import dataclass

import numpy as np

from data_extraction.report.faults import LANDED_HEIGHT_M
from risc_lab.phases import OutCause
from risc_simulator.faults import fault_settings

_MAY_FOLLOW = (OutCause.LADDER, OutCause.LANDED, OutCause.SILENT, OutCause.MANUAL)  # a fault may cause these


@dataclass(frozen=True)
class Limits:
    """Limits that a flight must keep."""

    position_rmse_m: float = 0.10  # per vehicle, on the course after settling
    position_max_m: float = 0.30
    yaw_rmse_rad: float = 0.1
    net_margin_m: float = 0.05  # nearest approach to the net
    landed_height_m: float = LANDED_HEIGHT_M  # at the end of the flight
    bearing_rms_deg: float = 0.2  # per vehicle, object and angle, of objects fully in the picture


def judge(flight, failure, limits=None, with_cameras=False, faults=None, namespaces=None):
    """List of reasons why the flight failed; empty when it passed.

    flight: data_extraction.flight_metrics.Flight; failure: why it failed while it was carried out; "" = it did not.
    with_cameras: every vehicle had to measure bearings.  faults: data_extraction.report.faults.Faults of the virtual
    lab, whose outcomes must be safe. A vehicle that a fault may have affected, or whose ladder has left OK since the
    first fault, may be off its course, and may land.  namespaces: {template: namespace}, needed with faults.
    """
    limits = limits or Limits()
    reasons = [failure] if failure else []
    if faults is not None and not failure:  # the failure would name them
        reasons += ["%s %s" % (name, out.reason) for name, out in faults.out.items() if not _may_be_out(name, faults)]
    if faults:
        reasons += unsafe(faults)
    for name, vehicle in flight.vehicles.items():
        suffered = bool(faults) and _suffered(namespaces.get(name, name), faults)
        if not suffered:  # else the outcome says whether it stayed inside the net
            reasons += ["%s: %s" % (name, reason) for reason in _judge_vehicle(vehicle, limits, flight.arena)]
        # references may have ended before the flight did
        height_m = flight.paths[name].values[-1, 2] if name in flight.paths else vehicle.actual_m[-1, 2]
        if (suffered or vehicle.course.any()) and height_m > limits.landed_height_m:
            reasons.append("%s: was still %.2f m up at the end" % (name, height_m))
        if with_cameras and not suffered:
            reasons += ["%s: %s" % (name, reason) for reason in _judge_bearings(name, flight.bearings, limits)]
    return reasons


def unsafe(faults):
    """Yields the unsafe outcomes of data_extraction.report.faults.Faults, as texts."""
    yield from ("fault %s: %s" % (fault.text, fault.outcome) for fault in faults.outcomes if not fault.is_safe)


def never_began(faults, asked, vehicles):
    """Why a flight failed in which fewer faults began than were asked for; "" when no vehicle flew any more.

    vehicles: their number.
    """
    count = asked - len(faults.outcomes)
    if count <= 0 or len(faults.out) >= vehicles:
        return ""
    return "%d of %d faults never began, and vehicles were flying" % (count, asked)


def _suffered(namespace, faults):
    """Whether a fault may have affected a vehicle, or its ladder has left OK since the first fault."""
    if any(fault.is_of(namespace) for fault in faults.outcomes):
        return True
    return faults.left_ok_s.get(namespace, -np.inf) >= faults.outcomes[0].begin_s


def _may_be_out(namespace, faults):
    """Whether faults may explain that a vehicle is out: its own, or those of a neighbour that it had to avoid."""
    out = faults.out[namespace]
    before = [fault for fault in faults.outcomes if fault.begin_s <= out.time_s]
    of_programs = any(fault_settings(fault.name).on_programs for fault in before)
    if not (out.cause in _MAY_FOLLOW or out.cause == OutCause.NODE and of_programs) or not before:
        return False
    return any(fault.is_of(namespace) for fault in before) or namespace in faults.kept_apart


def _judge_bearings(name, bearings, limits):
    targets = bearings.vehicles.get(name, {}).values() if bearings is not None else ()
    judged = [target for target in targets if len(target.judged_deg)]
    if not judged:
        yield "measured no bearing of a landmark that was fully in the picture"
    for target in judged:
        rms_deg = float(np.sqrt((target.judged_deg**2).mean(axis=0)).max())
        if rms_deg > limits.bearing_rms_deg:
            yield "bearings of %s are wrong by %.2f deg RMS, more than %.2f deg" % (
                target.name,
                rms_deg,
                limits.bearing_rms_deg,
            )


def _judge_vehicle(vehicle, limits, arena):
    """Yield why one vehicle failed."""
    if not vehicle.course.any():
        yield "never reached its course"
        return
    if vehicle.settle_s is None:
        yield "never settled on its course"
    else:
        if vehicle.position_rmse_m > limits.position_rmse_m:
            # a growing error means an oscillating loop
            parts = [1e3 * np.sqrt((part**2).mean()) for part in np.array_split(vehicle.error_m[vehicle.judged], 3)]
            text = "RMSE %.0f mm is over %.0f mm (in the three thirds of the course %.0f, %.0f, %.0f mm)"
            yield text % (1e3 * vehicle.position_rmse_m, 1e3 * limits.position_rmse_m, *parts)
        if vehicle.position_max_m > limits.position_max_m:
            yield "largest error %.0f mm is over %.0f mm" % (1e3 * vehicle.position_max_m, 1e3 * limits.position_max_m)
        if vehicle.yaw_rmse_rad > limits.yaw_rmse_rad:
            yield "yaw RMSE %.1f deg is over %.1f deg" % tuple(np.degrees([vehicle.yaw_rmse_rad, limits.yaw_rmse_rad]))
    reach = abs(vehicle.actual_m[:, :2]).max(axis=0)
    if reach[0] > arena.half_x_m - limits.net_margin_m or reach[1] > arena.half_y_m - limits.net_margin_m:
        yield "came closer than %.0f mm to the net" % (1e3 * limits.net_margin_m)
