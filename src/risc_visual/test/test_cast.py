"""Which vehicles are drawn, where, and with which airframe."""

from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from drawn import NOW_S, scene
from geometry_msgs.msg import Point
from scipy.spatial.transform import Rotation
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker

from risc_lab.lab import load_vehicle_type
from risc_lab.lab.vehicle_types import vehicle_type_file
from risc_lab.phases import phase_words
from risc_msgs.msg import Cortex, States
from risc_visual.drawing.cast import Index, reference_marks, title_text
from risc_visual.drawing.palette import vehicle_colour
from risc_visual.drawing.ros.airframes import parts_of

NAN = float("nan")


def state(name="Raven", visible=True, at=(1.0, 2.0, 3.0), euler_deg=(0.0, 0.0, 0.0)):
    return States(name, visible, *at, *[0.0] * 3, *euler_deg, *[0.0] * 3)


def drawn_of(drawing, *states):
    """{name: parts} of what draw_cortex makes of a message; of a vehicle the hull comes first."""
    found = {}
    for marker in drawing.vehicles(Cortex(Obj=list(states)), NOW_S)[0]:
        found.setdefault(marker.ns, []).append(marker)
    return found


def is_grey(parts):
    return {(m.color.r, m.color.g, m.color.b) for m in parts} == {(0.6, 0.6, 0.6)}


def test_a_name_keeps_its_number():
    index = Index(["fluffy_II", "albatross", "fluffy_II"])
    assert [index[name] for name in ("Raven", "albatross", "Kahn", "Raven", "fluffy_II")] == [2, 1, 3, 2, 0]


@pytest.mark.parametrize(
    "euler_deg, nose, right, belly",
    [
        ((0, 0, 0), (1, 0, 0), (0, -1, 0), (0, 0, -1)),
        ((0, 0, 90), (0, -1, 0), (-1, 0, 0), (0, 0, -1)),  # yaw is clockwise from above
        ((0, 90, 0), (0, 0, 1), (0, -1, 0), (1, 0, 0)),  # pitch lifts the nose
        ((90, 0, 0), (1, 0, 0), (0, 0, -1), (0, 1, 0)),  # roll lowers the right wing
    ],
)
def test_attitude_is_drawn_in_the_senses_of_the_message(euler_deg, nose, right, belly):
    turn = drawn_of(scene(), state(euler_deg=euler_deg))["Raven"][0].pose.orientation
    axes = Rotation.from_quat((turn.x, turn.y, turn.z, turn.w)).apply(np.eye(3))
    np.testing.assert_allclose(axes, [nose, right, belly], atol=1e-12)


def test_unseen_is_not_drawn_and_lost_stays_where_it_was():
    drawing = scene()
    assert drawn_of(drawing, state(visible=False, at=(0.0, 0.0, 0.0))) == {}
    seen = drawn_of(drawing, state())["Raven"]
    lost = drawn_of(drawing, state(visible=False, at=(9.0, 9.0, 9.0)))["Raven"]
    assert [m.pose for m in lost] == [m.pose for m in seen]
    assert is_grey(lost) and not is_grey(seen)
    assert not is_grey(drawn_of(drawing, state(at=(0.0, 0.0, 1.0)))["Raven"])


@pytest.mark.parametrize("broken", [{"at": (NAN, 0.0, 0.0)}, {"euler_deg": (0.0, NAN, 0.0)}])
def test_numbers_that_are_none_count_as_lost(broken):
    drawing = scene()
    drawn_of(drawing, state(), state("Kahn"))
    found = drawn_of(drawing, state(**broken), state("Kahn", at=(0.5, 0.0, 1.0)))
    assert is_grey(found["Raven"]) and found["Raven"][0].pose.position == Point(1.0, 2.0, 3.0)
    assert not is_grey(found["Kahn"]) and found["Kahn"][0].pose.position == Point(0.5, 0.0, 1.0)


def test_order_of_the_message_changes_no_colour():
    drawing = scene(vehicles=("fluffy_II", "albatross"))
    states = [state("albatross"), state(), state("fluffy_II")]
    there, back = (
        {name: parts[0].color for name, parts in drawn_of(drawing, *order).items()} for order in (states, states[::-1])
    )
    assert there == back
    assert there["fluffy_II"] == ColorRGBA(*vehicle_colour(0), 1.0) and there["Raven"] == ColorRGBA(
        *vehicle_colour(2), 1.0
    )


