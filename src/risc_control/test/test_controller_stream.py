"""Which messages of a controller a vehicle node answers, and which it reads at all."""

import numpy as np
import pytest

from risc_control.controller_stream import ControllerStream

TICK_S = 1.0 / 59.0
COMMAND_S = 1.0 / 29.5
LATENCY_S = 0.003  # from the state's stamp to the message's arrival


def listen(period_s, seconds, jitter_s=0.0, seed=1):
    """A node that commands one vehicle by a controller of this period: (ages of answered messages [s], number read).

    Nothing is read while the node waits; then it gets the newest that has come, at once if there is one.
    """
    rng = np.random.default_rng(seed)
    stamps_s = np.arange(0.0, seconds, period_s)
    arrivals_s = np.maximum.accumulate(stamps_s + LATENCY_S + jitter_s * rng.random(len(stamps_s)))
    stream, ages_s, read = ControllerStream(TICK_S), [], 0
    now_s, due_s, k = 0.0, 0.0, -1
    while True:
        newest = np.searchsorted(arrivals_s, now_s, "right") - 1
        k = max(k + 1, newest)  # what waits, or else the next one as soon as it comes
        if k >= len(stamps_s):
            return np.array(ages_s), read
        now_s = max(now_s, arrivals_s[k])
        read += 1
        age_s = now_s - stamps_s[k]
        is_due = now_s >= due_s
        if stream.answers(stamps_s[k], age_s, is_due):
            ages_s.append(age_s)
            due_s += COMMAND_S * (1 + (now_s - due_s) // COMMAND_S)
        if not stream.reads_on:
            now_s = max(now_s, min(due_s, now_s + TICK_S))


@pytest.mark.parametrize("rate_hz", [200.0, 150.0, 100.0])
def test_a_fast_controller_is_answered_fresh_and_read_seldom(rate_hz):
    ages_s, read = listen(1.0 / rate_hz, 20.0)
    assert len(ages_s) == pytest.approx(20.0 / COMMAND_S, abs=3)
    assert np.percentile(ages_s, 95) < LATENCY_S + 0.0015, "not what has lain for a period"
    assert read < 20.0 * 90.0


@pytest.mark.parametrize("rate_hz", [50.0, 30.0, 29.0, 10.0])
def test_a_slow_controller_is_answered_every_time_it_can_be(rate_hz):
    ages_s, read = listen(1.0 / rate_hz, 20.0)
    assert len(ages_s) == pytest.approx(20.0 * min(rate_hz, 1.0 / COMMAND_S), abs=3)
    assert np.allclose(ages_s, LATENCY_S), "each as it comes"
    assert read == pytest.approx(20.0 * rate_hz, abs=1)


def test_ages_that_vary_cost_no_command():
    ages_s, _ = listen(0.005, 20.0, jitter_s=0.004)
    assert len(ages_s) == pytest.approx(20.0 / COMMAND_S, abs=3)


def test_never_two_in_a_row_are_passed_over():
    stream = ControllerStream(TICK_S)
    for k in range(3):
        stream.answers(0.005 * k, LATENCY_S, True)  # found to be fast
    answered = [stream.answers(0.015 + 0.005 * k, 0.01 * (k + 2), True) for k in range(20)]
    assert not any(not one and not other for one, other in zip(answered, answered[1:]))
    assert not all(answered)


def test_a_controller_that_becomes_slow_is_found_out():
    stream = ControllerStream(TICK_S)
    for k in range(3):
        stream.answers(0.005 * k, LATENCY_S, True)
    assert not stream.reads_on
    stamps_s = 0.05 + 0.05 * np.arange(20)
    answered = [stream.answers(stamp_s, LATENCY_S + 0.002 * (k % 2), True) for k, stamp_s in enumerate(stamps_s)]
    assert answered.count(False) <= 1, "one is passed over until its period is known"
    assert stream.reads_on
