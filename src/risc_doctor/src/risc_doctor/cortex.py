"""Motion capture: is the host there and live, and does it know what the fleet and the templates know?"""

import math

from risc_doctor import axes
from risc_doctor.findings import green, red, yellow
from risc_doctor.interfaces import is_loopback
from risc_doctor.situation import START_THE_VIRTUAL_LAB

_SLOW = 0.9  # of the expected rate: less is worth a word
_MUCH_TOO_SLOW = 0.25  # ... and less than this gives no velocities
_LOST, _MUCH_LOST = 0.01, 0.1  # fraction of the frames
Z = 2


def check(situation):
    """Who is the host, and does the stream come: rate, loss, units."""
    return judge(situation.fleet.mocap, situation.cortex())


def judge(mocap, report):
    """Findings from a cortex_probe.CortexReport."""
    say, place = "cortex", "%s:%d" % (mocap.host, mocap.command_port)
    if report.error:
        if is_loopback(mocap.host):
            cure = START_THE_VIRTUAL_LAB
        elif report.refused:
            cure = "start Cortex there and switch its SDK server on, or correct mocap command_port in the fleet file"
        else:
            cure = (
                "is that computer on, in this network, and does its firewall let udp %d in? If it is elsewhere,"
                " correct the fleet file" % mocap.command_port
            )
        return [red(say, "no answer from Cortex at %s: %s" % (place, report.error), cure)]
    version = ".".join(map(str, report.identity.version[1:]))
    findings = [green(say, "%s %s answers at %s" % (report.identity.name, version, place))]
    findings += _units(report)
    if len(report.frames) > 1:
        return findings + _stream(mocap, report)
    if report.live and report.listeners and not report.stream_error:
        findings.append(
            yellow(
                say,
                "Cortex is live. Nothing comes to the group %s:%d; if it sends to this computer alone, %s has that"
                % (mocap.stream_group, mocap.stream_port, ", ".join(report.listeners)),
                "see `graph` for what stream_markers makes of it; if that is nothing: is multicast switched on in"
                " Cortex, with this group and port?",
            )
        )
        return findings
    if report.live:
        why = report.stream_error or "nothing comes in on %s:%d" % (mocap.stream_group, mocap.stream_port)
        findings.append(
            yellow(
                say,
                "Cortex is live, but its stream does not come (%s): frames are polled, later and fewer" % why,
                "is multicast switched on in Cortex, with this group and port? A firewall here (sudo nft list ruleset)"
                " or a switch with IGMP snooping may block it; see `multicast` and `ports`",
            )
        )
        return findings
    findings.append(
        yellow(
            say,
            "Cortex answers but sends no new frames: it is not in live mode",
            "stream_markers asks for it when it starts; to see frames now: ./maap doctor --live, or Run in Cortex",
        )
    )
    return findings


def _units(report):
    findings = []
    if report.mm_per_unit is not None and not math.isclose(report.mm_per_unit, 1.0, rel_tol=1e-3):
        text = "Cortex counts in units of %g mm; stream_markers converts them" % report.mm_per_unit
        findings.append(yellow("cortex", text, "set Cortex to millimetres: other programs may not ask"))
    if report.up_axis not in (None, Z):
        findings.append(
            red(
                "cortex",
                "Cortex says that its %s axis points up; the nodes need z" % "xyz"[report.up_axis % 3],
                "calibrate Cortex with z up (its L-frame), as nothing turns the axes here",
            )
        )
    return findings


def _stream(mocap, report):
    say, findings = "cortex", []
    rate_hz, text = report.rate_hz, "frames come at %.0f Hz" % report.rate_hz
    data = {"rate_hz": rate_hz, "lost": report.lost}
    set_right = bool(report.told_rate_hz) and abs(report.told_rate_hz - mocap.rate_hz) <= 0.01 * mocap.rate_hz
    if report.told_rate_hz and not set_right:
        text += "; Cortex is set to %g Hz" % report.told_rate_hz
    if rate_hz < _SLOW * mocap.rate_hz or rate_hz > mocap.rate_hz / _SLOW:
        level = red if rate_hz < _MUCH_TOO_SLOW * mocap.rate_hz else yellow
        cure = "set the camera rate in Cortex to %g Hz, or rate_hz in the fleet file" % mocap.rate_hz
        if set_right:
            cure = "Cortex is set to that: is its computer overloaded, or this one (`load`), or the network?"
        findings.append(level(say, "%s, the fleet expects %g Hz" % (text, mocap.rate_hz), cure, **data))
    else:
        findings.append(green(say, text, **data))
    if report.lost > _LOST:
        findings.append(
            (red if report.lost > _MUCH_LOST else yellow)(
                say,
                "%.0f %% of the frames are lost on the way" % (100.0 * report.lost),
                "use a cable instead of Wi-Fi to the Cortex network; end what loads this computer or its network",
            )
        )
    if report.malformed:
        text = "%d packets were not sound" % report.malformed
        findings.append(yellow(say, text, "is something else sending to udp %d?" % mocap.stream_port))
    return findings


