"""A seeded flight of four vehicles with occasional motion-capture faults, and how estimators cope with them."""

import functools
from dataclasses import dataclass, field

import numpy as np

from risc_estimation.filters import make_filter
from risc_estimation.pose_fit import PoseFitParams
from risc_estimation.state_estimator import StatesEstimator
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab import load_vehicle_type
from risc_lab.lab.templates import load_templates
from risc_lab.states import S

TEMPLATES = load_templates()
DT_S, NOISE_M = 0.005, 0.002
NAMES = "fluffy_II", "Raven", "albatross", "IRIS"
_CENTRES_M = np.array([[-1.2, -1.0, 1.0], [1.2, -1.0, 1.2], [-1.2, 1.0, 1.4], [1.2, 1.0, 1.0]])
OFF = {"memory_s": 0.0, "false_reject_probability": 0.0}  # the control arm: no gates and no corrections
WRONG_M, WRONG_TILT_RAD, WRONG_YAW_RAD = 0.03, np.radians(5.0), np.radians(10.0)


class Truth:
    """Vehicles on figure eights, tilting and turning, frame by frame. At pace 1 accelerations reach 1 m/s^2, so that a
    filter that does not know their commands can predict for 0.2 s.
    """

    def __init__(self, seed, pace=1.0, frames=1000, dt_s=DT_S):
        rng, t = np.random.default_rng(seed), pace * dt_s * np.arange(frames)
        self.positions_m, self.angles_rad = np.empty((2, frames, len(NAMES), 3))
        for i in range(len(NAMES)):
            a, turn_rad_s = rng.uniform(0.0, 2.0 * np.pi, 4), rng.uniform(-0.5, 0.5)
            eight = np.sin(t + a[0]), 0.5 * np.sin(2.0 * t + 2.0 * a[0]), 0.3 * np.sin(1.5 * t + a[1])
            self.positions_m[:, i] = _CENTRES_M[i] + 0.4 * np.transpose(eight)
            tilt = 0.2 * np.sin(2.0 * t + a[2]), 0.2 * np.sin(2.0 * t + a[3])
            self.angles_rad[:, i] = np.transpose([*tilt, a[2] + turn_rad_s * t])
        self.rotations = rotation_body_to_cortex(*np.moveaxis(self.angles_rad, 2, 0))
        self.layout = tuple((name, len(TEMPLATES[name].markers_m)) for name in NAMES)
        self.markers_m = np.concatenate(
            [
                self.positions_m[:, None, i] + TEMPLATES[name].markers_m @ np.swapaxes(self.rotations[:, i], 1, 2)
                for i, name in enumerate(NAMES)
            ],
            axis=1,
        )

    def bodies(self, markers_m):
        """{name: (n, 3) markers [m]} of a frame, views."""
        ends = np.cumsum([count for _, count in self.layout])
        return dict(zip(NAMES, np.split(markers_m, ends[:-1])))

    def are_wrong(self, k, states):
        """(vehicles,) bool: whether the states (vehicles, 12) are off the truth of frame k by more than WRONG_*."""
        R = rotation_body_to_cortex(*states[:, S.PHI : S.P].T)
        upright = np.einsum("ni,ni->n", R[:, :, 2], self.rotations[k, :, :, 2])
        yaw_rad = (states[:, S.PSI] - self.angles_rad[k, :, 2] + np.pi) % (2.0 * np.pi) - np.pi
        off_m = np.linalg.norm(states[:, : S.U] - self.positions_m[k], axis=1)
        return (off_m > WRONG_M) | (upright < np.cos(WRONG_TILT_RAD)) | (np.abs(yaw_rad) > WRONG_YAW_RAD)


truth_of = functools.cache(Truth)


# --- faults: f(bodies, name, place_m, rng, kept) change bodies, return unlabelled markers; kept: the event's draws


def _kept(kept, make):
    """Value that an event draws once and keeps."""
    if not kept:
        kept.append(make())
    return kept[0]


def _direction(rng):
    direction = rng.standard_normal(3)
    return direction / np.linalg.norm(direction)


def displaced(bodies, name, place_m, rng, kept):
    marker, by_m = _kept(kept, lambda: (rng.integers(len(bodies[name])), 0.05 * _direction(rng)))
    bodies[name][marker] += by_m


def ghost(bodies, name, place_m, rng, kept):
    """The label goes to a reflection; the marker itself has no label."""
    marker, by_m = _kept(kept, lambda: (rng.integers(len(bodies[name])), rng.uniform(0.1, 0.5) * _direction(rng)))
    loose = bodies[name][marker : marker + 1].copy()
    bodies[name][marker] += by_m
    return loose


def swap(bodies, name, place_m, rng, kept):
    pair = _kept(kept, lambda: rng.choice(len(bodies[name]), 2, replace=False))
    bodies[name][pair] = bodies[name][pair[::-1]]


