"""Numbers and names of flight modes are pymavlink's."""

from types import SimpleNamespace

import pytest
from pymavlink import mavutil

from roscopter.modes import MODES, mode_name, mode_number


@pytest.mark.parametrize(
    "kind, table", [("ArduCopter", mavutil.mode_mapping_acm), ("ArduRover", mavutil.mode_mapping_rover)]
)
def test_the_names_of_mavutil(kind, table):
    same = {number: name for number, name in MODES[kind].items() if table.get(number) == name}
    assert len(same) >= 0.7 * len(table)


@pytest.mark.parametrize(
    "name",
    ["STABILIZE", "ACRO", "ALT_HOLD", "AUTO", "GUIDED", "LOITER", "RTL", "CIRCLE", "POSITION", "LAND", "OF_LOITER"],
)
def test_the_modes_of_2014(name):
    assert mavutil.mode_mapping_acm[mode_number("ArduCopter", name)] == name


def test_a_mode_that_there_is_not():
    with pytest.raises(ValueError, match="ArduCopter .*MANUAL"):
        mode_number("ArduCopter", "MANUAL")


def test_what_a_heartbeat_tells():
    def name(base_mode, custom_mode):
        return mode_name("ArduCopter", SimpleNamespace(base_mode=base_mode, custom_mode=custom_mode))

    assert (name(81, 0), name(209, 9), name(81, 99), name(0x40, 0)) == (
        "STABILIZE",
        "LAND",
        "Mode(99)",
        "Mode(0x00000040)",
    )
