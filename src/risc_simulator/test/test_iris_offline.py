"""From sticks to an IRIS+ without sockets: board, PPM signal and radio as in the virtual lab."""

import math
import pathlib
import re
from collections import namedtuple

import numpy as np
import pytest
from iris_flight import make_world

from risc_simulator.models.flight import FlightAction, FlightPhase
from risc_simulator.models.perturbed_plant import spreads
from risc_simulator.vehicles.iris.firmware import Mode
from risc_simulator.vehicles.iris.offline import (
    FAILSAFE_S,
    FAILSAFE_US,
    FRACTION_MAX,
    FRAME_S,
    JUMP,
    SLEW_US,
    OfflineLink,
)

CYCLE_S = 0.005
Sticks = namedtuple("Sticks", "forward left up turn_left")  # as in a vehicle node


def test_its_board_is_the_one_that_is_shipped():
    path = pathlib.Path(__file__).resolve().parents[3] / "firmware/dueppm/configuration.h"
    shipped = dict(re.findall(r"constexpr \w+ (k\w+) = ([\w.]+);", path.read_text(encoding="utf-8")))
    centre_us, lowest_us = int(shipped["kCentreUs"]), int(shipped["kFailsafeThrottleUs"])
    assert shipped["kFailsafeHolds"] == "false" and (centre_us, centre_us, lowest_us, centre_us) == FAILSAFE_US
    assert (int(shipped["kFrameUs"]), int(shipped["kFailsafeMs"])) == (1e6 * FRAME_S, 1e3 * FAILSAFE_S)
    assert (float(shipped["kFractionMax"]), float(shipped["kJump"])) == (FRACTION_MAX, JUMP)
    assert int(shipped["kSlewUsPerS"]) * FRAME_S == SLEW_US


class Flight:
    """A vehicle in the air, on an offline link."""

    def __init__(self, phase=0.3, **options):
        self.world = make_world(**options)
        self.vehicle = self.world.vehicles["iris1"]
        self.autopilot = self.vehicle.firmware
        self.vehicle.fly_at((0.0, 0.0, 1.5))
        self.link = OfflineLink(self.vehicle, phase)
        self.seen = []

    def run(self, duration_s, sticks=None, every_s=0.0226):
        end_s, next_s = self.world.time_s + duration_s, self.world.time_s
        while self.world.time_s < end_s - 1e-9:
            now_s = self.world.time_s
            if sticks is not None and now_s >= next_s - 1e-9:
                self.link.send(sticks, now_s)
                next_s += every_s
            self.link.deliver(now_s)
            self.world.step_to(now_s + CYCLE_S)
            self.seen.append((self.world.time_s, self.autopilot.channels_us[:4]))

    def hover(self, **changes):
        throttle = self.autopilot.hover_throttle(self.vehicle.battery_pct)
        return Sticks(**{"forward": 0.0, "left": 0.0, "up": throttle, "turn_left": 0.0, **changes})


def test_sticks_become_channels_with_the_signs_of_the_angles():
    flight = Flight()
    flight.run(0.5, Sticks(forward=0.2, left=0.1234, up=-0.15, turn_left=-0.05))
    assert flight.autopilot.channels_us[:4] == (1438, 1400, 1425, 1525)
    flight.run(0.5, Sticks(forward=-1.0, left=-1.0, up=1.0, turn_left=1.0))
    assert flight.autopilot.channels_us[:4] == (2000, 2000, 2000, 1000)
    flight.run(0.3, Sticks(forward=0.0, left=0.0, up=0.0, turn_left=math.nan))
    assert flight.autopilot.channels_us[:4] == (2000, 2000, 2000, 1000), "refused"


def test_a_large_change_counts_when_the_next_message_confirms_it_and_takes_its_time():
    flight = Flight()
    flight.run(0.5, flight.hover())
    flight.run(0.02, flight.hover(left=0.4))
    flight.run(0.2, flight.hover())
    assert {us[0] for _, us in flight.seen[20:]} == {1500}, "one message alone may be damaged"
    flight.run(0.3, flight.hover(left=0.4))
    roll_us = [us[0] for _, us in flight.seen if us[0] > 0]
    assert roll_us[-1] == 1300 and np.abs(np.diff(roll_us[20:])).max() == SLEW_US


