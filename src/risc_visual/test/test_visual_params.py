"""Parameters of the drawing nodes: mistakes are named."""

import pytest

from risc_lab.ros.params import params_from_dict
from risc_visual.drawing.params import CortexParams, RayParams, TrajectoryParams, WaypointParams


@pytest.mark.parametrize(
    "kind, wrong",
    [
        (CortexParams, {"rate_hz": 0}),
        (CortexParams, {"vehicles": "Raven"}),
        (WaypointParams, {"alpha": 1.5}),
        (RayParams, {"azimuth_max_deg": float("inf")}),
        (TrajectoryParams, {"jump_m": 0.01}),
    ],
)
def test_wrong_value_is_named(kind, wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        params_from_dict([kind], wrong)


def test_unknown_keys_are_told():
    assert params_from_dict([CortexParams], {"rate": 3.0, "diagnostic_period": 1.0})[1] == ["rate"]