def check_templates(situation):
    """The names that Cortex announces against the fleet and the marker templates."""
    report = situation.cortex()
    if report.error or report.bodies is None:
        if report.error:
            return [yellow("templates", "cannot be compared: Cortex does not answer", "see `cortex`")]
        text = "cannot be compared: Cortex names no bodies"
        return [yellow("templates", text, "load the template list (properties file) in Cortex")]
    return judge_templates(situation.fleet, situation.templates(), report.bodies)


def judge_templates(fleet, templates, bodies):
    """Findings. bodies: of the host (cortex_ros.wire.BodyDef)."""
    say, findings = "templates", []
    announced = {body.name: len(body.marker_names) for body in bodies}
    needed = [(vehicle.template, vehicle.namespace, "vehicle") for vehicle in fleet.vehicles]
    needed += [(landmark.name, "", "landmark") for landmark in fleet.landmarks]
    for name, namespace, kind in needed:
        if kind == "vehicle" and name not in templates:
            findings.append(
                red(
                    say,
                    "template '%s' of %s is not in templates.yaml" % (name, namespace),
                    "add its markers to risc_lab/config/templates.yaml, or correct the fleet file: known are %s"
                    % ", ".join(sorted(templates)),
                )
            )
        if name not in announced:
            similar = [other for other in announced if _squeezed(other) == _squeezed(name)]
            findings.append(
                (red if kind == "vehicle" else yellow)(
                    say,
                    "Cortex does not know %s '%s'%s" % (kind, name, " of %s" % namespace if namespace else ""),
                    "rename '%s' in Cortex to '%s': names count letter by letter" % (similar[0], name)
                    if similar
                    else "load the template in Cortex, or correct the fleet file: Cortex has %s"
                    % (", ".join(sorted(announced)) or "none"),
                )
            )
    vehicles = {vehicle.template for vehicle in fleet.vehicles}
    good = 0
    for name, count in sorted(announced.items()):
        if name not in templates:
            text = "Cortex shows '%s', which templates.yaml does not know: it is ignored" % name
            cure = "add it to risc_lab/config/templates.yaml, or switch it off in Cortex"
            findings.append(yellow(say, text, cure))
        elif count != len(templates[name].marker_names):
            findings.append(
                (red if name in vehicles else yellow)(
                    say,
                    "'%s' has %d markers in Cortex and %d in templates.yaml"
                    % (name, count, len(templates[name].marker_names)),
                    "make the two agree, marker by marker, in the same order",
                )
            )
        else:
            good += 1
    if good:
        findings.insert(0, green(say, "%d of %d bodies are as templates.yaml has them" % (good, len(announced))))
    return findings


def _squeezed(name):
    return "".join(letter for letter in name.lower() if letter.isalnum())


def check_axes(situation):
    """Without moving anything: are size, handedness, up and place of the bodies what they should be?"""
    report = situation.cortex()
    if report.error or not report.shown():
        text = "cannot be judged: " + ("Cortex does not answer" if report.error else "no frame came")
        return [yellow("axes", text, "see `cortex`")]
    if not report.live:
        text = "cannot be judged: Cortex is not live, so the only frame may be old"
        return [yellow("axes", text, "./maap doctor --live, or --axes VEHICLE to move a vehicle by hand")]
    marker_sets = {}
    for frame in report.shown():
        for body in frame.bodies:
            marker_sets.setdefault(body.name, []).append(body.markers_mm * report.metres_per_unit)
    return axes.judge_poses(situation.fleet, situation.templates(), marker_sets)
