"""risc_control.joystick: edges, sticks, and messages that lack something."""

import math

import pytest

from risc_control.joystick import LATE_S, Button, ButtonPresses, Joystick, JoystickParams, Sticks


def buttons(*down, count=11):
    return [1 if index in down else 0 for index in range(count)]


def axes(**values):
    """Axes of the legacy defaults: roll 6, pitch 7, yaw 3."""
    result = [0.0] * 8
    for name, value in values.items():
        result[{"roll": 6, "pitch": 7, "yaw": 3}[name]] = value
    return result


def test_defaults_are_those_of_appendix_c():
    p = JoystickParams()
    assert (p.JoytoWay, p.ButtonEmergency, p.TakeoffLand, p.Up, p.Down, p.ShutDownNode) == (0, 2, 6, 9, 10, 7)
    assert (p.AxisRoll, p.AxisPitch, p.AxisYaw) == (6, 7, 3)
    assert (p.ScaleRoll, p.ScalePitch, p.ScaleYaw, p.ScaleZ) == (1, 1, 1, 1)


def test_buttons_count_once_however_long_they_are_held():
    joystick = Joystick(JoystickParams())
    assert joystick.update(buttons(), axes()).pressed == frozenset()
    assert joystick.update(buttons(6), axes()).pressed == {Button.TAKEOFF_LAND}
    again = joystick.update(buttons(6), axes())
    assert (again.pressed, again.held) == (frozenset(), {Button.TAKEOFF_LAND})
    assert joystick.update(buttons(0, 6), axes()).pressed == {Button.TOGGLE_AUTONOMOUS}
    joystick.update(buttons(), axes())
    assert joystick.update(buttons(6), axes()).pressed == {Button.TAKEOFF_LAND}


def test_first_message_can_be_a_press():
    assert Joystick(JoystickParams()).update(buttons(2), axes()).pressed == {Button.EMERGENCY}


def test_what_is_down_when_a_node_begins_to_listen_was_pressed_before():
    """It may have been restarted while the button is held."""
    joystick = Joystick(JoystickParams(), listens_since_s=100.0)
    first = joystick.update(buttons(6), axes(), now_s=100.3)
    assert (first.pressed, first.belated) == (frozenset(), {Button.TAKEOFF_LAND})
    assert joystick.update(buttons(2, 6), axes(), now_s=100.4).pressed == {Button.EMERGENCY}
    assert Joystick(JoystickParams(), 100.0).update(buttons(2), axes(), now_s=105.0).pressed == {Button.EMERGENCY}


def test_what_goes_down_in_late_messages_is_belated_once_in_time():
    joystick = Joystick(JoystickParams())
    joystick.update(buttons(6), axes(), age_s=0.4)
    joystick.update(buttons(2, 6), axes(), age_s=0.4)
    joystick.update(buttons(2), axes(), age_s=0.4)
    found = joystick.update(buttons(2, 7), axes())
    assert (found.pressed, found.belated) == ({Button.SHUT_DOWN}, {Button.EMERGENCY})
    assert joystick.update(buttons(2, 7), axes()).belated == frozenset()


@pytest.mark.parametrize(
    ("stick", "expected"),
    [
        ({"pitch": 0.5}, Sticks(0.25, 0.0, 0.0, 0.0)),
        ({"roll": -0.9}, Sticks(0.0, -0.3, 0.0, 0.0)),
        ({"yaw": 1.0}, Sticks(0.0, 0.0, 0.0, 1.0)),  # 1 / 0.5, limited
    ],
)
def test_sticks_are_divided_by_their_scale(stick, expected):
    joystick = Joystick(JoystickParams(ScalePitch=2.0, ScaleRoll=3.0, ScaleYaw=0.5))
    joystick.update(buttons(), axes(**stick))
    assert joystick.sticks == pytest.approx(expected)


def test_up_and_down_buttons():
    joystick = Joystick(JoystickParams(ScaleZ=4.0))
    for down, up in (((9,), 0.25), ((10,), -0.25), ((9, 10), 0.0), ((), 0.0)):
        joystick.update(buttons(*down), axes())
        assert joystick.sticks.up == up
    joystick.update(buttons(9), axes(), age_s=0.4)
    assert joystick.sticks.up == 0.0, "too late"


