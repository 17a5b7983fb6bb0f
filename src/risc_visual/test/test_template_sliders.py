"""The sliders of template nodes and mask_tuner: names, defaults and ranges match the settings that they change."""

import dataclasses

import pytest

from risc_visual.cfg import DenseFlowConfig, EdgesConfig, MaskTunerConfig, SegmentationConfig
from risc_visual.vision.mask_tuning import MaskSettings
from risc_visual.vision.templates.edges import EdgeSettings
from risc_visual.vision.templates.optical_flow import DenseSettings
from risc_visual.vision.templates.segmentation import SegmentationSettings

PAIRS = [(EdgesConfig, EdgeSettings), (DenseFlowConfig, DenseSettings), (SegmentationConfig, SegmentationSettings)]


@pytest.mark.parametrize("config, settings", PAIRS, ids=lambda item: item.__name__.rsplit(".", 1)[-1])
def test_sliders_are_the_settings(config, settings):
    assert dict(config.defaults) == dataclasses.asdict(settings())
    for ends in (config.min, config.max):
        for name, value in ends.items():
            if not isinstance(value, str):  # strings have no range
                settings(**{name: value})  # raises for a slider that goes too far


def test_the_sliders_of_mask_tuner_are_its_thresholds():
    """A limit that is at its end may contradict its partner, so the ends are tried together."""
    settings = dataclasses.asdict(MaskSettings())
    colour, file = settings.pop("colour"), settings.pop("file")  # texts are parameters without a slider
    assert dict(MaskTunerConfig.defaults) == settings
    for ends in (MaskTunerConfig.min, MaskTunerConfig.max):
        MaskSettings(colour=colour, file=file, **{name: ends[name] for name in settings})  # raises for one too far
