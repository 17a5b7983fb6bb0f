"""The lab as data: what is read is what is written, and every mistake is named."""

import copy
import pathlib

import numpy as np
import pytest
import yaml

from risc_control.lab import fleet_from_dict, load_fleet, load_templates, load_vehicle_type
from risc_control.lab.templates import templates_from_dict
from risc_control.lab.vehicle_types import vehicle_type_from_dict

FLEETS = pathlib.Path(__file__).resolve().parents[3] / "launch" / "fleets"
TYPES = pathlib.Path(__file__).resolve().parents[1] / "config" / "types"


@pytest.fixture()
def fleet_dict():
    return yaml.safe_load((FLEETS / "ardrones3.yaml").read_text())


@pytest.mark.parametrize("path", sorted(FLEETS.parent.glob("**/fleets/*.yaml")), ids=lambda path: path.stem)
def test_every_fleet_names_known_types_and_templates(path):
    fleet = load_fleet(path)
    templates = load_templates()
    for vehicle in fleet.vehicles:
        assert load_vehicle_type(vehicle.type).name == vehicle.type
        assert templates[vehicle.template].kind == "vehicle"
    for landmark in fleet.landmarks:
        assert templates[landmark.name].kind == "landmark"


def test_fleet_survives_the_way_through_a_dict(fleet_dict):
    fleet = fleet_from_dict(fleet_dict)
    assert fleet_from_dict(fleet.to_dict()) == fleet
    assert fleet.vehicles[1].namespace == "risc2"
    assert fleet.vehicles[1].start_position_m == (-0.45, 0.78, 0.0)


def test_vehicles_share_an_address_only_in_networks_of_their_own(fleet_dict):
    for vehicle in fleet_dict["vehicles"]:
        vehicle["address"] = "192.168.1.1"
    with pytest.raises(ValueError, match=r"two vehicles have the same address: 192\.168\.1\.1"):
        fleet_from_dict(fleet_dict)
    fleet = fleet_from_dict(dict(fleet_dict, own_networks=True))
    assert fleet_from_dict(fleet.to_dict()) == fleet
    with pytest.raises(ValueError, match="'own_networks' must be true or false, found 'yes'"):
        fleet_from_dict(dict(fleet_dict, own_networks="yes"))


def test_subnet_moves_every_address_and_nothing_else(fleet_dict):
    moved = fleet_from_dict(fleet_dict).in_subnet("127.99")
    assert moved.mocap.host == "127.99.0.1"
    assert [v.address for v in moved.vehicles] == ["127.99.1.1", "127.99.1.2", "127.99.1.3"]
    assert moved.in_subnet("127.77") == fleet_from_dict(fleet_dict)
    with pytest.raises(ValueError, match="first two bytes"):
        moved.in_subnet("127.0.0.1")
    with pytest.raises(ValueError, match="127.300"):
        moved.in_subnet("127.300")


def test_too_many_vehicles_are_refused(fleet_dict):
    fleet = fleet_from_dict(fleet_dict)
    assert len(fleet.with_vehicles(2).vehicles) == 2
    with pytest.raises(ValueError, match="has 3 vehicles, 4"):
        fleet.with_vehicles(4)


def set_in(content, path, value):
    for key in path[:-1]:
        content = content[key]
    if value is None:
        del content[path[-1]]
    else:
        content[path[-1]] = value


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (["vehicles"], [], "at least one vehicle"),
        (["vehicles"], "risc1", "must be a list"),
        (["vehicles", 0, "namespace"], "risc2", "same namespace: risc2"),
        (["vehicles", 0, "namespace"], "1risc", "no ROS name"),
        (["vehicles", 0, "template"], None, "'template' is missing"),
        (["vehicles", 0, "adress"], "127.0.0.9", "unknown key.* adress"),
        (["vehicles", 0, "address"], "localhost", "IPv4 address"),
        (["vehicles", 0, "start", "position_m"], [0.0, 1.0], "list of 3 numbers"),
        (["vehicles", 0, "start", "position_m"], [0.0, 1.0, float("nan")], "finite"),
        (["landmarks", 0, "name"], "Pink_blue", "same name: Pink_blue"),
        (["mocap", "stream_port"], 70000, "65535"),
        (["mocap", "stream_group"], "10.0.0.1", "no multicast"),
        (["mocap", "rate_hz"], "fast", "must be a number"),
        (["mocap"], 5, "must be a mapping"),
    ],
)
def test_mistakes_in_a_fleet_are_named(fleet_dict, path, value, message):
    broken = copy.deepcopy(fleet_dict)
    set_in(broken, path, value)
    with pytest.raises(ValueError, match=message):
        fleet_from_dict(broken)


def test_unreadable_files_are_named(tmp_path):
    with pytest.raises(ValueError, match="cannot read .*nowhere"):
        load_fleet(tmp_path / "nowhere.yaml")
    bad = tmp_path / "bad.yaml"
    bad.write_text("a: [1,\nb: 2")
    with pytest.raises(ValueError, match="not valid YAML"):
        load_fleet(bad)
    bad.write_text("- 1\n- 2\n")
    with pytest.raises(ValueError, match="must hold `key: value`"):
        load_fleet(bad)


def test_vehicle_type_is_that_of_the_identification():
    ardrone = load_vehicle_type("ardrone")
    jx, jy, _ = ardrone.inertia_kg_m2
    assert ardrone.roll.natural_frequency_rad_s == pytest.approx(np.sqrt(0.0757 / jx), rel=1e-3)
    assert ardrone.pitch.natural_frequency_rad_s == pytest.approx(np.sqrt(0.0944 / jy), rel=1e-3)
    assert ardrone.roll.damping_ratio == pytest.approx(0.0192 / (2 * np.sqrt(0.0757 * jx)), rel=1e-3)
    assert ardrone.pitch.damping_ratio == pytest.approx(0.0205 / (2 * np.sqrt(0.0944 * jy)), rel=1e-3)


def test_vehicle_type_mistakes_are_named():
    with pytest.raises(ValueError, match="unknown vehicle type 'zeppelin'; known are: .*ardrone"):
        load_vehicle_type("zeppelin")
    content = yaml.safe_load((TYPES / "ardrone.yaml").read_text())
    content["inertia_kg_m2"] = [0.002, 0.0, 0.004]
    with pytest.raises(ValueError, match="must be positive"):
        vehicle_type_from_dict(content)


def test_square_hull_has_its_middle_at_the_vehicle():
    hull = load_templates()["fluffy_II"]
    corner, left, right = hull.markers_m[:3]
    np.testing.assert_allclose((left + right) / 2, 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(hull.markers_m[:3], axis=1), np.linalg.norm(corner))


def test_template_mistakes_are_named():
    line = {"a": [0.0, 0, 0], "b": [0.1, 0, 0], "c": [0.2, 0, 0]}
    with pytest.raises(ValueError, match="off one line"):
        templates_from_dict({"geometries": {"line": line}, "templates": {"x": {"kind": "vehicle", "geometry": "line"}}})
    with pytest.raises(ValueError, match="unknown geometry 'cube'"):
        templates_from_dict({"geometries": {}, "templates": {"x": {"kind": "vehicle", "geometry": "cube"}}})
    with pytest.raises(ValueError, match="'kind' must be one of"):
        templates_from_dict({"geometries": {"g": line}, "templates": {"x": {"kind": "bird", "geometry": "g"}}})
