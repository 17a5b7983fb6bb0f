"""risc_control.separation: which vehicles are too near to each other, with fleets placed by the test."""

import dataclasses
import math

import numpy as np
import pytest

from risc_control.safety import SafetyLimits
from risc_control.separation import ALONE, Separation
from risc_lab.lab import load_vehicle_type
from risc_lab.states import S

LIMITS = SafetyLimits()
NEAR_M, STRAY_M, COURSE_M = LIMITS.separation_m, LIMITS.separation_stray_m, LIMITS.separation_course_m
NAMES = ("fluffy_II", "albatross", "Raven")
AT_REST = (0.0, 0.0, 0.0)
IRIS_M = load_vehicle_type("iris").wider_m


class Sky:
    """Vehicles at places with velocities; all are seen and checked every 20 ms, by one node for all of `own`, and by
    one node for each.
    """

    def __init__(self, places, own=None, limits=LIMITS, fleet=None, wider_m=None):
        """places: {name: position}."""
        self.places = dict(places)
        self.velocities = dict.fromkeys(places, AT_REST)
        self.references, self.speeds, self.turns = {}, {}, {}  # {name: place, velocity, acceleration}
        self.hidden, self.standing = set(), set()
        self.now_s = 100.0
        self.order = list(places)
        own, fleet = own or tuple(places), tuple(places) if fleet is None else fleet
        self.own = own
        self.separations = [Separation(names, limits, fleet, wider_m) for names in (own, *((name,) for name in own))]

    def look(self, duration_s=0.02):
        """{name: Look} after duration_s."""
        for _ in range(round(duration_s / 0.02)):
            self.now_s += 0.02
            names, states = tuple(self.order), np.zeros((len(self.order), len(S)))
            for row, name in enumerate(self.order):
                states[row, S.X : S.U], states[row, S.U : S.PHI] = self.places[name], self.velocities[name]
            visible = np.array([name not in self.hidden for name in names])
            referred, derivatives = tuple(self.references), np.zeros((len(self.references), 3, 4))
            for row, name in enumerate(referred):
                derivatives[row, 0, :3] = self.references[name]
                derivatives[row, 1, :3] = self.speeds.get(name, AT_REST)
                derivatives[row, 2, :3] = self.turns.get(name, AT_REST)
            looks = []
            for separation in self.separations:
                separation.see(names, visible, states, self.now_s)
                separation.refer(referred, derivatives, self.now_s)
                separation.tell((), self.standing)
                looks.append(separation.look(self.now_s + 0.004))
        for name, alone in zip(self.own, looks[1:]):
            assert alone.get(name, ALONE) == looks[0].get(name, ALONE), "every node comes to the same result"
        return {name: looks[0].get(name, ALONE) for name in self.own}

    def slide(self, name, to):
        """Let a reference move somewhere else, too slowly for a jump; returns the last looks."""
        start, end = np.array(self.references[name]), np.array(to)
        for part in np.linspace(0.0, 1.0, 21):
            self.references[name] = tuple(start + part * (end - start))
            looks = self.look()
        return looks


def pair(distance_m, height_m=1.0, **options):
    return Sky({"fluffy_II": (0.0, 0.0, height_m), "albatross": (distance_m, 0.0, height_m)}, **options)


def near(looks):
    return {name for name, look in looks.items() if look.holds}


# --- distance -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("distance_m", "is_near"), [(NEAR_M + 0.01, False), (NEAR_M - 0.01, True)])
def test_the_limit(distance_m, is_near):
    looks = pair(distance_m).look()
    assert near(looks) == (set(NAMES[:2]) if is_near else set())
    assert ("albatross" in looks["fluffy_II"].reason) == is_near


