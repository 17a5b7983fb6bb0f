"""The lab as data: what is read is what is written, and every mistake is named."""

import copy
import pathlib

import numpy as np
import pytest
import yaml

from risc_lab.lab import Arena, fleet_from_dict, generated_fleet, load_fleet, load_templates, load_vehicle_type
from risc_lab.lab.arena import NET_HALF_X_M, NET_HALF_Y_M
from risc_lab.lab.generated_fleet import MOST_VEHICLES, rows
from risc_lab.lab.templates import TemplateSet, attached_bodies
from risc_lab.lab.vehicle_types import VehicleType, vehicle_type_file
from risc_lab.settings import settings_from

FLEETS = pathlib.Path(__file__).resolve().parents[3] / "launch" / "fleets"
TYPES = pathlib.Path(__file__).resolve().parents[1] / "config" / "vehicle_types"


@pytest.fixture()
def fleet_dict():
    return yaml.safe_load((FLEETS / "ardrones3.yaml").read_text())


@pytest.mark.parametrize("path", sorted(FLEETS.parent.glob("**/fleets/*.yaml")), ids=lambda path: path.stem)
def test_every_fleet_names_known_types_and_templates(path):
    content = yaml.safe_load(path.read_text())
    content["mocap"]["host"] = content["mocap"]["host"] or "192.0.2.1"  # filled in as for a real laboratory
    for k, vehicle in enumerate(content["vehicles"], start=2):
        vehicle["address"] = vehicle["address"] or "192.0.2.%d" % k
    fleet = fleet_from_dict(content)
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
    assert fleet.vehicles[1].start.position_m == (-0.45, 0.78, 0.0)


def test_vehicles_share_an_address_only_in_networks_of_their_own(fleet_dict):
    for vehicle in fleet_dict["vehicles"]:
        vehicle["address"] = "192.168.1.1"
    with pytest.raises(ValueError, match=r"address.*192\.168\.1\.1"):
        fleet_from_dict(fleet_dict)
    fleet = fleet_from_dict(dict(fleet_dict, own_networks=True))
    assert fleet_from_dict(fleet.to_dict()) == fleet
    with pytest.raises(ValueError, match="own_networks.*yes"):
        fleet_from_dict(dict(fleet_dict, own_networks="yes"))


