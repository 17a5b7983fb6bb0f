"""The message definitions never change: bags of the original release carry these sums."""

import pathlib

import pytest
import roslib.message

MSG_DIR = pathlib.Path(__file__).resolve().parent.parent / "msg"

# Computed with genmsg from the original release's definitions.
MD5SUMS = {
    "Angle": "be95d8b52b2e16e0138b2b3779cd930f",
    "Angles": "9dd576705f18c801e12e4a78c9c66088",
    "Control": "006e11d00572e1d052feb2e4f190b45f",
    "Controls": "5fa2036879cc2f7d0c75bc2dc1639156",
    "Cortex": "ace87fb5cb38f4ed182a1466180c255e",
    "Landmark": "2edff07075d48378c13052415416989c",
    "Landmarks": "e9a4316d2f24284f65cb567c9ba0ce46",
    "Mocap_data": "4aa5a955bf007c7b2e0835be10fbfbd4",
    "Mocap_marker": "4a842b65f413084dc2b10fb484ea7f17",
    "Mocap_markers": "00f6d3da8c0240d68d028bf339d9a65f",
    "Observed_angles": "8b371119782f9b738e9c6225d8efba1c",
    "Observed_rois": "8173f98bffabff1f99aee7f14dbf861e",
    "Pen_with_cov": "ff4830a3e9858442f40e95367727974c",
    "Risc_roi": "09e4af56af7b1197f305e2925faf4927",
    "Risc_rois": "f66579dedd062ccc57f1aced22cbbd3a",
    "States": "8271f59b5179794f309908101ca21e03",
    "Trajectories": "aea5153d61f2124cab4812ac4763db8c",
    "Trajectory": "5bb19cf770231c9b18a409040fde64c0",
    "Waypoint": "c0027f92b0acc03e6886dd3a0b948e52",
    "Waypoints": "28fbf348f14b39c66bdb32d0c92bb26c",
}


@pytest.mark.parametrize("name", sorted(MD5SUMS))
def test_md5sum_is_that_of_the_original_release(name):
    assert roslib.message.get_message_class("risc_msgs/" + name)._md5sum == MD5SUMS[name]


def test_no_message_is_missing_or_added():
    assert {path.stem for path in MSG_DIR.glob("*.msg")} == set(MD5SUMS)


@pytest.mark.parametrize("name", sorted(MD5SUMS))
def test_every_field_is_commented(name):
    for line in (MSG_DIR / (name + ".msg")).read_text().splitlines():
        if line and not line.startswith("#"):
            field, _, comment = line.partition("#")
            assert comment.strip(), "no comment: " + line
