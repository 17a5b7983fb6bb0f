"""Controllers and reference buffer against what they gave before they were compiled, and against themselves uncompiled.

golden/tracking.npz is what `python test_tracking_golden.py golden/tracking.npz` wrote: "references" and "thesis" with
the numpy controllers of November 2026 (whose States took four arrays, and which, where a vehicle cannot be used, were
told to forget whether its command was cut: they went by a made-up state there), "full" and "late" uncompiled
(NUMBA_DISABLE_JIT=1) when their controller began to observe disturbances.

The flights are formulas with seeded noise, three vehicles of two types:

    t [s]
    0.0   vehicle 2 stands on the floor and takes off; vehicle 3 is not flown automatically before 0.5 s
    0.75  vehicle 1 is lost for 20 frames (its numbers mean nothing), again for 0.15 s from 2 s on
    1.3   one frame is missing; 0.15 s of frames from 2.6 s on
    1.7   the reference of vehicle 3 jumps by 3.9 m and 0.5 rad, and back at 2.2 s: its commands are cut
    3.0   no samples of the references for 0.1 s, then no references that may be used for 0.05 s
    3.5   vehicle 2 is not flown automatically for 0.3 s
    4.0   other weights
"""

import math
import os
import pathlib
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from risc_control.controllers import ControlLoop, differential_flatness, thesis_lqr
from risc_control.reference_buffer import ReferenceBuffer
from risc_lab.lab.vehicle_types import AttitudeLoop, VehicleType
from risc_lab.states import S, States

GOLDEN = np.load(pathlib.Path(__file__).parent / "golden" / "tracking.npz")
TOLERANCE = 1e-9  # of fractions, and N
# m, m/s, ... m/s^4: the condition number of the old fit was 319 (now 29) before it was squared by the normal equations
REFERENCE_TOLERANCES = (1e-10, 1e-9, 1e-8, 1e-7, 1e-6)
RATE_HZ, SECONDS, UNCOMPILED_SECONDS = 200.0, 5.0, 0.9
EVERY_COMMAND, EVERY_REFERENCE = 5, 30  # frames: what is kept of the results
EARLY = (3, 5, 8, 15, 19, 21, 25)  # and frames with few samples
OTHER = differential_flatness.Params(
    q_position=20.0, q_velocity=8.0, q_tilt=0.1, q_height=10.0, q_integral=0.0, q_yaw_rate=0.5
)
FIRST = differential_flatness.Params()
CASES = {  # controller, what the vehicles have otherwise, parameters, other parameters
    "full": (differential_flatness, {}, FIRST, OTHER),
    "late": (differential_flatness, {"command_delay_s": 0.3, "tilt_max_rad": 0.2, "climb_max_m_s": 0.5}, FIRST, OTHER),
    "thesis": (
        thesis_lqr,
        {},
        thesis_lqr.Params(q_position=2.0, q_velocity=4.0),
        thesis_lqr.Params(q_position=20.0, q_velocity=8.0, q_height=10.0, q_climb=8.0, q_yaw=4.0),
    ),
}

QUADROTOR = VehicleType(
    name="ardrone",
    mass_kg=0.45,
    inertia_kg_m2=(0.0022, 0.0030, 0.0048),
    radius_m=0.25,
    roll=AttitudeLoop(5.816, 0.738, 1.1714),
    pitch=AttitudeLoop(5.623, 0.611, 1.10714),
    yaw_rate_time_constant_s=0.1,
    climb_time_constant_s=0.3,
    tilt_max_rad=0.349066,
    yaw_rate_max_rad_s=0.349066,
    climb_max_m_s=1.0,
    command_delay_s=0.1,
    command_rate_hz=30.0,
    drag_n_s_m=0.1,
    battery_life_s=720.0,
)
HEAVY = replace(
    QUADROTOR,
    mass_kg=1.3,
    roll=AttitudeLoop(9.0, 0.8, 1.0),
    pitch=AttitudeLoop(8.0, 0.7, 0.9),
    yaw_rate_time_constant_s=0.2,
    climb_time_constant_s=0.4,
    climb_max_m_s=0.8,
    drag_n_s_m=0.3,
)
VEHICLE_TYPES = (QUADROTOR, HEAVY, QUADROTOR)


def reference(t):
    """(5, 3, 4) position to snap of x, y, z, psi of a circle, a slanted eight and a second circle."""
    result = np.zeros((5, 3, 4))
    w, phase = 2.0 * math.pi / 8.0, (0.0, 0.0, 2.0)
    for i in (0, 2):
        a = w * t + phase[i]
        for order in range(5):
            scale = 0.8 * w**order
            result[order, i, :2] = scale * math.cos(a + order * math.pi / 2), scale * math.sin(a + order * math.pi / 2)
        result[0, i, 2] = 1.0
    w = 2.0 * math.pi / 10.0
    for order in range(5):
        quarter = order * math.pi / 2
        result[order, 1, 0] = 1.5 * (w / 2) ** order * math.cos(w * t / 2 + quarter)
        result[order, 1, 1] = 0.75 * w**order * math.sin(w * t + quarter)
        result[order, 1, 2] = 0.5 * w**order * math.sin(w * t + quarter)
    result[0, 1, 2] += 1.0
    psi = np.array([0.15 * t + 2.8, -2.0, -0.02 * t * t - 3.0])  # two of them cross +-180 degrees
    result[0, :, 3] = (psi + math.pi) % (2.0 * math.pi) - math.pi
    result[1, :, 3], result[2, :, 3] = (0.15, 0.0, -0.04 * t), (0.0, 0.0, -0.04)
    if 1.7 <= t < 2.2:
        result[0, 2] += 3.0, -2.0, 1.5, 0.5
    return result


