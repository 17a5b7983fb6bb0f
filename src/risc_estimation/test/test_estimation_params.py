"""Parameter loading: types, limits, unknown keys."""

import pytest

pytest.importorskip("rospy")

from risc_estimation.filters import REGISTRY  # noqa: E402
from risc_estimation.pose_fit import PoseFitParams  # noqa: E402
from risc_estimation.ros.params import NodeParams  # noqa: E402
from risc_lab.lab.arena import Arena  # noqa: E402
from risc_lab.ros.params import params_from_dict  # noqa: E402


def test_values_are_converted_and_unknown_keys_reported():
    (node, estimator), unknown = params_from_dict(
        [NodeParams, PoseFitParams],
        {
            "vehicles": ["Raven"],
            "residual_max_m": 1,
            "filter": "thesis",
            "agnle_order": 1,
            "diagnostic_period": 1.0,
        },
    )
    assert node.vehicles == ("Raven",)
    assert node.filter == "thesis"
    assert estimator.residual_max_m == 1.0
    assert isinstance(estimator.residual_max_m, float)
    assert unknown == ["agnle_order"]


@pytest.mark.parametrize(
    "values,message",
    [
        ({"residual_max_m": "0.1"}, "residual_max_m"),
        ({"residual_max_m": True}, "residual_max_m"),
        ({"residual_max_m": float("inf")}, "residual_max_m.*inf"),
        ({"residual_max_m": float("nan")}, "residual_max_m.*nan"),
        ({"filter": 1}, "filter"),
        ({"vehicles": "Raven"}, "vehicles"),
        ({"templates_file": 3}, "templates_file"),
        ({"silence_s": -1.0}, "'silence_s'"),
        ({"queue_s": 0.0}, "'queue_s'"),
    ],
)
def test_bad_values_name_their_key(values, message):
    with pytest.raises(ValueError, match=message):
        params_from_dict([NodeParams, PoseFitParams], values)


@pytest.mark.parametrize(("rate_hz", "frames"), [(500.0, 25), (200.0, 10), (100.0, 5), (50.0, 2), (20.0, 1), (10.0, 1)])
def test_frames_wait_for_no_longer_at_a_lower_rate(rate_hz, frames):
    assert NodeParams().queue_frames(rate_hz) == frames


def test_the_arena_is_the_net_unless_it_is_set():
    changed = PoseFitParams(arena_y_m=1.0, tilt_max_rad=1.2).within(Arena(6.0, 5.0, 4.0))
    assert (changed.arena_x_m, changed.arena_y_m, changed.arena_z_max_m, changed.tilt_max_rad) == (6.0, 5.0, 4.0, 1.2)
    (told,), _ = params_from_dict([PoseFitParams().within(Arena(6.0, 5.0, 4.0))], {"arena_y_m": 1.0})
    assert (told.arena_x_m, told.arena_y_m) == (6.0, 1.0)
    assert PoseFitParams().within(Arena()) == PoseFitParams()


def test_settings_of_the_filter_may_be_private_parameters():
    settings = REGISTRY.settings("thesis", REGISTRY.module("thesis").Filter.PARAMS)
    given = {"filter": "thesis", "max_gap_s": 0.2, "silence_s": 0.3}
    (node, told), unknown = params_from_dict([NodeParams, settings], given)
    assert (told.max_gap_s, told.position_order, node.silence_s, unknown) == (0.2, 1, 0.3, [])
    with pytest.raises(ValueError, match="kalmann.*: .*least_squares, thesis"):
        REGISTRY.module("kalmann")
