"""The world: phases, floor, net, battery, signs, reproducibility."""

import dataclasses
import math
import pathlib

import numpy as np
import pytest

from risc_lab.frames import GRAVITY_M_S2, euler_rates_from_body_rates
from risc_lab.lab import Fleet, FleetLandmark, FleetVehicle, MocapEndpoint, Start, Template, load_vehicle_type
from risc_lab.lab.arena import NET_HALF_X_M, NET_HALF_Y_M, Arena
from risc_simulator.models import perturbed_plant
from risc_simulator.models.flight import FlightAction, FlightPhase, Setpoint
from risc_simulator.vehicles.ardrone import firmware
from risc_simulator.vehicles.ardrone.on_board import FLOW_GAIN_RAD_PER_M_S
from risc_simulator.world import REST_HEIGHT_M, World

GOLDEN = pathlib.Path(__file__).parent / "golden"
TYPES = {name: load_vehicle_type(name) for name in ("ardrone", "iris")}
MARKERS = np.array([[0.2, 0.2, 0.0], [0.2, -0.2, 0.0], [-0.2, 0.2, 0.0], [-0.1, -0.2, -0.08]])
NAMES = ["fluffy_II", "albatross", "Raven", "Condor", "Kahn"]
TEMPLATES = {name: Template(name, "vehicle", ("a", "b", "c", "d"), MARKERS) for name in NAMES}
TEMPLATES["Green_pink"] = Template("Green_pink", "landmark", ("a", "b"), np.array([[0, 0, 0.1], [0, 0.1, 0]]))
STARTS = [(0.5, 0.0), (-0.5, 0.5), (-0.5, -0.5), (1.0, 1.0), (-1.0, 1.0)]


def make_fleet(n=1, yaw=0.0, types=()):
    vehicles = tuple(
        FleetVehicle(
            "risc%d" % (i + 1),
            NAMES[i],
            types[i] if types else "ardrone",
            "127.0.0.%d" % (i + 2),
            Start(STARTS[i] + (0.0,), math.degrees(yaw)),
        )
        for i in range(n)
    )
    return Fleet("test", MocapEndpoint("127.0.0.1"), vehicles, (FleetLandmark("Green_pink", (2.0, 1.0, 1.0)),))


def make_world(n=1, yaw=0.0, types=(), **options):
    options.setdefault("perturbed", False)
    return World(make_fleet(n, yaw, types), TYPES, TEMPLATES, **options)


def flying(position_m=(0, 0, 1), yaw=0.0, **options):
    world = make_world(**options)
    world.vehicles["risc1"].fly_at(position_m, yaw)
    return world, world.vehicles["risc1"]


# ------------------------------------------------------------------ phases


def test_stands_still_until_told():
    world = make_world(2, yaw=0.4)
    start = [(v.state.position_m, v.state.psi) for v in world.vehicles.values()]
    world.step_to(3.0)
    for vehicle, (position_m, psi) in zip(world.vehicles.values(), start):
        state = vehicle.state
        assert vehicle.phase is FlightPhase.LANDED
        np.testing.assert_array_equal(state.position_m, position_m)
        assert (state.psi, state.motor_pwm) == (psi, (0, 0, 0, 0))
        np.testing.assert_allclose(state.specific_force_m_s2, [0, 0, -GRAVITY_M_S2])
    assert start[0][0].tolist() == [0.5, 0.0, REST_HEIGHT_M]


def test_what_on_board_logic_decides_counts_without_a_new_phase(monkeypatch):
    """E.g. a type that drops a command after a time, or whose rotors turn before the take-off order."""
    world = make_world()
    vehicle, woken_s = world.vehicles["risc1"], []

    def apply(action, time_s, vertical_motion):
        vehicle.firmware.wake_s, vehicle.firmware.lifted = time_s + 0.4, True

    def wake(time_s, vertical_motion):
        woken_s.append(time_s)
        vehicle.firmware.wake_s = np.inf

    monkeypatch.setattr(vehicle.firmware, "apply", apply)
    monkeypatch.setattr(vehicle.firmware, "wake", wake)
    vehicle.schedule(0.1, Setpoint())
    world.step_to(0.45)
    assert world._lifted[0]
    world.step_to(1.0)
    assert woken_s == pytest.approx([0.5])


