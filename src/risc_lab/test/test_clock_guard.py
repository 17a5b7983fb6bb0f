import math

import pytest

from risc_lab.clock import ClockGuard, Step

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
        ([1.0, 99.0, 1.1, 1.2], [A, R, A, A]),  # one that is damaged
        ([1.0, 99.0, 99.1, 99.2, 99.3], [A, R, R, N, A]),  # set forward
        ([1.0, math.nan, math.inf, -math.inf, 1.1], [A, R, R, R, A]),
        ([9.0, 8.0, 8.1, math.nan, 8.2], [A, R, R, R, N]),
    ],
)
def test_what_a_stamp_is_to_its_stream(stamps, expected):
    assert looked(stamps) == expected


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
