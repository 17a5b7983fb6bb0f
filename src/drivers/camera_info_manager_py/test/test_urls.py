import os

import pytest

from camera_info_manager import urls


@pytest.fixture(autouse=True)
def ros_home(monkeypatch):
    monkeypatch.setenv("ROS_HOME", "/var/home_of_ros")


@pytest.mark.parametrize(
    ("url", "path"),
    [
        ("", "/var/home_of_ros/camera_info/ardrone_front.yaml"),
        ("   ", "/var/home_of_ros/camera_info/ardrone_front.yaml"),
        ("file:///etc/cameras/${NAME}.yaml", "/etc/cameras/ardrone_front.yaml"),
        ("file://${ROS_HOME}/${NAME}_${NAME}.yaml", "/var/home_of_ros/ardrone_front_ardrone_front.yaml"),
        ("file:///a b.yaml", "/a b.yaml"),
    ],
)
def test_path_of_a_file_url(url, path):
    assert str(urls.path_of(url, "ardrone_front")) == path


def test_the_home_of_ros_is_in_the_users_home_by_default(monkeypatch):
    monkeypatch.delenv("ROS_HOME")
    assert str(urls.path_of("", "x")) == os.path.expanduser("~/.ros/camera_info/x.yaml")


def test_path_in_a_package():
    path = urls.path_of("package://sensor_msgs/calibrations/${NAME}.yaml", "left")
    assert path.is_absolute() and path.parts[-3:] == ("sensor_msgs", "calibrations", "left.yaml")


@pytest.mark.parametrize(
    ("url", "cause"),
    [
        ("risc1.yaml", "file:///PATH.yaml"),
        ("/etc/risc1.yaml", "file:///PATH.yaml"),
        ("file://relative.yaml", "file:///PATH.yaml"),
        ("http://example.org/x.yaml", "file:///PATH.yaml"),
        ("package://sensor_msgs", "file:///PATH.yaml"),
        ("package:///x.yaml", "file:///PATH.yaml"),
        ("package://no_such_package_anywhere/x.yaml", "no_such_package_anywhere"),
        ("file:///${HOME}/x.yaml", "{ROS_HOME}"),
    ],
)
def test_what_names_no_file_is_refused(url, cause):
    with pytest.raises(ValueError, match=cause):
        urls.path_of(url, "x")


def test_names():
    assert urls.is_valid_name("ardrone_front")
    for name in ("", "a b", "a/b", "../x", "x\n", "ä"):
        assert not urls.is_valid_name(name)
