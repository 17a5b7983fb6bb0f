"""Content of the browser view's panel, as HTML. No ROS.

Every value has an age: a silent source is shown as silent, with its last value, and never as if it were current.
Times are seconds of a monotonic clock.
"""

import html
import math
from collections import namedtuple

from risc_control.safety import FailsafeLevel
from risc_control.vehicles import state_text
from risc_visual.drawing.palette import vehicle_colour

PAGE_OLD_S = 3.0  # the page itself says that it is old when nothing came for this long
# How long a value stays valid [s]. Mode and status come 5 times a second and more, what changes seldom comes once, the
# others once a second.
_TRUE_S = {"mode": 1.0, "vehicle": 1.0, "error_m": 3.0, "mocap": 3.0, "references": 1.5, "operator": 3.0}
_TRUE_S.update(safety=math.inf, course=math.inf, refusals=math.inf)
_SOURCES = {"mode": "vehicle node", "mocap": "motion capture"}  # who sends it; of others, its name

# The rules of page-old are the page's watchdog: replacing the text in time restarts the animation before it shows.
PAGE_STYLE = (
    """<style>
.rm { font-size: 0.85em; line-height: 1.45; padding: 0 0.8em 0.4em; }
.rm .vehicle { border-left: 0.35em solid; padding: 0.1em 0 0.1em 0.6em; margin: 0.5em 0; }
.rm .good { color: #6d6; } .rm .hand { color: #fa5; } .rm .bad { color: #f66; font-weight: bold; }
.rm .old { color: #999; text-decoration: line-through; } .rm .silent { color: #fb3; font-weight: bold; }
.rm .small { color: #aaa; font-size: 0.9em; }
.rm .page-old { visibility: hidden; max-height: 0; color: #fff; background: #c00; font-weight: bold;
  text-align: center; animation: rm-old 0s linear %gs forwards; }
@keyframes rm-old { to { visibility: visible; max-height: 5em; padding: 0.4em; } }
div:has(> .rm-land) + div button { height: 3.4em !important; font-size: 1.25em; letter-spacing: 0.05em; }
</style><span class="rm-land"></span>"""
    % PAGE_OLD_S
)

Vehicle = namedtuple("Vehicle", "namespace template index")  # index: of its colour


class BrowserPanel:
    """The panel of the page: the button that lands all, those that land one, and the status."""

    def __init__(self, server, names, land_all, land_one):
        """names: of the vehicles; land_all(), land_one(name): called in a thread of its own by a button."""
        gui = server.gui
        gui.set_panel_label("RISC MAAP")
        gui.main_panel.dock_right()
        gui.add_html(PAGE_STYLE)
        button = gui.add_button("LAND ALL", color="red", hint="Every vehicle lands where it is, even if flown by hand")
        button.on_click(lambda _event: land_all())
        self.status = gui.add_html("")
        for name in names:  # a button each: a chooser may show another vehicle by the time it is read
            gui.add_button("land %s" % name).on_click(lambda _event, name=name: land_one(name))


