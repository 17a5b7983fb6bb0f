"""The virtual IRIS+ as a plant: throttle to thrust, rotors, attitude loops, reproducibility by seed."""

import math
import pathlib

import numpy as np
import pytest
from iris_flight import CENTRE_US, HIGHEST_US, Hands, make_fleet, make_world

from risc_lab.frames import GRAVITY_M_S2
from risc_lab.lab import fleet_from_dict, load_templates, load_vehicle_type
from risc_lab.registry import VARIABLE
from risc_simulator import vehicles
from risc_simulator.models.perturbed_plant import IDLE_THRUST_TO_WEIGHT
from risc_simulator.vehicles.iris.firmware import LOW_BATTERY_PCT, Mode, RcFrame
from risc_simulator.vehicles.iris.on_board import ROTOR_TIME_CONSTANT_S
from risc_simulator.world import World

# Eq. 5.5, with the c4 of the original release, by hand.
HOVERS = {0: 0.491675, 25: 0.170960, 50: 0.098411, 75: -0.018105, 100: -0.152852}


def flying(perturbed=False, seed=3, position_m=(0.0, 0.0, 1.2), **options):
    world = make_world(perturbed=perturbed, seed=seed, **options)
    hands = Hands(world)
    hands.vehicle.fly_at(position_m)
    return world, hands


@pytest.mark.parametrize("battery_pct", [100, 75, 50, 25])
def test_the_throttle_of_eq_5_5_hovers_at_each_charge(battery_pct):
    world, hands = flying(changes={"battery_life_s": 1e9})
    hands.vehicle.set_battery_pct(battery_pct)
    assert hands.autopilot.hover_throttle(battery_pct) == pytest.approx(HOVERS[battery_pct], abs=1e-3)
    throttle_us = CENTRE_US + round(500.0 * HOVERS[battery_pct])
    hands.send(2.0, throttle=throttle_us)
    rounding_m_s2 = GRAVITY_M_S2 * 1.5 / 500.0  # 1 us of throttle, and the third digit of the curve
    assert abs(hands.vehicle.state.velocity_m_s[2]) < 2.0 * rounding_m_s2
    hands.send(0.5, throttle=throttle_us + 25)
    gained_m_s = hands.vehicle.state.velocity_m_s[2]
    assert gained_m_s == pytest.approx(0.05 * GRAVITY_M_S2 * (0.5 - ROTOR_TIME_CONSTANT_S), abs=0.05)


def test_an_emptying_battery_sinks_a_vehicle_whose_throttle_stays():
    life_s, duration_s = 30.0, 1.5
    world, hands = flying(changes={"battery_life_s": life_s}, position_m=(0.0, 0.0, 2.0))
    hands.vehicle.set_battery_pct(90.0)
    hands.send(duration_s, throttle=hands.throttle_for())
    assert hands.vehicle.battery_pct == pytest.approx(90.0 - 100.0 * duration_s / life_s, abs=0.1)
    charges = np.linspace(90.0, 85.0, 151)
    lacks = [hands.autopilot.hover_throttle(pct) - hands.autopilot.hover_throttle(90.0) for pct in charges]
    lost_m_s = GRAVITY_M_S2 * np.mean(lacks) * duration_s
    assert 0.1 < lost_m_s == pytest.approx(-hands.vehicle.state.velocity_m_s[2], rel=0.15)


def test_a_battery_that_gives_way_takes_the_lift_by_and_by():
    """With another battery of that charge, swapped in at once, the vehicle would fall at 2 m/s within 0.6 s."""
    fallen_m_s = {}
    for how in "set_battery_pct", "weaken_battery":
        world, hands = flying(changes={"battery_life_s": 1e9})
        hands.send(0.2, throttle=hands.throttle_for())
        throttle_us = hands.throttle_for()
        getattr(hands.vehicle, how)(10.0)
        hands.send(0.6, throttle=throttle_us)
        assert hands.vehicle.battery_pct == pytest.approx(10.0)
        fallen_m_s[how] = -hands.vehicle.state.velocity_m_s[2]
    assert fallen_m_s["set_battery_pct"] > 1.5 and 0.02 < fallen_m_s["weaken_battery"] < 0.3


