"""Parameters: the YAML files say what the code does by default, and mistakes are named."""

import pytest
import yaml

from risc_estimation.mount_fit import FitParams
from risc_estimation.mount_samples import WindowParams
from risc_lab.lab.yaml_reader import package_file
from risc_lab.ros.params import params_from_dict
from risc_visual.drawing.rays import RayParams
from risc_visual.drawing.ros.params import AngleParams, ArenaParams, CortexParams, TrajectoryParams, WaypointParams
from risc_visual.tuner.mount_tuner import TunerParams

FILES = {
    "draw_risc_maap": (ArenaParams,),
    "draw_cortex": (CortexParams,),
    "draw_trajectories": (TrajectoryParams,),
    "draw_angles": (AngleParams, RayParams),
    "draw_waypoints": (WaypointParams,),
    "transform_tuner": (TunerParams, WindowParams, FitParams),
}


@pytest.mark.parametrize("name", sorted(FILES))
def test_files_hold_every_parameter_with_its_default(name):
    values = yaml.safe_load(package_file("risc_visual", "config/%s.yaml" % name).read_text())
    params, unknown = params_from_dict(FILES[name], values)
    assert (params, unknown) == ([kind() for kind in FILES[name]], [])
    assert set(values) == {key for kind in FILES[name] for key in kind.__dataclass_fields__}


@pytest.mark.parametrize(
    "wrong",
    [{"rate_hz": 0}, {"rate_hz": "fast"}, {"lifetime_s": True}, {"vehicles": "Raven"}, {"templates_file": 3}],
)
def test_wrong_value_is_named(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        params_from_dict([CortexParams], wrong)


@pytest.mark.parametrize("kind", [AngleParams, WaypointParams])
@pytest.mark.parametrize(
    "wrong", [{"rate_hz": 0}, {"lifetime_s": 0}, {"alpha": 0}, {"alpha": 1.5}, {"label_alpha": -1}]
)
def test_wrong_value_of_a_ray_or_waypoint_is_named(kind, wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        params_from_dict([kind], wrong)


def test_unknown_keys_are_told():
    assert params_from_dict([CortexParams], {"rate": 3.0, "diagnostic_period": 1.0})[1] == ["rate"]
