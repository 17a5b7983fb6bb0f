"""The lab's schedule in simulated time: long stalls under traffic, slow frame rates, wrong options."""

import socket

import numpy as np
import pytest
from addresses import free_port, own_net

from risc_lab.lab import FleetVehicle, Start
from risc_lab.lab.fleet import Fleet, MocapEndpoint
from risc_simulator import virtual_lab
from risc_simulator.models.flight import FlightPhase
from risc_simulator.virtual_lab import LabOptions, LatenessHistogram, VirtualLab

TAKE_OFF = 290718208


def make_fleet(rate_hz=200.0):
    net = own_net()
    vehicle = FleetVehicle("risc1", "fluffy_II", "ardrone", net + ".1.1", Start((0.5, 0.0, 0.0)))
    return Fleet("one", MocapEndpoint(net + ".0.1", stream_port=free_port(), rate_hz=rate_hz), (vehicle,), ())


class Pilot:
    """Sends AT commands as a real client does, one REF and one PCMD a datagram."""

    def __init__(self, fleet):
        self._address = (fleet.vehicles[0].address, 5556)
        self._sequence = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def send(self):
        self._socket.sendto(
            b"AT*REF=%d,%d\rAT*PCMD=%d,1,0,0,0,0\r" % (self._sequence + 1, TAKE_OFF, self._sequence + 2), self._address
        )
        self._sequence += 2

    def wake_up(self):
        self._socket.sendto(b"\1\0\0\0", (self._address[0], 5554))

    def close(self):
        self._socket.close()


@pytest.mark.parametrize("stall_s", [0.5, 3.0])
def test_commands_that_waited_through_a_stall_do_not_lie_in_the_future(clock, stall_s):
    """The lab once stamped them with the time before its clock was set back, so later commands waited behind them."""
    fleet = make_fleet()
    lab, pilot = VirtualLab(fleet), Pilot(fleet)
    try:
        pilot.wake_up()
        for _ in range(100):
            pilot.send()
            lab.step()
        for _ in range(5):
            pilot.send()
        clock.now_s += stall_s
        before_s = lab.exposure_s
        lab.step()
        assert lab.stalls == (1 if stall_s > virtual_lab.MAX_CATCH_UP_S else 0)
        if lab.stalls:
            assert lab.now_s() - before_s < 0.02, "the clock stood still"
        for _ in range(1100):
            pilot.send()
            lab.step()
        assert lab.lateness.max_s <= max(stall_s if not lab.stalls else 0.0, 0.011)
        assert lab.world.vehicles["risc1"].phase is FlightPhase.FLYING
        counts = lab.vehicle_hosts["risc1"].statistics()
        assert counts["com_watchdogs"] == 0 and counts["take_offs"] == 1
        assert lab.statistics()["vehicles"]["risc1"]["host"]["navdata_sent"] > 5
    finally:
        pilot.close()
        lab.close()


def test_a_short_stall_is_made_up_for_frame_by_frame(clock):
    """100 ms: late frames follow at once, each with its own time, until the schedule is met again."""
    fleet = make_fleet()
    lab, pilot = VirtualLab(fleet, live=True), Pilot(fleet)
    host, exposed_s, told_s, late_s = lab.vehicle_hosts["risc1"], [], [], []
    observe, tick, on_readable = lab.cameras.observe, host.tick, host.on_readable
    lab.cameras.observe = lambda time_s, *rest: (exposed_s.append(time_s), observe(time_s, *rest))[1]
    host.tick = lambda now_s: (told_s.append((now_s, lab.world.time_s)), tick(now_s))
    host.on_readable = lambda sock, now_s: (told_s.append((now_s, lab.world.time_s)), on_readable(sock, now_s))
    try:
        for k in range(200):
            if k == 100:
                clock.now_s += 0.1
            pilot.send()
            lab.step()
            late_s.append(lab.now_s() - lab.exposure_s - fleet.mocap.reported_delay_s)
        assert exposed_s == pytest.approx([k / 200.0 for k in range(1, 201)])
        assert lab.cortex_host.statistics()["frames_sent"] == 200 and lab.stalls == 0
        assert late_s[100:119] == pytest.approx([0.095 - 0.005 * k for k in range(19)], abs=1e-4)
        assert max(late_s[:100] + late_s[119:]) < 1e-4
        assert len(told_s) >= 400 and told_s == sorted(told_s), "time went back"
        assert all(world_s <= now_s for now_s, world_s in told_s), "the world was ahead of its hosts"
    finally:
        pilot.close()
        lab.close()


class Load:
    """Makes every cycle of a lab take cycle_s, or more, of simulated time."""

    def __init__(self, lab, clock, monkeypatch):
        self.cycle_s = 0.0
        advance = lab.world.step_to
        monkeypatch.setattr(
            lab.world, "step_to", lambda time_s: (setattr(clock, "now_s", clock.now_s + self.cycle_s), advance(time_s))
        )


