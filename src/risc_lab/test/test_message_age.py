import pytest
from hypothesis import given
from hypothesis import strategies as st

from risc_lab.message_age import MessageAges

RATE_HZ = 200.0


def seen(ages, transits_s, ahead_s, start_s=0.0):
    """Ages found by a receiver whose clock is ahead_s ahead of the sender's."""
    found = []
    for k, transit_s in enumerate(transits_s):
        sent_s = start_s + k / RATE_HZ
        found.append(ages.corrected(transit_s + ahead_s, sent_s + transit_s))
    return found


def test_with_equal_clocks_the_age_is_the_way():
    ages = MessageAges()
    assert seen(ages, [0.001, 0.004, 0.3], 0.0) == pytest.approx([0.001, 0.004, 0.3])
    assert ages.behind_s == 0.0


def test_a_clock_that_is_behind_makes_nothing_younger():
    ages = MessageAges()
    found = seen(ages, [0.002] * 10 + [0.120], -0.05)
    assert found[-1] == pytest.approx(0.118)  # the fastest transit, 2 ms, cannot be told from a clock offset
    assert ages.behind_s == pytest.approx(0.048)


def test_a_clock_that_is_ahead_makes_everything_older():
    assert seen(MessageAges(), [0.002] * 3, 0.05) == pytest.approx([0.052] * 3)


def test_what_an_outage_held_back_is_old_even_if_it_is_all_that_was_ever_seen():
    assert min(seen(MessageAges(), [10.0 - k / RATE_HZ for k in range(100)], 0.0)) > 9.4


def test_a_clock_that_was_set_is_believed_after_two_periods():
    ages = MessageAges(memory_s=1.0)
    seen(ages, [0.001] * 10, -0.05)
    seen(ages, [0.001] * 500, 0.0, start_s=0.1)
    assert ages.behind_s == 0.0


@given(
    ahead_s=st.floats(-0.5, 0.5),
    transits_s=st.lists(st.floats(0.0, 5.0), min_size=1, max_size=30),
)
def test_no_age_is_less_than_the_way_beyond_the_fastest(ahead_s, transits_s):
    found = seen(MessageAges(), transits_s, ahead_s)
    for k, (age_s, transit_s) in enumerate(zip(found, transits_s)):
        assert age_s >= transit_s - min(transits_s[: k + 1]) - 1e-9
        assert age_s >= 0.0