@pytest.mark.parametrize("turn_rad", [0.0, 1.0, 2.0, 4.0])
def test_who_will_be_too_near_before_it_can_stop_is_near(turn_rad):
    """By the velocities of both; not if they move apart, or pass each other at a sufficient distance."""
    along = np.array([math.cos(turn_rad), math.sin(turn_rad), 0.0])
    across = np.array([-along[1], along[0], 0.0])
    far_m = NEAR_M + LIMITS.separation_lookahead_s * 0.6
    for apart_m, speed_m_s, other_m_s, is_near in (
        (far_m * along - 0.02 * along, 0.6, 0.0, True),
        (far_m * along + 0.02 * along, 0.6, 0.0, False),
        (far_m * along - 0.02 * along, 0.3, 0.3, True),
        (far_m * along - 0.02 * along, -0.6, 0.0, False),
        (far_m * along - 0.02 * along, 0.6, -0.6, False),  # the other flies on ahead, as fast
        (0.5 * along + (NEAR_M + 0.02) * across, 0.6, 0.0, False),
        (0.5 * along + (NEAR_M - 0.02) * across, 0.6, 0.0, True),
    ):
        sky = Sky({"fluffy_II": (0.0, 0.0, 1.0), "albatross": tuple(apart_m + (0.0, 0.0, 1.0))})
        sky.velocities = {"fluffy_II": tuple(speed_m_s * along), "albatross": tuple(-other_m_s * along)}
        assert bool(near(sky.look())) == is_near, (apart_m, speed_m_s, other_m_s)


def test_a_distance_in_height_counts():
    sky = Sky({"fluffy_II": (0.0, 0.0, 1.0), "albatross": (0.0, 0.0, 1.0 + NEAR_M + 0.02)})
    assert not near(sky.look())
    sky.velocities["albatross"] = (0.0, 0.0, -0.1)
    assert near(sky.look()) == set(NAMES[:2])


def test_vehicles_on_the_floor_are_no_reason_and_have_none():
    sky = pair(0.3)
    sky.places["albatross"] = (0.3, 0.0, 0.1)
    assert not near(sky.look())
    sky.places["fluffy_II"] = (0.0, 0.0, 0.1)
    assert not near(sky.look())


def test_a_single_vehicle_is_alone():
    sky = Sky({"fluffy_II": (0.0, 0.0, 1.0)})
    sky.references["fluffy_II"] = (0.0, 0.0, 1.0)
    assert sky.look() == {"fluffy_II": ALONE}
    assert Separation(("fluffy_II",), LIMITS).look(5.0) == {}, "nothing is known yet"


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_numbers_that_are_none_change_nothing(value):
    sky = pair(0.7)
    sky.references = {name: sky.places[name] for name in NAMES[:2]}
    sky.look()
    sky.places["albatross"], sky.references["albatross"] = (value, 0.0, 1.0), (0.7, value, 1.0)
    assert sky.look(0.1) == dict.fromkeys(NAMES[:2], ALONE)
    sky.places["albatross"] = (0.5, 0.0, 1.0)
    assert near(sky.look()) == set(NAMES[:2])


def test_zero_is_off():
    limits = dataclasses.replace(LIMITS, separation_m=0.0)
    sky = pair(0.2, limits=limits)
    sky.hidden = {"albatross"}
    assert not near(sky.look(1.0))


# --- vehicles that reach farther than an AR.Drone ---------------------------------------------------------------------


WIDE = [("albatross",), ("fluffy_II",), NAMES[:2]]  # which of the pair are IRIS+


def irises(names):
    """(wider_m of a Separation in which these are IRIS+, how much farther than AR.Drones the pair has to be apart)"""
    return dict.fromkeys(names, IRIS_M), len(names) * IRIS_M


def test_the_rule_acts_before_contact():
    ardrone, iris = (load_vehicle_type(name) for name in ("ardrone", "iris"))
    assert (ardrone.wider_m, IRIS_M) == (0.0, pytest.approx(0.15))
    assert dataclasses.replace(iris, radius_m=0.05).wider_m == 0.0, "a small one is given as much room as an AR.Drone"
    for one, other in ((ardrone, ardrone), (ardrone, iris), (iris, iris)):
        assert NEAR_M + one.wider_m + other.wider_m >= one.radius_m + other.radius_m + 0.05 - 1e-9


@pytest.mark.parametrize("wide", WIDE)
def test_wide_ones_hold_at_the_same_gap_between_hulls(wide):
    wider_m, more_m = irises(wide)
    assert not near(pair(NEAR_M + more_m + 0.01, wider_m=wider_m).look())
    looks = pair(NEAR_M + more_m - 0.01, wider_m=wider_m).look()
    assert near(looks) == set(NAMES[:2]) and "%.2f m from" % (NEAR_M + more_m - 0.01) in looks["albatross"].reason
    # the control arm: taken for AR.Drones they do not hold, although they touch already
    assert not near(pair(NEAR_M + 0.09).look()) and NEAR_M + 0.09 < 0.65


