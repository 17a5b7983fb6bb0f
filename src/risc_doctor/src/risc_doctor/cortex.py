"""Motion capture: does the host answer, is it live, and does it agree with the fleet and the templates?"""

import math

from risc_doctor import axes
from risc_doctor.findings import RED, YELLOW, Findings
from risc_doctor.interfaces import is_loopback

_SLOW = 0.9  # of the expected rate: less is reported
_MUCH_TOO_SLOW = 0.25  # ... and less than this gives no velocities
_LOST, _MUCH_LOST = 0.01, 0.1  # fraction of the frames
Z = 2


def check(situation):
    """The host's identity and units, and the rate and loss of its stream."""
    return judge(situation.fleet.mocap, situation.cortex())


def judge(mocap, report):
    """Findings from a cortex_probe.CortexReport."""
    found, place = Findings("cortex"), "%s:%d" % (mocap.host, mocap.command_port)
    if report.error:
        code = "no_lab" if is_loopback(mocap.host) else "refused" if report.refused else "silent"
        return found.say(code, place=place, error=report.error, port=mocap.command_port)
    version = ".".join(map(str, report.identity.version[1:]))
    found.say("answers", name=report.identity.name, version=version, place=place)
    if report.mm_per_unit is not None and not math.isclose(report.mm_per_unit, 1.0, rel_tol=1e-3):
        found.say("units", mm=report.mm_per_unit)
    if report.up_axis not in (None, Z):
        found.say("up", axis="xyz"[report.up_axis % 3])
    stream = "%s:%d" % (mocap.stream_group, mocap.stream_port)
    if len(report.frames) > 1:
        _judge_stream(mocap, report, found)
    elif report.live and report.listeners and not report.stream_error:
        found.say("sent_to_others", stream=stream, listeners=", ".join(report.listeners))
    elif report.live:
        found.say("no_stream", why=report.stream_error or "nothing arrives on " + stream)
    else:
        found.say("not_live")
    return found


def _judge_stream(mocap, report, found):
    set_right = bool(report.told_rate_hz) and abs(report.told_rate_hz - mocap.rate_hz) <= 0.01 * mocap.rate_hz
    set_to = "; Cortex is set to %g Hz" % report.told_rate_hz if report.told_rate_hz and not set_right else ""
    code, level = "rate", None
    if not _SLOW * mocap.rate_hz <= report.rate_hz <= mocap.rate_hz / _SLOW:
        level = RED if report.rate_hz < _MUCH_TOO_SLOW * mocap.rate_hz else YELLOW
        code = "rate_not_kept" if set_right else "rate_wrong"
    found.say(code, level, rate_hz=report.rate_hz, set_to=set_to, wanted_hz=mocap.rate_hz, lost=report.lost)
    if report.lost > _LOST:
        found.say("lost", RED if report.lost > _MUCH_LOST else YELLOW, percent=100.0 * report.lost)
    if report.malformed:
        found.say("malformed", count=report.malformed, port=mocap.stream_port)


def check_templates(situation):
    """The names that Cortex announces against the fleet and the marker templates."""
    report = situation.cortex()
    if report.error or report.bodies is None:
        return Findings("templates").say("no_cortex" if report.error else "no_bodies")
    return judge_templates(situation.fleet, situation.templates(), report.bodies)


def judge_templates(fleet, templates, bodies):
    """Findings. bodies: of the host (cortex_ros.wire.BodyDef)."""
    found, problems, good = Findings("templates"), Findings("templates"), 0
    announced = {body.name: len(body.marker_names) for body in bodies}
    needed = {v.template: "vehicle '%s' of %s" % (v.template, v.namespace) for v in fleet.vehicles}
    for vehicle in fleet.vehicles:
        if vehicle.template not in templates:
            known = ", ".join(sorted(templates))
            problems.say("not_ours", name=vehicle.template, namespace=vehicle.namespace, known=known)
    for name, what in {**needed, **{mark.name: "landmark '%s'" % mark.name for mark in fleet.landmarks}}.items():
        if name not in announced:
            similar = next((other for other in announced if _squeezed(other) == _squeezed(name)), "")
            known, level = ", ".join(sorted(announced)) or "none", RED if name in needed else YELLOW
            code = "misspelt" if similar else "not_in_cortex"
            problems.say(code, level, what=what, name=name, similar=similar, known=known)
    for name, count in sorted(announced.items()):
        if name not in templates:
            problems.say("ignored", name=name)
        elif count != len(templates[name].marker_names):
            here = len(templates[name].marker_names)
            problems.say("other_count", RED if name in needed else YELLOW, name=name, there=count, here=here)
        else:
            good += 1
    if good:
        found.say("agree", good=good, count=len(announced))
    return found + problems


def _squeezed(name):
    return "".join(letter for letter in name.lower() if letter.isalnum())


def check_axes(situation):
    """Without moving anything: are size, handedness, up direction and position of the bodies plausible?"""
    report, found = situation.cortex(), Findings("axes")
    if report.error or not report.shown():
        return found.say("no_cortex" if report.error else "no_frame")
    if not report.live:
        return found.say("not_live")
    marker_sets = {}
    for frame in report.shown():
        for body in frame.bodies:
            marker_sets.setdefault(body.name, []).append(body.markers_mm * report.metres_per_unit)
    return axes.judge_poses(situation.fleet, situation.templates(), marker_sets)
