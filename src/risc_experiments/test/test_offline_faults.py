"""Faults on the wires of offline flights: mocap frames and commands."""

import dataclasses

import numpy as np
import pytest

from risc_experiments.offline import Flight, fly
from risc_simulator.faults import WireFault

CLEAN = Flight(vehicles=1, seed=3, duration_s=3.0)


@pytest.fixture(scope="module")
def clean():
    return fly(CLEAN)


def flown(*faults):
    return fly(dataclasses.replace(CLEAN, wire_faults=faults))


@pytest.mark.parametrize(
    "fault", [WireFault("drop", "cortex/stream", 0.3), WireFault("jitter", "*/commands", 0.05)], ids=lambda f: f.fault
)
def test_a_flight_bears_them_and_a_seed_repeats_it(clean, fault):
    first, again = flown(fault), flown(fault)
    np.testing.assert_array_equal(first.actual_m, again.actual_m)
    assert not np.array_equal(first.actual_m, clean.actual_m)
    assert first.rmse_m[0] < 0.1


def test_late_frames_are_known_to_be_late_and_late_commands_are_not(clean):
    frames, commands = (flown(WireFault("delay", channel, 0.08)) for channel in ("cortex/stream", "*/commands"))
    assert min(frames.rmse_m[0], commands.rmse_m[0]) > 1.3 * clean.rmse_m[0]
    assert frames.safety and not commands.safety


def test_a_hole_in_the_stream_is_seen_by_the_failsafe(clean):
    assert clean.safety == ()
    hole = flown(WireFault("blackhole", "cortex/stream", start_s=5.0, duration_s=0.3))
    assert hole.safety and 5.08 < hole.safety[0][0] < 5.15
