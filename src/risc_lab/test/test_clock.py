import time

import pytest

rospy = pytest.importorskip("rospy")

from risc_lab.ros.clock import ros_time_s  # noqa: E402 - needs ROS


@pytest.fixture
def simulated_time():
    rospy.rostime.set_rostime_initialized(True)
    yield rospy.rostime._set_rostime
    rospy.rostime._rostime_current = None
    rospy.rostime.set_rostime_initialized(False)


def test_it_is_the_wall_clock():
    assert ros_time_s() == pytest.approx(time.time(), abs=5.0)


def test_it_is_what_slash_clock_says(simulated_time):
    simulated_time(rospy.Time(1234, 500000000))
    assert ros_time_s() == 1234.5 == rospy.get_time()
