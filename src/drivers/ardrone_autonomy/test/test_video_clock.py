import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ardrone_autonomy import video_clock
from ardrone_autonomy.video_clock import ExposureClock

PERIOD_S = 1.0 / 30.0
LATENCY_S = 0.12
RESOLUTION_S = 0.0011  # of the aircraft's clock
BOOT_S = 4321.0  # our time when the aircraft's clock read 0


class Flight:
    """Pictures with known exposure times: radio jitter, stalls that deliver in bunches, a drifting clock."""

    def __init__(self, seconds, drift=0.0, jitter_s=0.02, stalls=(), seed=1, boot_s=BOOT_S, first_s=100.0):
        rng = np.random.default_rng(seed)
        self.exposure_s = boot_s + first_s + np.arange(int(seconds / PERIOD_S)) * PERIOD_S
        self.timestamp_ms = np.floor((self.exposure_s - boot_s) * (1.0 + drift) * 1e3).astype(int) % 2**32
        free_s = self.exposure_s + LATENCY_S + rng.gamma(0.5, jitter_s, len(self.exposure_s))
        free_s[::9] = self.exposure_s[::9] + LATENCY_S  # every ninth picture arrives undelayed
        for begin_s, length_s in stalls:  # pictures due during the stall arrive at its end
            begin_s += self.exposure_s[0]
            held_up = (free_s >= begin_s) & (free_s < begin_s + length_s)
            free_s[held_up] = begin_s + length_s
        self.received_s = np.maximum.accumulate(free_s)  # TCP keeps the order

    def results(self, clock):
        return np.array([clock.exposure_s(int(t), r) for t, r in zip(self.timestamp_ms, self.received_s)])


def test_jitter_is_filtered_and_the_latency_taken_off():
    flight = Flight(60.0)
    plain_s = flight.received_s - LATENCY_S - flight.exposure_s
    assert np.percentile(plain_s, 95) > 0.02  # the error of reception times alone
    error_s = flight.results(ExposureClock(LATENCY_S)) - flight.exposure_s
    assert np.abs(error_s[30:]).max() < RESOLUTION_S


def test_without_a_latency_it_is_the_time_of_an_undisturbed_reception():
    flight = Flight(20.0)
    error_s = flight.results(ExposureClock()) - flight.exposure_s
    assert np.abs(error_s[30:] - LATENCY_S).max() < 0.002


@pytest.mark.parametrize("drift", [-2.5e-4, -1e-4, 1e-4, 2.5e-4])
def test_drift_of_the_aircrafts_clock_is_followed(drift):
    flight = Flight(600.0, drift=drift)  # up to 150 ms in all
    error_s = flight.results(ExposureClock(LATENCY_S)) - flight.exposure_s
    assert np.abs(error_s[30:]).max() < RESOLUTION_S


def test_pictures_of_a_stall_get_their_own_times():
    flight = Flight(30.0, stalls=[(5.0, 0.4), (10.0, 1.5), (20.0, 3.0)])
    assert np.sum(np.diff(flight.received_s) == 0.0) > 100
    error_s = flight.results(ExposureClock(LATENCY_S)) - flight.exposure_s
    assert np.abs(error_s[30:]).max() < RESOLUTION_S


def test_a_computer_that_is_busy_for_seconds_moves_no_picture():
    flight = Flight(60.0)
    busy = (flight.exposure_s > flight.exposure_s[0] + 20.0) & (flight.exposure_s < flight.exposure_s[0] + 35.0)
    flight.received_s[busy] += 0.1 + 0.3 * np.random.default_rng(5).random(busy.sum())
    flight.received_s = np.maximum.accumulate(flight.received_s)
    clock = ExposureClock(LATENCY_S)
    error_s = flight.results(clock) - flight.exposure_s
    assert np.abs(error_s[30:]).max() < RESOLUTION_S, "15 s of MAX_DRIFT are 0.0045"
    assert clock.restarts == 0


def test_joining_in_a_stall_corrects_itself():
    flight = Flight(10.0, stalls=[(0.0, 1.0)])
    clock = ExposureClock(LATENCY_S)
    error_s = flight.results(clock) - flight.exposure_s
    assert error_s[0] > 0.5  # unavoidable at the first picture
    assert np.abs(error_s[45:]).max() < 0.002
    assert clock.restarts == 0


@pytest.mark.parametrize("first_s", [0.0, 7.0])
def test_a_rebooted_aircraft_starts_anew(first_s):
    clock = ExposureClock(LATENCY_S)
    Flight(20.0).results(clock)
    second = Flight(20.0, boot_s=BOOT_S + 130.0, first_s=first_s, seed=2)
    error_s = second.results(clock) - second.exposure_s
    assert clock.restarts == 1
    assert np.abs(error_s[30:]).max() < 0.002


def test_a_clock_that_stands_still_gives_reception_times():
    clock = ExposureClock()
    received_s = BOOT_S + np.cumsum(np.full(50, PERIOD_S))
    assert [clock.exposure_s(0, r) for r in received_s] == list(received_s)


def test_a_clock_set_forward_is_believed_at_once():
    clock = ExposureClock(LATENCY_S)
    Flight(10.0).results(clock)
    late = Flight(10.0, boot_s=BOOT_S - 1000.0, first_s=1110.0, seed=2)  # reads 1000 s more
    error_s = late.results(clock) - late.exposure_s
    assert np.abs(error_s[30:]).max() < 0.002


def test_a_clock_that_was_stopped_is_believed_after_a_while():
    clock = ExposureClock(LATENCY_S)
    Flight(10.0).results(clock)
    late = Flight(60.0, boot_s=BOOT_S + 1.0, first_s=110.0, seed=2)  # reads 1 s less than before, but advances
    error_s = late.results(clock) - late.exposure_s
    assert error_s[30] < -0.9
    settled = int((video_clock.PATIENCE_S + 0.5) / PERIOD_S)
    assert np.abs(error_s[settled:]).max() < 0.003
    assert clock.restarts == 1


def test_the_wrap_of_the_counter_changes_nothing():
    flight = Flight(20.0, first_s=(2**32 - 10000) / 1e3)
    assert np.any(np.diff(flight.timestamp_ms) < 0)
    clock = ExposureClock(LATENCY_S)
    error_s = flight.results(clock) - flight.exposure_s
    assert np.abs(error_s[30:]).max() < 0.002
    assert clock.restarts == 0


@given(st.lists(st.tuples(st.integers(0, 2**32 - 1), st.floats(0.002, 5.0)), min_size=1, max_size=60))
def test_whatever_the_aircraft_says_times_increase_and_never_lie_ahead(pictures):
    clock, received_s, last_s = ExposureClock(0.1), 1000.0, float("-inf")
    for timestamp_ms, step_s in pictures:
        received_s += step_s
        exposure_s = clock.exposure_s(timestamp_ms, received_s)
        assert last_s < exposure_s <= received_s - 0.1
        last_s = exposure_s
