"""ReferenceBuffer: extrapolation with jerk and snap, robustness against jumps and inconsistent samples."""

import numpy as np
import pytest

from risc_control import reference_buffer
from risc_control.reference_buffer import ReferenceBuffer
from risc_control.trajectories import make_course

DT_S = 0.005


def filled(course, count=60, start_s=0.0, jitter_s=0.0, seed=0):
    buffer, rng = ReferenceBuffer(), np.random.default_rng(seed)
    time_s = start_s
    for k in range(count):
        time_s = start_s + k * DT_S + jitter_s * rng.uniform(-1.0, 1.0)
        assert buffer.push(time_s, course.at(time_s)[:3])
    return buffer, time_s


@pytest.mark.parametrize("name", ["circle", "circles3", "flat8", "slanted8", "knot"])
@pytest.mark.parametrize("jitter_s", [0.0, 0.001])
def test_ahead_by_a_command_delay_with_jerk_and_snap(name, jitter_s):
    course = make_course(name, 3)
    buffer, now_s = filled(course, jitter_s=jitter_s, start_s=3.0)
    for ahead_s, tolerances in ((0.14, (2e-6, 3e-5, 1e-3, 0.015, 0.15)), (0.34, (5e-5, 5e-4, 5e-3, 0.05, 0.3))):
        value = buffer.at(np.array([now_s - 0.01, now_s + ahead_s]))
        exact = course.at(now_s + ahead_s)
        for order, tolerance in enumerate(tolerances):
            assert np.abs(value[1, order] - exact[order]).max() < tolerance, (ahead_s, order)
        assert np.abs(value[0, :3] - course.at(now_s - 0.01)[:3]).max() < 2e-6


def test_stamps_that_are_a_little_beside_the_time_of_the_sample_do_not_matter():
    """A microsecond of inconsistency, and the resolution of a float that counts seconds since 1970."""
    course, rng = make_course("circle", 1), np.random.default_rng(2)
    buffer = ReferenceBuffer()
    for k in range(80):
        buffer.push(1.7e9 + k * DT_S, course.at(k * DT_S + 1e-6 * rng.uniform(-1.0, 1.0))[:3])
    value = buffer.at(np.array([1.7e9 + 79 * DT_S + 0.34]))[0]
    exact = course.at(79 * DT_S + 0.34)
    for order, tolerance in enumerate((5e-5, 1e-3, 1e-2, 0.05, 0.3)):
        assert np.abs(value[order] - exact[order]).max() < tolerance


def test_a_jump_forgets_what_was_before():
    course = make_course("circle", 1)
    buffer, now_s = filled(course)
    moved = course.at(now_s + DT_S)[:3] + [[[1.0, 0.0, 0.0, 0.0]], [[0.0] * 4], [[0.0] * 4]]
    buffer.push(now_s + DT_S, moved)
    value = buffer.at(np.array([now_s + DT_S]))[0]
    assert value[0] == pytest.approx(moved[0]) and np.all(value[3:] == 0.0)


def test_an_acceleration_that_is_not_the_velocitys_derivative_does_not_wiggle():
    """A student's node that leaves the acceleration at 0: only the newest sample may count."""
    course = make_course("circle", 1)
    buffer = ReferenceBuffer()
    for k in range(60):
        sample = course.at(k * DT_S)[:3]
        sample[2] = 0.0
        buffer.push(k * DT_S, sample)
    value = buffer.at(np.array([59 * DT_S + 0.14]))[0]
    assert np.all(value[2:] == 0.0)
    assert value[0] == pytest.approx(sample[0] + 0.14 * sample[1])


def test_one_sample_is_extrapolated_with_its_acceleration():
    buffer = ReferenceBuffer()
    sample = np.arange(12.0).reshape(3, 1, 4)
    buffer.push(1.0, sample)
    value = buffer.at(np.array([1.2]))[0]
    assert value[0] == pytest.approx(sample[0] + 0.2 * sample[1] + 0.02 * sample[2])


