"""A seeded flight of four vehicles under motion capture that is false now and then, and what estimators make of it."""

from dataclasses import dataclass, field

import numpy as np
from mocap_frames import pack_bodies

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
OFF = {"memory_s": 0.0, "false_reject_probability": 0.0}  # the control arm: neither gates nor what mends
WRONG_M, WRONG_TILT_RAD, WRONG_YAW_RAD = 0.03, np.radians(5.0), np.radians(10.0)


class Fleet:
    """Vehicles on eights, tilting and turning: at a pace of 1 with up to 1 m/s^2, which is how a filter without their
    commands may go on with for 0.2 s.
    """

    def __init__(self, seed, pace=1.0):
        self.rng, self._pace = np.random.default_rng(seed), pace
        self._phase = self.rng.uniform(0.0, 2.0 * np.pi, (len(NAMES), 4))
        self._turn_rad_s = self.rng.uniform(-0.5, 0.5, len(NAMES))

    def poses(self, t):
        """{name: (position (3,) [m], (phi, theta, psi) [rad])} at a time [s]."""
        t, a, found = self._pace * t, self._phase, {}
        for i, name in enumerate(NAMES):
            eight = np.sin(t + a[i, 0]), 0.5 * np.sin(2.0 * t + 2.0 * a[i, 0]), 0.3 * np.sin(1.5 * t + a[i, 1])
            tilt = 0.2 * np.sin(2.0 * t + a[i, 2]), 0.2 * np.sin(2.0 * t + a[i, 3])
            found[name] = _CENTRES_M[i] + 0.4 * np.array(eight), (*tilt, a[i, 2] + self._turn_rad_s[i] * t)
        return found

    def markers(self, t):
        """{name: (n, 3) markers [m]} with noise."""
        return {name: exact + self.rng.normal(0.0, NOISE_M, exact.shape) for name, exact in self.exact(t).items()}

    def exact(self, t):
        """The same without noise."""
        return {
            name: position_m + TEMPLATES[name].markers_m @ rotation_body_to_cortex(*angles).T
            for name, (position_m, angles) in self.poses(t).items()
        }


# --- faults: (bodies, name, pose of it, rng, what the event keeps) change bodies and return markers without a label


def _kept(kept, make):
    """What an event draws once."""
    if not kept:
        kept.append(make())
    return kept[0]


def _direction(rng):
    direction = rng.standard_normal(3)
    return direction / np.linalg.norm(direction)


def displaced(bodies, name, pose, rng, kept):
    marker, by_m = _kept(kept, lambda: (rng.integers(len(bodies[name])), 0.05 * _direction(rng)))
    bodies[name][marker] += by_m


def ghost(bodies, name, pose, rng, kept):
    """The label goes to a reflection; the marker is there without one."""
    marker, by_m = _kept(kept, lambda: (rng.integers(len(bodies[name])), rng.uniform(0.1, 0.5) * _direction(rng)))
    loose = bodies[name][marker : marker + 1].copy()
    bodies[name][marker] += by_m
    return loose


def swap(bodies, name, pose, rng, kept):
    pair = _kept(kept, lambda: rng.choice(len(bodies[name]), 2, replace=False))
    bodies[name][pair] = bodies[name][pair[::-1]]


def swap_of_those_in_view(bodies, name, pose, rng, kept):
    """Two labels are exchanged while so many markers are hidden that three are left."""
    order = _kept(kept, lambda: rng.permutation(len(bodies[name])))
    bodies[name][order[3:]] = np.nan
    bodies[name][order[:2]] = bodies[name][order[1::-1]]


def flip(bodies, name, pose, rng, kept):
    centre_m = pose[0][:2]
    bodies[name][:, :2] = 2.0 * centre_m - bodies[name][:, :2]


def jump(bodies, name, pose, rng, kept):
    angle = _kept(kept, lambda: rng.uniform(0.1, 2.0 * np.pi))
    bodies[name] += 0.3 * np.array([np.cos(angle), np.sin(angle), 0.0])


def exchange(bodies, name, pose, rng, kept):
    other = _kept(kept, lambda: rng.choice([n for n in NAMES if n != name]))
    mine, theirs = bodies[name].copy(), bodies[other].copy()
    for to, markers in (name, theirs), (other, mine):
        count = min(len(bodies[to]), len(markers))
        bodies[to][:] = np.nan
        bodies[to][:count] = markers[:count]


def lost_labels(bodies, name, pose, rng, kept):
    loose = np.vstack([bodies[name][rng.permutation(len(bodies[name]))], rng.uniform(-2.0, 2.0, (2, 3))])
    bodies[name][:] = np.nan
    return loose


def not_a_number(bodies, name, pose, rng, kept):
    bodies[name][:] = np.nan


@dataclass
class Judged:
    """What came of a flight."""

    false_frames: int = 0  # frames in which motion capture was false
    wrong: int = 0  # of them, those in which a state was visible and wrong
    wrong_after: int = 0  # good frames in which one was
    blind: int = 0  # false frames in which the vehicle was not visible
    settled_s: list = field(default_factory=list)  # from the end of each event until all is well again
    counts: object = None  # EstimatorCounts


def is_wrong(state, pose):
    """Whether a state (12,) is off the truth by more than what counts."""
    position_m, angles = pose
    R, its = rotation_body_to_cortex(*angles), rotation_body_to_cortex(*state[S.PHI : S.P])
    yaw = np.abs((state[S.PSI] - angles[2] + np.pi) % (2.0 * np.pi) - np.pi)
    tilt = np.arccos(np.clip(R[:, 2] @ its[:, 2], -1.0, 1.0))
    return np.linalg.norm(state[: S.U] - position_m) > WRONG_M or tilt > WRONG_TILT_RAD or yaw > WRONG_YAW_RAD


def fly(fault, name, filter_name, seed, events=4, longest_s=0.2, **params):
    """Judged flight with an event a second; each lasts from one frame to longest_s, drawn evenly in its logarithm."""
    fleet, judged = Fleet(seed), Judged()
    rng = np.random.default_rng([seed, 1])
    types = {n: load_vehicle_type("iris" if n == "IRIS" else "ardrone") for n in NAMES}
    estimator = StatesEstimator(TEMPLATES, PoseFitParams(**params), NAMES, make_filter(filter_name), types)
    for event in range(events + 1):
        frames = round(np.exp(rng.uniform(0.0, np.log(longest_s / DT_S)))) if event else 0
        kept, settled = [], None
        for k in range(200):
            t = event + k * DT_S
            poses = fleet.poses(t)
            bodies = fleet.markers(t)
            loose = fault(bodies, name, poses[name], rng, kept) if k < frames else None
            loose = np.zeros((0, 3)) if loose is None else loose
            estimate = estimator.update(100.0 + t, *pack_bodies(bodies), loose)
            wrong = [
                visible and is_wrong(state, poses[n])
                for n, visible, state in zip(estimate.names, estimate.visible, estimate.states)
            ]
            shown = estimate.visible[NAMES.index(name)]
            if k < frames:
                judged.false_frames += 1
                judged.wrong += any(wrong)
                judged.blind += not shown
            elif event:
                judged.wrong_after += any(wrong)
                if any(wrong) or not estimate.visible.all():
                    settled = None
                elif settled is None:
                    settled = (k - frames) * DT_S
        if event:
            judged.settled_s.append(1.0 if settled is None else settled)
    judged.counts = estimator.counts
    return judged


FAULTS = displaced, ghost, swap, swap_of_those_in_view, flip, jump, exchange, lost_labels, not_a_number


def main(seeds=20):
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