def test_type_chooses_the_airframe():
    fleet = [SimpleNamespace(template="IRIS", type="iris"), SimpleNamespace(template="odd", type="no such type")]
    found = drawn_of(scene(fleet), state("IRIS"), state("odd"), state("Raven"))
    hulls_m = {name: parts[0].scale.x for name, parts in found.items()}
    assert hulls_m == {
        "IRIS": parts_of("iris")[0].size_m[0],
        **dict.fromkeys(("odd", "Raven"), parts_of("ardrone")[0].size_m[0]),
    }


def test_a_type_from_elsewhere_says_its_size(tmp_path, monkeypatch):
    content = yaml.safe_load(vehicle_type_file("ardrone").read_text(encoding="utf-8"))
    (tmp_path / "vehicle_types").mkdir()
    for name, size in (("small", {"arm_m": 0.05, "rotor_m": 0.06, "hull_m": [0.04, 0.03, 0.02]}), ("plain", None)):
        text = yaml.safe_dump({**content, "name": name, "airframe": size})
        (tmp_path / "vehicle_types" / (name + ".yaml")).write_text(text, encoding="utf-8")
    monkeypatch.setenv("RISC_MAAP_MEMBERS", str(tmp_path))
    assert parts_of("small")[0].size_m == (0.04, 0.03, 0.02)
    assert parts_of("plain") == parts_of("ardrone")


@pytest.mark.parametrize("name", ["ardrone", "iris"])
def test_airframes_are_symmetric_with_a_painted_front(name):
    parts = parts_of(name)
    rotors = [part for part in parts if part.shape == Marker.CYLINDER]
    assert len(rotors) == 4
    np.testing.assert_allclose(np.sum([part.centre_m[:2] for part in rotors], axis=0), (0, 0), atol=1e-12)
    assert all(part.painted == (part.centre_m[0] > 0) for part in rotors)
    assert all(part.centre_m[2] < 0 for part in rotors)  # above the hull: z points to the belly
    gaps = [np.hypot(*np.subtract(a.centre_m, b.centre_m)[:2]) for a in rotors for b in rotors if a is not b]
    assert min(gaps) >= rotors[0].size_m[0]  # discs do not cut each other
    (arrow,) = (part for part in parts if part.shape == Marker.ARROW)
    assert arrow.points_m[1][0] > arrow.points_m[0][0] > 0
    reach_m = max(np.hypot(*part.centre_m[:2]) + 0.5 * part.size_m[0] for part in rotors)
    assert reach_m == pytest.approx(load_vehicle_type(name).radius_m, abs=0.03), "an AR.Drone's hull gives way a little"


@pytest.mark.parametrize("tip_m, foot_m", [((0.9, 0.0, 2.0), (1.0, 0.0, 1.0)), ((0.0, 5.0, 2.0), None)])
def test_rod_stands_on_the_nearest_vehicle_within_reach(tip_m, foot_m):
    vehicles = state("a", at=(0.0, 0.0, 1.0)), state("b", at=(1.0, 0.0, 1.0))
    parts = drawn_of(scene(), *vehicles, state("Pendulum_tip", at=tip_m))["Pendulum_tip"]
    assert [m.points[0] for m in parts if m.id == 2] == ([Point(*foot_m)] if foot_m else [])
    (alone,) = drawn_of(scene(), state("Pendulum_tip", at=tip_m))["Pendulum_tip"]
    assert alone.id == 1


def test_references_are_marked_at_rest_or_when_their_vehicle_is_away():
    references = {
        "at_rest": (0, 0, 1),
        "followed": (1, 0, 1),
        "left": (2, 0, 1),
        "lost": (0, 1, 1),
        "Circle": (0, 0, 1),
    }
    speeds = dict(dict.fromkeys(references, 0.6), at_rest=0.0)
    positions = {"at_rest": (0.1, 0.0, 1.0), "followed": (1.0, 0.1, 1.0), "left": (2.0, 0.5, 1.0)}
    marks = reference_marks(references, speeds, positions, set(references) - {"Circle"}, 0.4)
    assert marks == [("at_rest", False), ("left", True), ("lost", True)]


def test_title_says_it_in_one_word_if_it_can():
    vehicles = [SimpleNamespace(name="fluffy_II", phase=2), SimpleNamespace(name="Raven", phase=1)]
    assert phase_words(vehicles) == {"fluffy_II": "course", "Raven": "approach"}
    assert title_text("circles3", {"a": "course", "b": "course"}) == "circles3\ncourse"
    assert title_text("", {"a": "course", "b": "home"}) == "a: course\nb: home"
    assert title_text("", {"a": "Circle"}) == "a: Circle"
    assert title_text("", {}) == ""