class LiveStatus:
    """The newest value of everything the panel shows. Values are noted in several threads, each replaced as a whole."""

    def __init__(self, vehicles):
        """vehicles: list of `Vehicle`."""
        self._vehicles = vehicles
        self._heard = {}  # (what, whose) -> (value, when [s])
        self._asked = ("", {})  # time of day of the last press on a land button; who was asked -> (class, text)

    def note(self, what, whose, value, now_s):
        """Note a value: "mode" (autonomous?), "vehicle" (VehicleStatus), "safety" (Verdict), "refusals"
        (TakeoffRefusals) of a vehicle by its namespace; "course" (phase), "error_m" of one by its template; "mocap"
        (EstimatorStatus), "references" and "operator" (text of its phase) of "".
        """
        self._heard[what, whose] = (value, now_s)

    def note_asked(self, names, time_of_day):
        """A land button was pressed: these vehicles are asked to land."""
        self._asked = time_of_day, dict.fromkeys(names, ("small", "asked"))

    def note_answer(self, name, done, text):
        """Note the answer of a vehicle, or of the operator, to the request to land."""
        self._asked[1][name] = ("good" if done else "bad", text)

    def forget(self):
        """Forget all values, since nothing was subscribed to for a while. Answers stay."""
        self._heard = {}

    def html(self, now_s, time_of_day):
        """The panel's content now."""
        parts = [self._answers_html()]
        parts += [self._vehicle_html(vehicle, now_s) for vehicle in self._vehicles]
        parts += ["<div>%s</div>" % self._told("mocap", "", now_s, _mocap_words, "motion capture ")]
        if ("operator", "") in self._heard:
            parts += ["<div>%s</div>" % self._told("operator", "", now_s, html.escape, "operator: ")]
        parts += ['<div class="small">as of %s</div>' % time_of_day]
        parts += ['<div class="page-old">NO UPDATE FOR %g s: WHAT YOU SEE IS OLD</div>' % PAGE_OLD_S]
        return '<div class="rm">%s</div>' % "".join(parts)

    def _news(self, what, whose, now_s):
        """A value; None when it was never received or is no longer valid."""
        value, heard_s = self._heard.get((what, whose), (None, -math.inf))
        return value if now_s - heard_s <= _TRUE_S[what] else None

    def _told(self, what, whose, now_s, words, lead=""):
        """words(value), as HTML, while the value is valid; else that its source is silent, and its last value."""
        value, heard_s = self._heard.get((what, whose), (None, -math.inf))
        if now_s - heard_s <= _TRUE_S[what]:
            return lead + words(value)
        source = _SOURCES.get(what, what)
        if math.isinf(heard_s):
            return _span("silent", source + ": nothing heard")
        silence = _span("silent", "%s silent for %.0f s" % (source, now_s - heard_s))
        return "%s %s" % (silence, _span("old", words(value)))

    def _answers_html(self):
        asked_at, answers = self._asked
        answers = dict(answers)  # more may come meanwhile
        if not answers:
            return ""
        parts = ['<div class="small">landing requested at %s</div>' % asked_at]
        for name, (told_as, text) in answers.items():
            parts.append('<div class="%s">%s: %s</div>' % (told_as, html.escape(name), html.escape(text)))
        return "".join(parts)

    def _vehicle_html(self, vehicle, now_s):
        name = vehicle.namespace
        title = "<b>%s</b> %s" % (html.escape(name), html.escape(vehicle.template))
        lines = ["%s, %s" % (title, self._told("mode", name, now_s, _mode_words))]
        if self._news("mode", name, now_s) is not None:  # the node that sends the mode sends the safety on change
            safety = self._news("safety", name, now_s)
            good = safety is None or safety.level == FailsafeLevel.OK
            lines.append(_span("good" if good else "bad", "safety: " + (html.escape(safety.text) if safety else "?")))
            refusals = self._news("refusals", name, now_s)
            reasons = refusals.reasons if refusals else ()
            lines += [_span("bad", "take-off refused: " + html.escape(reason)) for reason in reasons]
        lines += [self._told("vehicle", name, now_s, _status_words), self._way_html(vehicle, now_s)]
        colour = "rgb(%d, %d, %d)" % tuple(255.0 * part for part in vehicle_colour(vehicle.index))
        return '<div class="vehicle" style="border-color: %s">%s</div>' % (colour, "<br/>".join(lines))

    def _way_html(self, vehicle, now_s):
        """Phase on its course, and distance from its reference, where known."""
        found = []
        if self._news("references", "", now_s):
            found = [html.escape(self._news("course", vehicle.template, now_s) or "")]
            error_m = self._news("error_m", vehicle.template, now_s)
            if error_m is not None and math.isfinite(error_m):
                found.append("%.0f mm from its reference" % (1e3 * error_m))
        return ", ".join(filter(None, found)) or _span("small", "no reference")


def _span(kind, text):
    return '<span class="%s">%s</span>' % (kind, text)


def _mode_words(autonomous):
    return _span("good", "autonomous") if autonomous else _span("hand", "manual")


def _status_words(status):
    battery = "not known" if math.isnan(status.battery_pct) else "%.0f %%" % status.battery_pct
    return "%s, battery %s" % (state_text(status.state), battery)


def _mocap_words(status):
    return "%.0f Hz, %d of %d seen" % (status.rate_hz, status.visible, status.vehicles)
