"""Every fault flies offline, on an AR.Drone and on an IRIS+, and ends as its entry calls safe."""

import itertools
import math

import pytest

from risc_experiments.offline import Flight, fly
from risc_simulator.faults import REGISTRY, fault_settings, parse_fault

PASSING = {  # the flight goes on; faults one after another, each judged until the next begins
    "frames come late, twice, or not": (
        "loss:0.3,duration_s=1@0 drop:0.1,duration_s=1@1 duplicate:1,duration_s=1@2 reorder:0.5,duration_s=1@3 "
        "jitter:0.05,duration_s=1@4 delay:0.05,duration_s=1@5 burst:0.05,duration_s=1@6 "
        "intermittent:0.3,duration_s=1@7 blackhole:0.2@8.5 corrupt:0.3,duration_s=1@9 truncate:0.3,duration_s=1@10"
    ),
    "frames are wrong": (
        "clock_step:0.03,duration_s=0.5@0 clock_step:1,duration_s=0.5@1 clock_step:-1,duration_s=0.5@2 "
        "ghost_marker:0.05,duration_s=0.5@3 occlusion:0.3@4 nan_markers:0.3@5.5 sentinel_markers:0.3@7 garbage:0.3@8.5 "
        "wrong_unit:0.001,duration_s=0.2@10 marker_swap:0.2@11.5 occlusion:2,severity=0.25@13"
    ),
    "vehicles, links and hosts": (
        "wind:2,duration_s=2@0 gust:4,duration_s=2@2.5 added_mass:0.2,duration_s=2@5 link_slow:0.1,duration_s=1@7.5 "
        "link_blackhole:0.5@9 navdata_freeze:0.7@10.5 battery_low:14@12.5 battery_failing:1,duration_s=2@13.5 "
        "mocap_blackout:0.3@15.5 host_restart:0.3@17 bare_floor:2@18.5"
    ),
}
LANDING = (  # (fault, types): vehicles cannot go on, for so long that one that does not land reaches the net
    *[(fault, ("ardrone",)) for fault in ("flip:20", "freeze:20", "jump:2,duration_s=20", "mocap_blackout:20")],
    *[(fault, ("ardrone",)) for fault in ("occlusion:20", "burst:severe", "link_blackhole:20", "nan_markers:20")],
    *[(fault, ("ardrone",)) for fault in ("garbage:20", "battery_failing:30", "host_restart:20")],
    *[(fault, ("iris",)) for fault in ("battery_low:8", "link_blackhole:20", "wrong_axes:20")],
)
SHORT = (  # as LANDING, but over before they are down: the landing goes on
    *[(fault, ("ardrone",)) for fault in ("flip:3", "freeze:3", "jump:1", "mocap_blackout:3", "occlusion:3")],
    *[(fault, ("ardrone",)) for fault in ("link_blackhole:5", "nan_markers:3", "garbage:3", "host_restart:3")],
    *[(fault, ("iris",)) for fault in ("link_blackhole:5", "wrong_axes:0.5")],
)
# Faults in which a vehicle without a ladder lands by itself; outcomes if it cannot: (with the ladder, without it)
LAND_BY_THEMSELVES = {
    "mocap_blackout:20": ("landed", "breach"),  # no frames, no commands: the AR.Drone's watchdog
    "host_restart:20": ("landed", "breach"),  # the same
    "burst:severe": ("landed", "completed"),  # the same, in one of the gaps
    "link_blackhole:20": ("breach", "breach"),  # the same, or the failsafe of an IRIS+'s radio: no ladder reaches them
    "battery_failing:30": ("landed", "completed"),  # the aircraft's own limit; virtual rotors turn without a charge
    "battery_low:8": ("landed", "completed"),  # the autopilot's own limit
}
OWN_FAILSAFES = {  # of the aircraft, and the values that switch them off
    "ardrone.offline.LOST_S": math.inf,
    "ardrone.firmware.EMPTY_BATTERY_PCT": -1.0,
    "iris.offline.FAILSAFE_S": math.inf,
    "iris.firmware.CRITICAL_BATTERY_PCT": -1.0,
}
# faults that the state estimator corrects
MENDED = (("marker_swap:3", ("ardrone",)), ("name_exchange:3", ("ardrone", "ardrone")))
# faults of connections, answers and programs, which offline flights do not have
NOT_OFFLINE = {"cut", "wrong_reply", "node_kill", "node_stop"}


