"""Pictures of rviz without a screen: what is in the bag is where it should be in the picture."""

import functools
import os
import subprocess
import sys

import cv2
import numpy as np
import pytest
import rosbag
import rospy
from flying import ROOT, judged, left_behind, summary_of

from risc_control.trajectories import make_course
from risc_estimation.bearings import Bearing, make_camera
from risc_estimation.expected_bearings import Disc, Observer, look
from risc_estimation.ros.bearing_conversions import observed_angles
from risc_experiments.screenshot import main
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab import load_fleet
from risc_lab.lab.calibration import load_calibration, load_mount
from risc_msgs.msg import Cortex, Landmark, Landmarks, States, Trajectories, Trajectory
from risc_visual.drawing.palette import on_white, ray_colours, sphere_colours, vehicle_colour
from risc_visual.drawing.scenery import load_scenery
from risc_visual.pictures.captions import LIGHT, scene_size
from risc_visual.pictures.rviz_pictures import views_from
from risc_visual.pictures.virtual_screen import missing_programs
from risc_visual.vision.landmark_config import load_landmarks

pytestmark = [
    pytest.mark.alone,
    pytest.mark.skipif(
        bool(missing_programs("rviz")), reason="no rviz or no Xvfb: './maap screenshot' installs what pictures need"
    ),
]

T0_S = 1000.0
RATE_HZ = 50.0
DURATION_S = 8.0
AT_S = 7.07  # of the picture: between two messages
SEEN_S = 7.0  # when the cameras last saw something, long enough before that it is drawn
PICTURE_STEPS = 5  # from one picture of the cameras to the next
SIZE = (1280, 900)
SCENE = scene_size(SIZE)  # without the panel of texts
STARTS = (("oblique",), ("top", "rays"), ("tuner",))
TOP, RAYS, TUNER = (pytest.param(name, marks=pytest.mark.release) for name in ("top", "rays", "tuner"))
TIMEOUT_S = 900.0
FLEET = ROOT / "launch" / "fleets" / "ardrones3.yaml"
REACH_M = 0.36  # of a vehicle's nose and rotors from its centre, and a little more
LANDMARK_PX = 20  # around the middle of a landmark
PAINT = {"likeness_deg": 5.0, "brightness": 130.0}  # of a hull, which is opaque
GLASS = {"likeness_deg": 20.0, "brightness": 60.0}  # of rays: with some of what is behind
TUNER_TEXT_RGB = (1.0, 1.0, 0.6)
SPHERE = {"likeness_deg": 30.0, "brightness": 60.0}  # of a landmark: the floor's lines behind it are brighter


def flight():
    """Three vehicles on circles3, without errors: function of time [s] -> positions (3, 3) [m], yaws (3,) [rad]."""
    course = make_course("circles3", 3)

    def at(time_s):
        position = course.at(time_s)[0]
        return position[:, :3], position[:, 3]

    return at


def sightings(fleet, positions_m, yaws_rad):
    """{vehicle's index: Sightings of the landmarks that its camera sees whole}."""
    discs = []
    for mark in fleet.landmarks:
        normal = rotation_body_to_cortex(0.0, 0.0, mark.facing_rad) @ (1.0, 0.0, 0.0)
        discs.append(Disc(mark.name, mark.position_m, tuple(normal)))
    found = {}
    for i, vehicle in enumerate(fleet.vehicles):
        camera = make_camera(load_calibration(vehicle.calibration), True)
        observer = Observer(camera, load_mount(vehicle.camera_mount))
        seen = look(observer, positions_m[i], rotation_body_to_cortex(0.0, 0.0, yaws_rad[i]), discs)
        found[i] = [item for item in seen if item.fraction > 0.99]
    return found


@pytest.fixture(scope="module")
def fleet():
    return load_fleet(FLEET)


@pytest.fixture(scope="module")
def bag_file(tmp_path_factory, fleet):
    """States, references, landmarks and true bearings of a flight without errors."""
    path = tmp_path_factory.mktemp("drawn") / "flight.bag"
    region_of = {kind.name: kind.roi_name for kind in load_landmarks().landmarks}
    at = flight()
    with rosbag.Bag(str(path), "w") as bag:

        def write(topic, message, stamp):
            message.header.stamp, message.header.frame_id = stamp, "cortex"
            bag.write(topic, message, stamp)

        for k in range(int(DURATION_S * RATE_HZ) + 1):
            stamp = rospy.Time.from_sec(T0_S + k / RATE_HZ)
            positions_m, yaws_rad = at(k / RATE_HZ)
            states, references, pictures = [], [], []
            seen = sightings(fleet, positions_m, yaws_rad) if k % PICTURE_STEPS == 0 else {}
            for i, vehicle in enumerate(fleet.vehicles):
                x, y, z = positions_m[i]
                yaw_deg = np.degrees(yaws_rad[i])
                states.append(States(name=vehicle.template, visible=True, x=x, y=y, z=z, psi=yaw_deg))
                references.append(Trajectory(name=vehicle.template, x=x, y=y, z=z, xdot=1.0))
                bearings = [
                    Bearing(region_of[item.name], True, item.azimuth_rad, item.elevation_rad)
                    for item in seen.get(i, ())
                ]
                pictures.append((vehicle.namespace, bearings, []))
            write("/cortex_raw", Cortex(Obj=states), stamp)
            write("/trajectory", Trajectories(Obj=references), stamp)
            if k % PICTURE_STEPS == 0:
                marks = [Landmark(mark.name, *mark.position_m) for mark in fleet.landmarks]
                write("/states3", Landmarks(Obj=marks), stamp)
                angles = observed_angles(rospy.Header(), pictures)
                write("/angles", angles, stamp)
    return path


