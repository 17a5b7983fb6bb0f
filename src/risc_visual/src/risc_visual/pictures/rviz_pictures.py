"""Pictures of a bag as rviz shows it, without a screen.

Drawing in software takes a core, so nothing is drawn beside a flight: the bag is played into the drawing nodes
afterwards, on a master of its own, until the wanted time. There the clock stops, so that nothing expires, and every
view is taken.
"""

import contextlib
import os
import pathlib
import re
import subprocess
import tempfile
import time
import xmlrpc.client
from typing import NamedTuple

import numpy as np
import yaml
from roslib.packages import find_node

from data_extraction.bags import Bag
from data_extraction.flatten import seconds
from data_extraction.progress import Progress
from data_extraction.report.recorded_topics import fits
from risc_lab.lab.yaml_reader import package_file
from risc_lab.mortal import mortal
from risc_lab.phases import OperatorPhase
from risc_lab.ros.launching import Launch, any_busy, free_tcp_port, marked_processes, wait_until
from risc_visual.drawing.ros.markers import LABEL_M, TEXT_M
from risc_visual.drawing.scenery import load_scenery
from risc_visual.pictures import captions
from risc_visual.pictures.captions import DARK, LIGHT, Name, Row
from risc_visual.pictures.orbit_view import (
    ORBIT,
    OrbitView,
    has_display,
    load_config,
    marker_topics,
    orbit_view_from_dict,
    picture_config,
    saved_view,
)
from risc_visual.pictures.virtual_screen import VirtualScreen, save_picture

NAME = "/maap_screenshot"  # caller's name in requests to the master
CAMERAS, GRID, TITLE, TUNER = "/Cameras", "/Grid", "/desired_trajectory_name", "/transform_tuner/text"
VEHICLES, VEHICLE_NAMES, MODE, BATTERY = "/Quad_Markers", "/Quad_Labels", "/Ctrl_Status", "/Battery_Status"
REFERENCES, REFERENCE_NAMES = "/desired_trajectory", "traj_name"  # topic, and namespace of its texts
NAMES = (VEHICLE_NAMES, "/Land_Labels", "/Way_Labels")
TEXTS = (GRID, TITLE, MODE, BATTERY, TUNER, *NAMES)  # topics of nothing but texts, which captions writes
KEY = (("desired path", REFERENCES, "traj_line"), ("path flown", "/Quad_trajectory", "quad_line"))  # topic, namespace
RECORDED = (*TEXTS, VEHICLES, REFERENCES, "/Quad_trajectory")
VEHICLE_REACH_M = (0.36, 0.12)  # half width and half height: nose and rotors from its centre, and a little more
HANDLES_REACH_M = (0.45, 0.45)  # with the handles of its camera
THING_REACH_M = (0.1, 0.1)  # of a landmark, a waypoint


class StandardView(NamedTuple):
    """A view that has a name."""

    config: str  # rviz configuration of risc_visual
    saved: str  # one of its saved views, "" its current one
    without: tuple = ()  # topics that are not shown
    height_m: float = np.inf  # above the floor, up to which the arena fills the picture; at most that of the net


VIEWS = {
    "oblique": StandardView("Diff_flat.rviz", "Flight", (CAMERAS,)),
    "top": StandardView("Diff_flat.rviz", "Top", (CAMERAS,)),
    "rays": StandardView("coop.rviz", ""),
    "tuner": StandardView("Trans_tuner.rviz", "", (), 1.6),
}
FIXED = "<Fixed Frame>"
BEARINGS = "/angles"
HANDLES = "rviz/InteractiveMarkers"  # a view with this display is one of the transform tuner
FRAMES = ("/tf", "/tf_static")
DRAWN = ("/cortex_raw", "/mocap_data", "/states3", "/trajectory", "/trajectory_phase", BEARINGS)  # have a listener each
OF_VEHICLES = ("safety", "controller_status", "vehicle_status", "ardrone/navdata")  # the last: of the original release
BEFORE_END_S = 0.5  # of the course, so that the vehicles are still on it
DRAWN_WITHIN_S = 0.2  # rays: drawn after 0.04 s at most, gone after 0.3 s
LEAD_S = 20.0  # played before the picture: the paths are as long as that
# The end is played slowly: what rviz draws late, when the clock has stopped, would never expire.
SLOW_S = 1.0  # longer than the lifetimes of short-lived markers
SLOW_RATE = 0.2
STEP_S = 0.01  # forward between the two parts: rviz forgets everything when the clock steps back
FRAME_RATE_HZ = 5  # of rviz: enough for a picture, and leaves processor time to the drawing nodes
START_PATIENCE_S = 300.0  # for rviz and the drawing nodes, on a busy computer
REST_PERIOD_S = 0.07  # not the 0.04 s that the drawing nodes sleep after every message
REST_LOOKS = 10
REST_PATIENCE_S = 300.0
PLAY_MARGIN_S = 300.0  # beyond the time that is played
_LEAST_ALPHA = 0.6


