"""Parts of `./maap screenshot` that need no rviz: when a picture is worth taking, which views there are."""

import pathlib
import subprocess
import sys
import time

import pytest
import rosbag
import rospy

from data_extraction.bags import Bag
from data_extraction.progress import Progress
from risc_experiments import screenshot
from risc_experiments.screenshot import arguments
from risc_lab.phases import OperatorPhase as Phase
from risc_lab.ros.launching import any_busy
from risc_maap_msgs.msg import OperatorState
from risc_msgs.msg import Angle, Angles, Observed_angles
from risc_visual.pictures.orbit_view import has_display
from risc_visual.pictures.rviz_pictures import VIEWS, moment_of, standard_views, views_from

T0_S = 500.0
PATIENCE_S = 60.0
PHASES = (
    (0.0, Phase.WAITING, ""), (1.0, Phase.TAKEOFF, ""), (2.0, Phase.FLY, ""), (3.0, Phase.FLY, "on course"),
    (8.0, Phase.HOME, ""), (9.0, Phase.DONE, ""),
)  # fmt: skip


def observed(vehicle, count):
    """A picture in which a vehicle sees `count` landmarks, and one landmark that it does not see."""
    landmarks = [Angle(name="a%d" % k, visible=True) for k in range(count)] + [Angle(name="lost", visible=False)]
    return Observed_angles(Obj=[Angles(name=vehicle, landmarks=landmarks)])


def moment(path, messages):
    """moment_of a bag of (time [s], topic, message)."""
    with rosbag.Bag(str(path), "w") as bag:
        for time_s, topic, message in sorted(messages, key=lambda item: item[0]):
            bag.write(topic, message, rospy.Time.from_sec(T0_S + time_s))
    with Bag(path) as bag:
        return moment_of(bag)


def phases():
    return [(time_s, "/operator/phase", OperatorState(phase=phase, text=text)) for time_s, phase, text in PHASES]


def test_the_moment_is_the_end_of_the_course(tmp_path):
    assert moment(tmp_path / "x.bag", phases()) == pytest.approx(7.5)


def test_the_moment_of_bearings_is_when_most_is_seen(tmp_path):
    seen = [  # vehicle and number of landmarks
        (1.0, "risc1", 9),  # not on the course yet
        (4.0, "risc1", 2),
        (5.0, "risc1", 2),
        (5.1, "risc2", 1),  # three together
        (6.0, "risc1", 2),
        (7.0, "risc2", 1),  # what risc1 saw has expired
        (8.5, "risc1", 9),  # on its way home
    ]
    angles = [(time_s, "/angles", observed(name, count)) for time_s, name, count in seen]
    assert moment(tmp_path / "x.bag", phases() + angles) == pytest.approx(5.2)
    blind = [(time_s, "/angles", observed(name, 0)) for time_s, name, _ in seen]
    assert moment(tmp_path / "blind.bag", phases() + blind) == pytest.approx(7.5)


def test_bearings_add_views_and_the_tuner_needs_the_fleet(tmp_path):
    moment(tmp_path / "plain.bag", phases())
    with Bag(tmp_path / "plain.bag") as bag:
        assert standard_views(bag, "fleet.yaml") == ["oblique", "top"]
    moment(tmp_path / "coop.bag", [(0.0, "/angles", observed("risc1", 1))])
    with Bag(tmp_path / "coop.bag") as bag:
        assert standard_views(bag, None) == ["oblique", "top", "rays"]
        assert standard_views(bag, "fleet.yaml") == list(VIEWS)


def test_the_moment_of_a_bag_without_operator_is_its_middle(tmp_path):
    assert moment(
        tmp_path / "x.bag", [(0.0, "/angles", Observed_angles()), (6.0, "/angles", Observed_angles())]
    ) == pytest.approx(3.0)


def test_every_standard_view_exists_and_only_the_tuner_has_handles():
    views = views_from(list(VIEWS), (640, 480))
    assert [view.name for view in views] == list(VIEWS)
    assert [view.name for view in views if has_display(view.config, "rviz/InteractiveMarkers")] == ["tuner"]
    for view in views:
        classes = [item["Class"] for item in view.config["Visualization Manager"]["Displays"]]
        assert "rviz/Image" not in classes, "would take room from the scene"


def test_a_file_and_one_of_its_saved_views_make_a_view():
    path = pathlib.Path(__file__).resolve().parents[2] / "risc_visual" / "config" / "Diff_flat.rviz"
    assert [view.name for view in views_from(["%s:Side" % path, str(path)], (640, 480))] == [
        "diff_flat_side",
        "diff_flat",
    ]
    with pytest.raises(ValueError, match=r"Diff_flat.rviz.*Bottom.*Flight"):
        views_from(["%s:Bottom" % path], (640, 480))


def test_options_of_fly_are_left_for_it():
    args, rest = arguments(["circles3", "--trajectory", "flat8", "--views", "top,oblique,top", "--size", "800x600"])
    assert rest == ["--trajectory", "flat8"]
    assert (args.what, args.views, args.size) == ("circles3", ["top", "oblique"], (800, 600))


def test_an_experiment_is_flown_before_its_bag_is_drawn(tmp_path, monkeypatch):
    """With the caller's options; a real flight and a real picture: tests/test_screenshots.py."""
    flown, drawn = [], []

    def fly(flight, folder, *_):
        flown.append(flight)
        moment(folder / "flight.bag", phases())
        return ""

    monkeypatch.setattr(screenshot, "missing_programs", lambda *_: [])
    monkeypatch.setattr(screenshot.fly, "ROOT", tmp_path)
    monkeypatch.setattr(screenshot.fly, "fly", fly)
    monkeypatch.setattr(screenshot, "take_pictures", lambda *given: drawn.append(given) or [])
    assert screenshot.main(["circles3", "--vehicles", "2", "--views", "top"]) == 0
    (flight,), ((bag, views, at_s, out, *_),) = flown, drawn
    assert (flight.experiment, flight.vehicles, flight.duration) == ("circles3", 2, screenshot.FLIGHT_S)
    assert bag.parent.parent == tmp_path / "flights" and out == bag.parent / "screenshots"
    assert [view.name for view in views] == ["top"] and at_s == pytest.approx(7.5)


def test_on_a_slow_computer_the_flight_for_a_picture_begins_again(tmp_path, monkeypatch):
    argv = ["circles3", "--views", "top", "--vehicles", "2"]
    args, rest = screenshot.arguments(argv)
    called = []
    monkeypatch.setattr(screenshot.fly, "prepare_folder", lambda _: tmp_path)
    monkeypatch.setattr(screenshot.fly, "fly", lambda *_: screenshot.fly.TooSlow("too busy"))
    monkeypatch.setattr(screenshot.fly, "fly_slower", lambda *given: called.append(given[:4]) or "too slow")
    with pytest.raises(screenshot.fly.FlightError, match="too slow"):
        screenshot.flown(args, rest, Progress(), argv)
    assert called == [("risc_experiments.screenshot", argv, tmp_path, "too busy")]


def becomes(condition):
    """Wait for the condition, at most PATIENCE_S. Returns whether it holds."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


def test_busy_is_who_runs_not_who_sleeps():
    works = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    sleeps = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    try:
        assert becomes(lambda: not any_busy([sleeps.pid]))
        assert becomes(lambda: any_busy([sleeps.pid, works.pid]))
    finally:
        for process in (works, sleeps):
            process.kill()
            process.wait()
    assert not any_busy([works.pid]), "it is no more"
