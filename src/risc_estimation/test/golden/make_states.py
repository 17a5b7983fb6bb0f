"""Makes states.npz: what the estimator made of a seeded flight before it was compiled.

Run with the estimator of commit 6d2d503 (numpy; `update` took a dict of bodies; its modules have other names):

    python3 make_states.py

Recorded at 200 Hz with 2 mm of noise, on a grid of 0.1 mm: three vehicles from the start, a fourth and the tip of a
pendulum later, four landmarks, and everything that makes a frame irregular (SCRIPT below). Keys:

    stamps_s (frames,), layout (frames,) index into layouts (JSON), markers (all markers of all frames, 3) int16
    <variant>_visible (frames, bodies); <variant>_states (kept, bodies, 12) of the frames <variant>_kept, NaN = no row
    landmarks_seen (frames, landmarks), landmarks_m (kept, landmarks, 3) of the frames in default_kept; counts (JSON)
"""

import json
import pathlib

import numpy as np

from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.templates import load_templates

FRAMES, FRAME_S, NOISE_M, GRID_M = 300, 0.005, 0.002, 1e-4
LISTED = ("fluffy_II", "albatross", "IRIS")
BODIES = LISTED + ("Raven", "Pendulum_tip")  # in the order in which they are seen
LANDMARKS = ("Blue_green", "Green_pink", "Orange_blue", "Pink_blue")
LOST = {32767: 9999.999, 32766: np.inf, 32765: -np.inf, 32764: 100.5, -32768: np.nan}  # what a lost marker looks like
VARIANTS = {
    "default": ({}, 5),  # settings, and every how many frames one is kept
    "legacy": ({"legacy_window": True}, 20),
    "cubic": ({"position_order": 3, "angle_order": 3, "smooth_position": False, "max_gap_s": 0.2}, 20),
}


def place(name, t):
    """(position [m], phi, theta, psi [rad]) at time t [s]."""
    return {
        "fluffy_II": ((-1.0 + 1.2 * t, 0.5 * np.sin(2.0 * t), 1.0), 0.3 * np.sin(3.0 * t), 0.2, 2.5 + 1.5 * t),
        "albatross": ((np.cos(t), np.sin(t), 1.2 + 0.3 * np.sin(4 * t)), 0.1, 0.4 * np.sin(2.0 * t), -1.0 - 2.0 * t),
        "IRIS": ((0.2, 2.3 - 1.0 * t, 0.5 + 0.5 * t * t), 1.2 * np.sin(t), -0.1, 0.0),  # starts outside of the net
        "Raven": ((-1.5, -1.0, 1.5 - 0.4 * t), 0.0, 0.0, np.pi),
        "Pendulum_tip": ((0.1 * t, 0.3, 1.9), 0.2, 2.9, 0.5 * t),
    }[name]


def stamps():
    """(frames,) stamps [s]: jitter, a slow stretch, short and long gaps, stamps that do not advance, a reset clock."""
    rng = np.random.default_rng(41)
    steps_s = np.full(FRAMES, FRAME_S)
    steps_s[90:100] = 0.010  # 100 Hz
    steps_s[[125, 130]] = 0.020, 0.055  # frames that never came
    steps_s[150] = 0.130  # for longer than max_gap_s
    times_s = 1.0e6 + np.cumsum(steps_s) + rng.normal(0.0, 20e-6, FRAMES)
    times_s[60:75] += rng.normal(0.0, 150e-6, 15)
    times_s[[110, 111]] = times_s[109], times_s[105]
    times_s[230:] -= 5000.0
    return times_s


