"""One source for each number of a vehicle: its type, what the fleet file says otherwise, the original's parameters."""

import math

import pytest

from risc_lab.lab.fleet import fleet_from_dict
from risc_lab.lab.vehicle_types import FULL_SCALES, disagreement, legacy_overrides, load_vehicle_type

rospy = pytest.importorskip("rospy")
from risc_lab.ros.params import told_vehicle_type  # noqa: E402

ARDRONE = load_vehicle_type("ardrone")


def vehicle(**overrides):
    """The only vehicle of a fleet file, with these overrides."""
    place = {"namespace": "risc1", "template": "Raven", "type": "ardrone", "address": "127.0.0.2"}
    entry = {**place, "start": {"position_m": [0, 0, 0]}, "overrides": overrides}
    content = {"name": "test", "mocap": {"host": "127.0.0.1"}, "vehicles": [entry]}
    fleet = fleet_from_dict(content)
    assert fleet_from_dict(fleet.to_dict()) == fleet
    return fleet.vehicles[0]


@pytest.fixture
def server(monkeypatch):
    """The parameter server, as a dict."""
    values = {}
    monkeypatch.setattr(rospy, "get_param", lambda name, *default: values.get(name, *default))
    monkeypatch.setattr(rospy, "has_param", lambda name: name in values)
    return values


def test_a_fleet_file_overrides_the_type():
    assert vehicle().vehicle_type == ARDRONE
    assert vehicle(mass_kg=0.52).vehicle_type.mass_kg == 0.52
    with pytest.raises(ValueError, match="colour"):
        vehicle(colour=3)
    with pytest.raises(ValueError, match="tilt_max_rad"):
        assert vehicle(tilt_max_rad=0.0).vehicle_type


def test_the_global_limits_are_the_controllers_and_the_vehicle_nodes(server):
    """/control_vz_max was read by the controller only: a vehicle climbed at a fifth of what the vehicle node wanted."""
    server["/control_vz_max"] = 200
    told = told_vehicle_type(vehicle(), {})
    assert told.climb_max_m_s == pytest.approx(0.2)
    assert not disagreement("Raven", vars(told), vars(told), "the controller")
    private = {"control_vz_max": 500}
    assert told_vehicle_type(vehicle(), private).climb_max_m_s == pytest.approx(0.5), "a private one wins"
    server["/delay"] = 7.0
    assert told_vehicle_type(vehicle(), {}).climb_time_constant_s == 0.3, "a name for the delay of any type"


@pytest.mark.parametrize("field", FULL_SCALES)
def test_other_full_scales_are_named(field):
    mine = vars(ARDRONE)
    text = disagreement("Raven", mine, {field: 5.0 * mine[field]}, "the driver /risc1/ardrone_driver")
    assert field in text and "5.00 times" in text and "/risc1/ardrone_driver" in text
    assert disagreement("Raven", mine, {field: 1.005 * mine[field]}, "") == disagreement("Raven", mine, {}, "") == ""


def test_the_originals_parameters():
    assert legacy_overrides({"control_vz_max": 200, "euler_angle_max": -1, "JoytoWay": 5}) == {"climb_max_m_s": 0.2}
    assert legacy_overrides({"command_delay": 0}) == {"command_delay_s": 0.0}
    for name, value in (("delay", 0), ("control_yaw", "fast"), ("euler_angle_max", True), ("command_delay", math.nan)):
        with pytest.raises(ValueError, match=name):
            legacy_overrides({name: value})
