"""A flight looked at in a browser: the page, what it shows, its button that lands all; in headless Chromium.

One flight is looked at from its begin to its end; the tests judge what was seen.
"""

import base64
import ctypes
import json
import os
import pathlib
import re
import shutil
import signal
import time
import xmlrpc.client

import cv2
import numpy as np
import pytest
import yaml
from flying import judged

from data_extraction.bags import Bag
from risc_control.safety import FailsafeLevel, Rule
from risc_lab.lab import load_fleet
from risc_lab.ros.launching import Launch, PortReservation, free_tcp_port, marked_processes

ROOT = pathlib.Path(__file__).resolve().parents[1]
CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
VEHICLES = {"risc1": "fluffy_II", "risc2": "albatross"}
RATE_HZ = 100.0  # of motion capture and references: the browser needs the time
DRAWING = ("draw_risc_maap", "draw_cortex", "draw_trajectories", "draw_angles")
FLOWN_ON_S = 2.0  # without those: four times the ladder's limit for a landing
PATIENCE_S = 300.0  # for what takes seconds on an idle computer
WINDOW = (640, 480)  # few pixels: each costs time
ALL_SEEN = re.compile(r"motion capture \d+ Hz, 2 of 2 seen")
LEAST_PIXELS = 30  # of each colour
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--window-size=%d,%d" % WINDOW,
)
TEXT = "(document.body ? document.body.innerText : '')"
OLD = "[...document.querySelectorAll('.page-old')].some(e => getComputedStyle(e).visibility === 'visible')"
NICE = 10  # a picture by software takes all the time there is
PR_CAPBSET_DROP, CAP_SYS_NICE = 24, 23  # of linux/prctl.h and linux/capability.h

pytestmark = [
    pytest.mark.alone,
    pytest.mark.skipif(
        not (CHROMIUM and DRIVER), reason="no Chromium: apt-get install chromium chromium-driver (as root)"
    ),
]


