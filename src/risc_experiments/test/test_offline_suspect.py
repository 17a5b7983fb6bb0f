"""False poses from motion capture, whole flights offline: a vehicle holds and lands; without a ladder it hits the net.

The state estimator refuses most of these poses; where the vehicle nodes are tested, it is made to accept them. True
poses are never suspected.
"""

import dataclasses
from functools import partial

import numpy as np
import pytest

from risc_control import plausibility
from risc_control.plausibility import Plausibility
from risc_control.safety import FailsafeLevel, Rule
from risc_estimation.pose_fit import PoseFitParams
from risc_experiments import offline
from risc_experiments.offline import Flight, fly
from risc_simulator.faults import FaultEvent, parse_fault
from risc_simulator.models.mocap_cameras import MocapCameras

FLIGHT = Flight("circle", vehicles=2, seed=3, duration_s=4.0)
LIES_S = 6.0, 9.0  # begin and end of the false poses
more = partial(pytest.param, marks=pytest.mark.release)


class LyingCameras(MocapCameras):
    """Cameras that change the markers of the first body by `lie` during LIES_S."""

    def __init__(self, lie, *arguments, **options):
        super().__init__(*arguments, **options)
        self._lie, self._first = lie, None

    def observe(self, time_s, layout, exact_m):
        seen = super().observe(time_s, layout, exact_m)
        if LIES_S[0] <= time_s < LIES_S[1]:
            (_, count), (_, next_count) = seen.layout[:2]
            markers_m = seen.markers_m.copy()
            one, other = markers_m[:count], markers_m[count : count + next_count]
            if self._first is None:
                self._first = markers_m.copy()
            self._lie(one, other, self._first[:count])
            seen = seen._replace(markers_m=markers_m)
        return seen


def flip(one, other, first):
    centre_m = np.nanmean(one[:, :2], axis=0)
    one[:, :2] = 2.0 * centre_m - one[:, :2]


def exchange(one, other, first):
    way_m = np.nanmean(other, axis=0) - np.nanmean(one, axis=0)
    one += way_m
    other -= way_m


def freeze(one, other, first):
    one[:] = first


def believe_all(monkeypatch, **params):
    """Make the estimator accept each frame without comparing it with earlier ones."""
    monkeypatch.setattr(offline, "PoseFitParams", partial(PoseFitParams, memory_s=0.0, **params))


@pytest.mark.parametrize(
    ("lie", "rule", "kind"),
    [
        (flip, Rule.SUSPECT, "ardrone"),
        (exchange, Rule.SUSPECT, "iris"),
        (freeze, Rule.STATE, "ardrone"),
        more(flip, Rule.SUSPECT, "iris"),
        more(exchange, Rule.SUSPECT, "ardrone"),
        more(freeze, Rule.STATE, "iris"),
    ],
)
def test_a_lie_that_lasts_lands_the_vehicle(lie, rule, kind, monkeypatch, seed):
    monkeypatch.setattr(offline, "MocapCameras", lambda *a, **k: LyingCameras(lie, *a, **k))
    usual = dataclasses.replace(FLIGHT, trajectory="circles3", duration_s=2.0, types=(kind,) * 2)
    flight = dataclasses.replace(usual, seed=seed(FLIGHT.seed))
    assert fly(flight).landed[0]
    believe_all(monkeypatch)
    result = fly(flight)
    assert result.landed[0], result.safety
    said = [(level, by) for _, vehicle, level, by in result.levels if vehicle == 0]
    assert said[0][0] is FailsafeLevel.HOLD and (FailsafeLevel.LAND, rule) in said, said
    believe_all(monkeypatch, frozen_frames=0)
    with pytest.raises(RuntimeError, match="net|collided|floor"):
        fly(dataclasses.replace(usual, node={"ladder": False}))


@pytest.mark.parametrize("lie", [flip, exchange])
def test_a_short_one_is_held_through(lie, monkeypatch, seed):
    monkeypatch.setattr(offline, "MocapCameras", lambda *a, **k: LyingCameras(lie, *a, **k))
    monkeypatch.setattr("%s.LIES_S" % __name__, (6.0, 6.05))
    flight = dataclasses.replace(FLIGHT, seed=seed(FLIGHT.seed))
    refusing = fly(flight)
    assert not refusing.safety and refusing.rmse_m.max() < 0.03
    believe_all(monkeypatch)
    result = fly(flight)
    assert not any(result.landed) and result.rmse_m.max() < 0.03
    levels = [said.level for said in result.levels]
    assert FailsafeLevel.HOLD in levels and levels[-1] is FailsafeLevel.OK


@pytest.mark.parametrize(
    ("kind", "estimator"),
    [("ardrone", "least_squares"), ("iris", "thesis"), more("ardrone", "thesis"), more("iris", "least_squares")],
)
def test_the_truth_is_never_suspected(kind, estimator, monkeypatch, seed):
    """With gusts and a third of the frames lost."""
    looks = []

    class Watched(Plausibility):
        def look(self, names, visible, states, stamp_s):
            believed = super().look(names, visible, states, stamp_s)
            looks.append(believed.tolist() == visible.tolist())
            return believed

    monkeypatch.setattr(offline, "Plausibility", Watched)
    lost = FaultEvent("drop", severity=0.3, channel="cortex/stream")
    options = {"gusts": True, "types": (kind,) * 2, "estimator": estimator, "wire_faults": (lost,)}
    fly(Flight("slanted8", vehicles=2, seed=seed(2), duration_s=5.0, **options))
    assert len(looks) > 1000 and all(looks)


@pytest.mark.parametrize(("lasts_s", "seed"), [(0.4, 10), more(0.3, 15), more(0.25, 23)])
def test_a_velocity_made_of_false_places_is_not_flown_on(lasts_s, seed, monkeypatch):
    """After a short jump the estimator's window still holds false positions when the next ones are true again: braked
    by such a velocity, a vehicle slides into its neighbour.
    """
    fault = parse_fault("jump:0.11,risc3,duration_s=%g@4.52" % lasts_s)
    flight = Flight("circles3", seed=seed, duration_s=6.0, psi_deg=70.0 * seed, faults=(fault,))
    refusing = fly(flight)
    believe_all(monkeypatch)
    for result in (refusing, fly(flight)):
        assert result.faults[0].outcome == "landed" and result.breaches == result.contacts == ()
    # the control arm: a changed velocity is believed as soon as any other state
    for name in ("_judge", "_note"):  # numba has compiled the number into them
        function = getattr(plausibility, name)
        monkeypatch.setattr(plausibility, name, getattr(function, "py_func", function))
    monkeypatch.setattr(plausibility, "_SLOWLY", plausibility._AGREEING)
    assert fly(flight).contacts
