"""A controller and a vehicle type from elsewhere, each one file and one YAML in the folder `members`, flown offline."""

import json
import math
import pathlib
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from risc_control.controllers import REGISTRY, ControlLoop
from risc_control.vehicle_pilot import OwnState
from risc_control.vehicles import Command, ControlsConverter, adapter_class
from risc_experiments.fleets import default_fleet
from risc_experiments.offline import FRAME_S, Flight, fly
from risc_lab.frames import GRAVITY_M_S2
from risc_lab.lab import load_vehicle_type
from risc_lab.states import S
from risc_simulator.faults import parse_fault
from risc_simulator.vehicles import virtual_type

MEMBERS = pathlib.Path(__file__).parent / "members"
SPRING = MEMBERS.parents[2] / "risc_simulator" / "test" / "members"
BALL_MARKERS = {"a": [0.02, 0.0, 0.0], "b": [-0.01, 0.0173, 0.0], "c": [-0.01, -0.0173, 0.0]}
BALL = {"geometries": {"ball": BALL_MARKERS}, "templates": {"ball": {"kind": "attached", "geometry": "ball"}}}
HANGS_M = 0.3 + 0.05 * GRAVITY_M_S2 / 4.0  # as in toy_spring.yaml


@pytest.fixture(autouse=True)
def members(monkeypatch):
    monkeypatch.setenv("RISC_MAAP_MEMBERS", str(MEMBERS))


def test_a_controller_of_a_student_flies():
    result = fly(Flight("circle", vehicles=1, seed=1, psi_deg=57.0, duration_s=6.0, controller="toy_pd"))
    assert result.rmse_m[0] < 0.15


def test_a_controller_of_order_six_sees_exact_derivatives(monkeypatch):
    """On a circle the fifth is w^4 times the velocity, the sixth w^4 times the acceleration."""
    monkeypatch.setenv("RISC_MAAP_MEMBERS", str(MEMBERS.parents[2] / "risc_control" / "test" / "members"))
    result = fly(Flight("circle", vehicles=1, seed=1, duration_s=4.0, controller="sixth"))
    assert result.rmse_m[0] < 0.02
    seen = REGISTRY.module("sixth").SEEN[1:]  # the first loads what is compiled
    w = 2.0 * math.pi / 8.0
    for times, reference, _ in seen[-int(4.0 / FRAME_S) :]:
        present, ahead = reference.present[:, 0], reference.ahead[:, 0]
        for found in (present, ahead):
            assert len(found) == 7
            assert found[5:, :2] == pytest.approx(w**4 * found[1:3, :2], abs=1e-6)
            assert np.linalg.norm(found[5, :2]) == pytest.approx(0.8 * w**5, abs=1e-6)
        turned = w * (times.now_s - times.stamp_s + 0.1 + 1.0 / 30.0)
        turn = np.array([[np.cos(turned), np.sin(turned)], [-np.sin(turned), np.cos(turned)]])
        assert ahead[:, :2] == pytest.approx(present[:, :2] @ turn, abs=1e-6)
    jumps = np.abs(np.diff([reference.present[:, 0, :3] for _, reference, _ in seen], axis=0)).max(axis=(0, 2))
    assert (jumps < 0.2).all(), "continuous to the sixth, on the way as well"


def test_a_controller_sees_how_far_the_states_can_be_wrong(monkeypatch):
    """With a filter that has covariances; they are larger for a vehicle that was not seen for a moment."""
    monkeypatch.setenv("RISC_MAAP_MEMBERS", str(MEMBERS.parents[2] / "risc_control" / "test" / "members"))
    seen = REGISTRY.module("sixth").SEEN
    flight = Flight("circle", vehicles=2, seed=1, duration_s=1.0, controller="sixth")
    seen.clear()
    result = fly(replace(flight, estimator="ekf", faults=(parse_fault("occlusion:0.2,risc2@1"),)))
    covariances = np.array([covariances for _, _, covariances in seen[1:]])  # the first loads what is compiled
    times_s = np.array([times.stamp_s for times, *_ in seen[1:]]) - result.reached_s
    deviations_m = np.sqrt(covariances[:, :, S.X, S.X])
    assert deviations_m.shape == (len(times_s), 2)
    before, lost = (times_s > 0.5) & (times_s < 1.0), (times_s > 1.15) & (times_s < 1.2)
    assert np.median(deviations_m[lost, 1]) > 3.0 * np.median(deviations_m[before, 1])
    assert np.median(deviations_m[lost, 0]) < 1.2 * np.median(deviations_m[before, 0])
    seen.clear()
    fly(replace(flight, estimator="least_squares"))
    assert len(seen) > 100 and all(covariances is None for _, _, covariances in seen)