@pytest.mark.parametrize("wide", WIDE)
@pytest.mark.parametrize("follow", [False, True])
def test_wide_ones_are_told_as_early(wide, follow):
    """With the same time to stop, whether they follow their references or not."""
    wider_m, more_m = irises(wide)
    ahead_s = LIMITS.separation_follow_s if follow else LIMITS.separation_lookahead_s
    for spare_m in (-0.02, 0.02):
        sky = pair(NEAR_M + more_m + ahead_s * 0.6 + spare_m, wider_m=wider_m)
        sky.velocities["fluffy_II"] = (0.6, 0.0, 0.0)
        if follow:
            sky.references, sky.speeds = dict(sky.places), dict(sky.velocities)
        assert bool(near(sky.look())) == (spare_m < 0.0)


@pytest.mark.parametrize("wide", WIDE)
def test_wide_ones_keep_farther_from_one_that_is_not_seen_and_from_one_that_holds(wide):
    wider_m, more_m = irises(wide)
    for spare_m in (-0.02, 0.02):
        sky = pair(STRAY_M + more_m + spare_m, wider_m=wider_m)
        sky.look()
        sky.hidden = {"albatross"}
        assert near(sky.look(LIMITS.state_land_s + 0.1)) == ({"fluffy_II"} if spare_m < 0.0 else set())
        places = dict(pair(STRAY_M + more_m + spare_m).places)
        places["Raven"] = (places["albatross"][0] + 0.3, 0.0, 1.0)  # makes the albatross hold
        assert ("fluffy_II" in near(Sky(places, wider_m=wider_m).look())) == (spare_m < 0.0)


@pytest.mark.parametrize("wide", WIDE)
def test_wide_ones_land_farther_beside_each_other(wide):
    wider_m, more_m = irises(wide)
    for spare_m in (-0.02, 0.02):
        places = {"fluffy_II": (0.0, 0.0, 1.8), "albatross": (1.4 * NEAR_M + more_m + spare_m, 0.0, 1.0)}
        places["Raven"] = (0.0, 0.0, 2.2)  # makes it hold
        look = Sky(places, wider_m=wider_m).look()["fluffy_II"]
        assert look.holds and look.above == (spare_m < 0.0)


@pytest.mark.parametrize("wide", WIDE)
def test_wide_ones_give_way_while_their_gap_is_too_small(wide):
    wider_m, more_m = irises(wide)
    sky = pair(NEAR_M + more_m - 0.02, wider_m=wider_m)
    sky.places["albatross"] = (NEAR_M + more_m - 0.08, 0.0, 1.2)
    assert climbs(sky) == {"fluffy_II": -1, "albatross": 1}


# --- strays ---------------------------------------------------------------------------------------------------------


def test_one_that_has_left_its_course_is_given_more_room():
    sky = pair(STRAY_M - 0.05)
    sky.references = {name: sky.places[name] for name in NAMES[:2]}
    assert not near(sky.look())
    assert not near(sky.slide("albatross", (0.95, COURSE_M - 0.01, 1.0)))
    looks = sky.slide("albatross", (0.95, COURSE_M + 0.01, 1.0))
    assert near(looks) == set(NAMES[:2])
    assert "left its course" in looks["fluffy_II"].reason and "which holds" in looks["albatross"].reason
    sky.places["fluffy_II"] = (-0.1, 0.0, 1.0)
    assert not near(sky.look())


def test_one_that_is_about_to_leave_its_course_has_left_it():
    """It stands, and its reference flies on: this is noticed before the limit of the distance is reached."""
    sky = pair(STRAY_M - 0.05)
    sky.references = {name: sky.places[name] for name in NAMES[:2]}
    sky.look()
    gone_m, speed_m_s = 0.0, 0.5
    while not near(sky.look()):
        gone_m += 0.02 * speed_m_s
        sky.references["albatross"], sky.speeds["albatross"] = (0.95, gone_m, 1.0), (0.0, speed_m_s, 0.0)
    assert gone_m == pytest.approx(COURSE_M - LIMITS.separation_follow_s * speed_m_s, abs=0.02)


def test_a_reference_that_jumps_makes_no_stray_of_a_vehicle():
    sky = pair(STRAY_M - 0.1)
    sky.references = {name: sky.places[name] for name in NAMES[:2]}
    sky.look()
    sky.references["albatross"] = (0.9, 2.0, 1.0)
    assert not near(sky.look(1.0))