@pytest.mark.parametrize("phase", [0.0, 0.25, 0.5, 0.75])
def test_sticks_take_the_delay_of_the_vehicle_beside_the_wait_for_a_frame(phase):
    flight = Flight(phase)
    flight.run(0.5, flight.hover())
    began_s = flight.world.time_s
    flight.run(0.15, flight.hover(left=0.1))
    took_s = next(time_s for time_s, us in flight.seen if time_s > began_s and us[0] != 1500) - began_s
    delay_s = flight.vehicle.plant.command_delay_s
    assert delay_s - 1e-9 < took_s < delay_s + FRAME_S + 2 * CYCLE_S


def test_where_no_sticks_come_any_more_the_board_lowers_the_throttle_and_the_autopilot_lands():
    flight = Flight()
    flight.run(1.0, flight.hover())
    flight.link.lose(flight.world.time_s)
    flight.run(FAILSAFE_S - 0.05)
    assert flight.autopilot.mode is Mode.STABILIZE
    flight.run(0.25)
    assert flight.autopilot.mode is Mode.LAND and flight.autopilot.channels_us[2] == 950
    assert flight.link.report(flight.world.time_s)[:2] == (FlightPhase.LANDING, 100)
    flight.run(6.0)
    assert flight.link.phase is FlightPhase.LANDED and not flight.world.crashes


def test_orders_go_by_telemetry():
    flight = Flight()
    flight.run(0.5, flight.hover())
    flight.link.order(FlightAction.LAND, flight.world.time_s)
    flight.run(0.1, flight.hover())
    assert flight.link.phase is FlightPhase.LANDING
    flight.link.order(FlightAction.CUT_MOTORS, flight.world.time_s)
    flight.run(0.1, flight.hover())
    assert flight.link.phase is FlightPhase.EMERGENCY


def test_a_take_off_arms_in_stabilize_and_the_throttle_does_the_rest():
    flight = Flight()
    flight.run(0.5, flight.hover())
    flight.link.order(FlightAction.LAND, flight.world.time_s)
    flight.run(8.0, flight.hover(up=-1.0))
    assert not flight.autopilot.armed and flight.link.phase is FlightPhase.LANDED
    flight.link.order(FlightAction.TAKE_OFF, flight.world.time_s)
    flight.run(0.2, flight.hover(up=-1.0))
    assert flight.autopilot.armed and flight.link.phase is FlightPhase.FLYING, "armed is all that it tells"
    assert flight.vehicle.height_m == 0.08
    flight.run(1.0, flight.hover(up=0.1))
    assert flight.vehicle.height_m > 0.3


def test_the_charge_that_it_tells_is_whole_percents_of_the_true_one():
    flight = Flight()
    flight.vehicle.set_battery_pct(61.6)
    assert flight.link.report(flight.world.time_s)[1] == 62


def test_what_it_reports_of_itself():
    """It flies with its level error while reporting level; its height drifts; the same seed repeats all this."""
    flights = [Flight(perturbed=True, seed=3) for _ in range(2)]
    flight, reports = flights[0], []
    for _ in range(100):
        flight.run(0.1, flight.hover())
        reports.append(flight.link.report(flight.world.time_s)[2])
    tilt_rad = np.mean([report["tilt_rad"] for report in reports[20:]], axis=0)
    level_rad = flight.vehicle.plant.roll_level_rad, flight.vehicle.plant.pitch_level_rad
    assert 0.001 < max(map(abs, level_rad)) <= 2.0 * spreads().level_rad
    assert tilt_rad == pytest.approx((0.0, 0.0), abs=3e-4), "it is level, as it believes"
    assert (flight.vehicle.state.phi, flight.vehicle.state.theta) == pytest.approx(level_rad, abs=3e-4)
    ways_m = [report["height_m"] for report in reports]
    errors_m = np.array(ways_m) - flight.vehicle.state.position_m[2]
    assert 0.02 < np.std(np.diff(errors_m)) < 0.1 and len(set(ways_m)) == len(ways_m)
    assert 0.03 < flight.link.report_delay_s < 0.15
    flights[1].run(0.1, flights[1].hover())
    assert flights[1].link.report(flights[1].world.time_s)[2] == reports[0]