def test_take_off_hover_land():
    world = make_world(seed=3, perturbed=True)
    vehicle = world.vehicles["risc1"]
    vehicle.schedule(1.0, FlightAction.TAKE_OFF)
    phases, heights = {}, []
    for k in range(1, 1401):
        world.step_to(k * 0.01)
        phases.setdefault(vehicle.phase, world.time_s)
        heights.append(vehicle.state.position_m[2])
        if k == 900:
            vehicle.schedule(world.time_s, FlightAction.LAND)
    assert list(phases) == [FlightPhase.LANDED, FlightPhase.TAKING_OFF, FlightPhase.HOVERING, FlightPhase.LANDING]
    assert 4.0 <= phases[FlightPhase.HOVERING] - phases[FlightPhase.TAKING_OFF] <= 5.0
    assert heights[899] == pytest.approx(firmware.TAKE_OFF_HEIGHT_M, abs=0.03)
    descent = (heights[950] - heights[1050]) / 1.0
    assert descent == pytest.approx(firmware.LANDING_DESCENT_M_S, abs=0.05)
    assert vehicle.phase is FlightPhase.LANDED
    assert heights[-1] == REST_HEIGHT_M
    assert not world.crashes
    # the hover drifts by its level error and its optical-flow error, no more
    level_rad = math.hypot(vehicle.plant.roll_level_rad, vehicle.plant.pitch_level_rad)
    creeps_m_s = level_rad / FLOW_GAIN_RAD_PER_M_S + math.hypot(*vehicle.firmware.flow[1:])
    travelled = np.linalg.norm(vehicle.state.position_m[:2] - STARTS[0])
    assert travelled < creeps_m_s * (1400 * 0.01 - 1.0)


def test_setpoints_wait_for_the_end_of_take_off():
    world = make_world()
    vehicle = world.vehicles["risc1"]
    vehicle.schedule(0.0, FlightAction.TAKE_OFF)
    vehicle.schedule(1.0, Setpoint(pitch_rad=-0.2))
    world.step_to(4.0)
    assert vehicle.phase is FlightPhase.TAKING_OFF and abs(vehicle.state.theta) < 1e-3
    world.step_to(4.8)
    assert vehicle.phase is FlightPhase.FLYING and vehicle.state.theta < -0.1


def test_land_during_spin_up_never_leaves_the_floor():
    world = make_world()
    vehicle = world.vehicles["risc1"]
    vehicle.schedule(0.0, FlightAction.TAKE_OFF)
    vehicle.schedule(0.3, FlightAction.LAND)
    world.step_to(3.0)
    assert vehicle.phase is FlightPhase.LANDED and vehicle.state.position_m[2] == REST_HEIGHT_M


def test_emergency_falls_and_is_cleared_on_the_floor_only():
    world, vehicle = flying()
    vehicle.schedule(0.5, FlightAction.CUT_MOTORS)
    vehicle.schedule(0.6, FlightAction.CLEAR_EMERGENCY)
    world.step_to(0.8)
    state = vehicle.state
    assert vehicle.phase is FlightPhase.EMERGENCY and state.motor_pwm == (0, 0, 0, 0)
    assert state.velocity_m_s[2] == pytest.approx(-0.3 * GRAVITY_M_S2, rel=0.05)
    assert np.linalg.norm(state.specific_force_m_s2) < 0.8  # weightless but for drag
    world.step_to(2.0)
    assert vehicle.phase is FlightPhase.EMERGENCY and vehicle.state.position_m[2] == REST_HEIGHT_M
    vehicle.schedule(2.0, FlightAction.TAKE_OFF)
    world.step_to(2.1)
    assert vehicle.phase is FlightPhase.EMERGENCY
    vehicle.schedule(2.2, FlightAction.CLEAR_EMERGENCY)
    vehicle.schedule(2.3, FlightAction.TAKE_OFF)
    world.step_to(8.0)
    assert vehicle.phase is FlightPhase.HOVERING


