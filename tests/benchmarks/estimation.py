"""How noisy and late the estimates are and how long a frame takes: `./maap bench estimation`.

Simulated: hovering vehicles, white marker noise, stamps with the jitter of a good clock. Seeded. No filter gets the
commands. lag_ms: delay of the velocity of a vehicle that oscillates by 0.2 m, with a period of two seconds.
"""

import argparse
import io
import json
import sys
import time

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from std_msgs.msg import Header

from risc_estimation.ekf import DIM
from risc_estimation.filters import DEFAULT, REGISTRY, make_filter
from risc_estimation.ros.conversions import FRAME_ID, EstimateMessages
from risc_estimation.state_estimator import StatesEstimator
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.templates import Template, load_templates
from risc_lab.ros.fleet_messages import MocapArrays
from risc_lab.states import S

RATE_HZ = 200.0
MARKER_NOISE_M = 0.002
STAMP_JITTER_S = 30e-6
SINE_M, SINE_RAD_S = 0.2, np.pi
COLUMNS = {
    "x_mm": (S.X, 1e3),
    "z_mm": (S.Z, 1e3),
    "vx_mm_s": (S.U, 1e3),
    "vz_mm_s": (S.W, 1e3),
    "phi_deg": (S.PHI, np.rad2deg(1.0)),
    "psi_deg": (S.PSI, np.rad2deg(1.0)),
    "p_deg_s": (S.P, np.rad2deg(1.0)),
    "r_deg_s": (S.R, np.rad2deg(1.0)),
}


