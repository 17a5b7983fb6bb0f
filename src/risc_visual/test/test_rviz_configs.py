"""The rviz configurations: displays and check boxes of the original release, and nothing that could stay frozen."""

import pathlib

import pytest
import yaml

CONFIG = pathlib.Path(__file__).resolve().parents[1] / "config"
FILES = ("Diff_flat.rviz", "Trans_tuner.rviz", "coop.rviz")
GRIDS = {"Floor": True, "Middle": False, "3D": False}
ON, OFF = True, False

# name: (class, topic, on or off)
WAYPOINTS = {  # of draw_waypoints: nothing, unless somebody sends waypoints
    "Waypoints": ("MarkerArray", "/Way_Markers", ON),
    "Waypoint headings": ("MarkerArray", "/Heading_Markers", ON),
    "Waypoint labels": ("MarkerArray", "/Way_Labels", ON),
    "Waypoint paths": ("MarkerArray", "/Way_trail", ON),
}
# Diff_flat shows what the original did and, on, what it kept off.
WANTED = {
    "Diff_flat.rviz": {
        "Body_Frame": ("TF", None, OFF),
        "Cortex_Markers": ("MarkerArray", "/Cortex_Markers", ON),
        "Quad Labels": ("MarkerArray", "/Quad_Labels", ON),
        "Quadrotors": ("MarkerArray", "/Quad_Markers", ON),
        "Desired_Trajectory": ("MarkerArray", "/desired_trajectory", ON),
        "Actual_Trajectory": ("MarkerArray", "/Quad_trajectory", ON),
        "net": ("MarkerArray", "/net", ON),
        "Trajectory Name": ("Marker", "/desired_trajectory_name", ON),
        "Controller Status": ("Marker", "/Ctrl_Status", ON),
        "Grid Numbers": ("MarkerArray", "/Grid", ON),
        "Battery Level": ("Marker", "/Battery_Status", ON),
        "Quad Covariance": ("Marker", "/Cov_Quad", ON),
        **WAYPOINTS,
    },
    "Trans_tuner.rviz": {
        "Body_Frame": ("TF", None, ON),
        "Camera": ("TF", None, ON),
        "Cortex_Markers": ("MarkerArray", "/Cortex_Markers", ON),
        "Quad Labels": ("MarkerArray", "/Quad_Labels", ON),
        "Quadrotors": ("MarkerArray", "/Quad_Markers", ON),
        "net": ("MarkerArray", "/net", OFF),
        "Grid Numbers": ("MarkerArray", "/Grid", ON),
        "Image": ("Image", "/risc1/ardrone/image_raw", ON),
        "Landmarks": ("MarkerArray", "/Land_Markers", ON),
        "Landmark labels": ("MarkerArray", "/Land_Labels", ON),
        "Direction Info": ("MarkerArray", "/angle_lines", ON),
        "Transform tuner": ("InteractiveMarkers", "/transform_tuner/update", ON),
        "Tuner text": ("MarkerArray", "/transform_tuner/text", ON),
    },
    "coop.rviz": {
        "Quadrotors": ("MarkerArray", "/Quad_Markers", ON),
        "Landmarks": ("MarkerArray", "/Land_Markers", ON),
        "Direction Info": ("MarkerArray", "/angle_lines", ON),
        "Actual_Trajectory": ("MarkerArray", "/Quad_trajectory", ON),
        "Desired_Trajectory": ("MarkerArray", "/desired_trajectory", ON),
        "risc1": ("Image", "/risc1/ardrone/image_modi", ON),
        "risc2": ("Image", "/risc2/ardrone/image_modi", ON),
        "risc3": ("Image", "/risc3/ardrone/image_modi", ON),
        **WAYPOINTS,
    },
}
TOPIC_KEYS = ("Marker Topic", "Image Topic", "Update Topic")


def manager(name):
    return yaml.safe_load((CONFIG / name).read_text(encoding="utf-8"))["Visualization Manager"]


def displays(name):
    return {display["Name"]: display for display in manager(name)["Displays"]}


def test_these_are_all():
    assert {path.name for path in CONFIG.glob("*.rviz")} == set(FILES)


@pytest.mark.parametrize("name", FILES)
def test_the_world_of_every_configuration(name):
    content = manager(name)
    options = content["Global Options"]
    assert (options["Fixed Frame"], options["Background Color"], options["Frame Rate"]) == ("cortex", "0; 0; 0", 30)
    names = [display["Name"] for display in content["Displays"]]
    assert len(set(names)) == len(names)
    for display in content["Displays"]:
        assert display["Enabled"] is display["Value"]
    found = displays(name)
    assert {grid: found[grid]["Enabled"] for grid in GRIDS} == GRIDS
    sizes = {grid: (found[grid]["Plane Cell Count"], found[grid]["Cell Size"]) for grid in GRIDS}
    assert sizes == {"Floor": (18, 0.25), "Middle": (16, 0.25), "3D": (4, 1)}


@pytest.mark.parametrize("name", FILES)
def test_displays_topics_and_check_boxes(name):
    found = displays(name)
    for label, (kind, topic, on) in WANTED[name].items():
        display = found[label]
        topics = [display[key] for key in TOPIC_KEYS if key in display]
        assert (display["Class"], topics, display["Enabled"]) == ("rviz/" + kind, [topic] if topic else [], on), label


@pytest.mark.parametrize("name", FILES)
def test_frames_of_vehicles_go_stale(name):
    """An Axes display stays where the frame was last; a TF display fades and vanishes."""
    for display in manager(name)["Displays"]:
        if display["Class"] == "rviz/Axes":
            assert display["Reference Frame"] == "cortex"
        if display["Class"] == "rviz/TF":
            assert display["Frame Timeout"] == 1


def test_the_views_of_the_original():
    def view(name):
        current = manager(name)["Views"]["Saved"]
        return {item["Name"]: (item["Distance"], item["Pitch"], item["Yaw"]) for item in current}

    assert view("Diff_flat.rviz")["Top"] == (12.87, 1.5698, 3.1435)
    assert view("Trans_tuner.rviz")["Tuner"] == (7.99, 0.5098, 3.6735)
    current = manager("Trans_tuner.rviz")["Views"]["Current"]
    assert (current["Distance"], current["Pitch"], current["Yaw"]) == (7.99, 0.5098, 3.6735)