class View(NamedTuple):
    """One picture to take."""

    name: str  # of its file
    config: dict  # of rviz, for a picture of this size
    size_px: tuple  # (width, height)
    camera: OrbitView | None = None  # None: no orbit view in the fixed frame; then rviz draws the texts, too
    scheme: captions.Scheme = DARK

    @property
    def scene_px(self):
        """(width, height) of what rviz draws."""
        return captions.scene_size(self.size_px) if self.camera else self.size_px


def moment_of(bag):
    """The time [s] in an opened Bag that is worth a picture: just before the operator calls the vehicles home.

    With bearings: the last time on the course at which the most landmarks are seen. Without an operator: the middle of
    the bag.
    """
    begin_s, end_s = bag.start_s, bag.start_s + bag.duration_s
    found_s = 0.5 * (begin_s + end_s)
    if "/operator/phase" in bag.topics and fits("/operator/phase", bag.types["/operator/phase"]):
        phases = [(receipt_s, message.phase) for _, receipt_s, message in bag.messages(["/operator/phase"])]
        flying = [
            (start_s, stop_s) for (start_s, phase), (stop_s, _) in zip(phases, phases[1:]) if phase == OperatorPhase.FLY
        ]
        if flying:
            begin_s, end_s = flying[0][0], flying[-1][1] - BEFORE_END_S
            found_s = end_s
    if BEARINGS in bag.topics:
        found_s = _most_seen(bag, begin_s, end_s) or found_s
    return found_s - bag.start_s


def _most_seen(bag, begin_s, end_s):
    """The last time of receipt [s] in between at which the cameras see the most; None when they see nothing."""
    seen, best = {}, (0, None)
    for _, receipt_s, message in bag.messages([BEARINGS]):
        if begin_s <= receipt_s <= end_s - DRAWN_WITHIN_S:
            for angles in message.Obj:
                seen[angles.name] = receipt_s, sum(item.visible for item in angles.landmarks)
            now = sum(count for at_s, count in seen.values() if receipt_s - at_s < DRAWN_WITHIN_S)
            if now and now >= best[0]:
                best = now, receipt_s + 0.5 * DRAWN_WITHIN_S
    return best[1]


def standard_views(bag, fleet):
    """Names of the VIEWS that an opened Bag has something for. fleet: path of its fleet file, or None."""
    if BEARINGS not in bag.topics:
        return ["oblique", "top"]
    return ["oblique", "top", "rays"] + (["tuner"] if fleet else [])


def views_from(names, size_px, light=False, arena=None):
    """List of View. Standard views are filled by the arena. Raises ValueError for unknown names and configurations."""
    scenery = load_scenery()
    scenery = scenery.around(arena) if arena else scenery
    around = np.vstack([scenery.net.edges(), [at_m for _, at_m in scenery.grid.labels(scenery.net)]])
    scheme = LIGHT if light else DARK
    found = []
    for name in names:
        if name in VIEWS:
            path, saved, without, height_m = VIEWS[name]
            path = package_file("risc_visual", "config/" + path)
        else:
            path, _, saved = name.partition(":")
            without = ()
            if not path.endswith(".rviz"):
                raise ValueError("there is no view '%s': use %s, or FILE.rviz" % (name, ", ".join(VIEWS)))
        config = load_config(path)
        try:
            content = saved_view(config, saved)
            camera = _camera(content, config)
            size = captions.scene_size(size_px) if camera else size_px
            if name in VIEWS:
                camera = camera.fitted(np.minimum(around, (np.inf, np.inf, height_m)), *size)
                content = camera.as_dict(content)
            without, silent = (without + TEXTS, (REFERENCE_NAMES,)) if camera else (without, ())
            config = picture_config(config, content, size, FRAME_RATE_HZ, scheme, without, silent)
        except ValueError as error:
            raise ValueError("%s: %s" % (path, error)) from None
        words = name if name in VIEWS else pathlib.Path(path).stem + " " + saved
        found.append(View(re.sub(r"\W+", "_", words.lower()).strip("_"), config, size_px, camera, scheme))
    return found