@pytest.mark.parametrize("known", [(), ("fluffy_II",)])
def test_without_a_reference_nobody_strays(known):
    sky = pair(STRAY_M - 0.1)
    sky.references = {name: sky.places[name] for name in known}
    assert sky.look(1.0) == dict.fromkeys(NAMES[:2], ALONE)


def test_a_reference_of_long_ago_says_nothing():
    sky = pair(STRAY_M - 0.1)
    sky.references = {name: sky.places[name] for name in NAMES[:2]}
    sky.look()
    sky.references = {}
    sky.look(1.0)
    sky.places["albatross"] = (0.9, COURSE_M + 0.1, 1.0)
    assert sky.look() == dict.fromkeys(NAMES[:2], ALONE)


# --- those that fly together ----------------------------------------------------------------------------------------


def test_the_neighbours_of_one_that_holds_hold_and_theirs():
    y_m = 0.9 * STRAY_M * np.arange(4)
    sky = Sky({"v%d" % k: (0.0, y, 1.0) for k, y in enumerate([-0.4, *y_m, y_m[-1] + 1.1 * STRAY_M])})
    looks = sky.look()
    assert near(looks) == {"v0", "v1", "v2", "v3", "v4"}, "v5 is beyond a gap"
    assert "v1" in looks["v2"].reason and "holds" in looks["v2"].reason and "holds" not in looks["v1"].reason
    sky.places["v0"] = (0.0, -0.7, 1.0)
    assert not near(sky.look())


def test_two_that_follow_their_references_are_judged_by_these():
    """They fly towards each other, and their references turn away in time. Without such references they hold."""
    sky = pair(1.3)
    sky.velocities = sky.speeds = {"fluffy_II": (0.5, 0.0, 0.0), "albatross": (-0.5, 0.0, 0.0)}
    sky.turns = {"fluffy_II": (-0.8, 0.0, 0.0), "albatross": (0.8, 0.0, 0.0)}
    assert near(sky.look()) == set(NAMES[:2])
    sky.references = {name: sky.places[name] for name in NAMES[:2]}
    assert not near(sky.look())
    sky.turns = {}
    assert near(sky.look()) == set(NAMES[:2])


# --- what is not seen -----------------------------------------------------------------------------------------------


def test_one_that_is_not_seen_stays_in_the_way_where_it_was_until_it_is_forgotten():
    sky = pair(STRAY_M - 0.1)
    sky.look()
    sky.hidden = {"albatross"}
    assert not near(sky.look(LIMITS.state_land_s - 0.1)), "a few frames are not a loss"
    looks = sky.look(0.2)
    assert near(looks) == {"fluffy_II"}
    assert not looks["albatross"].holds, "its own ladder knows"
    sky.places["fluffy_II"] = (0.0, 0.0, 0.5)
    assert near(sky.look()) == {"fluffy_II"}, "it comes down there"
    sky.places["fluffy_II"] = (0.9, 0.0, 1.0 + STRAY_M + 0.05)
    assert not near(sky.look()), "high above"
    sky.places["fluffy_II"] = (0.0, 0.0, 1.0)
    assert near(sky.look(LIMITS.separation_forget_s - 2.0)) == {"fluffy_II"}
    assert not near(sky.look(2.0))
    sky.hidden = set()
    sky.places["albatross"] = (0.3, 0.0, 1.0)
    assert near(sky.look()) == set(NAMES[:2])


def test_one_that_is_not_seen_may_have_coasted_on():
    sky = pair(2.0)
    sky.velocities["albatross"] = (-0.5, 0.0, 0.0)
    sky.look()
    sky.hidden = {"albatross"}
    sky.places["fluffy_II"] = (2.0 - 0.45 - NEAR_M, 0.0, 1.0)
    assert near(sky.look(0.2)) == {"fluffy_II"}


def test_one_that_was_lost_on_the_floor_is_no_reason():
    sky = pair(0.3)
    sky.places["albatross"] = (0.3, 0.0, 0.1)
    sky.look()
    sky.hidden = {"albatross"}
    assert not near(sky.look(1.0))


