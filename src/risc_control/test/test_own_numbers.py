"""Controller parameters of a single vehicle, or of a type of vehicle."""

import shutil
from dataclasses import dataclass, replace

import numpy as np
import pytest

from risc_control import controllers
from risc_control.controllers import ControlLoop, own_params
from risc_lab.lab.fleet import fleet_from_dict
from risc_lab.lab.vehicle_types import load_vehicle_type, vehicle_type_file
from risc_lab.registry import VARIABLE
from risc_lab.settings import Count, Settings
from risc_lab.states import S, States

WEAK = {"q_position": 20.0, "error_max_m": 0.2}


def fleet(*entries):
    """Vehicles of a fleet file: one for each (type, its `controllers`)."""
    place = {"start": {"position_m": [0, 0, 0]}}
    vehicles = [
        {"namespace": "risc%d" % k, "template": "T%d" % k, "address": "127.0.0.%d" % k, "type": kind, **place}
        | {"controllers": own}
        for k, (kind, own) in enumerate(entries, 1)
    ]
    content = {"name": "test", "mocap": {"host": "127.0.0.9"}, "vehicles": vehicles}
    found = fleet_from_dict(content)
    assert fleet_from_dict(found.to_dict()) == found
    return found.vehicles


@pytest.fixture
def heavy(monkeypatch, tmp_path):
    """The folder of a vehicle type with controller parameters of its own."""
    folder = tmp_path / "vehicle_types"
    folder.mkdir()
    shutil.copy(vehicle_type_file("ardrone"), folder / "heavy.yaml")
    with open(folder / "heavy.yaml", "a", encoding="utf-8") as file:
        file.write("controllers: {differential_flatness: {q_position: 50, q_yaw: 1}}\n")
    (folder / "heavy.py").write_text("from risc_control.vehicles.ardrone import Adapter\n", encoding="utf-8")
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    return folder


def flown(name, own, frames=40):
    """(frames, 4, n) /controls of vehicles that are off their references."""
    n = len(own)
    loop = ControlLoop(name, [load_vehicle_type("ardrone")] * n, own=own)
    everyone, rng, answers = np.ones(n, dtype=bool), np.random.default_rng(1), []
    for k in range(frames):
        x = np.zeros((n, len(S)))
        x[:, : S.U] = 0.01 * rng.standard_normal((1, 3)) + (0.3, -0.2, 0.9)
        reference = np.zeros((5, n, 4))
        reference[0, :, 2:] = 1.0, 0.3
        stamp_s = 0.005 * k
        for i in range(n):
            loop.sent.append(i, stamp_s, 0.01 * rng.standard_normal(4))
        output = loop.update(stamp_s, stamp_s + 0.006, States(everyone, x), reference, reference, everyone, everyone)
        answers.append([*output.controls])
    return np.array(answers)


@pytest.mark.parametrize("name", ["differential_flatness", "thesis_lqr", "guidance"])
def test_each_vehicle_is_flown_as_if_all_had_its_numbers(name):
    own = [{}, WEAK, WEAK, {}]
    mixed, plain, weak = flown(name, own), flown(name, [{}] * 4), flown(name, [WEAK] * 4)
    assert np.array_equal(mixed[:, :, [0, 3]], plain[:, :, [0, 3]])
    assert np.array_equal(mixed[:, :, 1:3], weak[:, :, 1:3])
    assert not np.array_equal(plain, weak)


def test_own_numbers_stay_when_those_of_all_change():
    loop = ControlLoop("thesis_lqr", [load_vehicle_type("ardrone")] * 2, own=[{}, {"q_position": 20.0}])
    params = controllers.default_params("thesis_lqr")
    loop.set_params(type(params)(q_position=40.0, q_yaw=9.0))
    (first, _), (second, _) = loop.controller.design(loop.params)
    assert (first.q_position, second.q_position, second.q_yaw) == (40.0, 20.0, 9.0)


def test_a_vehicles_numbers_are_its_types_and_then_its_own(heavy):
    vehicles = fleet(("ardrone", {}), ("heavy", {"thesis_lqr": {"q_yaw": 2.0}}),
                     ("heavy", {"differential_flatness": {"q_position": 70}}))  # fmt: skip
    own = own_params("differential_flatness", vehicles, "my.yaml")
    assert own == [{}, {"q_position": 50.0, "q_yaw": 1.0}, {"q_position": 70.0, "q_yaw": 1.0}]
    assert own_params("thesis_lqr", vehicles, "my.yaml") == [{}, {"q_yaw": 2.0}, {}]


@pytest.mark.parametrize(
    ("own", "said"),
    [
        (
            {"differential_flatness": {"q_posit": 1}},
            "my.yaml: vehicle 'risc2': .*flatness: .* q_posit; known",
        ),
        ({"differential_flatness": {"r_yaw": 0}}, "my.yaml: vehicle 'risc2': .*'r_yaw' .* > 0"),
        (
            {"diferential": {}},
            "my.yaml: vehicle 'risc2': .*'diferential'; known",
        ),
    ],
)
def test_what_is_wrong_is_said_with_file_vehicle_and_key(own, said):
    with pytest.raises(ValueError, match=said):
        own_params("differential_flatness", fleet(("ardrone", {}), ("ardrone", own)), "my.yaml")


def test_a_wrong_number_of_a_type_is_said_with_its_file(heavy):
    text = (heavy / "heavy.yaml").read_text(encoding="utf-8").replace("q_yaw: 1", "q_yaw: -1")
    (heavy / "heavy.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match="heavy.yaml: controllers: differential_flatness: 'q_yaw'"):
        own_params("differential_flatness", fleet(("heavy", {})), "my.yaml")


def test_whole_numbers_are_whole_for_the_controller(monkeypatch):
    @dataclass(frozen=True)
    class Counting(Settings):
        samples: Count = 3

    monkeypatch.setattr(controllers, "default_params", lambda name: Counting())
    (own,) = own_params("thesis_lqr", fleet(("ardrone", {"thesis_lqr": {"samples": 5}})), "my.yaml")
    assert repr(replace(Counting(), **own).samples) == "5"


def test_too_high_an_order_is_refused_when_the_controller_is_loaded():
    class Thirteen(controllers.Controller):
        ORDER = 13

    with pytest.raises(ValueError, match=" 13 .* 12"):
        ControlLoop(Thirteen, [load_vehicle_type("ardrone")])


def test_sliders_have_the_limits_of_the_class():
    pytest.importorskip("rospy")
    from risc_control.ros.controller_node import reconfigurable

    config = reconfigurable(controllers.default_params("thesis_lqr"), controllers.descriptions("thesis_lqr"))
    texts = {item["name"]: item["description"] for item in config.config_description["parameters"]}
    assert texts["q_position"] == "[1/m^2] horizontal" and set(texts) == set(config.defaults)
    assert set(config.min) == set(config.max) == set(config.defaults) and "q_position" in config.defaults
    assert set(config.min.values()) == {0.0} and set(config.max.values()) == {np.inf}


def test_numbers_that_are_not_the_files_are_told():
    pytest.importorskip("rospy")
    from risc_control.ros.controller_node import other_numbers

    defaults = controllers.default_params("thesis_lqr")
    assert other_numbers(defaults, defaults) == ""
    told = other_numbers(type(defaults)(q_position=5.5), defaults) % "/controller"
    assert "q_position 5.5 (%s)" % defaults.q_position in told and "q_velocity" not in told
    assert "rosparam delete /controller/" in told