def _camera(view, config):
    """OrbitView of a view in the fixed frame, else None."""
    fixed = config["Visualization Manager"].get("Global Options", {}).get("Fixed Frame")
    if view.get("Class") != ORBIT or view.get("Target Frame", FIXED) not in (FIXED, fixed):
        return None
    return orbit_view_from_dict(view)


def take_pictures(bag_path, views, at_s, out, fleet=None, title="", progress=None):
    """Play a bag until at_s [s] from its begin and take each View then. Returns the paths of the pictures.

    out: folder for them. fleet: path of a fleet file. Raises ValueError for a useless bag, ScreenError or RuntimeError
    when rviz, the drawing nodes or the player fail.
    """
    progress = progress or Progress()
    with Bag(bag_path) as bag:
        recorded, duration_s = {topic for topic, kind in bag.types.items() if fits(topic, kind)}, bag.duration_s
    if at_s > duration_s:
        raise ValueError("%s is %.1f s long: there is no picture at %.1f s" % (bag_path, duration_s, at_s))
    drawn = recorded.intersection(DRAWN)
    if not drawn:
        raise ValueError("%s has nothing to draw: no %s" % (bag_path, ", ".join(DRAWN)))
    tuner = any(has_display(view.config, HANDLES) for view in views)
    if tuner and fleet is None:
        raise ValueError("the transform tuner needs the fleet of the bag: give it with --fleet, or leave its view out")
    played = drawn | {topic for topic in recorded if topic.endswith(OF_VEHICLES)}
    if "/tf" in recorded and not tuner:
        played |= recorded.intersection(FRAMES)
    out = pathlib.Path(out)
    out.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as stack:
        folder = pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="screenshot-")))
        port = free_tcp_port()
        values = {
            "fleet": fleet or "",
            "title": title,
            "transforms": "transform_tuner" if tuner else "" if "/tf" in recorded else "transforms",
            "light": str(any(view.scheme is LIGHT for view in views)).lower(),
            "record": " ".join(RECORDED),
            "record_to": folder / "drawn.bag",
        }
        launch_file = package_file("risc_visual", "launch/replay.launch")
        launch = Launch(launch_file, values, folder, port)
        stack.callback(launch.stop)
        master = xmlrpc.client.ServerProxy("http://127.0.0.1:%d" % port)
        progress.show("starting", "rviz for " + ", ".join(view.name for view in views))
        _wait(lambda: _unprepared(master), launch)
        network = {"ROS_MASTER_URI": "http://127.0.0.1:%d" % port, "ROS_IP": "127.0.0.1", "ROS_HOME": str(folder)}
        screens = [stack.enter_context(_rviz(view, folder, network)) for view in views]
        wanted = {(topic, "/" + _node(view)) for view in views for topic in marker_topics(view.config)}
        _wait(lambda: _deaf(master, drawn, wanted), launch, screens)
        parts = ((max(0.0, at_s - LEAD_S), at_s - SLOW_S, 1.0), (max(0.0, at_s - SLOW_S + STEP_S), at_s, SLOW_RATE))
        for start_s, stop_s, rate in parts:
            if start_s < stop_s:
                progress.show("playing", "%.1f s to %.1f s of %s" % (start_s, stop_s, bag_path))
                _play(bag_path, sorted(played), start_s, stop_s, rate, network)
                _wait_for_rest(launch)
        pictures = []
        for view, screen in zip(views, screens):
            progress.show("drawing", view.name)
            pictures.append(screen.steady_picture())
        launch.stop()  # and with it the recorder, whose bag is complete then
        drawn = newest_markers(folder / "drawn.bag")
        paths = []
        for view, picture in zip(views, pictures):
            if view.camera:
                picture = captions.write(picture, layout_of(view, drawn, "t = %.1f s" % at_s), view.scheme)
            paths.append(out / (view.name + ".png"))
            save_picture(paths[-1], picture)
        return paths