def test_one_that_is_not_seen_and_reports_that_it_stands_is_no_reason():
    sky = pair(NEAR_M - 0.1)
    sky.standing = {"albatross"}
    assert near(sky.look()) == set(NAMES[:2]), "what is seen counts more"
    sky.hidden = {"albatross"}
    assert not near(sky.look(1.0))
    assert sky.look()["fluffy_II"].above, "it must not be landed on"
    sky.standing = set()
    assert near(sky.look()) == {"fluffy_II"}, "it takes off again"


def test_an_own_vehicle_that_is_not_seen_has_its_own_reason():
    sky = pair(0.3)
    sky.look()
    sky.hidden = set(NAMES[:2])
    assert not near(sky.look(0.2))


# --- giving way -----------------------------------------------------------------------------------------------------


def climbs(sky):
    return {name: look.climb for name, look in sky.look().items()}


def test_the_higher_one_climbs_and_the_other_one_sinks():
    sky = pair(NEAR_M - 0.1)
    sky.places["albatross"] = (0.4, 0.0, 1.2)
    assert climbs(sky) == {"fluffy_II": -1, "albatross": 1}


def test_at_equal_heights_the_order_of_the_fleet_decides():
    for fleet in (NAMES, NAMES[::-1]):
        upper = min(NAMES[:2], key=fleet.index)
        sky = pair(NEAR_M - 0.1, fleet=fleet)
        sky.places["albatross"] = (0.4, 0.0, 1.02)
        assert climbs(sky) == {name: 1 if name == upper else -1 for name in NAMES[:2]}
    sky = pair(NEAR_M - 0.1, fleet=())
    assert climbs(sky) == {"albatross": 1, "fluffy_II": -1}, "without a fleet that of the names"


def test_nobody_gives_way_while_holding_is_enough():
    """Two that approach each other stop in time when both hold; if one does not hold, the other gives way."""
    sky = pair(NEAR_M + LIMITS.separation_lookahead_s * 0.8 - 0.02)
    sky.velocities = {"fluffy_II": (0.4, 0.0, 0.0), "albatross": (-0.4, 0.0, 0.0)}
    looks = sky.look()
    assert near(looks) == set(NAMES[:2]) and not any(look.climb for look in looks.values())
    sky.velocities["albatross"] = (-0.8, 0.0, 0.0)
    assert sky.look()["fluffy_II"].climb != 0


@pytest.mark.parametrize(("height_m", "upwards", "downwards"), [(1.0, 1, -1), (0.45, 1, 0), (2.7, 0, -1)])
def test_there_is_room_to_give_way(height_m, upwards, downwards):
    assert climbs(pair(NEAR_M - 0.1, height_m)) == {"fluffy_II": upwards, "albatross": downwards}


def test_the_nearest_of_several_decides():
    sky = Sky({"fluffy_II": (0.0, 0.0, 1.0), "albatross": (0.3, 0.0, 1.3), "Raven": (0.2, 0.0, 0.8)})
    assert climbs(sky) == {"fluffy_II": 1, "albatross": 1, "Raven": -1}


def test_one_that_is_straight_below_is_not_landed_on():
    """The upper one goes aside first, away from it."""
    sky = pair(0.2)
    sky.places["albatross"], sky.velocities["fluffy_II"] = (0.2, 0.0, 0.5), (0.0, 0.0, -0.1)
    looks = sky.look()
    assert looks["fluffy_II"].above and looks["fluffy_II"].aside == (-1.0, 0.0)
    assert not looks["albatross"].above and looks["albatross"].aside == (0.0, 0.0)
    sky.places["albatross"] = (0.0, 0.3, 0.1)
    looks = sky.look()
    assert looks["fluffy_II"].above and looks["fluffy_II"].aside == (0.0, -1.0), "nor is one that has landed"
    assert not near(looks)
    sky.places["albatross"] = (0.0, 1.4 * NEAR_M + 0.01, 0.1)
    assert sky.look()["fluffy_II"] == ALONE


