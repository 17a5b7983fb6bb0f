"""risc_visual.browser.live_status: the texts of the panel, with a simulated clock."""

import math
import re
import sys
import threading
import xml.etree.ElementTree as ET
from collections import namedtuple

import pytest

from risc_control.safety import FailsafeLevel, Verdict
from risc_visual.browser.live_status import PAGE_OLD_S, PAGE_STYLE, LiveStatus, Vehicle

FLYING = 3
Report = namedtuple("Report", "state battery_pct")  # as a VehicleStatus
Mocap = namedtuple("Mocap", "rate_hz visible vehicles")  # as an EstimatorStatus
Refusals = namedtuple("Refusals", "reasons")  # as a TakeoffRefusals


class Panel:
    """The panel of two vehicles that receives everything, except what the test cuts off."""

    def __init__(self):
        self.status = LiveStatus([Vehicle("risc1", "fluffy_II", 0), Vehicle("risc2", "albatross", 1)])
        self.values = {("operator", ""): "fly: on course for 30 s", ("references", ""): True}
        self.values["mocap", ""] = Mocap(200.0, 2, 2)
        for name, template in (("risc1", "fluffy_II"), ("risc2", "albatross")):
            self.values["mode", name] = True
            self.values["vehicle", name] = Report(FLYING, 87.0)
            self.values["safety", name] = Verdict(FailsafeLevel.OK, "")
            self.values["error_m", template] = 0.0234
            self.values["course", template] = "course"
        self.now_s = 300.0

    def hear(self):
        for (what, whose), value in self.values.items():
            self.status.note(what, whose, value, self.now_s)
        return self

    def tree(self):
        return ET.fromstring(self.status.html(self.now_s, "20:14:05"))

    def text(self):
        """All visible text, vehicles first."""
        return " ".join("".join(self.tree().itertext()).split())

    def vehicle(self, number):
        """Visible text of one vehicle."""
        block = [item for item in self.tree() if item.get("class") == "vehicle"][number]
        return " | ".join(text.strip() for text in block.itertext() if text.strip())

    def told_as(self, class_name):
        return [item.text for item in self.tree().iter() if item.get("class") == class_name]


def test_why_a_take_off_was_refused_stays_until_it_takes_off():
    panel = Panel()
    panel.values["refusals", "risc2"] = Refusals(["it stands 0.3 m from <Raven>", "battery"])
    first, second = panel.hear().told_as("bad")
    assert "it stands 0.3 m from <Raven>" in first and "battery" in second
    panel.values["refusals", "risc2"] = Refusals([])
    assert panel.hear().told_as("bad") == []


def test_a_flight_in_which_all_is_well():
    panel = Panel().hear()
    assert panel.vehicle(0) == (
        "risc1 | fluffy_II, | autonomous | safety: ok | flying, battery 87 % | course, 23 mm from its reference"
    )
    assert "motion capture 200 Hz, 2 of 2 seen" in panel.text()
    assert "operator: fly: on course for 30 s" in panel.text()
    assert "as of 20:14:05" in panel.text()
    assert panel.told_as("silent") == panel.told_as("old") == panel.told_as("bad") == []


def test_before_anything_was_heard_nothing_is_claimed():
    panel = Panel()
    assert panel.vehicle(1) == (
        "risc2 | albatross, | vehicle node: nothing heard | vehicle: nothing heard | no reference"
    )
    assert "motion capture: nothing heard" in panel.text()
    assert "operator" not in panel.text(), "a laboratory with real joysticks has none"


@pytest.mark.parametrize(
    "silent, says, was",
    [
        (("mode", "risc1"), "vehicle node silent for 5 s", "autonomous"),
        (("vehicle", "risc1"), "vehicle silent for 5 s", "flying, battery 87 %"),
        (("mocap", ""), "motion capture silent for 5 s", "200 Hz, 2 of 2 seen"),
        (("operator", ""), "operator silent for 5 s", "fly: on course for 30 s"),
    ],
)
def test_what_is_silent_is_said_to_be_so(silent, says, was):
    panel = Panel().hear()
    del panel.values[silent]
    panel.now_s += 5.0
    panel.hear()
    assert panel.told_as("silent") == [says]
    old = [item for item in panel.tree().iter() if item.get("class") == "old"]
    assert ["".join(item.itertext()) for item in old] == [was]