def test_a_small_joystick_is_a_problem_and_no_error():
    joystick = Joystick(JoystickParams())
    joy = joystick.update([0, 0, 1], [0.0])
    assert joy.pressed == {Button.EMERGENCY}, "what is there works"
    assert joystick.sticks == Sticks(0.0, 0.0, 0.0, 0.0)
    text = " ".join(joystick.problems)
    for name in ("TakeoffLand", "ShutDownNode", "AxisRoll", "3 buttons", "1 axes"):
        assert name in text
    assert Joystick(JoystickParams()).update([], []).pressed == frozenset()


def test_axis_that_is_not_a_number():
    joystick = Joystick(JoystickParams())
    joystick.update(buttons(), axes(roll=math.nan))
    assert joystick.sticks.left == 0.0
    assert "AxisRoll" in joystick.problems[0]


@pytest.mark.parametrize(
    ("kwargs", "name"),
    [
        ({"ScaleRoll": 0.0}, "ScaleRoll"),
        ({"AxisYaw": -1}, "AxisYaw"),
        ({"Up": 1.5}, "Up"),
        ({"Down": "4"}, "Down"),
        ({"Down": 9}, "Up and Down"),
        ({"joystick_late_s": 0.0}, "joystick_late_s"),
    ],
)
def test_bad_parameters_are_named(kwargs, name):
    with pytest.raises(ValueError, match=name):
        JoystickParams(**kwargs)


# --------------------------------------------------------------------------------- nodes that listen for a few buttons


def test_a_button_counts_once_however_long_it_is_held():
    presses = ButtonPresses((3, 5))
    presses.update(buttons())
    found = [presses.update(values).in_time for values in (buttons(3), buttons(3), buttons(3, 5, 0), buttons(), [0, 1])]
    assert found == [{3}, set(), {5}, set(), set()]
    assert presses.update(buttons(5, 3)).in_time == {3, 5}


def test_a_button_that_is_down_in_the_first_message_of_a_sender_was_pressed():
    presses = ButtonPresses((3,))
    assert presses.update(buttons(3), sender="/operator").in_time == {3}
    assert presses.update(buttons(3), sender="/joy_node").in_time == {3}


def test_a_press_in_a_late_message_counts_neither_then_nor_while_it_is_held():
    presses = ButtonPresses((3,))
    presses.update(buttons(), 0.0, 0.01)
    late = presses.update(buttons(3), 1.0, LATE_S + 0.1)
    assert (late.in_time, late.late, late.pressed, late.age_s) == (set(), True, {3}, pytest.approx(LATE_S + 0.1))
    held = presses.update(buttons(3), 1.1, 0.01)
    assert (held.in_time, held.late) == (set(), False)
    presses.update(buttons(), 1.2, 0.01)
    assert presses.update(buttons(3), 1.3, LATE_S - 0.1).in_time == {3}


def test_a_press_that_was_over_before_its_message_came_is_late():
    """A burst delayed by the network: the button is no longer held when it arrives."""
    presses = ButtonPresses((3,))
    presses.update(buttons(), 0.0, 0.01)
    burst = [presses.update(values, 5.0, age_s) for values, age_s in ((buttons(3), 4.0), (buttons(), 3.9))]
    assert [found.in_time for found in burst] == [set(), set()]


def test_a_clock_that_is_ahead_hides_no_late_press():
    presses = ButtonPresses((3,))
    presses.update(buttons(), 0.0, -2.0)
    assert presses.update(buttons(3), 1.0, -1.0).late


def test_beside_a_sender_of_zeros_a_held_button_is_no_new_press():
    presses = ButtonPresses((3,))
    found = []
    for k in range(5):
        presses.update(buttons(), 0.1 * k, 0.0, "/operator")
        found.append(presses.update(buttons(3) if k else buttons(), 0.1 * k, 0.0, "/joy_node").in_time)
    assert found == [set(), {3}, set(), set(), set()]


def test_without_a_limit_no_message_is_too_old():
    presses = ButtonPresses((3,), math.inf)
    presses.update(buttons())
    assert presses.update(buttons(3), 1.0, 1e8).in_time == {3}
