"""What the panel of the browser view says of the laboratory, as HTML. No ROS.

Every value has an age: what is silent is said to be silent, with its last word, and never shown as if it were true.
Times are seconds of a clock that never steps.
"""

import html
import math
import threading
from collections import namedtuple

from risc_control.failsafe import FailsafeLevel
from risc_control.vehicles import state_text
from risc_visual.drawing.airframes import vehicle_colour

PAGE_OLD_S = 3.0  # the page itself says that it is old when nothing came for so long
# How long a value stays true [s]. Mode and status come 5 times a second and more, the others once a second.
_TRUE_S = {"mode": 1.0, "vehicle": 1.0, "error_m": 3.0, "mocap": 3.0, "references": 1.5, "operator": 3.0}
_NEVER = float("inf")

# The last rule is the page's own watch: whoever replaces the text in time restarts the animation before it shows.
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
Mocap = namedtuple("Mocap", "rate_hz visible vehicles")  # visible: how many of the vehicles are seen
_Answer = namedtuple("_Answer", "done text")


class BrowserPanel:
    """The panel of the page: the button that lands all, those that land one, and the status."""

    def __init__(self, server, names, land_all, land_one):
        """names: of the vehicles; land_all(), land_one(name): called in a thread of its own for a button pressed."""
        gui = server.gui
        gui.set_panel_label("RISC MAAP")
        gui.main_panel.dock_right()
        gui.add_html(PAGE_STYLE)
        button = gui.add_button("LAND ALL", color="red", hint="Every vehicle lands where it is, whoever flies it")
        button.on_click(lambda _event: land_all())
        self.status = gui.add_html("")
        for name in names:  # a button each: one for several may say another vehicle by the time it is asked
            gui.add_button("land %s" % name).on_click(lambda _event, name=name: land_one(name))


class LiveStatus:
    """The newest of everything the panel shows. Values are noted in several threads, each replaced as a whole."""

    def __init__(self, vehicles):
        """vehicles: list of `Vehicle`."""
        self._vehicles = vehicles
        self._heard = {}  # (what, whose) -> (value, when [s])
        self._asked_at = ""  # time of day of the last press on a land button
        self._answers = {}  # who was asked -> _Answer, None before it has come
        self._answers_lock = threading.Lock()

    def note(self, what, whose, value, now_s):
        """Something was heard: "mode" (autonomous?), "vehicle" (VehicleStatus), "safety" (Verdict), "error_m" of a
        vehicle by its namespace; "course" (phase) of one by its template; "mocap" (`Mocap`), "references" and
        "operator" (text of its phase) of "".
        """
        self._heard[what, whose] = (value, now_s)

    def note_asked(self, names, time_of_day):
        """Somebody has pressed a land button: these vehicles are asked to land."""
        with self._answers_lock:
            self._asked_at, self._answers = time_of_day, dict.fromkeys(names)

    def note_answer(self, name, done, text):
        """What became of it."""
        with self._answers_lock:
            self._answers[name] = _Answer(done, text)

    def forget(self):
        """Nobody has listened for a while: nothing is known. Answers stay."""
        self._heard = {}

    def html(self, now_s, time_of_day):
        """The panel's content now."""
        parts = [self._answers_html()]
        parts += [self._vehicle_html(vehicle, now_s) for vehicle in self._vehicles]
        parts += [self._laboratory_html(now_s)]
        parts += ['<div class="small">as of %s</div>' % time_of_day]
        parts += ['<div class="page-old">NO NEWS FOR %g s: WHAT YOU SEE IS OLD</div>' % PAGE_OLD_S]
        return '<div class="rm">%s</div>' % "".join(parts)

    def _age_s(self, what, whose, now_s):
        return now_s - self._heard[what, whose][1] if (what, whose) in self._heard else _NEVER

    def _told(self, what, whose, now_s, text):
        """A value by its `text` (value -> HTML) while it is true, else that it is silent, and its last word."""
        age_s = self._age_s(what, whose, now_s)
        if age_s <= _TRUE_S[what]:
            return text(self._heard[what, whose][0])
        name = {"mode": "vehicle node", "mocap": "motion capture"}.get(what, what)
        if math.isinf(age_s):
            return '<span class="silent">%s: nothing heard</span>' % name
        old = '<span class="old">%s</span>' % text(self._heard[what, whose][0])
        return '<span class="silent">%s silent for %.0f s</span> %s' % (name, age_s, old)

    def _answers_html(self):
        with self._answers_lock:
            asked_at, answers = self._asked_at, dict(self._answers)
        if not answers:
            return ""
        parts = ['<div class="small">landing asked for at %s</div>' % asked_at]
        for name, answer in answers.items():
            told_as = "small" if answer is None else "good" if answer.done else "bad"
            text = "asked" if answer is None else answer.text
            parts.append('<div class="%s">%s: %s</div>' % (told_as, html.escape(name), html.escape(text)))
        return "".join(parts)

    def _vehicle_html(self, vehicle, now_s):
        name = vehicle.namespace
        title = "<b>%s</b> %s" % (html.escape(name), html.escape(vehicle.template))
        lines = ["%s, %s" % (title, self._told("mode", name, now_s, _mode_html))]
        if self._age_s("mode", name, now_s) <= _TRUE_S["mode"]:  # who says the mode, says the safety, when it changes
            safety = self._heard.get(("safety", name), (None, 0.0))[0]
            good = safety is None or safety.level == FailsafeLevel.OK
            text = html.escape(safety.text) if safety else "?"
            lines.append('<span class="%s">safety: %s</span>' % ("good" if good else "bad", text))
        lines += [self._told("vehicle", name, now_s, _status_html), self._way_html(vehicle, now_s)]
        colour = "rgb(%d, %d, %d)" % tuple(255.0 * part for part in vehicle_colour(vehicle.index))
        return '<div class="vehicle" style="border-color: %s">%s</div>' % (colour, "<br/>".join(lines))

    def _way_html(self, vehicle, now_s):
        """Where it is on its way, and how far from its reference, as far as somebody says so."""
        found = []
        if self._age_s("references", "", now_s) <= _TRUE_S["references"]:
            course = self._heard.get(("course", vehicle.template), ("", 0.0))[0]
            found += [html.escape(course)] if course else []
            error_m = self._heard.get(("error_m", vehicle.namespace), (math.nan, 0.0))[0]
            if self._age_s("error_m", vehicle.namespace, now_s) <= _TRUE_S["error_m"] and math.isfinite(error_m):
                found.append("%.0f mm from its reference" % (1e3 * error_m))
        return ", ".join(found) or '<span class="small">no reference</span>'

    def _laboratory_html(self, now_s):
        mocap = self._told("mocap", "", now_s, _mocap_html)
        lines = [mocap if mocap.startswith("<span") else "motion capture %s" % mocap]
        if ("operator", "") in self._heard:
            text = html.escape(self._heard["operator", ""][0])
            if self._age_s("operator", "", now_s) <= _TRUE_S["operator"]:
                lines.append("operator: %s" % text)
            else:
                lines.append('<span class="silent">operator silent</span> <span class="old">%s</span>' % text)
        return "".join("<div>%s</div>" % line for line in lines)


def _mode_html(autonomous):
    return '<span class="%s">%s</span>' % (("good", "autonomous") if autonomous else ("hand", "manual"))


def _status_html(status):
    battery = "not known" if math.isnan(status.battery_pct) else "%.0f %%" % status.battery_pct
    return "%s, battery %s" % (state_text(status.state), battery)


def _mocap_html(mocap):
    return "%.0f Hz, %d of %d seen" % mocap