@pytest.mark.parametrize("seed", range(5))
def test_the_true_hover_throttle_of_a_perturbed_vehicle(seed):
    world, hands = flying(perturbed=True, seed=seed, changes={"battery_life_s": 1e9})
    hands.vehicle.set_battery_pct(60.0)
    true, nominal = hands.autopilot.hover_throttle(60.0), make_world().vehicles["iris1"].firmware.hover_throttle(60.0)
    assert abs(true - nominal) > 1e-3
    record = world._kinds[0].records[0]
    record.rotor_thrust_n = hands.vehicle.plant.mass_kg * GRAVITY_M_S2 / hands.vehicle.plant.thrust_scale
    hands.send(1.0, throttle=CENTRE_US + round(500.0 * true))
    assert abs(hands.vehicle.state.velocity_m_s[2]) < 0.02
    hands.send(1.0, throttle=CENTRE_US + round(500.0 * nominal))
    assert abs(hands.vehicle.state.velocity_m_s[2]) > 0.5 * abs(true - nominal) * GRAVITY_M_S2


def test_thrust_follows_the_throttle_as_a_first_order_lag():
    world, hands = flying(step_s=0.001)
    plant = hands.vehicle.plant
    before_n = plant.mass_kg * GRAVITY_M_S2
    start_s = world.time_s
    throttle_us = hands.throttle_for() + 100  # 20 % of the weight
    hands.vehicle.schedule(start_s, RcFrame((1500, 1500, throttle_us, 1500)))
    share = []
    for k in range(1, 161):
        world.step_to(start_s + 0.001 * k)
        felt_n = -plant.mass_kg * hands.vehicle.state.specific_force_m_s2[2]
        climb_m_s = hands.vehicle.state.velocity_m_s[2]
        share.append((felt_n + plant.drag_n_s_m * climb_m_s - before_n) / (0.2 * before_n))
    expected = 1.0 - np.exp(-0.001 * np.arange(1, 161) / ROTOR_TIME_CONSTANT_S)
    np.testing.assert_allclose(share, expected, atol=0.01)


@pytest.mark.parametrize("axis, sign", [("roll", 1), ("pitch", -1)])
def test_attitude_follows_the_loops_of_the_type(axis, sign):
    world, hands = flying()
    us = CENTRE_US + sign * 116  # 20 beyond the dead zone: a fifth of full scale
    loop = getattr(hands.vehicle.type, axis)
    wanted = sign * hands.vehicle.type.tilt_max_rad * (116 - 20) / 480.0
    start_s, keep = world.time_s, hands.throttle_for()
    channels = {"roll": CENTRE_US, "pitch": CENTRE_US, axis: us}
    angles, times_s = [], []
    for _ in range(40):
        hands.send(0.02, throttle=keep, **channels)
        times_s.append(world.time_s - start_s)
        angles.append(hands.vehicle.state.phi if axis == "roll" else hands.vehicle.state.theta)
    wn, zeta, t = loop.natural_frequency_rad_s, loop.damping_ratio, np.array(times_s)
    wd = wn * math.sqrt(1.0 - zeta**2)
    response = 1.0 - np.exp(-zeta * wn * t) * (np.cos(wd * t) + zeta * wn / wd * np.sin(wd * t))
    np.testing.assert_allclose(angles, loop.gain * wanted * response, atol=0.002)


def test_yaw_follows_the_stick_clockwise():
    world, hands = flying()
    hands.send(1.0, throttle=hands.throttle_for(), yaw=HIGHEST_US)
    state = hands.vehicle.state
    assert state.r == pytest.approx(hands.vehicle.type.yaw_rate_max_rad_s, rel=0.01)
    assert state.psi == pytest.approx(hands.vehicle.type.yaw_rate_max_rad_s * 0.9, rel=0.05)


def test_a_throttle_at_its_end_lets_the_rotors_idle_and_the_vehicle_fall():
    world, hands = flying(position_m=(0.0, 0.0, 2.8))
    hands.send(0.2)
    fallen_m_s = -hands.vehicle.state.velocity_m_s[2]
    whole_m_s = (1.0 - IDLE_THRUST_TO_WEIGHT) * GRAVITY_M_S2 * (0.2 - ROTOR_TIME_CONSTANT_S)
    assert fallen_m_s == pytest.approx(whole_m_s, rel=0.05)  # the rest is drag
    assert hands.autopilot.armed


