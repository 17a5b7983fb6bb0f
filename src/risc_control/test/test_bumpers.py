"""Selection by joystick buttons: by edge, wrapping."""

import pytest

from risc_control.bumpers import BumperSelector

NOTHING, NEXT, BACK = [0] * 8, [0, 0, 0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 1, 0, 0, 0]


def test_a_held_button_steps_once():
    selector = BumperSelector(3)
    selector.update(NOTHING)
    assert [selector.update(NEXT) for _ in range(4)] == [True, False, False, False]
    assert selector.index == 1


def test_other_messages_change_nothing():
    """In the original any joystick message without a held bumper restarted the trajectory (D-31)."""
    selector = BumperSelector(3)
    assert not any(selector.update(NOTHING) for _ in range(3))


def test_wraps_both_ways():
    selector = BumperSelector(3)
    selector.update(NOTHING)
    indices = []
    for buttons in (BACK, NEXT, NEXT):
        selector.update(buttons)
        indices.append(selector.index)
        selector.update(NOTHING)
    assert indices == [2, 0, 1]


def test_held_at_the_start_and_short_messages():
    selector = BumperSelector(2)
    assert not selector.update(NEXT), "it was held before we looked"
    assert not selector.update([0, 1])
    assert selector.update(NEXT)


@pytest.mark.parametrize(("count", "buttons"), [(0, (5, 4)), (2, (3, 3)), (2, (-1, 4))])
def test_nonsense_is_refused(count, buttons):
    with pytest.raises(ValueError, match="two different buttons"):
        BumperSelector(count, *buttons)
