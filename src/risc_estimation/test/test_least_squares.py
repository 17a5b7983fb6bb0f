"""Sliding-window fits: exact on polynomials, noise as the formula says, gaps and irregular stamps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sliding_fit import SlidingFit, endpoint_weights, slope_noise_gain

DT_S = 0.005


def push_all(fit, stamps_s, values, present=None):
    """Push (n, bodies, channels) values; returns the last estimate of all bodies."""
    for k, stamp_s in enumerate(stamps_s):
        fit.push(stamp_s, values[k], None if present is None else present[k])
    return fit.estimate()


def polynomial(coefficients, stamps_s, origin_s):
    """(n,) values of sum c_k (t - origin)^k and its derivative at the last stamp."""
    u = np.asarray(stamps_s) - origin_s
    values = np.polynomial.polynomial.polyval(u, coefficients)
    derivative = np.polynomial.polynomial.polyder(coefficients)
    return values, np.polynomial.polynomial.polyval(u[-1], derivative)


@settings(max_examples=100, derandomize=True)
@given(order=st.integers(1, 4), seed=st.integers(0, 10**6), jitter=st.floats(0.0, 0.4))
def test_exact_on_polynomials_at_irregular_stamps(order, seed, jitter):
    rng = np.random.default_rng(seed)
    stamps_s = 1.7e9 + DT_S * (np.arange(50) + rng.uniform(-jitter, jitter, 50))
    coefficients = rng.uniform(-1.0, 1.0, order + 1) * 4.0 ** np.arange(order + 1)
    values, slope = polynomial(coefficients, stamps_s, stamps_s[20])
    fit = SlidingFit(0.25, order, 1, max_gap_s=0.1)
    fit.add_body()
    value, rate, samples, span_s = push_all(fit, stamps_s, values[:, None, None])
    assert samples[0] in (49, 50)  # jitter may take the sample at the window's edge out
    assert span_s[0] == pytest.approx(stamps_s[-1] - stamps_s[50 - samples[0]])
    assert value[0, 0] == pytest.approx(values[-1], abs=1e-8)
    # Weights may be reused within UNIFORM_TOLERANCE_S only, never across a change of pattern.
    assert rate[0, 0] == pytest.approx(slope, abs=1e-6)


def test_slope_of_a_line_is_the_textbook_least_squares_slope():
    rng = np.random.default_rng(3)
    ages_s = np.append(np.sort(rng.uniform(0.0, 0.3, 16))[::-1], 0.0)
    samples = rng.normal(size=17)
    slope, value = np.polyfit(-ages_s, samples, 1)
    assert endpoint_weights(ages_s, 1) @ samples == pytest.approx([value, slope], abs=1e-10)


@pytest.mark.parametrize("samples", [2, 10, 20, 50])
def test_noise_formula_of_a_line(samples):
    assert slope_noise_gain(samples, DT_S) == pytest.approx(
        np.sqrt(12.0 / (samples * (samples**2 - 1.0))) / DT_S, rel=1e-9
    )


def test_measured_noise_matches_the_formula_and_the_documented_figures():
    """50 samples of 2 mm noise at 200 Hz: 3.9 mm/s for a line, about four times that for a parabola."""
    rng = np.random.default_rng(1)
    fits = {order: SlidingFit(0.25, order, 400, max_gap_s=0.1) for order in (1, 2)}
    for fit in fits.values():
        fit.add_body()
    slopes = {1: [], 2: []}
    for k in range(1000):
        noise = rng.normal(0.0, 0.002, (1, 400))
        for order, fit in fits.items():
            fit.push(k * DT_S, noise)
            if k >= 50 and k % 50 == 0:  # windows that do not overlap: independent estimates
                slopes[order].append(fit.estimate()[1])
    for order in (1, 2):
        expected = 0.002 * slope_noise_gain(50, DT_S, order)
        assert np.std(slopes[order]) == pytest.approx(expected, rel=0.04)
    assert np.std(slopes[1]) == pytest.approx(0.0039, rel=0.04)
    assert np.std(slopes[2]) / np.std(slopes[1]) == pytest.approx(4.0, rel=0.08)


def test_line_lags_half_its_window_and_parabola_does_not():
    stamps_s = DT_S * np.arange(60)
    values = 0.5 * 2.0 * stamps_s**2  # acceleration 2 m/s^2
    found = {}
    for order in (1, 2):
        fit = SlidingFit(0.25, order, 1, max_gap_s=0.1)
        fit.add_body()
        found[order] = push_all(fit, stamps_s, values[:, None, None])[1][0, 0]
    assert found[2] == pytest.approx(2.0 * stamps_s[-1], abs=1e-9)
    assert found[1] == pytest.approx(2.0 * (stamps_s[-1] - 49 * DT_S / 2), abs=1e-9)


def test_a_missed_frame_costs_nothing_on_a_polynomial():
    rng = np.random.default_rng(4)
    stamps_s = DT_S * np.arange(80)
    values, slope = polynomial([0.3, -1.0, 2.0], stamps_s, 0.0)
    present = rng.random((80, 2)) < 0.7
    present[-1] = True
    noisy = np.where(present[:, :, None], values[:, None, None], np.nan)
    fit = SlidingFit(0.25, 2, 1, max_gap_s=0.1)
    fit.add_body()
    fit.add_body()
    value, rate, samples, _ = push_all(fit, stamps_s, noisy, present)
    assert samples.tolist() == present[-50:].sum(axis=0).tolist()
    assert value[:, 0] == pytest.approx([values[-1]] * 2, abs=1e-9)
    assert rate[:, 0] == pytest.approx([slope] * 2, abs=1e-7)


def test_gap_restarts_only_the_body_that_has_it():
    fit = SlidingFit(0.25, 2, 1, max_gap_s=0.05)
    fit.add_body()
    fit.add_body()
    for k in range(50):
        fit.push(k * DT_S, np.zeros((2, 1)))
    for k in range(50, 65):  # 75 ms without body 1
        fit.push(k * DT_S, np.zeros((2, 1)), np.array([True, False]))
    fit.push(65 * DT_S, np.array([[0.0], [7.0]]))
    value, rate, samples, span_s = fit.estimate()
    assert samples.tolist() == [50, 1]
    assert value[:, 0] == pytest.approx([0.0, 7.0])
    assert rate[:, 0] == pytest.approx([0.0, 0.0])
    assert span_s[1] == 0.0
    fit.push(66 * DT_S, np.array([[0.0], [7.01]]))
    assert fit.estimate()[1][1, 0] == pytest.approx(2.0)  # 10 mm in 5 ms: the old samples are gone


def test_short_gap_is_bridged():
    fit = SlidingFit(0.25, 1, 1, max_gap_s=0.05)
    fit.add_body()
    for k in (0, 1, 2, 3, 11, 12):
        fit.push(k * DT_S, np.array([[k * DT_S]]))
    _, rate, samples, _ = fit.estimate()
    assert samples[0] == 6
    assert rate[0, 0] == pytest.approx(1.0)


def test_gap_in_the_frames_themselves_restarts_everybody_without_touching_old_samples():
    fit = SlidingFit(0.25, 2, 1, max_gap_s=0.1)
    fit.add_body()
    for k in range(50):
        fit.push(k * DT_S, np.full((1, 1), 5.0))
    fit.push(60.0, np.full((1, 1), -1.0))
    value, rate, samples, _ = fit.estimate()
    assert (value[0, 0], rate[0, 0], samples[0]) == (pytest.approx(-1.0), pytest.approx(0.0), 1)


def test_short_window_falls_back_to_a_line():
    fit = SlidingFit(0.25, 2, 1, max_gap_s=0.1, ramp=0.6)
    fit.add_body()
    stamps_s = DT_S * np.arange(40)
    for k in range(20):
        fit.push(stamps_s[k], np.full((1, 1), stamps_s[k] ** 2))
    assert fit.estimate()[1][0, 0] == pytest.approx(np.polyfit(stamps_s[:20], stamps_s[:20] ** 2, 1)[0], abs=1e-9)
    for k in range(20, 40):
        fit.push(stamps_s[k], np.full((1, 1), stamps_s[k] ** 2))
    assert fit.estimate()[1][0, 0] == pytest.approx(2.0 * stamps_s[-1], abs=1e-9)


def test_end_of_the_ring_is_invisible():
    """Ten thousand frames go round the ring many times; every estimate stays exact."""
    fit = SlidingFit(0.1, 2, 1, max_gap_s=0.1, max_rate_hz=220.0)
    fit.add_body()
    for k in range(10000):
        t = k * DT_S
        fit.push(t, np.array([[np.sin(t)]]))
        if k > 20:
            assert fit.estimate()[1][0, 0] == pytest.approx(np.cos(t), abs=2e-3)


@pytest.mark.parametrize("rate_hz,expected", [(50.0, 13), (100.0, 25), (200.0, 50), (400.0, 100)])
def test_window_is_a_time_whatever_the_rate(rate_hz, expected):
    fit = SlidingFit(0.25, 1, 1, max_gap_s=0.1)
    fit.add_body()
    for k in range(300):
        fit.push(k / rate_hz, np.zeros((1, 1)))
    assert fit.estimate()[2][0] == expected


def test_subset_equals_the_rows_of_the_whole():
    rng = np.random.default_rng(8)
    fit = SlidingFit(0.25, 2, 3, max_gap_s=0.1)
    for _ in range(5):
        fit.add_body()
    for k in range(70):
        fit.push(k * DT_S, rng.normal(size=(5, 3)))
    whole, part = fit.estimate(), fit.estimate(np.array([3, 1]))
    for all_rows, rows in zip(whole, part):
        assert rows == pytest.approx(all_rows[[3, 1]])
    assert [len(rows) for rows in fit.estimate(np.zeros(0, dtype=int))] == [0, 0, 0, 0]


def test_a_body_added_later_starts_empty_and_leaves_the_others_alone():
    fit = SlidingFit(0.25, 2, 1, max_gap_s=0.1)
    fit.add_body()
    for k in range(60):
        fit.push(k * DT_S, np.full((1, 1), k * DT_S))
    fit.add_body()
    fit.push(60 * DT_S, np.array([[60 * DT_S], [4.0]]))
    value, rate, samples, _ = fit.estimate()
    assert samples.tolist() == [50, 1]
    assert rate[:, 0] == pytest.approx([1.0, 0.0])
    assert value[:, 0] == pytest.approx([60 * DT_S, 4.0])


def test_a_body_that_appears_when_nobody_was_seen_for_long():
    fit = SlidingFit(0.25, 2, 1, max_gap_s=0.1)
    fit.add_body()
    for k in range(300):
        here = k >= 100  # the pattern of a full window occurs first with no body present
        fit.push(k * DT_S, [[1.0 + 2.0 * k * DT_S]], np.array([here]))
        value, rate, samples, _ = fit.estimate(np.arange(1 if here else 0))
        if here and samples[0] > 1:
            assert (value[0, 0], rate[0, 0]) == pytest.approx((1.0 + 2.0 * k * DT_S, 2.0), abs=1e-6)


def test_reset_forgets():
    fit = SlidingFit(0.25, 1, 1, max_gap_s=0.1)
    fit.add_body()
    for k in range(60):
        fit.push(100.0 + k * DT_S, np.full((1, 1), 9.0))
    fit.reset()
    fit.push(1.0, np.zeros((1, 1)))
    value, _, samples, _ = fit.estimate()
    assert (value[0, 0], samples[0]) == (pytest.approx(0.0), 1)


def test_too_few_distinct_times_have_a_mean_and_no_slope():
    np.testing.assert_allclose(endpoint_weights([0.0, 0.0, 0.0], 1), [[1.0 / 3.0] * 3, [0.0] * 3])