def test_few_samples_are_enough_for_a_jerk():
    course = make_course("circle", 1)
    for count in (6, 10, 20, 22, 30):
        buffer, now_s = filled(course, count=count)
        value = buffer.at(np.array([now_s + 0.14]))[0]
        exact = course.at(now_s + 0.14)
        assert np.abs(value[0] - exact[0]).max() < 5e-4
        assert np.abs(value[3] - exact[3]).max() < 0.1


def test_yaw_that_wraps_in_the_messages_is_one_turn():
    buffer = ReferenceBuffer()
    for k in range(60):
        psi = 0.5 * k * DT_S + 3.0
        sample = np.zeros((3, 1, 4))
        sample[0, 0, 3], sample[1, 0, 3] = (psi + np.pi) % (2.0 * np.pi) - np.pi, 0.5
        buffer.push(k * DT_S, sample)
    value = buffer.at(np.array([59 * DT_S + 0.1]))[0, :, 0, 3]
    assert np.exp(1j * value[0]) == pytest.approx(np.exp(1j * (3.0 + 0.5 * (59 * DT_S + 0.1))))
    assert value[1:] == pytest.approx([0.5, 0.0, 0.0, 0.0], abs=1e-4)


def test_what_is_old_or_not_finite_is_refused():
    course = make_course("circle", 1)
    buffer, now_s = filled(course)
    assert not buffer.push(now_s, course.at(now_s)[:3])
    broken = course.at(now_s + DT_S)[:3]
    broken[1, 0, 2] = np.nan
    assert not buffer.push(now_s + DT_S, broken)
    assert buffer.newest_s == now_s


@pytest.mark.parametrize("every", [1, 2], ids=["for a while", "every other sample"])
def test_a_vehicle_without_numbers_changes_no_other_vehicles_reference(every):
    course = make_course("circles3", 3)
    (buffer, now_s), (sound, _) = filled(course), filled(course)
    for k in range(1, 80):
        sample = course.at(now_s + k * DT_S)[:3]
        assert sound.push(now_s + k * DT_S, sample)
        if k < 30 and k % every == 0:
            sample[k % 3, 1, k % 4] = (np.nan, np.inf)[k // 2 % 2]
        assert buffer.push(now_s + k * DT_S, sample)
        assert buffer.known[0] and buffer.known[2] and not (k % every == 0 and k < 30 and buffer.known[1])
        value, wanted = (each.at(np.array([now_s + k * DT_S + 0.14]))[0] for each in (buffer, sound))
        assert np.array_equal(value[:, (0, 2)], wanted[:, (0, 2)])
    assert buffer.known[1] and np.abs(value - wanted)[:3].max() < 1e-3, "and it has its own again"


def test_a_clock_that_falls_back_starts_afresh():
    """A bag that is played again, or a computer whose clock was set."""
    course = make_course("circle", 1)
    buffer, now_s = filled(course)
    sample = course.at(now_s)[:3]
    set_back_s = now_s - 0.3
    assert [buffer.push(set_back_s + k * DT_S, sample) for k in range(4)] == [False, False, True, True]
    assert buffer.newest_s == set_back_s + 3 * DT_S


def test_nothing_known():
    buffer = ReferenceBuffer()
    assert buffer.newest_s == -np.inf
    with pytest.raises(ValueError, match="no reference"):
        buffer.at(np.array([0.0]))


def test_nothing_is_compiled_in_flight_whatever_the_order_of_an_array():
    """A message's arrays are views with other strides."""
    functions = reference_buffer._find_finite, reference_buffer._continues, reference_buffer._evaluate
    course, buffer = make_course("circle", 2), ReferenceBuffer()
    before = [len(function.signatures) for function in functions]
    for k in range(60):
        buffer.push(k * DT_S, np.ascontiguousarray(course.at(k * DT_S)[:3].swapaxes(0, 1)).swapaxes(0, 1))
        buffer.at(np.array([k * DT_S]))
    assert [len(function.signatures) for function in functions] == before