def frames(seconds, seed=15):
    """(t, stamp_s, now_s, visible (3,), x (3, 12), usable (3,), autonomous (3,)) of each frame."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(-3.0, 3.0, (3, len(S)))
    frequency = rng.uniform(0.5, 4.0, (3, len(S)))
    size = np.array([0.04] * 3 + [0.05] * 3 + [0.06, 0.06, 0.03] + [0.3, 0.3, 0.1])
    for k in range(int(seconds * RATE_HZ)):
        t = k / RATE_HZ + 3e-5 * rng.standard_normal()
        age_s = 0.005 + 0.004 * rng.random()
        noise = rng.standard_normal((3, len(S))) * np.repeat([0.001, 0.01, 0.005, 0.1], 3)
        if k == 260 or 2.6 <= t < 2.75:
            continue
        before = reference(t - 0.08)
        x = size * np.sin(frequency * t + phase) + noise
        x[:, S.X : S.U] += before[0, :, :3] - (3.0 * (1.7 <= t < 2.2)) * np.array(
            [[0.0] * 3, [0.0] * 3, [1.0, -0.7, 0.5]]
        )
        x[:, S.U : S.PHI] += before[1, :, :3]
        x[:, S.PSI] += before[0, :, 3]
        x[1, S.Z] *= min(1.0, t)
        visible = np.array([not (0.75 <= t < 0.85 or 2.0 <= t < 2.15), True, True])
        x[~visible] = np.nan
        usable = np.full(3, not 3.1 <= t < 3.15)
        autonomous = np.array([True, not 3.5 <= t < 3.8, t >= 0.5])
        yield t, 1000.0 + t, 1000.0 + t + age_s, visible, x, usable, autonomous


def commands(case, seconds=SECONDS):
    """(commands (k, 4, 3), saturated (k, 3)) of a case."""
    module, overrides, params, other = CASES[case]
    types = [replace(vehicle_type, **overrides) for vehicle_type in VEHICLE_TYPES]
    loop = ControlLoop(module.Controller, types, params)
    found, saturated = [], []
    for k, (t, stamp_s, now_s, visible, x, usable, autonomous) in enumerate(frames(seconds)):
        if t >= 4.0 and loop.params is not other:
            loop.set_params(other)
        ahead = reference(t + loop.times_s(stamp_s, now_s)[1] - stamp_s)
        output = loop.update(stamp_s, now_s, States(visible, x), reference(t), ahead, usable, autonomous)
        if k % EVERY_COMMAND == 0:
            found.append(np.array(output.controls))
            saturated.append(output.saturated)
    return np.array(found), np.array(saturated)


def references(seconds=SECONDS):
    """(k, 2, 5, 3, 4) what a ReferenceBuffer gives at the time of a frame, and 0.14 or 0.34 s later in turn."""
    buffer, found = ReferenceBuffer(), []
    for k, (t, stamp_s, *_) in enumerate(frames(seconds)):
        if not 3.0 <= t < 3.15:
            buffer.push(stamp_s, reference(t)[:3])
        if k % EVERY_REFERENCE == 0 or k in EARLY:
            found.append(buffer.at(np.array([stamp_s, stamp_s + (0.14 if len(found) % 2 else 0.34)])))
    return np.array(found)


def everything(seconds):
    """Dict of all results."""
    results = {"references": references(seconds)}
    for case in CASES:
        results[case + "_commands"], results[case + "_saturated"] = commands(case, seconds)
    return results


@pytest.mark.parametrize("case", CASES)
def test_commands_are_as_ever(case):
    found, saturated = commands(case)
    assert np.abs(found - GOLDEN[case + "_commands"]).max() < TOLERANCE
    assert (saturated == GOLDEN[case + "_saturated"]).all()


def test_references_are_as_ever():
    worst = np.abs(references() - GOLDEN["references"]).max(axis=(0, 1, 3, 4))
    assert (worst < REFERENCE_TOLERANCES).all(), worst


@pytest.mark.release
def test_uncompiled_it_gives_the_same(tmp_path):
    file, seconds = tmp_path / "uncompiled.npz", str(UNCOMPILED_SECONDS)
    environment = dict(os.environ, NUMBA_DISABLE_JIT="1")
    subprocess.run([sys.executable, __file__, str(file), seconds], check=True, env=environment, timeout=300)
    uncompiled = np.load(file)
    for name, found in everything(UNCOMPILED_SECONDS).items():
        tolerance = np.array(REFERENCE_TOLERANCES)[:, None, None] if name == "references" else 1e-12
        assert (np.abs(found.astype(float) - uncompiled[name]) <= tolerance).all(), name


if __name__ == "__main__":
    np.savez_compressed(sys.argv[1], **everything(float(sys.argv[2]) if len(sys.argv) > 2 else SECONDS))
