"""A source of motion capture from elsewhere is chosen by the argument of mocap.launch, and its frames arrive."""

import os
import pathlib
import re
import subprocess

import pytest
import roslaunch

from risc_lab.ros.launching import Launch, free_tcp_port

ROOT = pathlib.Path(__file__).resolve().parents[1]
MEMBERS = ROOT / "src/cortex_ros/test"  # sources/toy.cpp and sources/toy.yaml
PROGRAM = ROOT / "devel/lib/cortex_ros/stream_markers_with_toy"  # as it is built with these members
FLEET = ROOT / "launch/fleets/ardrones3.yaml"
PATIENCE_S = 120.0


@pytest.fixture
def with_toy(tmp_path, monkeypatch):
    """Programs find the stream_markers that knows the toy."""
    folder = tmp_path / "devel/lib/cortex_ros"
    folder.mkdir(parents=True)
    (folder / "stream_markers").symlink_to(PROGRAM)
    (tmp_path / "devel/.catkin").write_text(str(ROOT / "src"))
    monkeypatch.setenv("CMAKE_PREFIX_PATH", "%s:%s" % (tmp_path / "devel", os.environ["CMAKE_PREFIX_PATH"]))
    monkeypatch.setenv("RISC_MAAP_MEMBERS", str(MEMBERS))


def test_the_argument_chooses_a_toy_whose_frames_arrive(with_toy, tmp_path):
    port = free_tcp_port()
    launch = Launch(ROOT / "launch/mocap.launch", {"fleet": FLEET, "source": "toy"}, tmp_path, port)
    try:
        environment = {**os.environ, "ROS_MASTER_URI": "http://127.0.0.1:%d" % port, "ROS_IP": "127.0.0.1"}
        command = ["rostopic", "echo", "-n", "3", "/mocap_data/Obj[0]/name"]
        # it waits for the master and the topic
        heard = subprocess.run(
            ["sh", "-c", 'until "$@" 2>/dev/null; do sleep 0.5; done', "sh", *command],
            env=environment, capture_output=True, text=True, timeout=PATIENCE_S, check=True,
        ).stdout  # fmt: skip
    finally:
        launch.stop()
    assert heard.count("wooden_duck") == 3, heard


def test_a_source_that_nobody_has_is_refused_with_the_names_of_those_that_are_there(with_toy, capfd):
    config, path = roslaunch.config.ROSLaunchConfig(), str(ROOT / "launch/mocap.launch")
    with pytest.raises(roslaunch.RLException, match="fleet_value"):
        roslaunch.xmlloader.XmlLoader().load(path, config, argv=["fleet:=%s" % FLEET, "source:=sundial"], verbose=False)
    assert re.search("'sundial'; .* cortex, toy", capfd.readouterr().err)
