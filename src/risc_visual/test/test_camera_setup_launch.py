"""risc_camera_setup.launch and risc_camera_setup_bottom.launch: arguments reach the programs that need them."""

import pathlib
import re

import pytest
import roslaunch.config
import roslaunch.xmlloader
import yaml

from camera_info_manager.urls import path_of
from risc_lab.lab.calibration import resolve_url

PACKAGE = pathlib.Path(__file__).resolve().parents[1]
LAUNCH = PACKAGE.parents[1] / "launch"
FLEET, VEHICLE = LAUNCH / "fleets" / "ardrones3.yaml", LAUNCH / "vehicle.launch"


def load(file_name, *arguments):
    """({node name: node}, {parameter: value}) that a launch file makes."""
    config = roslaunch.config.ROSLaunchConfig()
    path = str(PACKAGE / "launch" / file_name)  # an absolute path stays as it is
    roslaunch.xmlloader.XmlLoader().load(path, config, argv=list(arguments), verbose=False)
    nodes = {node.namespace + node.name: node for node in config.nodes}
    params = {name: param.value for name, param in config.params.items()}
    own = {re.sub("/vehicles/[^/]+/", "/", name): value for name, value in params.items()}
    return nodes, {**own, **params}


@pytest.mark.parametrize(
    ("file_name", "camera", "channel"),
    [("risc_camera_setup.launch", "front", 0), ("risc_camera_setup_bottom.launch", "bottom", 1)],
)
def test_calibrator_and_driver_are_about_the_same_camera(file_name, camera, channel):
    nodes, params = load(file_name, "name:=albatross", "ip:=192.168.1.7", "size:=7x5", "square:=0.03")
    assert set(nodes) == {"/albatross/ardrone_driver", "/albatross/cameracalibrator"}
    calibrator = nodes["/albatross/cameracalibrator"]
    assert calibrator.args == "--size 7x5 --square 0.03 --camera_name ardrone_%s" % camera
    assert dict(calibrator.remap_args) == {
        "image": "ardrone/%s/image_raw" % camera,
        "camera": "ardrone/%s" % camera,
    }
    assert params["/albatross/ardrone_driver/video_channel"] == channel
    assert params["/albatross/ardrone_driver/drone_ip"] == "192.168.1.7"


@pytest.mark.parametrize("calibration", ["risc2.yaml", "not_calibrated_yet.yaml", "relative/to/here.yaml", ""])
def test_what_is_committed_is_what_the_next_flight_reads(tmp_path, calibration):
    content = yaml.safe_load(FLEET.read_text(encoding="utf-8"))
    content["vehicles"][1]["calibration"] = calibration
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(yaml.safe_dump(content), encoding="utf-8")
    _, setup = load("risc_camera_setup.launch", "name:=risc2", "fleet:=%s" % fleet)
    _, flight = load(VEHICLE, "name:=risc2", "fleet:=%s" % fleet)
    url = setup["/risc2/ardrone_driver/camera_info_url"]
    assert url == flight["/risc2/ardrone_driver/camera_info_url"]
    if calibration:
        assert path_of(url, "ardrone_front") == resolve_url(calibration).absolute()
    else:
        assert url == ""
    _, setup = load("risc_camera_setup_bottom.launch", "name:=risc2", "fleet:=%s" % fleet)
    assert [name for name in (*setup, *flight) if "bottom_camera_info_url" in name] == []  # the driver's default


def test_without_a_screen_a_bag_is_recorded():
    nodes, params = load("risc_camera_setup_bottom.launch", "gui:=false", "driver:=false", "bag:=/tmp/board.bag")
    assert set(nodes) == {"/risc1/camera_compressor", "/risc1/camera_recorder"}
    topic = params["/risc1/camera_compressor/topic"]
    assert topic == "ardrone/bottom/image_raw"
    assert nodes["/risc1/camera_recorder"].args == "-O /tmp/board.bag /risc1/%s/compressed" % topic