def newest_markers(path):
    """{(topic, namespace, id): Marker} of a bag of what was drawn: what rviz shows at its end."""
    found, now_s = {}, 0.0
    with Bag(path) as bag:
        for topic, now_s, message in bag.messages([topic for topic in RECORDED if topic in bag.topics]):
            for marker in getattr(message, "markers", [message]):
                lifetime_s = seconds(marker.lifetime) or np.inf
                found[topic, marker.ns, marker.id] = marker, now_s + lifetime_s
    return {key: marker for key, (marker, until_s) in found.items() if until_s >= now_s}


def layout_of(view, drawn, time_text=""):
    """captions.Layout of a View with an orbit camera. drawn: as of `newest_markers`."""
    shown, tuner = set(marker_topics(view.config)), has_display(view.config, HANDLES)
    names = []
    for (topic, ns, _), marker in drawn.items():
        below = topic == REFERENCES and ns == REFERENCE_NAMES and topic in shown
        if topic in NAMES or topic == GRID or below:
            is_vehicle, at = topic == VEHICLE_NAMES, marker.pose.position
            reach_m = (HANDLES_REACH_M if tuner else VEHICLE_REACH_M) if is_vehicle else THING_REACH_M
            at_m = (at.x, at.y, at.z) - np.multiply(0.0 if topic == GRID else -1.0 if below else 1.0, LABEL_M)
            anchor, *around = view.camera.project(np.vstack((at_m, at_m + outline_m(*reach_m))), *view.scene_px)
            reach_px = np.abs(np.subtract(around, anchor)).max(axis=0)
            rgb, places = _faded(marker, view.scheme), (tuple(anchor.tolist()), tuple(reach_px.tolist()))
            names.append(Name(marker.text, *places, rgb, topic != GRID, is_vehicle))
    return captions.lay_out(names, _rows(drawn, shown, tuner, time_text), view.size_px, view.scheme)


def outline_m(across, up):
    """(n, 3) [m] points around a flat object at the origin: a ring of radius `across`, and `up` above and below."""
    turns = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    ring = across * np.column_stack((np.cos(turns), np.sin(turns), np.zeros(16)))
    return np.vstack((ring, [(0.0, 0.0, up), (0.0, 0.0, -up)]))


def _faded(marker, scheme):
    """(r, g, b) of a marker on the scheme's ground, but never so pale that it cannot be read."""
    alpha = max(_LEAST_ALPHA, marker.color.a)
    ground = np.array(scheme.ground) / 255.0
    return tuple((alpha * np.array(_rgb(marker)) + (1.0 - alpha) * ground).tolist())


def _rgb(marker):
    return marker.color.r, marker.color.g, marker.color.b


def _rows(drawn, shown, tuner, time_text):
    """The lines of the panel: what is flown and when, every vehicle and how it is, the key, the tuner's text."""
    of = {}  # topic -> its markers by namespace and id
    for (topic, *_), marker in sorted(drawn.items()):
        of.setdefault(topic, []).append(marker)
    rows = [Row(line, bold=True) for marker in of.get(TITLE, ()) for line in marker.text.split("\n")]
    rows.append(Row(time_text, small=True))
    states = of.get(MODE, []) + of.get(BATTERY, [])
    alone = [state for state in states if state.scale.z == TEXT_M]  # without a fleet: nameless, of the first vehicle
    for marker in sorted(of.get(VEHICLE_NAMES, ()), key=lambda marker: marker.id):
        hull = drawn.get((VEHICLES, marker.ns, 1), marker)
        rows.append(Row(marker.text, mark="dot", mark_rgb=_rgb(hull), space=True))
        mine = alone + [state for state in states if state.text.startswith(marker.ns + ": ")]
        alone = []
        rows += [Row(state.text.removeprefix(marker.ns + ": "), _rgb(state), small=True) for state in mine]
    first = {(topic, marker.ns): _rgb(marker) for topic in shown for marker in reversed(of.get(topic, ()))}
    key = [(text, first[topic, ns]) for text, topic, ns in KEY if (topic, ns) in first]
    rows += [Row(text, mark="line", mark_rgb=rgb, small=True, space=k == 0) for k, (text, rgb) in enumerate(key)]
    if tuner:
        rows += [Row(marker.text, _rgb(marker), small=True, space=True) for marker in of.get(TUNER, ())]
    return rows