def wait_for(condition, what, is_hopeless=lambda: False):
    """Wait until the condition holds. what: function that returns what there was instead, for the error."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline and not is_hopeless(), "never came; there was:\n%s" % what()
        time.sleep(0.25)


class Flight:
    """Two vehicles in the virtual lab, the virtual operator, the drawing nodes and the browser view."""

    def __init__(self, folder):
        self._reservation = PortReservation()
        fleet = load_fleet(ROOT / "launch/fleets/ardrones3.yaml").with_vehicles(len(VEHICLES))
        settings = fleet.in_subnet(self._reservation.subnet).to_dict()
        settings["mocap"]["rate_hz"] = RATE_HZ
        (folder / "fleet.yaml").write_text(yaml.safe_dump(settings))
        self.bag, self.port, master_port = folder / "flight.bag", free_tcp_port(), free_tcp_port()
        self._statistics = folder / "virtual_lab.json"
        self.master = xmlrpc.client.ServerProxy("http://127.0.0.1:%d" % master_port)
        given = {"fleet": folder / "fleet.yaml", "vehicles": " ".join(VEHICLES), "bag": self.bag, "port": self.port}
        given |= {"statistics": self._statistics, "rate": RATE_HZ}
        self.launch = Launch(ROOT / "tests/live_view.launch", given, folder, master_port)

    def log(self):
        return self.launch.log_path.read_text(errors="replace")

    def log_says_that_it_failed(self):
        return any(words in self.log() for words in ("operator: result failed", "landed by its safety ladder"))

    def summary(self):
        """The part of the summary that tells whether the computer had time; {} if the lab has not ended by itself."""
        if not self._statistics.exists():
            return {}
        return {"lab_late_ms": json.loads(self._statistics.read_text())["late_ms"]}

    def listens_to(self):
        """Topics that the browser view subscribes to."""
        _, _, (_, subscribed, _) = self.master.getSystemState("/test_live_view")
        return {topic for topic, nodes in subscribed if "/live_view" in nodes}

    def kill(self, program):
        """As if it had crashed."""
        (pid,) = [
            pid
            for pid, command in marked_processes(self.launch.identity).items()
            if any(part.endswith("/risc_visual/" + program) for part in command.split())
        ]
        os.kill(pid, signal.SIGKILL)

    def end(self):
        self.launch.stop()
        self._reservation.close()


def yield_to_flights():
    """To be called in the process that becomes a browser: as root it would give its drawing priority over a flight."""
    os.nice(NICE)
    if os.geteuid() == 0:
        ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_SYS_NICE, 0, 0, 0)


class Page:
    """The page in a browser."""

    def __init__(self, folder, port):
        from selenium import webdriver
        from selenium.webdriver.chrome.service import Service

        options = webdriver.ChromeOptions()
        options.binary_location = CHROMIUM
        for flag in FLAGS + ("--user-data-dir=%s" % (folder / "chromium"),):
            options.add_argument(flag)
        service = Service(DRIVER, popen_kw={"preexec_fn": yield_to_flights})
        self.driver = webdriver.Chrome(options=options, service=service)
        self.driver.command_executor.client_config.timeout = 2.0 * PATIENCE_S
        self.driver.set_page_load_timeout(PATIENCE_S)
        self.driver.set_script_timeout(PATIENCE_S)
        self.driver.get("http://127.0.0.1:%d" % port)

    def text(self):
        return self.driver.execute_script("return %s" % TEXT)

    def text_and_age(self):
        """(text, whether the page says that it is old) at one moment: the page of a starved browser is old at times."""
        return self.driver.execute_script("return [%s, %s]" % (TEXT, OLD))

    def press(self, label):
        """Click a button by what is written on it."""
        self.driver.execute_script(
            "[...document.querySelectorAll('button')].find(b => b.innerText.trim() === arguments[0]).click()", label
        )

    def picture(self):
        """What the scene shows, without the panel: (h, w, 3) uint8, BGR."""
        url = self.driver.execute_script(
            "return [...document.querySelectorAll('canvas')].find(c => c.width > 0).toDataURL('image/png')"
        )
        data = np.frombuffer(base64.b64decode(url.partition(",")[2]), np.uint8)
        return cv2.imdecode(data, cv2.IMREAD_COLOR)

    def says_that_it_is_old(self):
        return self.driver.execute_script("return %s" % OLD)

    def resources(self):
        """Everything that the page has loaded."""
        return self.driver.execute_script("return performance.getEntriesByType('resource').map(e => e.name)")


def pixels(picture, low, high):
    """How many pixels lie between two colours (hue 0..179, saturation, value)."""
    return int(cv2.inRange(cv2.cvtColor(picture, cv2.COLOR_BGR2HSV), low, high).astype(bool).sum())


def colours(picture):
    """How much there is in the scene of what must be there [pixels]."""
    return {
        "first vehicle": pixels(picture, (95, 70, 70), (112, 255, 255)),  # light blue
        "second vehicle": pixels(picture, (17, 70, 100), (28, 255, 255)),  # yellow
        "path flown": pixels(picture, (0, 150, 60), (4, 255, 255)),  # red
        "path to be flown": pixels(picture, (56, 150, 60), (64, 255, 255)),  # green
        "net": pixels(picture, (0, 0, 100), (179, 30, 140)),  # grey
    }


def look_at(flight, folder):
    """Go through the whole flight. Returns {what: what was seen}; raises AssertionError if something never came."""
    seen = {}
    wait_for(lambda: "the flight in a browser: http://127.0.0.1:%d" % flight.port in flight.log(), flight.log)
    seen["listens to, unwatched"] = flight.listens_to()
    wait_for(lambda: "operator: phase fly: on course" in flight.log(), flight.log, flight.log_says_that_it_failed)
    page = Page(folder, flight.port)
    try:

        def all_is_well():
            text, is_old = page.text_and_age()
            seen["text in flight"] = text
            each = ("autonomous", "safety: ok", "mm from its reference")
            complete = ALL_SEEN.search(text) and "nothing heard" not in text and "silent" not in text
            new = complete and not is_old
            return new and all(text.count(words) == len(VEHICLES) for words in each)

        wait_for(all_is_well, page.text, flight.log_says_that_it_failed)
        seen["listens to, watched"] = flight.listens_to()

        seen["colours"] = {}

        def everything_is_drawn():
            picture = page.picture()
            cv2.imwrite(str(folder / "scene.png"), picture)
            for what, count in colours(picture).items():  # a vehicle may be behind a label for a moment
                seen["colours"][what] = max(count, seen["colours"].get(what, 0))
            return min(seen["colours"].values()) >= LEAST_PIXELS

        wait_for(everything_is_drawn, lambda: "%s in %s" % (seen["colours"], folder))
        seen["resources"] = page.resources()
        for program in DRAWING:
            flight.kill(program)
        time.sleep(FLOWN_ON_S)
        wait_for(all_is_well, page.text, flight.log_says_that_it_failed)
        page.press("LAND ALL")
        wait_for(lambda: page.text().count("landing (landing was requested)") == len(VEHICLES), page.text)
        wait_for(lambda: "virtual operator: landing all vehicles" in page.text(), page.text)
        wait_for(lambda: "operator: aborted: " in page.text(), page.text)
        wait_for(lambda: page.text().count("landed, battery") == len(VEHICLES), page.text)
        page.press("LAND ALL")
        wait_for(lambda: page.text().count("not airborne (state 2, landed)") == len(VEHICLES), page.text)
        flight.kill("live_view")
        wait_for(page.says_that_it_is_old, page.text)
        seen["goes on without the view"] = flight.launch.running()
    finally:
        page.driver.quit()
    flight.end()
    with Bag(flight.bag) as bag:
        seen["safety"] = {name: [] for name in VEHICLES}
        for topic, _, message in bag.messages(["/%s/safety" % name for name in VEHICLES]):
            seen["safety"][topic.split("/")[1]].append((message.level, message.rule))
        for _, _, message in bag.messages(["/ground_truth"]):
            seen["heights_m"] = {entry.name: entry.z for entry in message.Obj}
        seen["results"] = [message.reason for _, _, message in bag.messages(["/operator/result"])]
    return seen


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """What `look_at` has seen."""
    folder = tmp_path_factory.mktemp("live_view")
    flight = Flight(folder)
    try:
        return look_at(flight, folder)
    except AssertionError as error:
        flight.end()
        judged((1, str(error), flight.summary(), folder))
        raise
    finally:
        flight.end()


def test_while_nobody_looks_it_listens_to_nothing(seen):
    assert seen["listens to, unwatched"] == set()
    assert {"/Quad_Markers", "/net", "/risc2/safety"} <= seen["listens to, watched"]


def test_the_panel_tells_the_flight(seen):
    text = seen["text in flight"]
    for name, template in VEHICLES.items():
        assert "%s %s, autonomous" % (name, template) in text
    assert ALL_SEEN.search(text) and "operator: fly: on course" in text
    assert "nothing heard" not in text


def test_the_scene_has_vehicles_paths_and_net(seen):
    assert min(seen["colours"].values()) >= LEAST_PIXELS, seen["colours"]


def test_the_page_loads_nothing_from_elsewhere(seen):
    own = ("http://127.0.0.1:", "data:", "blob:")
    assert [name for name in seen["resources"] if not name.startswith(own)] == []


def test_land_all_lands_all_by_their_safety(seen):
    for name, template in VEHICLES.items():
        said = seen["safety"][name]
        assert [rule for level, rule in said if level == FailsafeLevel.LAND] == [Rule.REQUEST]
        assert said[-1] == (FailsafeLevel.OK, Rule.NONE), "it has landed"
        assert seen["heights_m"][template] < 0.1, "it stands on the floor"
    (result,) = seen["results"]  # it begins with what reached the operator first: the button, or the vehicles
    assert re.match("landing was requested|no vehicle flies any more", result), result


def test_a_view_that_dies_ends_no_flight(seen):
    """Nor do the drawing nodes, killed in the air: see `look_at`. With rviz: test_drawing_is_optional.py."""
    assert seen["goes on without the view"]