def name_of(value):
    return value if isinstance(value, str) else value[0]


def flown(faults, types, seed=1, course="circle", longer_s=0.0, **fields):
    events = tuple(map(parse_fault, faults))
    duration_s = max(event.start_s for event in events) + longer_s
    return fly(Flight(course, len(types), seed, duration_s, types=types, faults=events, **fields))


def test_each_fault_is_in_a_flight():
    named = [parse_fault(text).fault for faults in PASSING.values() for text in faults.split()]
    named += [parse_fault(text).fault for text, _ in (*LANDING, *MENDED)]
    elsewhere = {"motor_loss", "pilot_takeover"}  # it falls; another person flies, see test_iris_flight
    assert set(REGISTRY.names()) - NOT_OFFLINE - set(named) == elsewhere


def test_faults_on_programs_are_refused():
    with pytest.raises(ValueError, match="node_kill .* ./maap fly"):
        flown(["node_kill:controller@1"], ("ardrone",))


@pytest.mark.parametrize("kind", ["ardrone", pytest.param("iris", marks=pytest.mark.release)])
@pytest.mark.parametrize("faults", PASSING.values(), ids=PASSING)
def test_they_are_flown_through(faults, kind, seed):
    """By a single vehicle: no other one that holds can make it land."""
    # intermittent with other seeds: frames may be missing for 0.5 s on end, and it lands
    result = flown(faults.split(), (kind,), 1 if "intermittent" in faults else seed(1))
    assert {fault.outcome for fault in result.faults} <= {"completed", "held"}
    assert all(fault.safe for fault in result.faults) and not any(result.landed)
    assert not result.breaches and not result.contacts and len(result.faults) == len(faults.split())


@pytest.mark.parametrize("fault, types", LANDING, ids=name_of)
@pytest.mark.parametrize("ladder", [True, False])
def test_they_land_it(fault, types, ladder, seed):
    """The control arm, without the ladder: the flight ends in the net, unless the vehicle lands by itself."""
    # with other seeds a vehicle without the ladder may miss the net: with seed 1 in four of the cases
    result = flown([fault + "@1"], types, seed(3) if ladder else 3, longer_s=15.0, node={"ladder": ladder})
    (outcome,) = result.faults
    lands = ladder or fault in LAND_BY_THEMSELVES
    assert (outcome.outcome, outcome.safe) == (("landed", True) if lands else ("breach", False))
    assert bool(result.breaches) is not lands and not result.contacts


@pytest.mark.parametrize("fault, types", SHORT, ids=name_of)
def test_they_land_it_although_it_is_over_before_they_are_down(fault, types, seed):
    result = flown([fault + "@1"], types, seed(1))
    (outcome,) = result.faults
    assert (outcome.outcome, outcome.safe) == ("landed", True)
    assert not result.breaches and not result.contacts


def test_they_do_not_where_a_hold_never_becomes_a_landing():
    """The control arm. link_blackhole is left out: there the vehicle lands by itself in that time, see below."""
    held = [(fault, types) for fault, types in SHORT if not fault.startswith("link_blackhole")]
    assert len(held) == len(SHORT) - 2
    for fault, types in held:
        result = flown([fault + "@1"], types, node={"state_land_s": 60.0, "controls_land_s": 60.0})
        assert result.faults[0].outcome in ("completed", "held") and not any(result.landed), fault