def _node(view):
    return "rviz_" + view.name


@contextlib.contextmanager
def _rviz(view, folder, network):
    """A virtual screen with rviz on it, as the node of the view's name."""
    config = folder / (view.name + ".rviz")
    config.write_text(yaml.safe_dump(view.config), encoding="utf-8")
    with VirtualScreen(*view.scene_px) as screen:
        command = ["rviz", "--splash-screen", "", "--fullscreen", "--display-config", str(config)]
        screen.start([*command, "__name:=" + _node(view)], folder / (view.name + ".log"), **network)
        yield screen


def _unprepared(master):
    """What rviz still needs before it starts, as a list of texts: a master with /use_sim_time set."""
    try:
        _, _, simulated = master.getParam(NAME, "/use_sim_time")
    except (OSError, xmlrpc.client.Error):
        return ["the ROS master does not answer"]  # not there yet, or just starting
    return [] if simulated is True else ["/use_sim_time is not set"]


def _deaf(master, topics, pairs):
    """What is still missing, as a list of texts: topics without a subscriber, and (topic, node) without that node."""
    _, _, (_, subscribers, _) = master.getSystemState(NAME)
    listeners = dict(subscribers)
    missing = ["%s has no listener" % topic for topic in sorted(topics) if not listeners.get(topic)]
    deaf = [(topic, node) for topic, node in sorted(pairs) if node not in listeners.get(topic, ())]
    return missing + ["%s does not listen to %s" % (node, topic) for topic, node in deaf]


def _wait(missing, launch, screens=()):
    """Wait until missing() is empty. Raises RuntimeError with its content when that does not happen."""
    reasons = []

    def over():
        for screen in screens:
            screen.check_programs()
        reasons[:] = missing()
        return not reasons or not launch.running()

    wait_until(over, START_PATIENCE_S)
    if reasons:
        raise RuntimeError("the drawing nodes did not start: %s\n%s" % ("; ".join(reasons), launch.log_tail()))


def _wait_for_rest(launch):
    """Wait until the nodes have nothing left to do: the clock stands, so they come to rest when all is drawn.

    Raises RuntimeError when they do not.
    """

    def rest():
        for _ in range(REST_LOOKS):
            if any_busy(marked_processes(launch.identity)):
                return False
            time.sleep(REST_PERIOD_S)
        return True

    if not wait_until(rest, REST_PATIENCE_S):
        raise RuntimeError("the drawing nodes do not come to rest:\n%s" % launch.log_tail())


def _play(bag_path, topics, start_s, stop_s, rate, network):
    """Play a part of a bag; the clock that it publishes stands still from then on."""
    # the player itself: the script `rosbag` would leave it behind when it is killed
    command = [*find_node("rosbag", "play"), "--quiet", "--clock", "--rate=%g" % rate]
    command += ["--start=%.3f" % start_s, "--duration=%.3f" % (stop_s - start_s)]
    command += ["--topics", *topics, "--bags", bag_path, "__name:=player"]
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    timeout_s = (stop_s - start_s) / rate + PLAY_MARGIN_S
    try:
        done = subprocess.run(mortal("TERM", command), env=dict(os.environ, **network), timeout=timeout_s, **pipes)
    except subprocess.TimeoutExpired:
        raise RuntimeError("rosbag play of %s does not end within %g s" % (bag_path, timeout_s)) from None
    if done.returncode:
        raise RuntimeError("rosbag play failed:\n" + done.stdout)
