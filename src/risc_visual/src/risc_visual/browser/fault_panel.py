"""The part of the browser view's panel that injects faults into the virtual lab. No ROS.

It is shown as long as a virtual lab publishes the faults that it knows.
"""

import html
import math
import threading

_CHOSEN, _EACH = "chosen by the lab", "each"


class FaultPanel:
    """Choice of fault, argument and vehicle; active faults; the lab's answer."""

    def __init__(self, server, names, inject):
        """names: of the vehicles.  inject(**fields): a button was pressed; fields of InjectFault; without any: end all.

        Called in a thread of its own.
        """
        self._server, self._names, self._inject = server, names, inject
        self._lock = threading.RLock()  # messages, answers and clicks come in threads of their own
        self._folder, self._kinds, self._answer = None, {}, ("", "")
        self._told, self._began = [], set()  # (class, words) of each fault; ids of those that are or were active

    def offer(self, kinds):
        """Offer the faults that the lab knows (FaultKind of rospy), in place of those before."""
        with self._lock:
            offered = {kind.name: kind for kind in kinds}
            if offered == self._kinds:  # rospy may deliver a latched message twice: choices in the panel stay
                return
            self.close()
            self._kinds = offered
            if self._kinds:
                self._build()

    def _build(self):
        gui = self._server.gui
        self._folder = gui.add_folder("Faults of the virtual lab", expand_by_default=False)
        with self._folder:
            self._fault = gui.add_dropdown("fault", tuple(self._kinds))
            self._about = gui.add_html("")
            self._argument = gui.add_text("argument", "", hint="empty: the default")
            self._vehicle = gui.add_dropdown("vehicle", (_CHOSEN, _EACH, *self._names))
            # other colours than those of the buttons that land
            gui.add_button("inject", color="orange").on_click(lambda _event: self._inject_chosen())
            gui.add_button("end all faults", color="gray").on_click(lambda _event: self._inject())
            self._status = gui.add_html("")
        self._fault.on_update(lambda _event: self._choose())
        self._show_kind()
        self._show_status()

    def close(self):
        """Remove this part from the panel and forget the faults."""
        with self._lock:
            if self._folder is not None:
                self._folder.remove()
            self._folder, self._kinds, self._answer = None, {}, ("", "")
            self._told, self._began = [], set()

    def _inject_chosen(self):
        kind = self._kinds[self._fault.value]
        vehicle = {_CHOSEN: "", _EACH: "*"}.get(self._vehicle.value, self._vehicle.value)
        fields = {"fault": kind.name, "vehicle": vehicle}
        argument = self._argument.value.strip()
        if argument:
            grades = dict(zip(kind.grades, kind.grade_values))
            try:
                fields[kind.argument] = [grades[argument] if argument in grades else float(argument)]
            except ValueError:
                self.note_answer(False, "'%s' is not a number%s" % (argument, "".join(map(" or {}".format, grades))))
                return
        self._inject(**fields)

    def note(self, records):
        """Show the FaultRecords of faults that wait, are active or have just ended."""
        with self._lock:
            self._told = []
            for record in records:
                if record.active:
                    self._began.add(record.id)
                now = "acts" if record.active else "has ended" if record.id in self._began else "waits"
                words = "%s %s" % (_words(record.name, record.args), now)
                self._told.append(("hand" if record.active else "small", words))
            self._show_status()

    def note_answer(self, done, text):
        """Show the lab's answer."""
        with self._lock:
            self._answer = "good" if done else "bad", text
            self._show_status()

    def _choose(self):
        with self._lock:
            if self._fault.value in self._kinds:  # the kinds may have changed since
                self._argument.value = ""
                self._show_kind()

    def _show_kind(self):
        kind = self._kinds[self._fault.value]
        self._vehicle.disabled = not kind.per_vehicle
        if not kind.per_vehicle:
            self._vehicle.value = _CHOSEN
        words = html.escape(kind.summary), html.escape(argument_words(kind))
        self._about.content = _rm('%s<div class="small">argument: %s</div>' % words)

    def _show_status(self):
        if self._folder is None:
            return
        told_as, text = self._answer
        lines = [(told_as, text)] if text else []
        lines += self._told or [("small", "no active faults")]
        content = "".join('<div class="%s">%s</div>' % (shown_as, html.escape(line)) for shown_as, line in lines)
        self._status.content = _rm(content)


def argument_words(kind):
    """Text about the argument of a FaultKind, e.g. "duration 0 to 60 s (default 0.3): mild 0.1, severe 3"."""
    unit = " " + kind.unit if kind.unit else ""
    if kind.least == kind.greatest:
        return "none"
    most = "%g to %g" % (kind.least, kind.greatest) if math.isfinite(kind.greatest) else "from %g" % kind.least
    words = "%s %s%s (default %g)" % (kind.argument.partition("_")[0], most, unit, kind.default_value)
    grades = ", ".join("%s %g" % grade for grade in zip(kind.grades, kind.grade_values))
    return words + (": " + grades if grades else "")


def _words(name, args):
    return ":".join(filter(None, (name, args)))


def _rm(content):
    return '<div class="rm">%s</div>' % content