def hover_frames(templates, frames, rng, hidden=0.0):
    """(layout, list of markers (n, 3) [m]): every template at rest at its own place inside the net.

    hidden: share of the bodies that lack a marker, different ones in each frame.
    """
    exact = {}
    for index, template in enumerate(templates):
        place = np.array([-2.0 + 0.4 * (index % 11), -1.6 + 0.8 * (index // 11), 1.0])
        turn = rotation_body_to_cortex(0.0, 0.0, 0.4 * index) if template.kind == "vehicle" else np.eye(3)
        exact[template.name] = place + template.markers_m @ turn.T
    layout, exact_m = tuple((name, len(part)) for name, part in exact.items()), np.concatenate(list(exact.values()))
    sampled = [exact_m + rng.normal(0.0, MARKER_NOISE_M, exact_m.shape) for _ in range(frames)]
    if hidden:
        firsts = np.cumsum([0] + [count for _, count in layout[:-1]])
        for markers_m in sampled:
            markers_m[firsts[rng.random(len(firsts)) < hidden]] = np.nan
    return layout, sampled


def run(estimator, layout, frames, rng):
    """Estimates of all frames and the seconds each took."""
    stamps_s = 1.0e9 + np.arange(len(frames)) / RATE_HZ + rng.normal(0.0, STAMP_JITTER_S, len(frames))
    estimates, seconds = [], []
    for stamp_s, markers_m in zip(stamps_s.tolist(), frames):
        start = time.perf_counter()
        estimates.append(estimator.update(stamp_s, layout, markers_m))
        seconds.append(time.perf_counter() - start)
    return estimates, seconds


def noise_table(frames=4000, seed=1):
    """Standard deviation of the estimates of one hovering vehicle: dict filter -> dict column -> number."""
    template = load_templates()["fluffy_II"]
    corners = Template(template.name, template.kind, template.marker_names[:3], template.markers_m[:3])
    cases = {name: (template, name, None) for name in REGISTRY.names()}
    cases[DEFAULT + ", raw"] = (template, DEFAULT, {"smooth_position": False, "smooth_angles": False})
    cases[DEFAULT + ", three corner markers"] = (corners, DEFAULT, None)
    table = {}
    for case, (body, name, given) in cases.items():
        rng = np.random.default_rng(seed)
        estimator = StatesEstimator({body.name: body}, velocity_filter=make_filter(name, given))
        estimates, _ = run(estimator, *hover_frames([body], frames, rng), rng)
        states = np.array([estimate.states[0] for estimate in estimates[100:]])
        table[case] = {column: float(states[:, index].std() * scale) for column, (index, scale) in COLUMNS.items()}
        table[case]["lag_ms"] = lag_ms(body, make_filter(name, given), seed)
    return table


def lag_ms(body, velocity_filter, seed=1, periods=4):
    """Delay [ms] of the velocity of a vehicle on a sine along x, from its phase; the first period is left out."""
    rng, n = np.random.default_rng(seed), round(2.0 * np.pi / SINE_RAD_S * RATE_HZ)
    layout, frames = hover_frames([body], n * (1 + periods), rng)
    turns_rad = SINE_RAD_S * np.arange(len(frames)) / RATE_HZ
    for markers_m, moved_m in zip(frames, SINE_M * np.sin(turns_rad)):
        markers_m[:, 0] += moved_m
    estimates, _ = run(StatesEstimator({body.name: body}, velocity_filter=velocity_filter), layout, frames, rng)
    velocity_m_s = np.array([estimate.states[0, S.U] for estimate in estimates[n:]])
    return float(-1e3 * np.angle(velocity_m_s @ np.exp(-1j * turns_rad[n:])) / SINE_RAD_S)


def filterpy_us(times=500):
    """Median time [us] of one prediction and one update by a pose in filterpy, with model and matrices given."""
    other, H, R = ExtendedKalmanFilter(dim_x=DIM, dim_z=6), np.eye(DIM)[:6], np.eye(6)
    seconds = []
    for _ in range(times):
        start = time.perf_counter()
        other.predict()
        other.update(np.zeros((6, 1)), lambda x: H, lambda x: H @ x, R)
        seconds.append(time.perf_counter() - start)
    return 1e6 * float(np.median(seconds))


def time_table(fleet_sizes, frames=1000, seed=1):
    """Microseconds per frame: list of dict, one for each fleet; its vehicles have five markers.

    Keys without the name of a filter are those of the default one.
    """
    known = load_templates()
    iris = known["IRIS"]
    landmarks = [template for template in known.values() if template.kind == "landmark"]
    rows = []
    for count in fleet_sizes:
        vehicles = [Template("vehicle_%d" % k, "vehicle", iris.marker_names, iris.markers_m) for k in range(count)]
        bodies = vehicles + landmarks
        row = {"vehicles": count, "landmarks": len(landmarks)}
        for view, hidden in (("", 0.0), ("hidden_", 0.3)):
            rng = np.random.default_rng(seed)
            layout, sampled = hover_frames(bodies, frames, rng, hidden)
            for name in REGISTRY.names() if not hidden else [DEFAULT]:
                estimator = StatesEstimator(
                    {template.name: template for template in bodies}, velocity_filter=make_filter(name)
                )
                estimates, seconds = run(estimator, layout, sampled, rng)
                case = view if name == DEFAULT else name + "_"
                row[case + "p50_us"], row[case + "p99_us"] = (1e6 * np.percentile(seconds[100:], [50, 99])).tolist()
                if not hidden and name == DEFAULT:
                    row["messages_p50_us"] = messages_us(layout, sampled, estimates)
        rows.append(row)
    return rows


def messages_us(layout, frames, estimates):
    """Median time [us] to deserialise a frame, convert both ways and serialise the results."""
    frame, messages, seconds, sent = MocapArrays(), EstimateMessages(), [], MocapArrays(layout)
    sent.header = Header(frame_id=FRAME_ID)
    for markers_m, estimate in zip(frames, estimates):
        wire = io.BytesIO()
        sent.markers_m[:] = markers_m
        sent.serialize(wire)
        data = wire.getvalue()
        start = time.perf_counter()
        frame.deserialize(data)
        messages.states(frame.header, estimate).serialize(io.BytesIO())
        messages.landmarks(frame.header, estimate).serialize(io.BytesIO())
        seconds.append(time.perf_counter() - start)
    return 1e6 * float(np.median(seconds))


def main(arguments=None):
    """Print the tables; with --json also write them. Returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vehicles", type=int, nargs="+", default=[3, 10, 50], help="fleet sizes to time")
    parser.add_argument("--json", metavar="FILE", help="also write the figures here")
    options = parser.parse_args(arguments)
    if min(options.vehicles) < 1:
        parser.error("--vehicles needs numbers from 1 up")
    noise, times = noise_table(), time_table(options.vehicles)
    print(
        "Noise (1 sigma) of a hovering vehicle, %.0f mm markers at %.0f Hz, simulated" % (1e3 * MARKER_NOISE_M, RATE_HZ)
    )
    columns = *COLUMNS, "lag_ms"
    print("%-36s" % "" + "".join("%10s" % column for column in columns))
    for name, row in noise.items():
        print("%-36s" % name + "".join("%10.2f" % row[column] for column in columns))
    print("\nTime per frame [us], one core; hidden: three of ten bodies lack a marker, others in each frame")
    cases = "", "hidden_", *(name + "_" for name in REGISTRY.names() if name != DEFAULT)
    keys = ["%sp%d_us" % (case, percent) for case in cases for percent in (50, 99)] + ["messages_p50_us"]
    titles = [key.removesuffix("_us").replace("_p", ": p").replace("_", " ") for key in keys]
    print(("%10s%10s" + "%20s" * len(keys)) % ("vehicles", "landmarks", *titles))
    for row in times:
        print(("%10d%10d" + "%20.1f" * len(keys)) % (row["vehicles"], row["landmarks"], *(row[key] for key in keys)))
    oracle_us = filterpy_us()
    print("\nA prediction and a pose of one body by filterpy: %.0f us" % oracle_us)
    if options.json:
        with open(options.json, "w", encoding="utf-8") as output:
            json.dump(
                {
                    "simulated": True,
                    "marker_noise_m": MARKER_NOISE_M,
                    "rate_hz": RATE_HZ,
                    "noise": noise,
                    "time": times,
                    "filterpy_us": oracle_us,
                },
                output,
                indent=2,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