@pytest.fixture(scope="module")
def picture_of(bag_file):
    """picture_of(view): (scene (height, width, 3) RGB, OrbitView, panel) as the command makes them."""
    out = bag_file.parent / "pictures"

    @functools.cache
    def taken(*names):
        command = [sys.executable, "-m", "risc_experiments.screenshot", str(bag_file), "--fleet", str(FLEET)]
        command += ["--at", str(AT_S), "--out", str(out), "--views", ",".join(names), "--size", "%dx%d" % SIZE]
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=TIMEOUT_S)
        assert done.returncode == 0, done.stdout
        found = {}
        for name in names:
            picture = cv2.imread(str(out / (name + ".png")))[:, :, ::-1].astype(float)
            assert picture.shape == (SIZE[1], SIZE[0], 3)
            (view,) = views_from([name], SIZE)
            assert view.scene_px == SCENE
            found[name] = picture[:, : SCENE[0]], view.camera, picture[:, SCENE[0] :]
        return found

    # one start of rviz for each; the tuner has another node for the frames
    return lambda name: next(taken(*names)[name] for names in STARTS if name in names)


def alike(picture, rgb, likeness_deg, brightness):
    """(height, width) bool: the pixels that have this colour, up to this angle between them, and are so bright."""
    length = np.linalg.norm(picture, axis=2)
    cosine = picture @ np.array(rgb) / (np.maximum(length, 1e-9) * np.linalg.norm(rgb))
    return (length >= brightness) & (cosine >= np.cos(np.radians(likeness_deg)))


def brightest_around(picture, pixels, reach=1):
    """(n,) greatest brightness within `reach` pixels of pixels (n, 2)."""
    brightness = cv2.dilate(picture.max(axis=2), np.ones((2 * reach + 1, 2 * reach + 1)))
    x, y = np.round(pixels).astype(int).T
    return brightness[y, x]


def along(ends_m, view, count=100):
    """(n, 2) pixels along a line between two points, those that are in the picture."""
    part = np.linspace(0.0, 1.0, count)[:, None]
    pixels = view.project(ends_m[0] + part * (ends_m[1] - ends_m[0]), *SCENE)
    inside = ((pixels >= 12) & (pixels <= np.subtract(SCENE, 13))).all(axis=1)
    return pixels[inside]


@pytest.mark.parametrize("name", ["oblique", TOP])
def test_the_net_is_where_the_projection_says(picture_of, name):
    picture, view, _ = picture_of(name)
    ends_m = load_scenery().net.edges().reshape(-1, 2, 3)
    checked = 0
    for edge in ends_m[np.any(ends_m[:, :, 2] > 0.0, axis=1)]:  # those on the floor are among the floor's lines
        pixels = along(edge, view)
        if len(pixels) < 20:
            continue
        checked += 1
        step = (pixels[-1] - pixels[0]) / np.linalg.norm(pixels[-1] - pixels[0])
        beside = [pixels + side * 10.0 * step[::-1] * (1, -1) for side in (-1, 1)]
        on = brightest_around(picture, pixels)
        off = np.minimum(*(brightest_around(picture, line) for line in beside))
        assert np.median(on) > 60, edge
        assert np.mean(on > off + 20) > 0.8, edge
    assert checked >= 4


@pytest.mark.parametrize("name", ["oblique", TOP, RAYS])
def test_every_vehicle_is_in_its_place_and_nowhere_else(picture_of, fleet, name):
    picture, view, _ = picture_of(name)
    positions_m, _ = flight()(AT_S - 0.5 / RATE_HZ)
    y, x = np.mgrid[: SCENE[1], : SCENE[0]]
    landmark = np.zeros(x.shape, dtype=bool)  # orange glass over grey is yellow
    for mark in fleet.landmarks:
        centre = view.project(mark.position_m, *SCENE)
        landmark |= np.hypot(x - centre[0], y - centre[1]) <= LANDMARK_PX
    for i, vehicle in enumerate(fleet.vehicles):
        centre = view.project(positions_m[i], *SCENE)
        near_m = positions_m[i] + REACH_M * np.vstack((np.eye(3), -np.eye(3)))
        reach = np.linalg.norm(view.project(near_m, *SCENE) - centre, axis=1).max()
        near = np.hypot(x - centre[0], y - centre[1]) <= reach
        hull = np.hypot(x - centre[0], y - centre[1]) <= 0.25 * reach
        coloured = alike(picture, vehicle_colour(i), **PAINT)
        assert (coloured & hull).sum() > 30, vehicle.template
        elsewhere = (coloured & ~near & ~landmark).sum()
        assert elsewhere <= 0.02 * (coloured & near).sum(), (vehicle.template, elsewhere)


