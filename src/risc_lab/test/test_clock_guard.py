import math

import numpy as np
import pytest

from risc_lab.clock_guard import ClockGuard, Step

R, A, N = Step


def looked(stamps, longest_step_s=1.0):
    guard = ClockGuard(longest_step_s)
    return [guard.look(stamp) for stamp in stamps]


@pytest.mark.parametrize(
    ("stamps", "expected"),
    [
        ([1.0, 1.1, 1.2], [A, A, A]),
        ([1.0, 1.0, 1.1], [A, R, A]),
        ([1.0, 0.9, 1.1, 1.05, 1.2], [A, R, A, R, A]),  # stragglers
        ([9.0, 8.0, 8.1, 8.2, 8.3, 9.0], [A, R, R, N, A, A]),  # set back
        ([9.0, 8.0, 7.9, 7.8, 7.7, 7.6], [A, R, R, R, R, R]),  # they do not agree
        ([9.0, 8.0, 8.0, 8.1, 8.1, 8.2], [A, R, R, R, R, N]),  # each frame twice
        ([9.0, 8.0, 8.1, 9.1, 8.2, 8.3, 9.2], [A, R, R, A, R, R, A]),  # the old clock goes on
        ([1.0, 99.0, 1.1, 1.2], [A, R, A, A]),  # one damaged stamp
        ([1.0, 99.0, 99.1, 99.2, 99.3], [A, R, R, N, A]),  # set forward
        ([1.0, math.nan, math.inf, -math.inf, 1.1], [A, R, R, R, A]),
        ([9.0, 8.0, 8.1, math.nan, 8.2], [A, R, R, R, N]),
    ],
)
def test_what_a_stamp_is_to_its_stream(stamps, expected):
    assert looked(stamps) == expected


FRAMES_S = [100.0 + 0.005 * k for k in range(60)]


@pytest.mark.parametrize("jitter_s", [0.0, 0.0005])
@pytest.mark.parametrize(
    "order",
    [
        (54, 51, 52, 53, 55),
        (54, 55, 56, 51, 52, 53, 57),  # the gap is not the newest
        (52, 54, 56, 51, 53, 55, 57),  # three gaps
        (59, *range(51, 59)),
        (54, 51, 51, 52, 52, 53, 53, 55),  # each comes twice
    ],
)
def test_a_burst_of_late_frames_is_no_set_clock(order, jitter_s):
    """A steady clock at 200 Hz; the stamps of late frames rise among themselves and never pass the newest."""
    rng = np.random.default_rng(1)
    frames = (np.array(FRAMES_S) + rng.uniform(-jitter_s, jitter_s, 60)).tolist()
    steps = looked(frames[:51] + [frames[k] for k in order])
    newest = [max((50, *order[:i])) for i in range(len(order))]
    assert steps == [A] * 51 + [A if k > before else R for k, before in zip(order, newest)]


@pytest.mark.parametrize("share_lost", [0.0, 0.3])
@pytest.mark.parametrize("back_s", [0.0501, 0.0524, 0.1037, 0.6])
def test_a_clock_set_back_by_little_is_new_after_three_frames(back_s, share_lost):
    """The control arm of the test above: also with frames lost, which leave gaps."""
    rng = np.random.default_rng(2)
    frames = [t for t in FRAMES_S if rng.random() >= share_lost]
    steps = looked(frames + [frames[-1] + 0.005 * k - back_s for k in range(1, 9)])
    assert N in steps and steps.index(N) - len(frames) <= (2 if not share_lost else 5)
    assert set(steps[steps.index(N) + 1 :]) == {A}


def test_what_is_older_than_a_delay_explains_is_of_another_clock():
    stamps = FRAMES_S[:20] + FRAMES_S[-3:] + FRAMES_S[-20:-14]
    assert looked(stamps)[-6:] == [R] * 6, "up to 0.1 s late"
    stamps = [t + (1.0 if t > FRAMES_S[19] else 0.0) for t in FRAMES_S] + [FRAMES_S[20] + 0.005 * k for k in range(3)]
    assert looked(stamps)[-3:] == [R, R, N]


def test_a_stream_that_may_pause():
    assert looked([1.0, 500.0, 500.1, 2.0, 2.1, 500.2, math.inf], math.inf) == [A, A, A, R, R, A, R]
    assert looked([math.inf, 1.0], math.inf) == [R, A]


def test_refused_is_false_and_the_newest_is_known():
    guard = ClockGuard()
    assert guard.newest_s == -math.inf and guard.look(5.0) and not guard.look(4.0)
    assert guard.newest_s == 5.0
    guard.forget()
    assert guard.look(4.0) is Step.ADVANCES


@pytest.mark.parametrize("longest_s", [0.0, -1.0, math.nan])
def test_a_step_needs_a_length(longest_s):
    with pytest.raises(ValueError, match="longest step"):
        ClockGuard(longest_s)
