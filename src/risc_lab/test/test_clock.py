import time

import pytest

rospy = pytest.importorskip("rospy")

from risc_lab.ros import clock as ros_clock  # noqa: E402 - needs ROS
from risc_lab.ros.clock import SteadyClock, ros_time_s  # noqa: E402 - needs ROS


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


def test_a_steady_clock_goes_on_when_the_clock_is_set(monkeypatch):
    clock, wall_ahead_s = SteadyClock(), time.time() - time.monotonic()
    began_s = clock.now_s()
    for set_by_s in (-0.6, 3600.0):
        ahead_s = wall_ahead_s + set_by_s
        monkeypatch.setattr(ros_clock.time, "time", lambda ahead_s=ahead_s: time.monotonic() + ahead_s)
        for _ in range(100):  # delayed readings have no effect
            steady_s, stamp_s = clock.now()
        assert steady_s - began_s < 5.0
        assert stamp_s - steady_s == pytest.approx(set_by_s, abs=0.01)


def test_a_steady_clock_goes_back_with_a_bag(simulated_time):
    clock = SteadyClock()
    simulated_time(rospy.Time(1234, 0))
    assert clock.now() == (1234.0, 1234.0)
