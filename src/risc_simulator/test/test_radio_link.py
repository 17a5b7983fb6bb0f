"""The command link: newest per slot, exact arrival times, events that are never lost."""

import numpy as np
import pytest

from risc_simulator.models.radio_link import RadioLink


def test_newest_of_each_slot_arrives_after_the_delay():
    link = RadioLink(delay_s=0.1, rate_hz=10.0)
    for t in (0.01, 0.05, 0.09):  # slot that ends at 0.1
        link.submit(t, t)
    link.submit(0.15, 0.15)  # slot that ends at 0.2
    assert link.collect(0.099) == []
    assert link.collect(0.1) == [(pytest.approx(0.2), 0.09)]
    assert link.collect(0.15) == []
    assert link.collect(0.5) == [(pytest.approx(0.3), 0.15)]
    assert link.collect(0.9) == []
    assert link.items_superseded == 2


def test_a_submission_at_the_end_of_a_slot_belongs_to_it():
    link = RadioLink(delay_s=0.0, rate_hz=10.0)
    link.submit(0.1, "a")
    link.submit(0.1000001, "b")
    assert link.collect(1.0) == [(pytest.approx(0.1), "a"), (pytest.approx(0.2), "b")]


def test_phase_shifts_the_slots():
    link = RadioLink(delay_s=0.0, rate_hz=10.0, phase_s=0.03)
    link.submit(0.01, "a")
    link.submit(0.04, "b")
    assert link.collect(1.0) == [(pytest.approx(0.03), "a"), (pytest.approx(0.13), "b")]


def test_late_submission_waits_for_the_next_open_slot():
    link = RadioLink(delay_s=0.0, rate_hz=10.0)
    assert link.collect(0.25) == []
    link.submit(0.11, "late")
    assert link.collect(0.25) == []
    assert link.collect(0.3) == [(pytest.approx(0.3), "late")]


def test_events_are_all_kept_in_order():
    link = RadioLink(delay_s=0.05, rate_hz=10.0)
    for item, must in (("s1", False), ("take off", True), ("s2", False), ("land", True), ("s3", False), ("cut", True)):
        link.submit(0.02, item, must_arrive=must)
    assert [item for _, item in link.collect(0.1)] == ["take off", "land", "s3", "cut"]


def test_40_hz_commands_come_out_at_30_hz():
    link = RadioLink(delay_s=0.1, rate_hz=30.0, phase_s=0.0123)
    out = []
    for k in range(2000):  # 10 s in steps of 5 ms
        if k % 5 == 0:
            link.submit(k * 0.005, k * 0.005)
        out += link.collect(k * 0.005)
    arrivals = np.array([arrival for arrival, _ in out])
    assert len(out) in (299, 300)
    np.testing.assert_allclose(np.diff(arrivals), 1.0 / 30.0, atol=1e-9)
    ages = arrivals - np.array([sent for _, sent in out])
    assert ages.min() >= 0.1 and ages.max() <= 0.1 + 0.025 + 1e-9  # never older than one command period


def test_losses_drop_sticks_but_only_delay_events():
    link = RadioLink(delay_s=0.0, rate_hz=10.0, loss=0.5, rng=np.random.default_rng(4))
    sticks, events = [], []
    for k in range(1000):
        t = 0.1 * k + 0.05
        link.submit(t, k)
        link.submit(t, ("event", k), must_arrive=True)
        for _, item in link.collect(t + 0.05):
            (events if isinstance(item, tuple) else sticks).append(item)
    for _, item in link.collect(1e3):
        (events if isinstance(item, tuple) else sticks).append(item)
    assert events == [("event", k) for k in range(1000)]
    assert 400 < len(sticks) < 600
    assert sticks == sorted(sticks)
    assert 400 < link.slots_lost < 600


def test_same_seed_same_losses():
    def run(seed):
        link = RadioLink(0.0, 10.0, 0.3, np.random.default_rng(seed))
        for k in range(200):
            link.submit(0.1 * k, k)
        return link.collect(100.0)

    assert run(1) == run(1)
    assert run(1) != run(2)


def test_a_link_that_loses_everything_is_refused():
    with pytest.raises(ValueError, match="probability"):
        RadioLink(0.1, loss=1.0)