def test_without_its_vehicle_node_there_is_no_word_on_safety():
    panel = Panel().hear()
    panel.now_s += 5.0
    assert "safety" not in panel.vehicle(0)


def test_errors_and_phases_of_a_silent_trajectory_are_not_shown():
    panel = Panel().hear()
    del panel.values["references", ""]
    panel.now_s += 5.0
    panel.hear()
    assert panel.vehicle(0).endswith("no reference")


def test_an_error_that_is_none_is_not_shown():
    panel = Panel()
    panel.values["error_m", "fluffy_II"] = math.nan
    assert panel.hear().vehicle(0).endswith("| course")


def test_the_failsafe_level_and_its_reason_stand_out():
    panel = Panel()
    panel.values["safety", "risc2"] = Verdict(FailsafeLevel.LAND, "landing was requested")
    panel.values["mode", "risc2"] = False
    panel.hear()
    assert panel.told_as("bad") == ["safety: land: landing was requested"]
    assert panel.told_as("hand") == ["manual"]


def test_answers_to_a_landing_are_shown_good_or_bad():
    panel = Panel().hear()
    panel.status.note_asked(["risc1", "risc2"], "20:13:59")
    assert "landing requested at 20:13:59" in panel.text()
    assert {"risc1: asked", "risc2: asked"} <= set(panel.told_as("small"))
    panel.status.note_answer("risc1", True, "landing (landing was requested)")
    panel.status.note_answer("risc2", False, "no answer within 3 s")
    assert panel.told_as("bad") == ["risc2: no answer within 3 s"]
    assert "risc1: landing (landing was requested)" in panel.told_as("good")
    panel.status.forget()
    assert panel.told_as("bad") == ["risc2: no answer within 3 s"] and "autonomous" not in panel.text()
    panel.status.note_answer("risc2", True, "landing (landing was requested)")
    assert panel.told_as("bad") == [], "it has answered after all"
    panel.status.note_asked(["risc2"], "20:14:30")
    assert "risc1:" not in panel.text()


def test_no_answer_is_lost_when_several_come_at_once():
    """Each button and each vehicle answers in a thread of its own."""
    panel = Panel().hear()
    names = ["risc%d" % number for number in range(2000)]
    panel.status.note_asked(names, "20:13:59")
    interval_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:

        def answer(part):
            for name in part:
                panel.status.note_answer(name, True, "landing")

        threads = [threading.Thread(target=answer, args=(names[k::4],)) for k in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(interval_s)
    assert len(panel.told_as("good")) >= len(names) and panel.text().count(": asked") == 0


def test_texts_from_outside_are_no_html():
    panel = Panel()
    panel.values["safety", "risc1"] = Verdict(FailsafeLevel.HOLD, "<script>alert(1)</script>")
    panel.values["operator", ""] = "<b>&"
    panel.hear()
    panel.status.note_answer("<i>", False, "<i>")
    assert not {"script", "i"} & {item.tag for item in panel.tree().iter()}
    assert "<script>alert(1)</script>" in panel.text()


def test_a_state_without_a_name():
    panel = Panel()
    panel.values["vehicle", "risc1"] = Report(77, 50.0)
    assert "not known, battery 50 %" in panel.hear().vehicle(0)


def test_the_page_says_by_itself_that_it_is_old():
    """The note's animation ends with the note visible; every new text of the panel restarts it."""
    panel = Panel().hear()
    assert [" 3 s" in text for text in panel.told_as("page-old")] == [True]
    assert re.search(r"page-old \{[^}]*hidden;[^}]*animation: [^;}]* %gs" % PAGE_OLD_S, PAGE_STYLE)
    assert panel.status.html(panel.now_s, "20:14:05") != panel.status.html(panel.now_s, "20:14:06")