def test_a_controller_reacts_to_what_a_vehicle_carries(monkeypatch, tmp_path):
    """The second of two carries a ball on a spring; `toy_carrier` lets that follow the course, 0.3 m below it."""
    monkeypatch.setenv("RISC_MAAP_MEMBERS", "%s:%s" % (MEMBERS, SPRING))

    def errors_m(controller, own=None, params=None):
        content = default_fleet(2, "circle").to_dict() | {"templates": BALL}
        carries = {"attached": {"body": "toy_spring", "template": "ball"}, "controllers": {controller: own or {}}}
        content["vehicles"] = [content["vehicles"][0], content["vehicles"][1] | carries]
        (tmp_path / "fleet.yaml").write_text(json.dumps(content), encoding="utf-8")
        flown = {"fleet": str(tmp_path / "fleet.yaml"), "controller": controller, "params": params}
        result = fly(Flight("circle", vehicles=2, seed=1, psi_deg=20.0, duration_s=4.0, **flown))
        return (result.actual_m - result.reference_m)[result.judged]

    blind_m, looking_m = errors_m("toy_pd"), errors_m("toy_carrier", params={"below_m": 0.3})
    np.testing.assert_array_equal(looking_m[:, 0], blind_m[:, 0])
    higher_m = (looking_m - blind_m)[:, 1, 2].mean()
    assert higher_m == pytest.approx(HANGS_M - 0.3, abs=0.01)
    np.testing.assert_array_equal(errors_m("toy_carrier", own={"below_m": 0.3}), looking_m)


def test_one_controller_flies_a_fleet_of_two_types():
    """Other delays, rates, units on /controls and sticks."""
    result = fly(Flight("circle", vehicles=2, seed=1, psi_deg=115.0, duration_s=8.0, types=("ardrone", "toy_quad")))
    assert result.rmse_m.max() < 0.03


@pytest.mark.parametrize(
    ("own", "complaint"),
    [
        ("{lift: 2.4, lifts: 3}", "own: .* lifts; .* lift$"),
        ("{lift: much}", "own: 'lift' .*'much'"),
        ("{}", "own: 'lift' is missing"),
    ],
)
def test_numbers_of_its_own_are_read_as_strictly_as_the_others(monkeypatch, tmp_path, own, complaint):
    """By the adapter and by the virtual vehicle, before the flight."""
    shutil.copytree(MEMBERS, tmp_path / "members")
    monkeypatch.setenv("RISC_MAAP_MEMBERS", str(tmp_path / "members"))
    path = tmp_path / "members/vehicle_types/toy_quad.yaml"
    path.write_text(re.sub("(?m)^own:.*$", "own: " + own, path.read_text()))
    toy, error = load_vehicle_type("toy_quad"), "%s: %s" % (re.escape(str(path)), complaint)
    with pytest.raises(ValueError, match=error):
        adapter_class(toy)
    with pytest.raises(ValueError, match=error):
        virtual_type("toy_quad").Firmware(toy, np.random.default_rng(0), False, 0.0)


def test_who_has_no_numbers_of_its_own_takes_none():
    with pytest.raises(ValueError, match="ardrone.yaml: own: .* lift"):
        adapter_class(replace(load_vehicle_type("ardrone"), own={"lift": 2.0}))


def test_with_the_delay_of_the_other_type_it_flies_worse():
    """Each vehicle is controlled with its own delay."""
    types = [load_vehicle_type(name) for name in ("ardrone", "toy_quad")]
    loop = ControlLoop("differential_flatness", types)
    delays_s = loop.controller.delay_s
    assert delays_s == pytest.approx([0.1 + 1.0 / 30.0, 0.05 + 1.0 / 50.0])
    times_s = loop.times_s(5.0, 5.006)
    values = np.broadcast_to(times_s[:, None, None, None], (3, 5, 2, 4))
    present, ahead = loop.pick(values)
    assert (present == 5.0).all() and ahead[0, :, 0] == pytest.approx(5.006 + delays_s)


def test_its_gains_and_units_are_its_own():
    types = [load_vehicle_type("ardrone"), load_vehicle_type("toy_quad")]
    nobody = np.zeros(2, dtype=bool)
    command = Command(*np.array([[0.1, 0.1], [0.0, 0.0], [0.0, 0.0], [5.0, 5.0]]))
    controls, _ = ControlsConverter(types)(command, ~nobody, nobody)
    assert controls.phi == pytest.approx([-0.1 / (1.1714 * 0.349066), 0.1]), "a fraction; radians"
    adapter = adapter_class(types[1])(types[1], 49.0)
    sinks = OwnState((0.0, 0.0, 1.0), (0.0, 0.0, -0.2), 0.0, 0.0, 0.0)
    weights = adapter.numbers.weights(adapter.move(0.0, 0.0, 0.0, sinks).up)
    assert not adapter.HOLDS_POSITION and weights > 1.05, "it is held by us"


def test_what_the_fleet_file_says_counts_for_controller_adapter_and_plant():
    heavy = load_vehicle_type("ardrone", {"mass_kg": 0.6})
    assert heavy == replace(load_vehicle_type("ardrone"), mass_kg=0.6)
    nobody = np.zeros(1, dtype=bool)
    level, _ = ControlsConverter([heavy])(Command(*np.zeros((4, 1))), nobody, nobody)
    assert level.thrust_n[0] == pytest.approx(0.6 * GRAVITY_M_S2)
    result = fly(Flight("circle", vehicles=1, seed=1, duration_s=4.0, overrides={"mass_kg": 0.6, "climb_max_m_s": 0.5}))
    assert result.rmse_m[0] < 0.02