def frame(k, t, templates, rng):
    """List of (name, markers [m]) of one frame. SCRIPT: what is irregular about it."""
    bodies = {}
    for name in BODIES:
        position, phi, theta, psi = place(name, t)
        bodies[name] = np.asarray(position) + templates[name].markers_m @ rotation_body_to_cortex(phi, theta, psi).T
    for row, name in enumerate(LANDMARKS):
        axes = [2, 0, 1] if name == "Pink_blue" else [0, 1, 2]  # this one is mounted at another angle
        bodies[name] = templates[name].markers_m[:, axes] + [2.0, row - 1.5, 1.2]
    bodies = {name: markers + rng.normal(0.0, NOISE_M, markers.shape) for name, markers in bodies.items()}
    if k < 100:
        del bodies["Raven"]
    if k < 130:
        del bodies["Pendulum_tip"]
    if 30 <= k < 50:
        bodies["fluffy_II"][k % 4] = list(LOST.values())[k % 5]  # hidden: three are left
    if k in (55, 57, 58):
        bodies["fluffy_II"][:2] = np.nan  # two are left
    if 76 <= k < 82:
        del bodies["albatross"]
    if 160 <= k < 190:
        bodies["albatross"][:, k % 3] = np.nan  # for longer than max_gap_s
    if 84 <= k < 88:
        bodies["IRIS"][[0, 3]] = bodies["IRIS"][[3, 0]]  # swapped
    if 102 <= k < 106:
        bodies["IRIS"][k % 5] += [0.1, 0.0, 0.05]  # a ghost
        bodies["albatross"][3] += [0.0, 0.2, 0.0]
    if k in (107, 108):
        bodies["fluffy_II"] = bodies["fluffy_II"][[0, 2, 1]]  # a corner less, and two swapped: belly up
    if k == 115:
        bodies["Raven"][:, :] = bodies["Raven"][0]  # in one place: does not fit
    if k in (135, 136):
        bodies["Pendulum_tip"][:] = [(0.12, 0.3, 1.9), (0.09, 0.3, 1.9), (0.09, 0.3, 1.9)]  # on a line: fits
    if 140 <= k < 145:
        bodies["Raven"] = np.vstack([bodies["Raven"], [[0.0, 0.0, 1.0]]])  # a marker too many
    if 118 <= k < 122:
        bodies["stranger"] = np.ones((2, 3))
    if k < 5:
        bodies["Pink_blue"][0] = np.nan  # not yet seen whole: its template is wrong for it
    if 200 <= k < 215:
        bodies["Pink_blue"][: k % 4] = np.nan
        bodies["Green_pink"][2] += [0.0, 0.1, 0.0]
        bodies["Green_pink"][0] = 9999.999
    if 205 <= k < 208:
        del bodies["Orange_blue"]
    listed = list(bodies.items())
    if 118 <= k < 120:
        listed.append(("albatross", np.zeros((4, 3))))  # a second one of that name
    return listed[::-1] if 120 <= k < 124 else listed


def on_grid(markers):
    """int16 on the grid of 0.1 mm, lost ones by their code."""
    out = np.zeros(markers.shape, dtype=np.int16)
    usual = np.abs(markers) < 3.2
    out[usual] = np.rint(markers[usual] / GRID_M)
    for code, value in LOST.items():
        out[np.isnan(markers) if np.isnan(value) else markers == value] = code
    assert (usual | (out != 0)).all()
    return out


def from_grid(codes):
    """The markers [m] that `on_grid` stands for."""
    markers = codes * GRID_M
    for code, value in LOST.items():
        markers[codes == code] = value
    return markers


def run(frames, times_s, params, every):
    """(estimator, visible, kept, states, landmarks seen, landmark positions) of the old estimator."""
    from risc_estimation.state_estimator import EstimatorParams, StatesEstimator

    estimator = StatesEstimator(load_templates(), EstimatorParams(**params), LISTED)
    visible = np.zeros((FRAMES, len(BODIES)), dtype=bool)
    seen = np.zeros((FRAMES, len(LANDMARKS)), dtype=bool)
    kept, states, places = [], [], []
    for k, (stamp_s, listed) in enumerate(zip(times_s.tolist(), frames)):
        bodies = {}
        for name, markers in listed:
            bodies.setdefault(name, from_grid(markers))
        estimate = estimator.update(stamp_s, bodies)
        if estimate is None:
            continue
        visible[k, : len(estimate.names)] = estimate.visible
        seen[k] = [name in estimate.landmark_names for name in LANDMARKS]
        if k % every == 0:
            kept.append(k)
            states.append(np.full((len(BODIES), 12), np.nan))
            states[-1][: len(estimate.names)] = estimate.states
            places.append(np.full((len(LANDMARKS), 3), np.nan))
            places[-1][seen[k]] = estimate.landmarks_m
    assert estimator.names == BODIES
    return estimator, visible, np.array(kept), np.array(states), seen, np.array(places)


def main():
    templates, rng, times_s = load_templates(), np.random.default_rng(40), stamps()
    frames = [
        [(name, on_grid(markers)) for name, markers in frame(k, FRAME_S * k, templates, rng)] for k in range(FRAMES)
    ]
    layouts = [[(name, len(markers)) for name, markers in listed] for listed in frames]
    different = [layout for k, layout in enumerate(layouts) if layout not in layouts[:k]]
    out = {
        "stamps_s": times_s,
        "layouts": json.dumps(different),
        "layout": np.array([different.index(layout) for layout in layouts], dtype=np.uint8),
        "markers": np.concatenate([markers for listed in frames for _, markers in listed]),
    }
    for name, (params, every) in VARIANTS.items():
        estimator, visible, kept, states, seen, places = run(frames, times_s, params, every)
        out.update({name + "_visible": visible, name + "_kept": kept, name + "_states": states})
        if name == "default":
            counts = vars(estimator.counts)
            print(counts)
            out.update(landmarks_seen=seen, landmarks_m=places, counts=json.dumps(counts))
        print(name, visible.mean(axis=0).round(2), seen.mean(axis=0).round(2))
    path = pathlib.Path(__file__).with_name("states.npz")
    np.savez_compressed(path, **out)
    print(path.stat().st_size, "bytes")


if __name__ == "__main__":
    main()