@pytest.mark.parametrize("ladder", [True, False])
@pytest.mark.parametrize("fault, types", [case for case in LANDING if case[0] in LAND_BY_THEMSELVES], ids=name_of)
def test_without_a_watchdog_the_ladder_lands_it(fault, types, ladder, monkeypatch, seed):
    """The ladder alone: the link's watchdog and the aircraft's own battery limit are switched off."""
    for name, off in OWN_FAILSAFES.items():
        monkeypatch.setattr("risc_simulator.vehicles." + name, off)
    wanted = LAND_BY_THEMSELVES[fault][0 if ladder else 1]
    chosen = seed(3) if wanted == "landed" else 3
    result = flown([fault + "@1"], types, chosen, longer_s=15.0, node={"ladder": ladder})
    assert [outcome.outcome for outcome in result.faults] == [wanted]


@pytest.mark.parametrize("timeout_s", [1.0, 0.0])
@pytest.mark.parametrize("other", ["", "mocap_blackout:3@1.5", "battery_low:8@1.5"])
def test_reports_that_repeat_themselves_land_it(other, timeout_s, monkeypatch):
    """They contain the velocity that holds it without motion capture, and its charge. In the control arm repeated
    reports count as reports.
    """
    monkeypatch.setattr("risc_simulator.vehicles.ardrone.firmware.EMPTY_BATTERY_PCT", -1.0)
    result = flown(["navdata_freeze:10@1", *other.split()], ("ardrone",), node={"navdata_timeout_s": timeout_s})
    blind = other.startswith("mocap")  # and lands for that
    assert result.faults[-1].outcome == ("landed" if timeout_s > 0.0 or blind else "completed")
    assert all(fault.safe for fault in result.faults) and not result.breaches
    told = any("navdata the same for 1.0 s" in text for _, _, text in result.safety)
    assert told is (timeout_s > 0.0 and not blind)


@pytest.mark.parametrize("fault, types", [*MENDED, pytest.param("marker_swap:3", ("iris",), marks=pytest.mark.release)])
def test_nobody_notices_it(fault, types, seed):
    result = flown([fault + "@1"], types, seed(1), "circles3")
    (outcome,) = result.faults
    assert (outcome.outcome, outcome.safe) == ("completed", True)
    assert not result.safety and not result.contacts and result.rmse_m.max() < 0.03


@pytest.mark.parametrize("kind", ["ardrone", "iris"])
def test_who_loses_a_motor_falls_and_touches_nobody(kind, seed):
    result = flown(["motor_loss:risc1@1"], (kind, "ardrone"), seed(1), "circles3")
    (outcome,) = result.faults
    assert (outcome.outcome, outcome.safe) == ("breach", True)
    assert [breach.name for breach in result.breaches] == ["risc1"] and not result.contacts


def test_a_seed_repeats_the_outcomes():
    faults, types = ["gust:4@0", "ghost_marker:0.05@0.2", "jitter:0.03@0.5"], ("ardrone", "ardrone")
    first, again, other = (flown(faults, types, seed, "circles3") for seed in (5, 5, 6))  # which they soon reach
    assert first.faults == again.faults and (first.actual_m == again.actual_m).all()
    assert [fault.args for fault in other.faults] != [fault.args for fault in first.faults]


IRIS = ("iris",)
# it takes two
NOT_FLOWN = {("name_exchange", grade, IRIS) for grade in ("mild", "medium", "severe")}
GRADES = [(name, grade) for name in REGISTRY.names() for grade in fault_settings(name).grades]


@pytest.mark.release
@pytest.mark.parametrize("name, grade", GRADES)
def test_each_grade_ends_safe_whatever_the_seed(name, grade):
    """Two AR.Drones, so that names can be exchanged, and an IRIS+ on its own where one is enough."""
    fleets = itertools.product((("ardrone", "ardrone"), IRIS), (1, 2))
    for types, seed in fleets:
        if (name, grade, types) not in NOT_FLOWN:
            (outcome,) = flown(["%s:%s@1" % (name, grade)], types, seed).faults
            assert outcome.safe, (types, seed, outcome)