@pytest.fixture()
def radio_type(tmp_path, monkeypatch):
    """Name of a type whose driver opens two devices."""
    content = yaml.safe_load(vehicle_type_file("ardrone").read_text(encoding="utf-8"))
    content.update(name="radio", devices={"telemetry": "udpout:{address}:14550", "arduino": "socket://{address}:11411"})
    (tmp_path / "vehicle_types").mkdir()
    (tmp_path / "vehicle_types/radio.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    monkeypatch.setenv("RISC_MAAP_MEMBERS", str(tmp_path))
    return "radio"


def test_links_are_at_the_address_or_at_devices(fleet_dict, radio_type):
    vehicle = fleet_dict["vehicles"][0]
    vehicle.update(type=radio_type, address="127.77.1.1")
    at_address = {"telemetry": "udpout:127.77.1.1:14550", "arduino": "socket://127.77.1.1:11411"}
    assert fleet_from_dict(fleet_dict).vehicles[0].links == at_address
    vehicle["devices"] = {"arduino": "/dev/ttyACM0"}
    assert fleet_from_dict(fleet_dict).vehicles[0].links == {**at_address, "arduino": "/dev/ttyACM0"}
    vehicle["devices"]["telemetry"] = "/dev/ttyUSB0"
    vehicle["address"] = ""
    fleet = fleet_from_dict(fleet_dict)
    assert fleet.vehicles[0].links == vehicle["devices"]
    assert fleet_from_dict(fleet.to_dict()) == fleet
    moved = fleet.in_subnet("127.99").vehicles[0]
    assert (moved.address, moved.devices) == ("127.99.1.1", {}), "no virtual lab opens a real device"
    assert fleet.vehicles[1].links == {}


@pytest.mark.parametrize(
    ("kind", "devices", "message"),
    [
        ("radio", {}, r"vehicles\[0\]: 'address' "),
        ("radio", {"arduino": "/dev/ttyACM0"}, "'risc1' .* address, .* telemetry .*`devices`"),
        ("radio", {"arduno": "/dev/ttyACM0"}, "arduno; .* arduino, telemetry"),
        ("ardrone", {"arduino": "/dev/ttyACM0"}, "arduino; .* address "),
        ("radio", {"arduino": 3}, "devices.arduino' .*text"),
        ("radio", {"arduino": ""}, "devices.arduino' .*length"),
        ("radio", {"arduino": "/dev/ttyACM0", "telemetry": "/dev/ttyACM0"}, "device twice: /dev/ttyACM0"),
    ],
)
def test_a_link_that_is_nowhere_is_named(fleet_dict, radio_type, kind, devices, message):
    fleet_dict["vehicles"][0].update(type=kind, address="", devices=devices)
    with pytest.raises(ValueError, match=message):
        assert fleet_from_dict(fleet_dict).vehicles[0].links


def test_subnet_moves_every_address_and_nothing_else(fleet_dict):
    moved = fleet_from_dict(fleet_dict).in_subnet("127.99")
    assert moved.mocap.host == "127.99.0.1"
    assert [v.address for v in moved.vehicles] == ["127.99.1.1", "127.99.1.2", "127.99.1.3"]
    assert moved.in_subnet("127.77") == fleet_from_dict(fleet_dict)
    with pytest.raises(ValueError, match="127.0.0.1"):
        moved.in_subnet("127.0.0.1")
    with pytest.raises(ValueError, match="127.300"):
        moved.in_subnet("127.300")


def test_too_many_vehicles_are_refused(fleet_dict):
    fleet = fleet_from_dict(fleet_dict)
    assert len(fleet.with_vehicles(2).vehicles) == 2
    with pytest.raises(ValueError, match=" 3 vehicles, 4"):
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
        (["vehicles"], [], "one vehicle"),
        (["vehicles"], "risc1", "vehicles.* list"),
        (["vehicles", 0, "namespace"], "risc2", "same namespace: risc2"),
        (["vehicles", 0, "namespace"], "1risc", "no ROS name"),
        (["vehicles", 0, "template"], None, "template' is missing"),
        (["vehicles", 0, "adress"], "127.0.0.9", "unknown key.* adress"),
        (["vehicles", 0, "address"], "localhost", "IPv4 address"),
        (["vehicles", 1, "address"], "", r"vehicles\[1\]: 'address' "),
        (["mocap", "host"], "", "fleet: mocap: 'host' "),
        (["vehicles", 0, "start", "position_m"], [0.0, 1.0], "list of length 3"),
        (["vehicles", 0, "start", "position_m"], [0.0, 1.0, float("nan")], "finite"),
        (["landmarks", 0, "name"], "Pink_blue", "Pink_blue"),
        (["mocap", "stream_port"], 70000, "65535"),
        (["mocap", "stream_group"], "10.0.0.1", "no multicast"),
        (["mocap", "rate_hz"], "fast", "mocap.rate_hz.* number"),
        (["mocap"], 5, "mocap.* mapping"),
        (["arena"], {"half_x_m": -1.0}, "arena.*half_x_m"),
        (["arena"], {"half_x_m": "wide"}, "half_x_m"),
        (["arena"], {"radius_m": 3.0}, "arena.*radius_m"),
        (["arena"], [5, 4], "arena.* mapping"),
        (["templates"], {"geometries": {}, "templates": {"x": {"kind": "vehicle", "geometry": "y"}}}, "geometry 'y'"),
        (["templates"], ["fluffy_II"], "templates"),
        (["templates"], {"geometries": {"wide": {"a": [0.0, 1.0, "high"]}}}, r"templates.geometries.wide.a\[2\]"),
    ],
)
def test_mistakes_in_a_fleet_are_named(fleet_dict, path, value, message):
    broken = copy.deepcopy(fleet_dict)
    set_in(broken, path, value)
    with pytest.raises(ValueError, match=message):
        fleet_from_dict(broken)