def wander(seed, n=3):
    """Truth and autopilot texts of several vehicles that fly in gusts through several modes."""
    world = make_world(n, perturbed=True, seed=seed, gusts=True)
    everyone = [Hands(world, namespace) for namespace in world.vehicles]
    places_m = [hands.vehicle.state.position_m for hands in everyone]
    rows = []
    for k in range(500):
        for i, (hands, place_m) in enumerate(zip(everyone, places_m)):
            if k == 20:
                hands.autopilot.arm()
            if k == 200 + 20 * i:
                hands.autopilot.set_mode(Mode.ALT_HOLD)
            if k == 280:
                hands.autopilot.set_mode(Mode.LAND)
            climbs = hands.autopilot.mode is not Mode.STABILIZE
            throttle_us = 1000 if k < 22 else 1500 if climbs else hands.keep(1.0)
            roll_us, pitch_us = hands.stay(place_m)
            hands.vehicle.schedule(world.time_s, RcFrame((roll_us, pitch_us, throttle_us, 1485 - i)))
        world.step_to(0.02 * (k + 1))
        rows.append(world.truth())
    assert not world.crashes
    return np.array(rows), [hands.texts() for hands in everyone]


def test_a_seed_repeats_a_flight_bit_for_bit_and_another_does_not():
    rows, texts = wander(seed=4)
    again, texts_again = wander(seed=4)
    np.testing.assert_array_equal(rows, again)
    assert texts == texts_again and all("Disarming motors" in said for said in texts)
    assert np.abs(rows - wander(seed=5)[0]).max() > 0.01
    assert rows[190, :, 2].min() > 0.8, "it was flown"


def test_who_else_flies_does_not_matter():
    np.testing.assert_array_equal(wander(seed=4, n=2)[0][:, 0], wander(seed=4, n=1)[0][:, 0])


def test_it_flies_among_ardrones_and_leaves_them_alone():
    """One of each: the AR.Drone flies exactly as beside another AR.Drone."""

    def fly(kinds):
        content = make_fleet(2).to_dict()
        content["vehicles"] = [dict(v, type=kind) for v, kind in zip(content["vehicles"], kinds)]
        fleet = fleet_from_dict(content)
        types = {name: load_vehicle_type(name) for name in set(kinds)}
        world = World(fleet, types, load_templates(fleet=fleet), seed=2, gusts=True)
        for vehicle in world.vehicles.values():
            vehicle.fly_at(vehicle.state.position_m + [0, 0, 1])
        world.step_to(0.4)
        return world.truth()

    np.testing.assert_array_equal(fly(["ardrone", "iris"])[0], fly(["ardrone", "ardrone"])[0])


def test_it_can_carry_a_body(monkeypatch):
    """Its equations and those of the body are compiled together; on-board logic still reaches its parameter record."""
    monkeypatch.setenv(VARIABLE, str(pathlib.Path(__file__).parent / "members"))
    offsets = {"top": [0.0, 0.0, 0.02], "side": [0.02, 0.0, 0.0]}
    templates = {"geometries": {"ball": offsets}, "templates": {"ball": {"kind": "attached", "geometry": "ball"}}}
    content = make_fleet(templates=templates).to_dict()
    content["vehicles"][0]["attached"] = {"body": "toy_spring", "template": "ball"}
    try:
        hands = Hands(make_world(fleet=fleet_from_dict(content)))
        hands.vehicle.fly_at((0.0, 0.0, 1.5))
        hands.send(1.0, throttle=hands.throttle_for())
    finally:
        vehicles.virtual_type.cache_clear()
    ball_kg = 0.05
    assert hands.vehicle.state.velocity_m_s[2] < -0.5 * ball_kg / hands.vehicle.plant.mass_kg * GRAVITY_M_S2


def test_a_low_battery_does_not_end_the_curve():
    autopilot = make_world().vehicles["iris1"].firmware
    hovers = [autopilot.hover_throttle(pct) for pct in range(0, 101, 5)]
    assert (np.diff(hovers) < 0.0).all() and autopilot.hover_throttle(LOW_BATTERY_PCT) < 0.4
