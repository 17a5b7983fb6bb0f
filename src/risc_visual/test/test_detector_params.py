"""Settings of risc_landmarks and quad_tracker: errors name the wrong value; and the contents of their messages."""

from types import SimpleNamespace

import genpy
import pytest
from std_msgs.msg import Header

from risc_lab.ros.params import params_from_dict
from risc_visual.ros.conversions import rois_of_picture
from risc_visual.vision.ros.detector_node import LookoutParams


@pytest.mark.parametrize(
    "wrong", [{"image": ""}, {"rate_hz": -1.0}, {"vehicles": "risc1"}, {"rectified": 1}, {"quads": "no"}]
)
def test_a_wrong_value_is_named(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        params_from_dict([LookoutParams], wrong)


def test_regions_are_every_name_once_and_the_best_of_each():
    def item(name, x):
        return SimpleNamespace(name=name, x=x, y=20.4, width=30.5, height=12.25, angle=45.0)

    head = Header(stamp=genpy.Time(7, 9), frame_id="camera", seq=3)
    found = [item("pink", 10.6), item("green", 1.0), item("pink", 99.0)]
    message = rois_of_picture(head, "risc2", ["green", "pink", "blue"], found, ["risc1"], [])
    assert (message.header.stamp, message.header.frame_id) == (genpy.Time(7, 9), "cortex")
    (entry,) = message.Obj
    assert entry.name == "risc2"
    assert [(roi.name, roi.visible) for roi in entry.landmarks] == [("green", True), ("pink", True), ("blue", False)]
    pink, blue = entry.landmarks[1:]
    assert (pink.x, pink.y, pink.width, pink.height, pink.angle) == (11, 20, 30.5, 12.25, 45.0)
    assert (blue.x, blue.y, blue.width, blue.height, blue.angle) == (0, 0, 0.0, 0.0, 0.0)
    assert [(roi.name, roi.visible) for roi in entry.quads] == [("risc1", False)]