def test_hover_brakes_and_keeps_height():
    world, vehicle = flying()
    vehicle.schedule(0.0, Setpoint(pitch_rad=-0.15, climb_m_s=0.2, yaw_rate_rad_s=0.3))
    world.step_to(1.0)
    moving = vehicle.state
    assert moving.velocity_m_s[0] > 0.5
    vehicle.schedule(1.0, Setpoint(hover=True, roll_rad=0.3, climb_m_s=1.0, yaw_rate_rad_s=1.0))
    world.step_to(7.0)
    state = vehicle.state
    assert vehicle.phase is FlightPhase.HOVERING
    assert np.linalg.norm(state.velocity_m_s) < 0.02
    assert abs(state.r) < 1e-6 and abs(state.phi) < 0.005
    assert state.position_m[2] == pytest.approx(moving.position_m[2] + 0.3 * moving.velocity_m_s[2], abs=0.03)


@pytest.mark.parametrize("seed", range(4))
def test_height_is_held_while_gaz_is_at_rest(seed):
    """Tilted to and fro with a climb command of exactly 0, as after a take-off: the climb loop alone would drift."""
    world, vehicle = flying((0, 0, 1.2), seed=seed, perturbed=True)
    for k in range(12):
        vehicle.schedule(4.0 + 0.5 * k, Setpoint(pitch_rad=0.12 * (-1) ** k, yaw_rate_rad_s=0.3))
    heights_m, thetas = [], []
    for k in range(1, 61):
        world.step_to(4.0 + 0.1 * k)
        heights_m.append(vehicle.state.position_m[2])
        thetas.append(vehicle.state.theta)
    assert vehicle.phase is FlightPhase.FLYING
    assert np.ptp(thetas) > 0.16 and vehicle.state.r > 0.2, "the other sticks are obeyed"
    assert max(abs(height_m - 1.2) for height_m in heights_m) < 0.1
    assert abs(heights_m[-1] - 1.2) < 0.05, "the slow integral has found the thrust"


def test_gaz_at_rest_holds_the_height_where_the_climb_can_stop_and_gaz_goes_on_from_there():
    world, vehicle = flying((0, 0, 1.0))
    vehicle.schedule(0.0, Setpoint(climb_m_s=0.5))
    world.step_to(1.5)
    moving = vehicle.state
    expected_m = moving.position_m[2] + firmware.STOPPING_TIME_S * moving.velocity_m_s[2]
    for k in range(90):
        vehicle.schedule(1.5 + k / 30.0, Setpoint(pitch_rad=0.01 * (-1) ** k))  # at rest, again and again
    world.step_to(4.5)
    assert moving.velocity_m_s[2] > 0.4 and vehicle.state.position_m[2] == pytest.approx(expected_m, abs=0.01)
    vehicle.schedule(4.5, Setpoint(climb_m_s=-0.3))
    world.step_to(6.0)
    assert vehicle.state.velocity_m_s[2] == pytest.approx(-0.3, abs=0.02), "a commanded climb rate is no hold"
    vehicle.schedule(6.0, Setpoint(hover=True))
    vehicle.schedule(7.0, Setpoint(pitch_rad=0.01))  # from hover to sticks at rest: the same height
    world.step_to(7.0)
    held_m = vehicle.firmware.hold.height_m
    world.step_to(7.5)
    assert vehicle.phase is FlightPhase.FLYING and vehicle.firmware.hold.height_m == held_m


def test_empty_battery_lands_and_low_battery_stays_down():
    world, vehicle = flying()
    vehicle.set_battery_pct(firmware.EMPTY_BATTERY_PCT + 0.2)
    world.step_to(10.0)
    assert vehicle.phase is FlightPhase.LANDED
    vehicle.set_battery_pct(firmware.LOW_BATTERY_PCT - 1)
    vehicle.schedule(10.0, FlightAction.TAKE_OFF)
    world.step_to(12.0)
    assert vehicle.phase is FlightPhase.LANDED


def test_battery_lasts_as_long_as_its_type_says():
    world, vehicle = flying()
    world.step_to(20.0)
    assert vehicle.state.battery_pct == pytest.approx(100 * (1 - 20 / TYPES["ardrone"].battery_life_s))
    resting = make_world()
    resting.step_to(20.0)
    drained = 100 - resting.vehicles["risc1"].state.battery_pct
    assert 0 < drained < 0.2 * 100 * 20 / TYPES["ardrone"].battery_life_s


