"""Which vehicles a vehicle node flies, by its parameters and the fleet."""

from dataclasses import replace

import pytest

pytest.importorskip("rospy")

from risc_control.ros.vehicle_node import _chosen, _without_ladder  # noqa: E402
from risc_lab.lab import generated_fleet  # noqa: E402
from risc_lab.lab.fleet import fleet_from_dict, unplaced_vehicle  # noqa: E402

FLEET = generated_fleet(3)


def chosen(values, namespace=""):
    """[(mocap template, type, prefix, whether it is the only one)]"""
    return [(vehicle.template, vehicle.type, *others) for vehicle, *others in _chosen(values, namespace, FLEET)]


def test_several_vehicles_by_their_namespaces():
    for names in ("risc1 risc3", ["risc1", "risc3"]):
        assert chosen({"vehicles": names}) == [
            ("fluffy_II", "ardrone", "/risc1/", False),
            ("Raven", "ardrone", "/risc3/", False),
        ]
    assert chosen({"vehicles": "risc2"}) == [("albatross", "ardrone", "/risc2/", True)]


def test_a_type_that_is_set_is_that_of_one_vehicle_and_of_several():
    assert [kind for _, kind, _, _ in chosen({"type": "other", "vehicles": "risc1 risc3"})] == ["other"] * 2
    assert [kind for _, kind, _, _ in chosen({"type": "other"}, "risc1")] == ["other"]


@pytest.mark.parametrize("names", ["risc1 risc9", "risc1 risc1"])
def test_names_that_cannot_be_meant(names):
    with pytest.raises(ValueError, match="~vehicles .* /fleet"):
        _chosen({"vehicles": names}, "", FLEET)


def one(wanted, namespace, fleet):
    """(mocap template, type) of the only vehicle."""
    ((vehicle, _, is_alone),) = _chosen({"vehicle": wanted}, namespace, fleet)
    assert is_alone
    return vehicle.template, vehicle.type


def fleet(*vehicles):
    return fleet_from_dict(
        {
            "name": "test",
            "mocap": {"host": "127.0.0.1"},
            "vehicles": [
                {
                    "namespace": namespace,
                    "template": template,
                    "type": kind,
                    "address": "127.0.0.%d" % (k + 2),
                    "start": {"position_m": [0, 0, 0]},
                }
                for k, (namespace, template, kind) in enumerate(vehicles)
            ],
        }
    )


def test_vehicle_is_found_by_name():
    two = fleet(("risc1", "Raven", "ardrone"), ("risc2", "iris_1", "iris"))
    assert one("", "risc1", two) == ("Raven", "ardrone"), "the fleet overrides the lab's table"
    assert one("", "risc2", two) == ("iris_1", "iris")
    assert one("iris_1", "risc1", two) == ("iris_1", "iris")
    assert one("condor", "risc1", two) == ("condor", "ardrone")
    assert one("", "", fleet(("risc1", "Raven", "ardrone"))) == ("Raven", "ardrone")
    assert one("", "risc1", None) == ("fluffy_II", "ardrone")
    assert one("", "risc2", None) == ("albatross", "ardrone")
    assert one("", "risc3", None) == ("Raven", "ardrone")
    for namespace, known in (("risc3", two), ("", two), ("", None), ("risc4", None)):
        with pytest.raises(ValueError, match="~vehicle"):
            one("", namespace, known)


def test_only_the_virtual_lab_flies_without_the_ladder():
    _without_ladder(FLEET, FLEET.vehicles)
    _without_ladder(FLEET.in_subnet("127.77"), FLEET.in_subnet("127.77").vehicles)
    real = FLEET.in_subnet("10.1")
    mocap, vehicles = (replace(FLEET, **{name: getattr(real, name)}) for name in ("mocap", "vehicles"))
    serial = replace(FLEET, vehicles=(replace(FLEET.vehicles[0], devices={"arduino": "/dev/ttyACM0"}),))
    for fleet_file in (real, mocap, vehicles, serial):
        with pytest.raises(ValueError, match="~ladder"):
            _without_ladder(fleet_file, fleet_file.vehicles)
    for fleet_file in (FLEET, None):
        with pytest.raises(ValueError, match="~ladder"):
            _without_ladder(fleet_file, [unplaced_vehicle("risc9", "buzzard")])