def swap_of_those_in_view(bodies, name, place_m, rng, kept):
    """Two labels are exchanged while only three markers are in view."""
    order = _kept(kept, lambda: rng.permutation(len(bodies[name])))
    bodies[name][order[3:]] = np.nan
    bodies[name][order[:2]] = bodies[name][order[1::-1]]


def flip(bodies, name, place_m, rng, kept):
    bodies[name][:, :2] = 2.0 * place_m[:2] - bodies[name][:, :2]


def jump(bodies, name, place_m, rng, kept):
    angle = _kept(kept, lambda: rng.uniform(0.1, 2.0 * np.pi))
    bodies[name] += 0.3 * np.array([np.cos(angle), np.sin(angle), 0.0])


def exchange(bodies, name, place_m, rng, kept):
    other = _kept(kept, lambda: rng.choice([n for n in NAMES if n != name]))
    mine, theirs = bodies[name].copy(), bodies[other].copy()
    for to, markers in (name, theirs), (other, mine):
        count = min(len(bodies[to]), len(markers))
        bodies[to][:] = np.nan
        bodies[to][:count] = markers[:count]


def lost_labels(bodies, name, place_m, rng, kept):
    loose = np.vstack([bodies[name][rng.permutation(len(bodies[name]))], rng.uniform(-2.0, 2.0, (2, 3))])
    bodies[name][:] = np.nan
    return loose


def not_a_number(bodies, name, place_m, rng, kept):
    bodies[name][:] = np.nan


@dataclass
class Judged:
    """Result of a flight."""

    false_frames: int = 0  # frames in which motion capture was false
    wrong: int = 0  # of them, those in which a state was visible and wrong
    wrong_after: int = 0  # good frames in which a state was visible and wrong
    blind: int = 0  # false frames in which the vehicle was not visible
    settled_s: list = field(default_factory=list)  # from the end of each event until all states are visible and right
    counts: object = None  # EstimatorCounts


EVERY, WARM_UP = 100, 200  # frames


def fly(fault, name, filter_name, seed, events=8, longest_s=0.2, **params):
    """Judged flight with two events a second; each lasts from one frame to longest_s, drawn log-uniformly."""
    truth, judged = truth_of(seed), Judged()
    rng, row = np.random.default_rng([seed, 1]), NAMES.index(name)
    types = {n: load_vehicle_type("iris" if n == "IRIS" else "ardrone") for n in NAMES}
    estimator = StatesEstimator(TEMPLATES, PoseFitParams(**params), NAMES, make_filter(filter_name), types)
    frames = 0  # length of the event
    for k in range(WARM_UP + EVERY * events):
        since = (k - WARM_UP) % EVERY if k >= WARM_UP else k
        if k >= WARM_UP and since == 0:
            frames, kept, settled_s = round(np.exp(rng.uniform(0.0, np.log(longest_s / DT_S)))), [], 1.0
        markers_m = truth.markers_m[k] + rng.normal(0.0, NOISE_M, truth.markers_m[k].shape)
        loose_m, false = None, since < frames
        if false:
            loose_m = fault(truth.bodies(markers_m), name, truth.positions_m[k, row], rng, kept)
        loose_m = np.zeros((0, 3)) if loose_m is None else loose_m
        estimate = estimator.update(100.0 + k * DT_S, truth.layout, markers_m, loose_m)
        wrong = bool((estimate.visible & truth.are_wrong(k, estimate.states)).any())
        if false:
            judged.false_frames += 1
            judged.wrong += wrong
            judged.blind += not estimate.visible[row]
        elif k >= WARM_UP:
            judged.wrong_after += wrong
            if wrong or not estimate.visible.all():
                settled_s = 1.0
            elif settled_s == 1.0:
                settled_s = (since - frames) * DT_S
            if since == EVERY - 1:
                judged.settled_s.append(settled_s)
    judged.counts = estimator.counts
    return judged


FAULTS = displaced, ghost, swap, swap_of_those_in_view, flip, jump, exchange, lost_labels, not_a_number


def main(seeds=6):
    """Print the share of false frames with a state that is visible and wrong, without the gates and with them."""
    print(("%-24s%-11s" + "%18s" * 4) % ("fault", "vehicle", *[f + a for f in ("lines", "ekf") for a in (" off", "")]))
    for fault in FAULTS:
        for name in "fluffy_II", "IRIS":
            row = []
            for filter_name in "least_squares", "ekf":
                for params in OFF, {}:
                    flights = [fly(fault, name, filter_name, seed, **params) for seed in range(seeds)]
                    false, wrong, after = (
                        sum(getattr(f, n) for f in flights) for n in ("false_frames", "wrong", "wrong_after")
                    )
                    settled_ms = 1e3 * np.median([s for f in flights for s in f.settled_s])
                    row.append("%.1f %% %d %.0f ms" % (100.0 * wrong / false, after, settled_ms))
            print(("%-24s%-11s" + "%18s" * 4) % (fault.__name__, name, *row), flush=True)


if __name__ == "__main__":
    main()