def test_truth_is_the_states_of_all_vehicles_with_rates_of_the_angles():
    world, vehicle = flying((0.5, -0.4, 1.2), yaw=2.0)
    np.testing.assert_array_equal(make_world().truth()[0, 3:6], 0.0)  # it stands
    vehicle.schedule(0.0, Setpoint(pitch_rad=-0.2, roll_rad=0.15, climb_m_s=0.3, yaw_rate_rad_s=0.3))
    world.step_to(0.4)
    state = vehicle.state
    row = world.truth()[0]
    np.testing.assert_allclose(row[:3], state.position_m)
    np.testing.assert_allclose(row[3:6], state.velocity_m_s)
    np.testing.assert_allclose(row[6:9], [state.phi, state.theta, state.psi])
    rates = euler_rates_from_body_rates(state.phi, state.theta, state.p, state.q, state.r)
    assert max(abs(rate) for rate in rates) > 0.1
    np.testing.assert_allclose(row[9:], rates)


# ------------------------------------------------------------------ floor and net


@pytest.mark.parametrize(
    "setpoint, yaw, axis, limit",
    [
        (Setpoint(pitch_rad=-0.3), 0.0, 0, NET_HALF_X_M),
        (Setpoint(pitch_rad=0.3), 0.0, 0, -NET_HALF_X_M),
        (Setpoint(pitch_rad=-0.3), np.pi / 2, 1, -NET_HALF_Y_M),
        (Setpoint(roll_rad=-0.3), 0.0, 1, NET_HALF_Y_M),
    ],
)
def test_net_stops_the_flight_and_tells(setpoint, yaw, axis, limit):
    world, vehicle = flying(yaw=yaw)
    vehicle.schedule(0.0, setpoint)
    inside = True
    for k in range(1, 81):
        world.step_to(k * 0.05)
        inside &= abs(vehicle.state.position_m[axis]) <= abs(limit)
    (crash,) = world.crashes
    assert (crash.namespace, crash.reason) == ("risc1", "flew into the net")
    assert crash.position_m[axis] == pytest.approx(limit, abs=0.02)
    assert inside and vehicle.phase is FlightPhase.EMERGENCY
    assert vehicle.state.position_m[2] == REST_HEIGHT_M
    vehicle.schedule(4.0, FlightAction.CLEAR_EMERGENCY)  # it lies clear of the net and can fly on
    vehicle.schedule(4.1, FlightAction.TAKE_OFF)
    world.step_to(10.0)
    assert vehicle.phase is FlightPhase.HOVERING and len(world.crashes) == 1


def test_another_net_is_another_limit():
    fleet = dataclasses.replace(make_fleet(), arena=Arena(4.0, 3.0, 5.0))
    world = World(fleet, TYPES, TEMPLATES, perturbed=False)
    vehicle = world.vehicles["risc1"]
    vehicle.fly_at((0.0, 0.0, 4.0), 0.0)
    vehicle.schedule(0.0, Setpoint(pitch_rad=-0.3))
    world.step_to(6.0)
    (crash,) = world.crashes
    assert crash.position_m[0] == pytest.approx(4.0, abs=0.02)


def test_ceiling_is_the_top_of_the_net():
    world, vehicle = flying((0, 0, 2.5))
    vehicle.schedule(0.0, Setpoint(climb_m_s=1.0))
    world.step_to(3.0)
    assert len(world.crashes) == 1 and vehicle.phase is FlightPhase.EMERGENCY


def test_diving_into_the_floor_is_a_crash_and_touching_it_is_not():
    world, vehicle = flying((0, 0, 2.5))
    vehicle.schedule(0.0, Setpoint(climb_m_s=-2.0))
    world.step_to(4.0)
    assert "floor" in world.crashes[0].reason and vehicle.phase is FlightPhase.EMERGENCY

    world, vehicle = flying((0, 0, 0.5))
    vehicle.schedule(0.0, Setpoint(climb_m_s=-0.5, pitch_rad=-0.1))
    world.step_to(2.0)
    place = vehicle.state.position_m
    assert vehicle.phase is FlightPhase.FLYING and place[2] == pytest.approx(REST_HEIGHT_M, abs=1e-3)
    vehicle.schedule(2.0, Setpoint(climb_m_s=0.5))
    world.step_to(3.0)
    assert vehicle.state.position_m[2] > 0.3 and not world.crashes


