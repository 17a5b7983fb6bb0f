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

import yaml

from data_extraction.bags import Bag
from data_extraction.progress import Progress
from data_extraction.report.kinds import fits
from risc_lab.lab.yaml_reader import package_file
from risc_lab.phases import OperatorPhase
from risc_lab.ros.launching import Launch, any_busy, free_tcp_port, marked_processes
from risc_visual.pictures.orbit_view import has_display, load_config, marker_topics, picture_config, saved_view
from risc_visual.pictures.virtual_screen import VirtualScreen, save_picture

NAME = "/maap_screenshot"  # under which the master is asked
VIEWS = {  # name: (rviz configuration of risc_visual, one of its saved views)
    "oblique": ("Diff_flat.rviz", "Flight"),
    "top": ("Diff_flat.rviz", "Top"),
    "rays": ("coop.rviz", ""),
    "tuner": ("Trans_tuner.rviz", ""),
}
BEARINGS = "/angles"
HANDLES = "rviz/InteractiveMarkers"  # a view with this display is one of the transform tuner
FRAMES = ("/tf", "/tf_static")
DRAWN = ("/cortex_raw", "/mocap_data", "/states3", "/trajectory", "/trajectory_phase", BEARINGS)  # have a listener each
OF_VEHICLES = ("safety", "controller_status", "ardrone/navdata")
BEFORE_END_S = 0.5  # of the course: still on it
DRAWN_WITHIN_S = 0.2  # rays: drawn after 0.04 s at most, gone after 0.3 s
LEAD_S = 20.0  # played before the picture: the paths are as long as that
# The end is played slowly: what rviz draws late, when the clock stands already, would never expire.
SLOW_S = 1.0  # longer than the lifetimes of what comes and goes
SLOW_RATE = 0.2
STEP_S = 0.01  # forward between the two parts: rviz forgets everything when the clock steps back
FRAME_RATE_HZ = 5  # of rviz: enough for a picture, and the nodes that draw keep their time
START_PATIENCE_S = 300.0  # for rviz and the drawing nodes, on a computer that has other things to do
REST_PERIOD_S = 0.07  # not that of the drawing nodes, who sleep 0.04 s after every message
REST_LOOKS = 10
REST_PATIENCE_S = 300.0
PLAY_MARGIN_S = 300.0  # beyond the time that is played


class View(NamedTuple):
    """One picture to take."""

    name: str  # of its file
    config: dict  # of rviz, for a picture of this size
    size_px: tuple  # (width, height)


def moment_of(bag):
    """The time [s] in an opened Bag that is worth a picture: just before the operator calls the vehicles home.

    With bearings the last time on the course at which as many landmarks are seen as ever. Of a bag without an operator
    the middle.
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


def views_from(names, size_px):
    """List of View. Raises ValueError for a name that is none, and for a bad configuration."""
    found = []
    for name in names:
        if name in VIEWS:
            path, saved = VIEWS[name]
            path = package_file("risc_visual", "config/" + path)
        else:
            path, _, saved = name.partition(":")
            if not path.endswith(".rviz"):
                raise ValueError("there is no view '%s': use %s, or FILE.rviz" % (name, ", ".join(VIEWS)))
        config = load_config(path)
        try:
            config = picture_config(config, saved_view(config, saved), *size_px, FRAME_RATE_HZ)
        except ValueError as error:
            raise ValueError("%s: %s" % (path, error)) from None
        words = name if name in VIEWS else pathlib.Path(path).stem + " " + saved
        found.append(View(re.sub(r"\W+", "_", words.lower()).strip("_"), config, size_px))
    return found


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
                _play(bag_path, sorted(played), start_s, stop_s, rate, folder, network)
                _wait_for_rest(launch)
        paths = []
        for view, screen in zip(views, screens):
            progress.show("drawing", view.name)
            paths.append(out / (view.name + ".png"))
            save_picture(paths[-1], screen.steady_picture())
        return paths


def _node(view):
    return "rviz_" + view.name


@contextlib.contextmanager
def _rviz(view, folder, network):
    """A virtual screen with rviz on it, as the node of the view's name."""
    config = folder / (view.name + ".rviz")
    config.write_text(yaml.safe_dump(view.config), encoding="utf-8")
    with VirtualScreen(*view.size_px) as screen:
        command = ["rviz", "--splash-screen", "", "--fullscreen", "--display-config", str(config)]
        screen.start([*command, "__name:=" + _node(view)], folder / (view.name + ".log"), **network)
        yield screen


def _unprepared(master):
    """What rviz has to find when it starts, as a list of texts: a master that tells it whose clock is the clock."""
    try:
        _, _, simulated = master.getParam(NAME, "/use_sim_time")
    except (OSError, xmlrpc.client.Error):
        return ["the ROS master does not answer"]  # not there yet, or just starting
    return [] if simulated is True else ["/use_sim_time is not set"]


def _listeners(master):
    """{topic: names of the nodes that subscribe it}."""
    _, _, (_, subscribers, _) = master.getSystemState(NAME)
    return {topic: set(nodes) for topic, nodes in subscribers}


def _deaf(master, topics, pairs):
    """What is still missing, as a list of texts: topics without any listener, and of every (topic, node) that node."""
    listeners = _listeners(master)
    missing = ["%s has no listener" % topic for topic in sorted(topics) if not listeners.get(topic)]
    return missing + [
        "%s does not listen to %s" % (node, topic)
        for topic, node in sorted(pairs)
        if node not in listeners.get(topic, ())
    ]


def _wait(missing, launch, screens=()):
    """Until missing() is empty. Raises RuntimeError with what is in it when that does not come true."""
    deadline = time.monotonic() + START_PATIENCE_S
    while True:
        reasons = missing()
        if not reasons:
            return
        for screen in screens:
            screen.check_programs()
        if not launch.running() or time.monotonic() > deadline:
            raise RuntimeError("what draws did not start: %s\n%s" % ("; ".join(reasons), launch.log_tail()))
        time.sleep(0.1)


def _wait_for_rest(launch):
    """Until the nodes have nothing left to do: the clock stands, so they come to rest when all is drawn.

    Raises RuntimeError when they do not.
    """
    deadline = time.monotonic() + REST_PATIENCE_S
    looks = 0
    while looks < REST_LOOKS:
        looks = 0 if any_busy(marked_processes(launch.identity)) else looks + 1
        if time.monotonic() > deadline:
            raise RuntimeError("what draws does not come to rest:\n%s" % launch.log_tail())
        time.sleep(REST_PERIOD_S)


def _play(bag_path, topics, start_s, stop_s, rate, folder, network):
    """Play a part of a bag; the clock that it publishes stands still from then on."""
    command = ["rosbag", "play", "--quiet", "--clock", "--rate=%g" % rate]
    command += ["--start=%.3f" % start_s, "--duration=%.3f" % (stop_s - start_s)]
    command += ["--topics", *topics, "--bags", str(bag_path), "__name:=player"]
    log = folder / "player.log"
    with log.open("wb") as output:
        player = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            env=dict(os.environ, **network),
            start_new_session=True,
        )
    try:
        if player.wait((stop_s - start_s) / rate + PLAY_MARGIN_S) != 0:
            raise RuntimeError("rosbag play failed:\n" + log.read_text(errors="replace"))
    except subprocess.TimeoutExpired:
        raise RuntimeError("rosbag play does not end:\n" + log.read_text(errors="replace")) from None
    finally:
        if player.poll() is None:
            player.terminate()
            player.wait()
