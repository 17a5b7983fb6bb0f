"""Selection by joystick buttons: both ways, wrapping."""

import pytest

from risc_control.bumpers import NEXT_BUTTON, PREVIOUS_BUTTON, BumperSelector


def test_wraps_both_ways():
    selector = BumperSelector(3)
    indices = []
    for button in (PREVIOUS_BUTTON, NEXT_BUTTON, NEXT_BUTTON):
        assert selector.press({button})
        indices.append(selector.index)
    assert indices == [2, 0, 1]


@pytest.mark.parametrize("pressed", [(), (0, 7), (NEXT_BUTTON, PREVIOUS_BUTTON)])
def test_other_presses_change_nothing(pressed):
    """In the original any joystick message without a held bumper restarted the trajectory (D-31)."""
    selector = BumperSelector(3)
    assert not selector.press(pressed)
    assert selector.index == 0


def test_buttons_of_ones_own():
    selector = BumperSelector(3, next_button=7, previous_button=0)
    assert selector.buttons == {7, 0}
    assert selector.press({7})
    assert selector.index == 1


def test_the_only_entry_stays():
    assert not BumperSelector(1).press({NEXT_BUTTON})


@pytest.mark.parametrize(("count", "buttons"), [(0, (5, 4)), (2, (3, 3)), (2, (-1, 4))])
def test_nonsense_is_refused(count, buttons):
    with pytest.raises(ValueError, match="two different buttons"):
        BumperSelector(count, *buttons)