def test_landing_brakes_by_optical_flow_on_the_way_down():
    """From 0.6 m/s: the time constant is 1 / (0.15 rad s/m * g) = 0.68 s, so 0.41 m; coasting would be 1.5 m."""
    for seed in range(6):
        world, vehicle = flying((-1.5, 0.0, 1.5), seed=seed, perturbed=True)
        vehicle.schedule(0.0, Setpoint(pitch_rad=-0.04))
        while vehicle.state.velocity_m_s[0] < 0.6:
            world.step_to(world.time_s + world.step_s)
        start = vehicle.state
        vehicle.schedule(world.time_s, FlightAction.LAND)
        farthest_m = 0.0
        while vehicle.phase is not FlightPhase.LANDED and world.time_s < 12.0:
            world.step_to(world.time_s + world.step_s)
            farthest_m = max(farthest_m, np.linalg.norm((vehicle.state.position_m - start.position_m)[:2]))
        assert vehicle.phase is FlightPhase.LANDED and not world.crashes
        assert 0.2 < farthest_m < 0.6


# ------------------------------------------------------------------ each other


def test_vehicles_in_the_air_do_not_pass_through_each_other():
    world = make_world(3)
    first, second, third = world.vehicles.values()
    first.fly_at((-1.0, 0.0, 1.2))
    second.fly_at((1.0, 0.0, 1.2))
    third.fly_at((0.0, 1.5, 1.2))
    first.schedule(0.0, Setpoint(pitch_rad=-0.1))
    second.schedule(0.0, Setpoint(pitch_rad=0.1))
    gaps_m = []
    while not world.crashes and world.time_s < 5.0:
        world.step_to(world.time_s + world.step_s)
        gaps_m.append(np.linalg.norm(first.state.position_m - second.state.position_m))
    assert [(c.namespace, c.reason) for c in world.crashes] == [
        ("risc1", "collided with risc2"),
        ("risc2", "collided with risc1"),
    ]
    assert gaps_m[-2] >= 0.5 > gaps_m[-1]
    assert world.least_separation_m == pytest.approx(gaps_m[-1], abs=1e-12)
    np.testing.assert_allclose(world.crashes[0].position_m, first.state.position_m)
    world.step_to(world.time_s + 3.0)
    assert [v.phase for v in (first, second, third)] == [FlightPhase.EMERGENCY] * 2 + [FlightPhase.HOVERING]
    assert first.state.position_m[2] == second.state.position_m[2] == REST_HEIGHT_M
    assert len(world.crashes) == 2  # each is reported once


@pytest.mark.parametrize(
    ("types", "touch_m"), [(("ardrone", "ardrone"), 0.5), (("iris", "ardrone"), 0.65), (("iris", "iris"), 0.8)]
)
def test_two_vehicles_touch_at_the_sum_of_their_radii(types, touch_m):
    for towards in np.eye(3):
        for apart_m in (touch_m + 0.002, touch_m - 0.002):
            world = make_world(2, types=types)
            first, second = world.vehicles.values()
            first.fly_at((0.0, 0.0, 1.0))
            second.fly_at((0.0, 0.0, 1.0) + apart_m * towards)
            world.step_to(world.step_s)
            assert world.least_separation_m == pytest.approx(apart_m, abs=1e-3)
            crashed = [(crash.namespace, crash.reason) for crash in world.crashes]
            both = [("risc1", "collided with risc2"), ("risc2", "collided with risc1")]
            assert crashed == (both if apart_m < touch_m else [])


def test_a_pair_that_is_farther_apart_may_be_the_one_that_touches():
    world = make_world(4, types=("ardrone", "ardrone", "iris", "iris"))
    places = (-1.0, -1.0, 1.0), (-0.4, -1.0, 1.0), (0.2, 1.0, 1.0), (0.95, 1.0, 1.0)
    for vehicle, place in zip(world.vehicles.values(), places):
        vehicle.fly_at(place)
    world.step_to(world.step_s)
    assert {crash.namespace for crash in world.crashes} == {"risc3", "risc4"}
    assert world.least_separation_m == pytest.approx(0.6, abs=1e-3)


def test_a_falling_vehicle_takes_another_with_it():
    world = make_world(2)
    upper, lower = world.vehicles.values()
    upper.fly_at((0.0, 0.0, 2.2))
    lower.fly_at((0.1, 0.0, 1.0))
    upper.schedule(0.1, FlightAction.CUT_MOTORS)
    world.step_to(3.0)
    assert [(c.namespace, c.reason) for c in world.crashes] == [("risc2", "collided with risc1")]
    assert lower.phase is FlightPhase.EMERGENCY


