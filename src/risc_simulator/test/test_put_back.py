"""Vehicles are put back at their starts, as a person does between two flights."""

import numpy as np
import pytest
from test_virtual_lab_run import make_fleet, net  # noqa: F401 (a fixture)

from risc_simulator.faults import parse_fault
from risc_simulator.models.flight import FlightAction, FlightPhase
from risc_simulator.virtual_lab import HANDS_S, VirtualLab


@pytest.fixture
def lab(net, clock):  # noqa: F811
    lab = VirtualLab(make_fleet(net), seed=4)
    yield lab
    lab.close()


def run(lab, duration_s):
    lab.run(duration_s=lab.exposure_s + duration_s)


def fall(lab, vehicle, position_m):
    """Cut the vehicle's motors at a position and let it fall to the floor."""
    vehicle.fly_at(position_m, 1.0)
    vehicle.schedule(lab.world.time_s, FlightAction.CUT_MOTORS)
    run(lab, 1.5)
    assert vehicle.phase is FlightPhase.EMERGENCY and not vehicle.firmware.lifted


def test_one_that_fell_stands_where_it_started_as_it_was_with_a_full_battery(lab):
    vehicle = lab.world.vehicles["risc1"]
    start, plant = vehicle.state, vehicle.plant
    for text in ("added_mass:0.2,risc1", "bare_floor:risc1", "battery_low:20,risc1", "wind:1,risc1", "wind:1,risc2"):
        lab.inject(parse_fault(text))
    run(lab, 0.1)
    fall(lab, vehicle, (1.0, 0.8, 1.0))
    assert vehicle.plant.mass_kg > 1.1 * plant.mass_kg and vehicle.battery_pct <= 20.0
    vehicle.schedule(lab.world.time_s + 0.1, FlightAction.CUT_MOTORS)  # still pending
    lab.put_back("risc1")
    run(lab, 0.3)
    assert (vehicle.phase, vehicle.plant) == (FlightPhase.LANDED, plant)
    np.testing.assert_array_equal(vehicle.state.position_m, start.position_m)
    assert (vehicle.state.psi, vehicle.state.motor_pwm) == (start.psi, (0, 0, 0, 0))
    assert vehicle.battery_pct > 99.0 and vehicle.firmware.flow.scale > 0.5
    # faults on it have ended permanently; those on the other vehicle go on
    assert [record.event.vehicle for record in lab.injector.active] == ["risc2"]
    assert all(record.ends_s < lab.now_s() for record in lab.injector.history[:4])
    run(lab, 1.0)
    assert vehicle.plant == plant
    vehicle.schedule(lab.world.time_s, FlightAction.TAKE_OFF)
    run(lab, 5.0)
    assert vehicle.phase is FlightPhase.HOVERING


def test_a_fault_on_all_goes_on_for_the_others(lab):
    record = lab.inject(parse_fault("added_mass:0.2,*"))
    run(lab, 0.1)
    lab.put_back("risc1")
    first, second = lab.world.vehicles.values()
    assert second.plant.mass_kg > 1.1 * second.type.mass_kg > first.plant.mass_kg
    assert [active.id for active in lab.injector.active] == [record.id]
    changes = lab.injector.changes
    lab.put_back()
    assert not lab.injector.active and lab.injector.changes > changes
    assert lab.injector.history[0].ends_s <= lab.now_s()


def test_no_camera_sees_it_meanwhile(lab):
    def seen():
        exact_m = lab.world.markers_m().copy()
        markers_m = lab.cameras.observe(lab.world.time_s, lab.world.layout, exact_m).markers_m
        count = lab.world.layout[0][1]
        return [bool(np.isfinite(part).any()) for part in (markers_m[:count], markers_m[count : 2 * count])]

    run(lab, 0.1)
    lab.put_back("risc1")
    assert seen() == [False, True]
    run(lab, HANDS_S)
    assert seen() == [True, True]


@pytest.mark.parametrize("which", ["risc1", ""])
@pytest.mark.parametrize(
    "phase, cause",
    [
        (None, "risc1 .*air"),
        (FlightAction.CUT_MOTORS, "air"),
        (FlightAction.TAKE_OFF, "rotors of risc1"),
    ],
)
def test_one_that_flies_falls_or_is_about_to_fly_is_out_of_reach(lab, which, phase, cause):
    vehicle = lab.world.vehicles["risc1"]
    if phase is not FlightAction.TAKE_OFF:
        vehicle.fly_at((1.0, 0.8, 1.5))
    if phase is not None:
        vehicle.schedule(lab.world.time_s, phase)
    run(lab, 0.05)
    before = [v.state.position_m.tolist() for v in lab.world.vehicles.values()]
    with pytest.raises(ValueError, match=cause):
        lab.put_back(which)
    assert [v.state.position_m.tolist() for v in lab.world.vehicles.values()] == before, "nothing was moved"


def test_one_in_the_place_of_another_comes_first(lab):
    first, second = lab.world.vehicles.values()
    place = first.state.position_m
    fall(lab, second, (*place[:2], 1.0))
    fall(lab, first, (1.0, 1.0, 1.0))
    with pytest.raises(ValueError, match="risc2 .* risc1"):
        lab.put_back("risc1")
    lab.put_back("risc2")
    lab.put_back("risc1")
    fall(lab, second, (*place[:2], 1.0))
    lab.put_back()
    np.testing.assert_array_equal(first.state.position_m, place)
    with pytest.raises(ValueError, match="risc9"):
        lab.put_back("risc9")
