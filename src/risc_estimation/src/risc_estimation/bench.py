"""How noisy the estimates are and how long a frame takes: `python3 -m risc_estimation.bench [--json FILE]`.

Simulated: hovering vehicles, white marker noise, stamps with the jitter of a good clock. Seeded.
"""

import argparse
import importlib.util
import json
import sys
import time

import numpy as np

from risc_control.frames import rotation_body_to_cortex
from risc_control.lab.templates import Template, load_templates
from risc_estimation.states import EstimatorParams, S, StatesEstimator

RATE_HZ = 200.0
MARKER_NOISE_M = 0.002
STAMP_JITTER_S = 30e-6
VARIANTS = {
    "default": EstimatorParams(),
    "legacy_window": EstimatorParams(legacy_window=True),
    "raw": EstimatorParams(smooth_position=False, smooth_angles=False),
}
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


def hover_frames(templates, frames, rng):
    """List of dict name -> markers (n, 3) [m]: every template at rest at its own place inside the net."""
    exact = {}
    for index, template in enumerate(templates):
        place = np.array([-2.0 + 0.4 * (index % 11), -1.6 + 0.8 * (index // 11), 1.0])
        turn = rotation_body_to_cortex(0.0, 0.0, 0.4 * index) if template.kind == "vehicle" else np.eye(3)
        exact[template.name] = place + template.markers_m @ turn.T
    return [
        {name: markers + rng.normal(0.0, MARKER_NOISE_M, markers.shape) for name, markers in exact.items()}
        for _ in range(frames)
    ]


def run(estimator, frames, rng):
    """Estimates of all frames and the seconds each took."""
    stamps_s = 1.0e9 + np.arange(len(frames)) / RATE_HZ + rng.normal(0.0, STAMP_JITTER_S, len(frames))
    estimates, seconds = [], []
    for stamp_s, frame in zip(stamps_s.tolist(), frames):
        start = time.perf_counter()
        estimates.append(estimator.update(stamp_s, frame))
        seconds.append(time.perf_counter() - start)
    return estimates, seconds


def noise_table(frames=4000, seed=1):
    """Standard deviation of the estimates of one hovering vehicle: dict variant -> dict column -> number."""
    template = load_templates()["fluffy_II"]
    cases = {name: (template, params) for name, params in VARIANTS.items()}
    corners = Template(template.name, template.kind, template.marker_names[:3], template.markers_m[:3])
    cases["default, three corner markers"] = (corners, VARIANTS["default"])
    table = {}
    for name, (body, params) in cases.items():
        rng = np.random.default_rng(seed)
        estimates, _ = run(StatesEstimator({body.name: body}, params), hover_frames([body], frames, rng), rng)
        states = np.array([estimate.states[0] for estimate in estimates[100:]])
        table[name] = {column: float(states[:, index].std() * scale) for column, (index, scale) in COLUMNS.items()}
    return table


def time_table(fleet_sizes, frames=600, seed=1):
    """Microseconds per frame: list of dict with vehicles, p50_us, p99_us (estimator), messages_p50_us (ROS side)."""
    known = load_templates()
    hull = known["fluffy_II"]
    landmarks = [template for template in known.values() if template.kind == "landmark"]
    rows = []
    for count in fleet_sizes:
        vehicles = [Template("vehicle_%d" % k, "vehicle", hull.marker_names, hull.markers_m) for k in range(count)]
        bodies = vehicles + landmarks
        rng = np.random.default_rng(seed)
        sampled = hover_frames(bodies, frames, rng)
        estimator = StatesEstimator({template.name: template for template in bodies})
        estimates, seconds = run(estimator, sampled, rng)
        row = {
            "vehicles": count,
            "landmarks": len(landmarks),
            "p50_us": 1e6 * float(np.percentile(seconds[100:], 50)),
            "p99_us": 1e6 * float(np.percentile(seconds[100:], 99)),
        }
        if importlib.util.find_spec("risc_msgs") is not None:
            row["messages_p50_us"] = messages_us(sampled, estimates)
        rows.append(row)
    return rows


def messages_us(frames, estimates):
    """Median time [us] to deserialise a frame, convert both ways and serialise the results."""
    import io

    from std_msgs.msg import Header

    from risc_estimation.ros import conversions
    from risc_msgs.msg import Mocap_data

    seconds = []
    for frame, estimate in zip(frames, estimates):
        wire = io.BytesIO()
        conversions.bodies_to_msg(Header(frame_id=conversions.FRAME_ID), frame).serialize(wire)
        data = wire.getvalue()
        start = time.perf_counter()
        msg = Mocap_data().deserialize(data)
        conversions.bodies_from_msg(msg)
        header = conversions.header_for(msg.header)
        conversions.cortex_from_estimate(header, estimate).serialize(io.BytesIO())
        conversions.landmarks_from_estimate(header, estimate).serialize(io.BytesIO())
        seconds.append(time.perf_counter() - start)
    return 1e6 * float(np.median(seconds))


def main(arguments=None):
    """Print both tables; with --json also write them. Returns the exit code."""
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
    print("%-30s" % "" + "".join("%10s" % column for column in COLUMNS))
    for name, row in noise.items():
        print("%-30s" % name + "".join("%10.2f" % row[column] for column in COLUMNS))
    print("\nTime per frame, one core")
    print("%10s%10s%14s%14s%16s" % ("vehicles", "landmarks", "estimate p50", "estimate p99", "messages p50"))
    for row in times:
        messages = "%13.0f us" % row["messages_p50_us"] if "messages_p50_us" in row else "%16s" % "-"
        print(
            "%10d%10d%11.0f us%11.0f us%s" % (row["vehicles"], row["landmarks"], row["p50_us"], row["p99_us"], messages)
        )
    if options.json:
        with open(options.json, "w", encoding="utf-8") as output:
            json.dump(
                {
                    "simulated": True,
                    "marker_noise_m": MARKER_NOISE_M,
                    "rate_hz": RATE_HZ,
                    "noise": noise,
                    "time": times,
                },
                output,
                indent=2,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