def test_only_vehicles_in_the_air_collide_or_count_for_the_separation():
    world = make_world(2)
    first, second = world.vehicles.values()
    first.fly_at(STARTS[1] + (0.3,))  # just above the other one, which is on the floor
    world.step_to(1.0)
    assert not world.crashes and world.least_separation_m is None
    first.fly_at((0.5, 0.5, 1.0))
    second.schedule(1.0, FlightAction.TAKE_OFF)
    world.step_to(6.0)
    assert world.least_separation_m == pytest.approx(1.0, abs=0.02)
    second.schedule(6.0, FlightAction.LAND)
    world.step_to(10.0)
    first.fly_at((-0.5, 0.5, 1.0))
    world.step_to(11.0)
    assert world.least_separation_m == pytest.approx(1.0, abs=0.02) and not world.crashes


@pytest.mark.parametrize("yaw, forward", [(0.0, (1, 0)), (np.pi / 2, (0, -1)), (np.pi, (-1, 0)), (-np.pi / 2, (0, 1))])
def test_signs_in_the_cortex_frame(yaw, forward):
    """Yaw is clockwise from above: at +90 degrees the nose points along -y, the left wing along +x."""
    for setpoint, direction in (
        (Setpoint(pitch_rad=-0.1), forward),
        (Setpoint(roll_rad=-0.1), (-forward[1], forward[0])),
    ):
        world, vehicle = flying(yaw=yaw)
        vehicle.schedule(0.0, setpoint)
        world.step_to(1.0)
        move = vehicle.state.position_m[:2]
        np.testing.assert_allclose(move / np.linalg.norm(move), direction, atol=1e-6)
        np.testing.assert_allclose(
            vehicle.state.velocity_m_s[:2] / np.linalg.norm(vehicle.state.velocity_m_s[:2]), direction, atol=1e-3
        )


def test_accelerometer_feels_thrust_and_drag_only():
    world, vehicle = flying()
    vehicle.schedule(0.0, Setpoint(climb_m_s=0.5))
    world.step_to(0.05)
    force = vehicle.state.specific_force_m_s2
    assert force[2] < -GRAVITY_M_S2 - 0.5  # pushed upwards: z points down
    world.step_to(3.0)
    np.testing.assert_allclose(vehicle.state.specific_force_m_s2, [0, 0, -GRAVITY_M_S2], atol=0.02)


def test_bodies_are_exact_rigid_markers_in_fleet_order_then_landmarks():
    world = make_world(2)
    vehicle = world.vehicles["risc1"]
    vehicle.fly_at((0.3, -0.2, 1.2), np.pi / 2)
    vehicle.schedule(0.0, Setpoint(roll_rad=0.2, pitch_rad=0.1, yaw_rate_rad_s=0.3))
    assert world.layout == (("fluffy_II", 4), ("albatross", 4), ("Green_pink", 2))
    markers_m = world.markers_m()
    assert markers_m.shape == (10, 3)
    # nose to -y: front right marker (0.2, 0.2) lies at -y (front) and -x (right)
    np.testing.assert_allclose(markers_m[0], [0.1, -0.4, 1.2], atol=1e-12)
    world.step_to(0.5)
    markers_m = world.markers_m()
    np.testing.assert_allclose(np.linalg.norm(markers_m[0] - markers_m[2]), 0.4)
    right_wing, left_wing = markers_m[0], markers_m[1]
    assert right_wing[2] < left_wing[2]  # roll + is right wing down
    assert markers_m[0][2] > markers_m[2][2]  # pitch + is nose up
    np.testing.assert_allclose(world.markers_m()[8:], [[2, 1, 1.1], [2, 1.1, 1.0]])


# ------------------------------------------------------------------ time and reproducibility


