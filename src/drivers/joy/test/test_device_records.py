"""joy.device_records: records, dead zone, growth of the arrays, and the moments of publication."""

import struct

import pytest

from joy.device_records import JoyEvent, JoySettings, JoyState, PublishClock, RecordReader, Urgency
from risc_lab.settings import settings_from

BUTTON, AXIS, INIT = 0x01, 0x02, 0x80


def record(value, kind, number, time_ms=5):
    return struct.pack("=IhBB", time_ms, value, kind, number)


def test_reader_takes_records_in_any_pieces():
    data = record(-32767, AXIS, 3) + record(1, BUTTON, 6) + record(0, BUTTON | INIT, 10)
    expected = [JoyEvent(-32767, AXIS, 3), JoyEvent(1, BUTTON, 6), JoyEvent(0, BUTTON | INIT, 10)]
    assert RecordReader().feed(data) == expected
    reader = RecordReader()
    assert [event for byte in data for event in reader.feed(bytes([byte]))] == expected


@pytest.mark.parametrize(
    ("raw", "deadzone", "value"),
    [
        (0, 0.05, 0.0),
        (1638, 0.05, 0.0),  # just inside the dead zone of 1638.35
        (32767, 0.05, -1.0),  # right and down are negative
        (-32767, 0.05, 1.0),
        (-32768, 0.05, 1.0),
        (16384, 0.0, -16384 / 32767.0),
        (-16384, 0.2, (16384 - 0.2 * 32767) / (0.8 * 32767)),
    ],
)
def test_axis_formula(raw, deadzone, value):
    assert JoyState(JoySettings(deadzone=deadzone)).axis_value(raw) == pytest.approx(value, abs=1e-12)


def test_axis_is_continuous_at_the_edge_of_the_dead_zone():
    state = JoyState(JoySettings(deadzone=0.1))
    assert abs(state.axis_value(3278)) < 1e-4


@pytest.mark.parametrize(
    ("given", "used", "note"),
    [
        (JoySettings(deadzone=3276.7), JoySettings(deadzone=0.1), "32767"),
        (JoySettings(deadzone=0.95), JoySettings(deadzone=0.9), "0.9"),
        (JoySettings(deadzone=-0.1), JoySettings(deadzone=0.0), "deadzone -0.1"),
        (JoySettings(autorepeat_rate=-1.0), JoySettings(autorepeat_rate=0.0), "autorepeat_rate"),
        (JoySettings(coalesce_interval=-1.0), JoySettings(coalesce_interval=0.0), "coalesce_interval"),
    ],
)
def test_settings_are_brought_into_range_and_say_so(given, used, note):
    checked, notes = given.checked()
    assert checked.deadzone == pytest.approx(used.deadzone)
    assert checked.autorepeat_rate == used.autorepeat_rate
    assert checked.coalesce_interval == used.coalesce_interval
    assert len(notes) == 1
    assert note in notes[0]


def test_good_settings_are_left_alone():
    assert JoySettings().checked() == (JoySettings(), [])
    with pytest.raises(ValueError, match="deadzone"):
        settings_from(JoySettings, {"deadzone": float("nan")})
    _, notes = JoySettings(autorepeat_rate=100.0, coalesce_interval=0.1).checked()
    assert "coalesce_interval" in notes[0]


def test_arrays_grow_to_the_highest_number():
    state = JoyState(JoySettings())
    assert state.apply(JoyEvent(0, BUTTON | INIT, 2)) == Urgency.SOON
    assert state.apply(JoyEvent(32767, AXIS | INIT, 4)) == Urgency.SOON
    assert state.buttons == [0, 0, 0]
    assert state.axes == [0.0] * 5, "initial axis values read 0"
    assert state.apply(JoyEvent(1, BUTTON, 1)) == Urgency.NOW
    assert state.apply(JoyEvent(-32767, AXIS, 0)) == Urgency.SOON
    assert state.buttons == [0, 1, 0]
    assert state.axes == [1.0, 0.0, 0.0, 0.0, 0.0]


def test_default_trig_val_takes_initial_axis_values():
    state = JoyState(JoySettings(default_trig_val=True))
    state.apply(JoyEvent(-32767, AXIS | INIT, 0))
    assert state.axes == [1.0]


def test_sticky_buttons_toggle_on_press():
    state = JoyState(JoySettings(sticky_buttons=True))
    seen = []
    for value in (1, 0, 1, 0):
        state.apply(JoyEvent(value, BUTTON, 0))
        seen.append(state.buttons[0])
    assert seen == [1, 1, 0, 0]


def test_unknown_types_change_nothing():
    state = JoyState(JoySettings())
    assert state.apply(JoyEvent(1, 0x04, 0)) == Urgency.NEVER
    assert (state.axes, state.buttons) == ([], [])


def test_axis_events_are_merged_and_buttons_are_not():
    clock = PublishClock(JoySettings(coalesce_interval=0.01))
    assert not clock.event(Urgency.SOON, 1.000)
    assert not clock.event(Urgency.SOON, 1.008)  # does not prolong the wait
    assert not clock.due(1.009)
    assert clock.wait_s(1.004, 1.0) == pytest.approx(0.006)
    assert clock.due(1.0101)
    clock.published(1.0101)
    assert not clock.due(5.0)
    assert clock.event(Urgency.NOW, 5.0)
    assert clock.wait_s(5.0, 1.0) == 1.0


def test_a_button_takes_pending_axis_events_along():
    clock = PublishClock(JoySettings(coalesce_interval=0.01))
    clock.event(Urgency.SOON, 1.0)
    assert clock.event(Urgency.NOW, 1.001)
    clock.published(1.001)
    assert not clock.due(2.0)


def test_autorepeat_counts_from_the_last_message():
    clock = PublishClock(JoySettings(autorepeat_rate=20.0))
    assert not clock.due(0.0)
    assert clock.wait_s(0.0, 1.0) == pytest.approx(0.05)
    assert clock.due(0.0501)
    clock.published(0.0501)
    assert not clock.due(0.09)
    assert clock.due(0.1002)


def test_no_autorepeat_by_default():
    clock = PublishClock(JoySettings())
    assert not clock.due(0.0)
    assert not clock.due(1e6)
