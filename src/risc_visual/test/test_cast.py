"""Who is drawn, where, and as what."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from risc_lab.phases import phase_words
from risc_visual.drawing.airframes import AIRFRAMES, PAINT, vehicle_colour
from risc_visual.drawing.cast import Cast, Index, Pose, reference_marks, rod_foot, title_text

NAN = float("nan")


def pose(name="Raven", visible=True, at=(1.0, 2.0, 3.0), euler=(0.0, 0.0, 0.0)):
    return Pose(name, visible, at, euler)


def view_of(**options):
    return Cast(Index()).views([pose(**options)])[0]


@pytest.mark.parametrize(
    "euler_deg, nose, right",
    [
        ((0, 0, 0), (1, 0, 0), (0, -1, 0)),
        ((0, 0, 90), (0, -1, 0), (-1, 0, 0)),  # yaw is clockwise from above
        ((0, 90, 0), (0, 0, 1), (0, -1, 0)),  # pitch lifts the nose
        ((90, 0, 0), (1, 0, 0), (0, 0, -1)),  # roll lowers the right wing
    ],
)
def test_attitude_is_drawn_in_the_senses_of_the_message(euler_deg, nose, right):
    turn = Rotation.from_quat(view_of(euler=tuple(np.radians(euler_deg))).quaternion)
    np.testing.assert_allclose(turn.apply([(1, 0, 0), (0, 1, 0)]), [nose, right], atol=1e-12)


def test_belly_is_below():
    np.testing.assert_allclose(Rotation.from_quat(view_of().quaternion).apply((0, 0, 1)), (0, 0, -1), atol=1e-12)


def test_unseen_is_not_drawn_and_lost_stays_where_it_was():
    cast = Cast(Index())
    assert cast.views([pose(visible=False, at=(0.0, 0.0, 0.0))]) == []
    seen = cast.views([pose()])[0]
    lost = cast.views([pose(visible=False, at=(9.0, 9.0, 9.0))])[0]
    assert not seen.lost and lost.lost
    assert (lost.position_m, lost.quaternion) == (seen.position_m, seen.quaternion)
    assert not cast.views([pose(at=(0.0, 0.0, 1.0))])[0].lost


@pytest.mark.parametrize("broken", [{"at": (NAN, 0.0, 0.0)}, {"euler": (0.0, NAN, 0.0)}])
def test_numbers_that_are_none_count_as_lost(broken):
    cast = Cast(Index())
    cast.views([pose(), pose("Kahn")])
    raven, kahn = cast.views([pose(**broken), pose("Kahn", at=(0.5, 0.0, 1.0))])
    assert raven.lost and raven.position_m == (1.0, 2.0, 3.0)
    assert not kahn.lost and kahn.position_m == (0.5, 0.0, 1.0)


def test_order_of_the_message_changes_neither_index_nor_colour():
    cast = Cast(Index(["fluffy_II", "albatross"]))
    there = {
        view.name: (view.index, view.colour) for view in cast.views([pose("albatross"), pose(), pose("fluffy_II")])
    }
    back = {view.name: (view.index, view.colour) for view in cast.views([pose("fluffy_II"), pose(), pose("albatross")])}
    assert there == back
    assert there["fluffy_II"] == (0, vehicle_colour(0)) and there["Raven"][0] == 2


def test_type_chooses_the_airframe():
    cast = Cast(Index(), {"IRIS": "iris", "odd": "no such type"})
    parts = {view.name: view.parts for view in cast.views([pose("IRIS"), pose("odd"), pose("Raven")])}
    assert parts["IRIS"] is AIRFRAMES["iris"]
    assert parts["odd"] is parts["Raven"] is AIRFRAMES["ardrone"]


@pytest.mark.parametrize("name", sorted(AIRFRAMES))
def test_airframes_are_symmetric_with_a_painted_front(name):
    parts = AIRFRAMES[name]
    rotors = [part for part in parts if part.shape == "cylinder"]
    assert len(rotors) == 4
    np.testing.assert_allclose(np.sum([part.centre_m[:2] for part in rotors], axis=0), (0, 0), atol=1e-12)
    assert all((part.colour == PAINT) == (part.centre_m[0] > 0) for part in rotors)
    assert all(part.centre_m[2] < 0 for part in rotors)  # above the hull: z points to the belly
    gaps = [np.hypot(*np.subtract(a.centre_m, b.centre_m)[:2]) for a in rotors for b in rotors if a is not b]
    assert min(gaps) >= rotors[0].size_m[0]  # discs do not cut each other
    (arrow,) = (part for part in parts if part.shape == "arrow")
    assert arrow.points_m[1][0] > arrow.points_m[0][0] > 0


def test_rod_stands_on_the_nearest_vehicle_within_reach():
    views = Cast(Index()).views([pose("a", at=(0.0, 0.0, 1.0)), pose("b", at=(1.0, 0.0, 1.0))])
    assert rod_foot((0.9, 0.0, 2.0), views) == (1.0, 0.0, 1.0)
    assert rod_foot((0.0, 5.0, 2.0), views) is None
    assert rod_foot((0.0, 0.0, 2.0), []) is None


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
