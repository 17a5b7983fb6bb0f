"""Parameter loading: types, unknown keys, and the YAML file that must agree with the defaults."""

import pathlib

import pytest
import yaml

pytest.importorskip("rospy")

from risc_estimation.ros.params import AngleParams, NodeParams, SyntheticNodeParams  # noqa: E402
from risc_estimation.state_estimator import ARENA_KEYS, EstimatorParams  # noqa: E402
from risc_estimation.synthetic_bearings import SyntheticParams  # noqa: E402
from risc_lab.lab.arena import Arena  # noqa: E402
from risc_lab.ros.params import params_from_dict  # noqa: E402

CONFIG = pathlib.Path(__file__).resolve().parents[1] / "config"
FILES = {
    "states_estimation": [NodeParams, EstimatorParams],
    "angle_estimation": [AngleParams],
    "synthetic_angles": [SyntheticNodeParams, SyntheticParams],
}


def test_values_are_converted_and_unknown_keys_reported():
    (node, estimator), unknown = params_from_dict(
        [NodeParams, EstimatorParams],
        {
            "vehicles": ["Raven"],
            "angle_window_s": 1,
            "min_samples": 7.0,
            "smooth_position": False,
            "agnle_order": 1,
            "diagnostic_period": 1.0,
        },
    )
    assert node.vehicles == ("Raven",)
    assert estimator.angle_window_s == 1.0
    assert isinstance(estimator.angle_window_s, float)
    assert estimator.min_samples == 7
    assert isinstance(estimator.min_samples, int)
    assert estimator.smooth_position is False
    assert unknown == ["agnle_order"]


@pytest.mark.parametrize(
    "values,message",
    [
        ({"max_gap_s": "0.1"}, "max_gap_s"),
        ({"max_gap_s": True}, "max_gap_s"),
        ({"max_gap_s": float("inf")}, "max_gap_s.*inf"),
        ({"max_gap_s": float("nan")}, "max_gap_s.*nan"),
        ({"min_samples": float("-inf")}, "min_samples.*-inf"),
        ({"min_samples": float("nan")}, "min_samples.*nan"),
        ({"min_samples": 2.5}, "min_samples"),
        ({"legacy_window": "false"}, "legacy_window"),
        ({"vehicles": "Raven"}, "vehicles"),
        ({"templates_file": 3}, "templates_file"),
        ({"silence_s": -1.0}, "silence_s must be"),
        ({"queue_s": 0.0}, "queue_s must be"),
        ({"min_samples": 0}, "min_samples"),
    ],
)
def test_bad_values_name_their_key(values, message):
    with pytest.raises(ValueError, match=message):
        params_from_dict([NodeParams, EstimatorParams], values)


@pytest.mark.parametrize(("rate_hz", "frames"), [(500.0, 25), (200.0, 10), (100.0, 5), (50.0, 2), (20.0, 1), (10.0, 1)])
def test_frames_wait_for_no_longer_at_a_lower_rate(rate_hz, frames):
    assert NodeParams().queue_frames(rate_hz) == frames


@pytest.mark.parametrize("name", sorted(FILES))
def test_config_files_hold_every_setting_at_its_default(name):
    values = yaml.safe_load((CONFIG / (name + ".yaml")).read_text(encoding="utf-8"))
    instances, unknown = params_from_dict(FILES[name], values)
    assert unknown == []
    assert instances == [params() for params in FILES[name]]
    known = {key for params in instances for key in vars(params)}
    assert set(values) == known - set(ARENA_KEYS), "the arena is the net of the fleet file"


def test_the_arena_is_the_net_unless_it_is_set():
    params = EstimatorParams(arena_y_m=1.0, max_gap_s=0.2).within(Arena(6.0, 5.0, 4.0))
    assert (params.arena_x_m, params.arena_y_m, params.arena_z_max_m, params.max_gap_s) == (6.0, 5.0, 4.0, 0.2)
    params = EstimatorParams(arena_y_m=1.0).within(Arena(6.0, 5.0, 4.0), keep=("arena_y_m",))
    assert (params.arena_x_m, params.arena_y_m) == (6.0, 1.0)
    assert EstimatorParams().within(Arena()) == EstimatorParams()