def test_one_file_describes_the_whole_lab(fleet_dict):
    assert fleet_from_dict(fleet_dict).arena == Arena() == Arena(NET_HALF_X_M, NET_HALF_Y_M, 3.0)
    hull = {"a": [0.1, 0.2, 0.0], "b": [-0.2, 0.0, -0.05], "c": [0.1, -0.2, 0.03]}
    own = {"geometries": {"wide": hull}, "templates": {"albatross": {"kind": "vehicle", "geometry": "wide"}}}
    fleet = fleet_from_dict(dict(fleet_dict, arena={"half_x_m": 6, "height_m": 4.0}, templates=own))
    assert fleet.arena == Arena(6.0, NET_HALF_Y_M, 4.0)
    assert fleet_from_dict(yaml.safe_load(yaml.safe_dump(fleet.to_dict()))) == fleet
    assert fleet != fleet_from_dict(dict(fleet_dict, arena={"half_x_m": 6, "height_m": 4.0}))
    templates = load_templates(fleet=fleet)
    assert templates["albatross"].markers_m.tolist() == list(hull.values()), "its own before the laboratory's"
    assert set(templates) == set(load_templates()) and len(templates["Raven"].markers_m) == 4


def test_what_hangs_on_a_vehicle_is_told_by_the_kind_of_its_template(fleet_dict):
    ring = {"a": [0.05, 0.0, 0.0], "b": [-0.05, 0.05, 0.0], "c": [-0.05, -0.05, 0.0]}
    own = {"geometries": {"ring": ring}, "templates": {"Load": {"kind": "attached", "geometry": "ring"}}}
    assert attached_bodies(load_templates(fleet=fleet_from_dict(dict(fleet_dict, templates=own)))) == {
        *attached_bodies(load_templates()),
        "Load",
    }


@pytest.mark.parametrize("vehicles", [1, 3, 6, 14, 50])
def test_a_generated_lab_is_whole(vehicles):
    fleet = generated_fleet(vehicles)
    assert fleet_from_dict(yaml.safe_load(yaml.safe_dump(fleet.to_dict()))) == fleet == generated_fleet(vehicles)
    assert [v.namespace for v in fleet.vehicles] == ["risc%d" % k for k in range(1, vehicles + 1)]
    templates, places = load_templates(fleet=fleet), np.array([v.start.position_m for v in fleet.vehicles])
    assert all(templates[v.template].kind == "vehicle" for v in fleet.vehicles)
    assert all(templates[m.name].kind == "landmark" for m in fleet.landmarks)
    apart_m = np.linalg.norm(places[:, None] - places, axis=2) + 9.0 * np.eye(vehicles)
    assert apart_m.min() >= 0.95
    half_m = np.array([fleet.arena.half_x_m, fleet.arena.half_y_m])
    assert (half_m - np.abs(places[:, :2]).max(axis=0) >= 1.5 - 1e-9).all()
    assert (half_m >= (NET_HALF_X_M, NET_HALF_Y_M)).all()
    assert np.array([m.position_m for m in fleet.landmarks])[:, 0].max() < fleet.arena.half_x_m
    assert fleet.in_subnet("127.99").vehicles[-1].address == "127.99.1.%d" % vehicles


