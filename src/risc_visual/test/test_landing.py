"""risc_visual.browser.landing: asking several at once."""

import threading
import time

from risc_visual.browser.landing import ask_all


class Told:
    """The reports, in order."""

    def __init__(self):
        self.all = []

    def __call__(self, name, done, text):
        self.all.append((name, done, text))

    def wait_for(self, count):
        deadline_s = time.monotonic() + 30.0
        while len(self.all) < count:
            assert time.monotonic() < deadline_s
            time.sleep(0.01)

    def by_name(self):
        return {name: (done, text) for name, done, text in self.all}


def test_all_are_asked_at_the_same_time():
    meeting = threading.Barrier(3, timeout=20.0)  # no thread passes before all three are there
    told = Told()

    def question(name):
        meeting.wait()
        return True, "landing " + name

    names = ("risc1", "risc2", "risc3")
    ask_all({name: lambda name=name: question(name) for name in names}, 30.0, told)
    told.wait_for(3)
    assert told.by_name() == {name: (True, "landing " + name) for name in names}
    assert len(told.all) == 3


def test_who_is_silent_has_failed_and_holds_up_nobody_until_it_answers_after_all():
    wakes, told = threading.Event(), Told()
    ask_all({"risc1": lambda: (wakes.wait(60.0), "landing"), "risc2": lambda: (True, "landing")}, 0.5, told)
    told.wait_for(2)
    assert told.all == [("risc2", True, "landing"), ("risc1", False, "no answer within 0.5 s")]
    wakes.set()
    told.wait_for(3)
    assert told.all[2] == ("risc1", True, "landing")


def test_an_error_is_an_answer_that_is_not_good():
    told = Told()

    def broken():
        raise OSError("gone")

    ask_all({"risc1": broken, "risc2": lambda: (True, "landing")}, 30.0, told)
    told.wait_for(2)
    assert told.by_name() == {"risc1": (False, "OSError: gone"), "risc2": (True, "landing")}
