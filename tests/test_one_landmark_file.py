"""A landmark stands in one file: a fifth one is known to estimation, vision, the virtual lab, drawing and reports."""

import numpy as np
import pytest
import yaml
from picture_truth import LabelledRenderer

from risc_estimation.state_estimator import StatesEstimator
from risc_lab.camera import Camera, rotation_camera_to_body
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab import landmark_catalogue, load_templates
from risc_lab.lab.calibration import FRONT_MOUNT, load_calibration
from risc_lab.lab.landmark_catalogue import load_landmark_catalogue
from risc_simulator.video.scene import CameraPose, Scene, load_style
from risc_visual.drawing.palette import ray_colours, sphere_colours
from risc_visual.vision.landmark_config import load_landmarks
from risc_visual.vision.landmark_detector import LandmarkDetector

FIFTH = {"name": "Blue_pink", "roi_name": "fifth", "centre": "blue", "ring": "pink"}
PLACE_M = np.array([2.3, 0.2, 1.1])


@pytest.fixture(autouse=True)
def five(tmp_path, monkeypatch):
    """The laboratory's file with a fifth landmark."""
    content = yaml.safe_load(landmark_catalogue.landmarks_file().read_text(encoding="utf-8"))
    content["landmarks"].append(FIFTH)
    path = tmp_path / "landmarks.yaml"
    path.write_text(yaml.safe_dump(content))
    monkeypatch.setattr(landmark_catalogue, "landmarks_file", lambda: path)


def test_motion_capture_and_estimation_know_it():
    templates = load_templates()
    assert templates["Blue_pink"].kind == "landmark"
    estimator = StatesEstimator(templates)
    markers = templates["Blue_pink"].markers_m + PLACE_M
    estimate = estimator.update(0.0, (("Blue_pink", len(markers)),), markers)
    assert estimate.landmark_names == ("Blue_pink",)
    np.testing.assert_allclose(estimate.landmarks_m, [PLACE_M], atol=1e-9)
    assert load_landmark_catalogue().template_of_region["fifth"] == "Blue_pink"


def test_the_virtual_lab_shows_it_and_vision_finds_it():
    style, camera = load_style(), Camera(load_calibration("ardrone_front.yaml"))
    disc = style.disc("Blue_pink", PLACE_M, (-1.0, 0.0, 0.0))
    renderer = LabelledRenderer(camera, Scene(style, (disc,)), 1)
    eye = CameraPose(np.array([0.0, 0.0, 1.0]), rotation_body_to_cortex(0, 0, 0) @ rotation_camera_to_body(FRONT_MOUNT))
    (found,) = LandmarkDetector(load_landmarks(), camera).detect(renderer.render(eye))
    (truth,) = [item for item in renderer.truth(eye) if item.kind == "landmark"]
    assert found.name == "fifth"
    assert np.hypot(*(np.array(truth.centre_px) - (found.x, found.y))) < 0.2


def test_it_is_drawn_in_the_colour_of_its_paint():
    landmarks = load_landmarks()
    assert sphere_colours(landmarks)["Blue_pink"] == sphere_colours(landmarks)["Blue_green"]
    assert ray_colours(landmarks)["fifth"] == ray_colours(landmarks)["blue"]
