"""Messages of cameras and bearings: degrees outside, radians inside, names and visibility kept."""

import math

import pytest
import rospy
from std_msgs.msg import Header

from risc_estimation.bearings import Bearing, Region
from risc_estimation.ros.bearing_conversions import observed_angles, regions_from_msg, states_from_msg
from risc_msgs.msg import Cortex, Risc_roi, States


def test_regions():
    rois = [Risc_roi("green", True, 12, 34, 5.0, 6.0, 7.0), Risc_roi(name="pink")]
    assert regions_from_msg(rois) == [Region("green", True, 12, 34), Region("pink", False, 0, 0)]


def test_bearings_are_degrees_in_messages():
    lost = Bearing("pink", False, math.nan, math.nan)
    header = Header(stamp=rospy.Time(5, 6), frame_id="cortex")
    message = observed_angles(header, [("risc1", [Bearing("green", True, 0.1, -0.2), lost], [lost]), ("risc2", [], [])])
    assert message.header is header
    assert [entry.name for entry in message.Obj] == ["risc1", "risc2"]
    green, pink = message.Obj[0].landmarks
    assert (green.name, green.visible) == ("green", True)
    assert (math.radians(green.azim), math.radians(green.elev)) == pytest.approx((0.1, -0.2))
    assert not pink.visible and math.isnan(pink.azim) and math.isnan(pink.elev)
    assert [entry.name for entry in message.Obj[0].quads] == ["pink"]


def test_states_of_the_visible_vehicles():
    seen = States(name="Raven", visible=True, x=1.0, y=2.0, z=3.0, phi=10.0, theta=20.0, psi=-30.0, u=9.0, r=9.0)
    states = states_from_msg(Cortex(Obj=[seen, States(name="Kahn", visible=False, x=5.0)]))
    assert list(states) == ["Raven"]
    position_m, euler_rad = states["Raven"]
    assert position_m == (1.0, 2.0, 3.0)
    assert [math.degrees(angle) for angle in euler_rad] == pytest.approx([10.0, 20.0, -30.0])