@pytest.mark.parametrize("name", [RAYS, TUNER])
def test_rays_hit_their_spheres(picture_of, fleet, name):
    """From every camera to every landmark that it sees whole: the ray's colour along the line, none of it beside."""
    picture, view, _ = picture_of(name)
    positions_m, yaws_rad = flight()(SEEN_S)
    landmarks = load_landmarks()
    place_m = {mark.name: np.array(mark.position_m) for mark in fleet.landmarks}
    checked = 0
    for i, seen in sightings(fleet, positions_m, yaws_rad).items():
        mount = load_mount(fleet.vehicles[i].camera_mount)
        eye_m = positions_m[i] + rotation_body_to_cortex(0.0, 0.0, yaws_rad[i]) @ mount.position_m
        for item in seen:
            checked += 1
            line_m = place_m[item.name] - eye_m
            coloured = alike(picture, ray_colours(landmarks)[item.name], **GLASS).astype(np.uint8)
            coloured = cv2.dilate(coloured, np.ones((5, 5))) > 0
            pixels = along((eye_m + 0.4 * line_m, eye_m + 0.9 * line_m), view)
            x, y = np.round(pixels).astype(int).T
            assert coloured[y, x].mean() > 0.8, (i, item.name)
            across = (pixels[-1] - pixels[0])[::-1] * (1, -1) / np.linalg.norm(pixels[-1] - pixels[0])
            for side in (-15.0, 15.0):
                x, y = np.round(pixels + side * across).astype(int).T
                assert coloured[y, x].mean() < 0.2, (i, item.name)
    assert checked >= 3
    for landmark, at_m in place_m.items():
        x, y = np.round(view.project(at_m, *SCENE)).astype(int)
        sphere = picture[y - 4 : y + 5, x - 4 : x + 5]
        assert alike(sphere, sphere_colours(landmarks)[landmark], **SPHERE).mean() > 0.8, landmark


@pytest.mark.release
def test_the_tuner_says_by_how_much_rays_miss(picture_of):
    assert alike(picture_of("tuner")[2], TUNER_TEXT_RGB, **PAINT).sum() > 500


@pytest.mark.release
def test_a_light_picture_is_light_and_shows_the_same(bag_file, tmp_path):
    arguments = ["--fleet", str(FLEET), "--at", str(AT_S), "--out", str(tmp_path), "--views", "top", "--light"]
    assert main([str(bag_file), *arguments]) == 0
    picture = cv2.imread(str(tmp_path / "top.png"))[:, :, ::-1].astype(float)
    scene = picture[:, : scene_size((1280, 900))[0]]
    assert (scene.reshape(-1, 3) == LIGHT.ground).all(axis=1).mean() > 0.4
    assert np.percentile(picture.mean(axis=2), 10) > 180, "nothing dark but lines, letters and vehicles"
    for i in range(3):
        assert alike(scene, on_white(vehicle_colour(i)), 12.0, 60.0).sum() > 100


@pytest.mark.release  # without the flight: test_screenshot.py
def test_an_experiment_is_flown_first(tmp_path):
    (tmp_path / "launch").symlink_to(ROOT / "launch")
    command = [sys.executable, "-m", "risc_experiments.screenshot", "circles3", "--vehicles", "1", "--duration", "6"]
    done = subprocess.run(
        [*command, "--views", "oblique"],
        env=dict(os.environ, RISC_MAAP_ROOT=str(tmp_path)),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=TIMEOUT_S,
    )
    (folder,) = (tmp_path / "flights").iterdir()
    code, output, _, _ = judged((done.returncode, done.stdout, summary_of(folder), folder))
    assert code == 0, output
    picture = cv2.imread(str(folder / "screenshots" / "oblique.png"))[:, :, ::-1].astype(float)
    assert [alike(picture, vehicle_colour(i), **PAINT).sum() > 50 for i in range(3)] == [True, False, False]
    assert left_behind(folder) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["circle4"], "circle4"),
        (["nowhere.bag"], "nowhere.bag"),
        (["nowhere.bag", "--duration", "9"], "--duration 9"),
        (["circles3", "--views", "oblique,bottom"], "'bottom'"),
        (["circles3", "--views", "nowhere.rviz"], "nowhere.rviz"),
        (["circles3", "--size", "big"], "'big'"),
        (["circles3", "--at", "-1"], "--at"),
        (["circles3", "--vehicles", "0"], "--vehicles"),
    ],
)
def test_wrong_use_is_one_clear_line(capfd, arguments, message):
    with pytest.raises(SystemExit) as end:
        raise SystemExit(main(arguments))
    assert end.value.code not in (0, None)
    assert message in capfd.readouterr().err


def test_a_time_after_the_end_is_refused(capfd, bag_file):
    assert main([str(bag_file), "--at", "99"]) == 1
    assert "99.0 s" in capfd.readouterr().err