def fly_a_tour(world):
    for k, vehicle in enumerate(world.vehicles.values()):
        vehicle.schedule(0.02 * k, FlightAction.TAKE_OFF)
        for j in range(20):
            vehicle.schedule(5.0 + 0.2 * j, Setpoint(0.05 * (-1) ** j, 0.04 * (-1) ** (j // 2), 0.1, 0.2))
        vehicle.schedule(9.0, FlightAction.LAND)
    history = []
    for k in range(1, 121):
        world.step_to(k * 0.1)
        history.append(
            [
                np.concatenate([v.state.position_m, v.state.velocity_m_s, [v.state.phi, v.state.psi]])
                for v in world.vehicles.values()
            ]
        )
    return np.array(history)


def fly_the_golden_flight():
    """Everything that can happen to a vehicle: see golden/README.md."""
    world = make_world(3, seed=5, perturbed=True, gusts=True)
    first, second, third = world.vehicles.values()
    rng = np.random.default_rng(8)
    for k, vehicle in enumerate((first, second, third)):
        vehicle.schedule(0.013 + 0.3 * k, FlightAction.TAKE_OFF)
        for j in range(90 if vehicle is not third else 0):  # stick commands by radio, off the world's time grid
            vehicle.schedule(4.0 + j / 30.0, Setpoint(*(0.06 * rng.standard_normal(2)), 0.3, 0.4, hover=j % 40 > 34))
    first.schedule(7.2, Setpoint(hover=True))
    first.schedule(9.0, FlightAction.LAND)
    second.schedule(7.1, Setpoint(roll_rad=-0.3, climb_m_s=1e-12))  # into the net; zero gaz did not hold height then
    second.schedule(12.0, FlightAction.CLEAR_EMERGENCY)
    second.schedule(12.1, FlightAction.TAKE_OFF)
    third.schedule(7.1, Setpoint(climb_m_s=-0.5))  # along the floor
    third.schedule(11.0, Setpoint(climb_m_s=0.5, yaw_rate_rad_s=-0.3))
    third.schedule(13.0, Setpoint(climb_m_s=0.1))
    rows, phases = [], []
    for k in range(1, 86):
        if k == 70:
            third.set_battery_pct(firmware.EMPTY_BATTERY_PCT + 0.2)  # it lands by itself
        world.step_to(0.2 * k)
        rows.append(world.truth())
        phases.append([list(FlightPhase).index(vehicle.phase) for vehicle in world.vehicles.values()])
    forces = [vehicle.state.specific_force_m_s2 for vehicle in world.vehicles.values()]
    crashes = [[crash.time_s, *crash.position_m] for crash in world.crashes]
    return {
        "truth": np.array(rows),
        "phases": np.array(phases),
        "forces": np.array(forces),
        "crashes": np.array(crashes),
        "least_separation_m": world.least_separation_m,
    }


def test_the_golden_flight_is_flown_as_ever(monkeypatch):
    """Only the parameters that were drawn when the golden flight was made are perturbed."""
    drawn = "mass", "thrust", "bandwidth", "drag", "delay_s"
    others = {name: 0.0 for name in vars(perturbed_plant.spreads()) if name not in drawn}
    spreads = dataclasses.replace(perturbed_plant.spreads(), **others)
    monkeypatch.setattr(perturbed_plant, "spreads", lambda: spreads)
    golden = np.load(GOLDEN / "world_flight.npz")
    flown = fly_the_golden_flight()
    assert set(flown) == set(golden)
    assert len(np.unique(golden["phases"])) == len(FlightPhase)
    for key, expected in golden.items():
        np.testing.assert_allclose(flown[key], expected, rtol=0, atol=1e-9, err_msg=key)


def test_same_seed_same_bits_other_seed_other_flight():
    first = fly_a_tour(make_world(3, seed=5, perturbed=True, gusts=True))
    np.testing.assert_array_equal(first, fly_a_tour(make_world(3, seed=5, perturbed=True, gusts=True)))
    assert np.abs(first - fly_a_tour(make_world(3, seed=6, perturbed=True, gusts=True))).max() > 0.01


def test_a_vehicle_does_not_depend_on_who_else_flies():
    alone = fly_a_tour(make_world(1, seed=5, perturbed=True, gusts=True))
    company = fly_a_tour(make_world(4, seed=5, perturbed=True, gusts=True))
    np.testing.assert_array_equal(alone[:, 0], company[:, 0])
    plants = [make_world(n, seed=9, perturbed=True).vehicles["risc1"].plant for n in (1, 3, 5)]
    assert plants[0] == plants[1] == plants[2]
    five = [v.plant for v in make_world(5, seed=9, perturbed=True).vehicles.values()]
    assert len({plant.mass_kg for plant in five}) == 5


def test_looking_changes_nothing_and_the_size_of_the_strides_neither():
    quiet, watched = make_world(2, seed=2, perturbed=True), make_world(2, seed=2, perturbed=True)
    for world in (quiet, watched):
        for vehicle in world.vehicles.values():
            vehicle.schedule(0.013, FlightAction.TAKE_OFF)
            vehicle.schedule(6.0, Setpoint(pitch_rad=-0.1))
    quiet.step_to(6.5)
    for k in range(1, 2167):
        watched.step_to(k * 0.003)
        watched.markers_m()
        assert watched.vehicles["risc2"].state.battery_pct > 0
    watched.step_to(6.5)
    np.testing.assert_array_equal(quiet.vehicles["risc1"].state.position_m, watched.vehicles["risc1"].state.position_m)


def test_actions_wait_for_their_time_and_keep_their_order():
    world, vehicle = flying()
    vehicle.schedule(0.5, Setpoint(pitch_rad=-0.2))
    vehicle.schedule(0.5, Setpoint(pitch_rad=0.2))  # same time: the later call counts
    vehicle.schedule(0.2, Setpoint(roll_rad=0.1))
    world.step_to(0.2)
    assert vehicle.phase is FlightPhase.HOVERING
    world.step_to(0.205)
    assert vehicle.phase is FlightPhase.FLYING
    world.step_to(0.5)
    assert abs(vehicle.state.theta) < 1e-6 < vehicle.state.phi
    world.step_to(0.7)
    assert vehicle.state.theta > 0.01


def test_time_stands_on_the_grid():
    world = make_world(step_s=0.005)
    world.step_to(0.0149)
    assert world.time_s == pytest.approx(0.010)
    world.step_to(0.015)
    assert world.time_s == pytest.approx(0.015)
    world.step_to(0.001)
    assert world.time_s == pytest.approx(0.015)
    for k in range(1, 2001):
        world.step_to(k / 200.0)
    assert world.time_s == pytest.approx(10.0)


def test_trim_forgets_a_thrust_error():
    """A wrong thrust makes the climb rate wrong at first and, by the slow integral, right in the end."""
    world = make_world(seed=5, perturbed=True)
    vehicle = world.vehicles["risc1"]
    plant = vehicle.plant
    expected = (plant.thrust_scale * plant.nominal_mass_kg / plant.mass_kg - 1) * GRAVITY_M_S2 * 0.3
    assert abs(expected) > 0.05, "choose a seed with an error worth the test"
    vehicle.fly_at((0, 0, 1.5))
    vehicle.schedule(0.0, Setpoint(climb_m_s=1e-6))  # not at rest: the climb loop alone
    world.step_to(1.0)
    early = vehicle.state.velocity_m_s[2]
    assert abs(early) > 0.5 * abs(expected) and np.sign(early) == np.sign(expected)
    world.step_to(6.0)
    assert abs(vehicle.state.velocity_m_s[2]) < 0.6 * abs(early)


# ------------------------------------------------------------------ bad input


def test_errors_name_cause_and_cure():
    with pytest.raises(ValueError, match="finite"):
        Setpoint(roll_rad=float("nan"))
    world = make_world()
    with pytest.raises(ValueError, match="finite time"):
        world.vehicles["risc1"].schedule(float("inf"), FlightAction.LAND)
    with pytest.raises(ValueError, match="net"):
        world.vehicles["risc1"].fly_at((5, 0, 1))
    with pytest.raises(ValueError, match="template 'fluffy_II'; "):
        World(make_fleet(), TYPES, {})
    with pytest.raises(ValueError, match="'submarine' .*virtual_vehicles; .* ardrone"):
        World(make_fleet(), {"ardrone": dataclasses.replace(TYPES["ardrone"], name="submarine")}, TEMPLATES)
    with pytest.raises(ValueError, match="step_s"):
        make_world(step_s=0.1)
    fleet = make_fleet()
    outside = dataclasses.replace(fleet.vehicles[0], start=Start((0.0, 2.5, 0.0)))
    with pytest.raises(ValueError, match="risc1 .*net"):
        World(dataclasses.replace(fleet, vehicles=(outside,)), TYPES, TEMPLATES)
