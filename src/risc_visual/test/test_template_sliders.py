"""The sliders of the template nodes: their names, defaults and ranges fit the settings they move."""

import dataclasses

import pytest

from risc_visual.cfg import DenseFlowConfig, EdgesConfig, SegmentationConfig
from risc_visual.templates.edges import EdgeSettings
from risc_visual.templates.optical_flow import DenseSettings
from risc_visual.templates.segmentation import SegmentationSettings

PAIRS = [(EdgesConfig, EdgeSettings), (DenseFlowConfig, DenseSettings), (SegmentationConfig, SegmentationSettings)]


@pytest.mark.parametrize("config, settings", PAIRS, ids=lambda item: item.__name__.rsplit(".", 1)[-1])
def test_sliders_are_the_settings(config, settings):
    assert dict(config.defaults) == dataclasses.asdict(settings())
    for ends in (config.min, config.max):
        for name, value in ends.items():
            if not isinstance(value, str):  # strings have no range
                settings(**{name: value})  # raises for a slider that goes too far