@pytest.mark.parametrize("rate_hz", [50.0, 200.0])
def test_a_lab_that_is_too_slow_leaves_frames_out_and_stays_near_real_time(clock, monkeypatch, rate_hz):
    """20 s of a load that allows two of three cycles; the lab used to be 1 s late throughout."""
    fleet = make_fleet(rate_hz)
    lab, pilot = VirtualLab(fleet, live=True), Pilot(fleet)
    load = Load(lab, clock, monkeypatch)
    late_s, told_s = [], []
    tick = lab.vehicle_hosts["risc1"].tick
    lab.vehicle_hosts["risc1"].tick = lambda now_s: (told_s.append(now_s), tick(now_s))
    try:
        lab.run(duration_s=1.0)
        load.cycle_s = 0.0075
        while lab.now_s() < 21.0:
            pilot.send()
            lab.step()
            late_s.append(lab.now_s() - lab.world.time_s)
        assert max(late_s) < 0.5 and sum(late_s) / len(late_s) < 0.25, "the world, and what it was told, were late"
        statistics = lab.statistics()
        skipped = statistics["frames_skipped"]
        assert skipped == pytest.approx(20.0 * rate_hz / 3.0, rel=0.1) and lab.stalls == 0
        assert statistics["cortex"]["frames_exposed"] == lab.frame - skipped
        assert told_s == sorted(told_s) and lab.world.vehicles["risc1"].phase is FlightPhase.FLYING
        load.cycle_s = 0.0
        lab.run(duration_s=lab.exposure_s + 1.0)
        assert lab.now_s() - lab.exposure_s < 0.01, "the load has ended, so has the delay"
        assert lab.statistics()["frames_skipped"] == skipped
    finally:
        pilot.close()
        lab.close()


def test_stalls_are_counted_not_the_cycles_after_them(clock, monkeypatch):
    lab = VirtualLab(make_fleet())
    load = Load(lab, clock, monkeypatch)
    try:
        lab.run(duration_s=0.1)
        clock.now_s += 0.98  # almost a stall,
        load.cycle_s = 0.006  # and the computer is too slow to make up for it
        for _ in range(50):
            lab.step()
        assert lab.stalls == 0
        for _ in range(2):
            clock.now_s += 5.0
            for _ in range(50):
                lab.step()
        assert lab.stalls == 2
    finally:
        lab.close()


@pytest.mark.parametrize("rate_hz, frames", [(10.0, 5), (60.0, 30), (200.0, 100), (400.0, 200)])
def test_vehicles_are_served_at_200_hz_whatever_the_cameras_do(clock, rate_hz, frames):
    fleet = make_fleet(rate_hz)
    lab, pilot = VirtualLab(fleet, live=True), Pilot(fleet)
    ticks = []
    tick = lab.vehicle_hosts["risc1"].tick
    lab.vehicle_hosts["risc1"].tick = lambda now_s: (ticks.append(now_s), tick(now_s))
    try:
        lab.run(duration_s=0.5)
        assert lab.frame == frames
        assert lab.statistics()["cortex"]["frames_exposed"] == frames
        assert lab.world.time_s == pytest.approx(0.5)
        gaps_s = [after - before for before, after in zip(ticks, ticks[1:])]
        assert max(gaps_s) < 0.0051
    finally:
        pilot.close()
        lab.close()


@pytest.mark.parametrize(
    "options, key",
    [({"rate": 0.0}, "rate_hz"), ({"cortex_port": 70000}, "command_port"), ({"stream_port": 0}, "stream_port")],
)
def test_options_are_checked_like_the_fleet_file(options, key):
    with pytest.raises(ValueError, match=key):
        LabOptions(**options).configure(make_fleet())


def test_impossible_delay_is_refused():
    with pytest.raises(ValueError, match="command.delay|finite"):
        VirtualLab(make_fleet(), delay=float("inf"))


def test_histogram_percentiles_agree_with_the_sorted_values():
    values = np.random.default_rng(3).exponential(0.0005, 5000)
    histogram = LatenessHistogram()
    for value in values:
        histogram.add(value)
    for percent, rank in ((1.0, 50), (50.0, 2500), (90.0, 4500), (99.0, 4950), (99.9, 4995)):
        exact = np.sort(values)[rank - 1]
        assert exact <= histogram.percentile_s(percent) <= exact + histogram.BIN_S
    assert histogram.percentile_s(100.0) == histogram.max_s == values.max()


def test_histogram_edges():
    histogram = LatenessHistogram()
    assert histogram.percentile_s(99.0) == 0.0
    histogram.add(-0.5)
    assert (histogram.percentile_s(50.0), histogram.max_s) == (0.0, 0.0)
    histogram.add(7.0)
    assert histogram.percentile_s(99.0) == histogram.max_s == 7.0
    assert histogram.percentile_s(50.0) == histogram.BIN_S