@pytest.mark.parametrize(
    ("fluffy_m", "others_m", "turn_deg"),
    [
        ((0.0, 0.0), ((-0.8, 0.0, 1.0),), 90.0),
        ((0.0, 0.0), ((-1.1, 0.5, 1.0),), 45.0),
        ((0.0, 0.0), ((-1.1, -0.5, 1.0),), -45.0),
        ((0.0, 0.0), ((-1.0, 0.3, 0.08),), 45.0),
        ((0.0, 0.0), ((-1.0, 0.0, 1.0), (0.0, -1.0, 1.0), (-0.8, 0.8, 0.08)), -90.0),
        ((-2.1, 0.0), (), 90.0),
    ],
    ids=["in the way", "to its right", "to its left", "one that stands", "three", "the net"],
)
def test_nobody_goes_aside_towards_others_or_the_net(fluffy_m, others_m, turn_deg):
    """But past them. The one below is beyond +x, so that away from it is -x, and a turn to the left is one to -y."""
    places = {"fluffy_II": (*fluffy_m, 1.0), "albatross": (fluffy_m[0] + 0.2, 0.0, 0.6)}
    look = Sky(places | {"other%d" % i: other_m for i, other_m in enumerate(others_m)}).look()["fluffy_II"]
    turn_rad = math.radians(turn_deg)
    assert look.above and look.aside == pytest.approx((-math.cos(turn_rad), -math.sin(turn_rad)))


def test_one_that_is_shut_in_does_not_go_aside():
    places = {"fluffy_II": (0.0, 0.0, 1.0), "albatross": (0.2, 0.0, 0.6)}
    places |= {"stands%d" % i: (-0.8, 0.8 * side, 0.08) for i, side in enumerate((-1.0, 0.0, 1.0))}
    places |= {"flies%d" % i: (0.0, 0.9 * side, 1.0) for i, side in enumerate((-1.0, 1.0))}
    look = Sky(places).look()["fluffy_II"]
    assert look.above and look.aside == (0.0, 0.0)


# --- who is told ----------------------------------------------------------------------------------------------------


def scene(seed):
    rng = np.random.default_rng(seed)
    names = tuple("v%d" % k for k in range(8))
    places = rng.uniform((-1.2, -1.2, 0.2), (1.2, 1.2, 2.9), (8, 3)).tolist()
    sky = Sky(dict(zip(names, map(tuple, places))), fleet=names)
    sky.velocities = dict(zip(names, map(tuple, rng.normal(0.0, 0.4, (8, 3)).tolist())))
    sky.references = {name: sky.places[name] for name in names[:6]}
    sky.look()
    sky.hidden = {names[7]}
    sky.look(0.6)
    for name in names[:6:2]:
        sky.slide(name, np.array(sky.places[name]) + (0.0, 0.8, 0.0))
    return sky


@pytest.mark.parametrize("seed", range(5))
def test_the_order_of_the_entries_changes_nothing(seed):
    sky, other = scene(seed), scene(seed)
    np.random.default_rng(seed).shuffle(other.order)
    assert other.order != sky.order
    expected = sky.look()
    assert other.look() == expected
    assert near(expected)


def test_pairs_are_as_good_as_written_out():
    """The compiled loops against numpy: all pairs, with random positions and velocities."""
    rng = np.random.default_rng(5)
    t = np.linspace(0.0, LIMITS.separation_lookahead_s, 2001)
    for _ in range(100):
        places, velocities = rng.uniform(0.4, 2.0, (4, 3)), rng.normal(0.0, 0.5, (4, 3))
        sky = Sky({"v%d" % k: tuple(place) for k, place in enumerate(places)})
        sky.velocities = {"v%d" % k: tuple(velocity) for k, velocity in enumerate(velocities)}
        apart = places[:, None, :, None] - places[None, :, :, None]
        apart = apart + (velocities[:, None] - velocities[None])[..., None] * t
        nearest_m = np.linalg.norm(apart, axis=2).min(axis=2) + 9.0 * np.eye(4)
        holds = (nearest_m < NEAR_M).any(axis=1)
        for _ in range(4):
            holds |= (nearest_m[:, holds] < STRAY_M).any(axis=1)
        expected = {"v%d" % k for k in np.flatnonzero(holds)}
        assert near(sky.look()) == expected


def test_only_vehicles_of_the_fleet_count():
    places = {"fluffy_II": (0.0, 0.0, 1.0), "pendulum_tip": (0.0, 0.1, 1.4)}
    assert not near(Sky(places, own=("fluffy_II",), fleet=("fluffy_II", "albatross")).look())
    sky = Sky(places, own=("fluffy_II",), fleet=())
    sky.separations[0].refer(tuple(places), np.zeros((2, 3, 4)), sky.now_s)
    assert near(sky.look()) == {"fluffy_II"}, "no fleet is known"