def test_nobody_can_take_one_generated_hull_for_another():
    fleet = generated_fleet(50)
    hulls = [t.markers_m for t in fleet.templates.by_name().values()]
    assert len(hulls) == 45 and {len(markers) for markers in hulls} == {5}
    distances = []
    for markers in hulls:
        assert np.linalg.svd(markers - markers.mean(axis=0), compute_uv=False)[2] > 0.05, "not in one plane"
        apart_m = np.linalg.norm(markers[:, None] - markers, axis=2)[np.triu_indices(5, 1)]
        assert apart_m.min() > 0.08 and np.abs(markers).max() < 0.25
        distances.append(np.sort(apart_m))
    differences = np.abs(np.array(distances)[:, None] - distances).max(axis=2) + np.eye(45)
    assert differences.min() >= 0.03


def test_a_larger_generated_lab_begins_with_the_same_hulls():
    small, large = generated_fleet(8).templates, generated_fleet(20).templates
    assert len(small.templates) == 3 and small.geometries.items() <= large.geometries.items()


@pytest.mark.parametrize("vehicles", [0, MOST_VEHICLES + 1])
def test_no_lab_for_so_many(vehicles):
    with pytest.raises(ValueError, match="1 to 250.* %d " % vehicles):
        generated_fleet(vehicles)


def test_rows_are_around_the_origin():
    for count in (1, 2, 7, 12):
        places = rows(count, 2.0)
        assert len({tuple(place) for place in places}) == count
        assert places.min(axis=0) == pytest.approx(-places.max(axis=0))
        assert np.ptp(places, axis=0)[0] >= np.ptp(places, axis=0)[1]


def test_unreadable_files_are_named(tmp_path):
    with pytest.raises(ValueError, match="/nowhere.yaml"):
        load_fleet(tmp_path / "nowhere.yaml")
    bad = tmp_path / "bad.yaml"
    bad.write_text("a: [1,\nb: 2")
    with pytest.raises(ValueError, match="bad.yaml.* YAML"):
        load_fleet(bad)
    bad.write_text("- 1\n- 2\n")
    with pytest.raises(ValueError, match="bad.yaml.*`key: value`"):
        load_fleet(bad)


def test_vehicle_type_is_that_of_the_identification():
    ardrone = load_vehicle_type("ardrone")
    jx, jy, _ = ardrone.inertia_kg_m2
    assert ardrone.roll.natural_frequency_rad_s == pytest.approx(np.sqrt(0.0757 / jx), rel=1e-3)
    assert ardrone.pitch.natural_frequency_rad_s == pytest.approx(np.sqrt(0.0944 / jy), rel=1e-3)
    assert ardrone.roll.damping_ratio == pytest.approx(0.0192 / (2 * np.sqrt(0.0757 * jx)), rel=1e-3)
    assert ardrone.pitch.damping_ratio == pytest.approx(0.0205 / (2 * np.sqrt(0.0944 * jy)), rel=1e-3)


def test_vehicle_type_mistakes_are_named():
    with pytest.raises(ValueError, match="zeppelin.*ardrone"):
        load_vehicle_type("zeppelin")
    content = yaml.safe_load((TYPES / "ardrone.yaml").read_text())
    content["inertia_kg_m2"] = [0.002, 0.0, 0.004]
    with pytest.raises(ValueError, match="inertia_kg_m2.*> 0"):
        settings_from(VehicleType, content)


def test_square_hull_has_its_middle_at_the_vehicle():
    hull = load_templates()["fluffy_II"]
    corner, left, right = hull.markers_m[:3]
    np.testing.assert_allclose((left + right) / 2, 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(hull.markers_m[:3], axis=1), np.linalg.norm(corner))


def test_template_mistakes_are_named():
    line = {"a": [0.0, 0, 0], "b": [0.1, 0, 0], "c": [0.2, 0, 0]}
    with pytest.raises(ValueError, match="off one line"):
        TemplateSet({"line": line}, {"x": {"kind": "vehicle", "geometry": "line"}})
    with pytest.raises(ValueError, match="'cube'"):
        TemplateSet({}, {"x": {"kind": "vehicle", "geometry": "cube"}})
    with pytest.raises(ValueError, match="kind"):
        TemplateSet({"g": line}, {"x": {"kind": "bird", "geometry": "g"}})
