"""The report as a page: complete for a whole flight, clear about what a poor bag lacks, valid, self-contained."""

import html.parser
import json
import re
import sys

import numpy as np
import pytest
import rosbag
import rospy
import yaml
from cv_bridge import CvBridge
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Path
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Bool, String

from data_extraction.report.__main__ import INSTALL, main, make, write_pdf
from data_extraction.report.gates import GATES
from data_extraction.report.origin import parameter_hash
from risc_control.safety import Rule
from risc_lab.lab.yaml_reader import package_file
from risc_lab.phases import OperatorPhase, OperatorResult, TrajectoryPhase
from risc_maap_msgs.msg import (
    CommandSent,
    CommandsSent,
    Counter,
    EstimatorStatus,
    FaultRecord,
    Faults,
    MocapTime,
    OperatorState,
    Safety,
    TrajectoryPhases,
    VehiclePhase,
    VehicleStatus,
)
from risc_msgs.msg import (
    Angle,
    Angles,
    Controls,
    Cortex,
    Landmark,
    Landmarks,
    Mocap_data,
    Mocap_marker,
    Mocap_markers,
    Observed_angles,
    Observed_rois,
    Risc_roi,
    Risc_rois,
    States,
    Trajectories,
    Trajectory,
)

T0_S = 1000.0
EVERY = 4  # one of this many frames of the 200 Hz: the page says the same, and is made four times as fast
NAN = float("nan")
NAMES = ("fluffy_II", "albatross")
SECTIONS = (
    "flown", "result", "map", "tracking", "latency", "processors", "mocap", "gates", "ladder", "faults", "fence",
    "battery", "cameras", "bearings", "events", "contents",
)  # fmt: skip
HOLD = rospy.Duration(0.105)
VOID = {"meta", "img", "link", "br", "hr", "input"}


class Page(html.parser.HTMLParser):
    """Checks that tags are balanced, and keeps what the tests need."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.open, self.ids, self.links, self.images, self.words, self.rows = [], [], [], [], [], []
        self.feed(text)
        self.close()
        assert self.open == [], "not closed"

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.ids += [values["id"]] if "id" in values else []
        self.links += [values[key] for key in ("href", "src", "data", "action", "poster") if key in values]
        if tag == "img":
            self.images.append(values)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open and self.open.pop() == tag, "%s closes nothing" % tag

    def handle_data(self, data):
        if self.open and self.open[-1] in ("td", "th"):
            self.rows[-1][-1] += data
        if "style" not in self.open:
            self.words.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())


def read(path):
    """The Page of a file; asserts what holds of every report."""
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    assert text.startswith("<!DOCTYPE html>")
    assert len(page.ids) == len(set(page.ids))
    for link in page.links:
        assert link.startswith(("data:image/", "#")), "the page needs nothing but itself"
        assert not link.startswith("#") or link[1:] in page.ids
    assert not re.search(r"@import|url\(", text)
    assert all(image["alt"] for image in page.images)
    return page


def circle(t_s, index):
    return np.cos(0.8 * t_s + 2 * index), np.sin(0.8 * t_s + 2 * index), 1.0 + 0.3 * index


def full_rows(every=1):
    """20 s of two vehicles with everything that a cooperative experiment in the virtual lab records. every: keep
    one of this many frames (a divisor of 20), for tests in which the rate does not matter.
    """
    bridge = CvBridge()
    picture = bridge.cv2_to_compressed_imgmsg(np.full((90, 160, 3), 90, np.uint8), "jpg")
    K = [150.0, 0.0, 80.0, 0.0, 150.0, 45.0, 0.0, 0.0, 1.0]
    info = CameraInfo(
        width=160, height=90, distortion_model="plumb_bob", D=[0.0] * 5, K=K, R=np.eye(3).ravel().tolist(),
        P=[150.0, 0.0, 80.0, 0.0, 0.0, 150.0, 45.0, 0.0, 0.0, 0.0, 1.0, 0.0],
    )  # fmt: skip
    phases = [VehiclePhase(name, TrajectoryPhase.COURSE) for name in NAMES]
    yield 0.0, "/trajectory_phase", TrajectoryPhases(vehicles=phases)
    yield 0.0, "/operator/phase", OperatorState(phase=OperatorPhase.FLY, on_course=True)
    begins, ends = (rospy.Time.from_sec(T0_S + t_s) for t_s in (7.9, 8.2))
    record = FaultRecord(1, "blackout", "0.3", "", begins, ends, True, ["completed"])
    yield 7.9, "/virtual_lab/faults", Faults(faults=[record])
    yield 8.1, "/commands_sent", CommandsSent(commands=[CommandSent(name="fluffy_II", sent=begins + HOLD, level=1)])
    yield 0.0, "/risc1/safety", Safety()
    yield 8.0, "/risc1/safety", Safety(level=Safety.HOLD, rule=Safety.STATE, reason="state 120 ms old <b>")
    yield 8.2, "/risc1/safety", Safety()
    yield 0.5, "/risc1/controller_status", Bool(True)
    for k in range(0, 4000, every):
        t_s = 0.005 * k
        lost = 1600 <= k < 1640
        states = [
            States(name, not lost or index, *circle(t_s - 0.02, index), *([0.0] * 9))
            for index, name in enumerate(NAMES)
        ]
        truth = [States(name, True, *circle(t_s - 0.02, index), *([0.0] * 9)) for index, name in enumerate(NAMES)]
        wanted = [Trajectory(name, *circle(t_s, index), *([0.0] * 9)) for index, name in enumerate(NAMES)]
        x, y, z = circle(t_s, 0)
        marker = Mocap_marker(NAN, NAN, NAN) if lost else Mocap_marker(x, y, z)
        yield t_s, "/trajectory", Trajectories(Obj=wanted)
        yield t_s, "/ground_truth", Cortex(Obj=truth)
        yield t_s, "/mocap_data", Mocap_data(Obj=[Mocap_markers("fluffy_II", 0.0, [marker, Mocap_marker(x, y, z)])])
        yield t_s, "/mocap_time", MocapTime(receipt=rospy.Time.from_sec(T0_S + t_s + 0.003), frame=k // every)
        yield t_s, "/cortex_raw", Cortex(Obj=states)
        yield t_s, "/controls", Controls()
        if k % 7 == 0:
            yield t_s, "/risc1/cmd_vel_stamped", TwistStamped()
        if k % 20 == 0:
            yield t_s, "/risc1/vehicle_status", VehicleStatus(battery_pct=90.0 - t_s, state=3)
            yield t_s, "/states3", Landmarks(Obj=[Landmark("Green_pink", 2.3, 0.3, 1.0)])
            found = Risc_roi("green", True, 80, 45, 40.0, 30.0, 10.0)
            yield t_s, "/risc1/ardrone/camera_info", info
            yield t_s, "/risc1/ardrone/image_rect_color/compressed", picture
            yield t_s, "/land_rois", Observed_rois(Obj=[Risc_rois("risc1", [found], [])])
            yield t_s, "/angles", Observed_angles(Obj=[Angles("risc1", [Angle("green", True, 5.0, 2.0)], [])])
        if k % 200 == 0:
            yield t_s, "/estimator_status", EstimatorStatus(frames=k // every, counters=[Counter("misfits", 3)])
    yield 20.0, "/operator/result", OperatorState(phase=OperatorPhase.DONE, result=OperatorResult.OK)


def write_bag(path, rows, unstamped=()):
    """unstamped: topics whose messages bear no stamp."""
    with rosbag.Bag(str(path), "w") as bag:
        for t_s, topic, message in rows:
            if getattr(message, "_has_header", False) and topic not in unstamped:
                message.header.stamp = rospy.Time.from_sec(T0_S + t_s)
            bag.write(topic, message, rospy.Time.from_sec(T0_S + t_s + 0.004))


FLEET = {
    "name": "two",
    "mocap": {"host": "127.0.0.1"},
    "vehicles": [
        {"namespace": "risc%d" % k, "template": name, "type": "ardrone", "address": "127.0.0.%d" % k,
         "start": {"position_m": [0.9, 0.0, 0.0], "yaw_deg": 90}}
        for k, name in enumerate(NAMES, start=1)
    ],
}  # fmt: skip
SUMMARY = {
    "experiment": "coop",
    "simulated": {"plant": "perturbed", "marker_noise_m": 0.002, "command_delay_s": 0.1},
    "passed": False,
    "reasons": ["Raven: was still 0.90 m up at the end"],
}
PARAMETERS = {"controller": {"q_yaw": 4.0}}
PROCESSORS = {
    "cpu_cores": {"controller": 0.25, "virtual_lab": 0.125},
    "memory_mb": {"controller": 81.5, "virtual_lab": 95.0},
    "computer": {"cores": 2, "idle": 0.5, "steal": 0.01, "others": 0.4, "busiest_other": "browser",
                 "busiest_other_cores": 0.3},
}  # fmt: skip


@pytest.fixture(scope="module")
def full(tmp_path_factory):
    """Folder of a whole flight."""
    folder = tmp_path_factory.mktemp("full")
    write_bag(folder / "flight.bag", full_rows(EVERY))
    (folder / "fleet.yaml").write_text(yaml.safe_dump(FLEET))
    (folder / "summary.json").write_text(json.dumps(SUMMARY))
    (folder / "parameters.yaml").write_text(yaml.safe_dump(PARAMETERS))
    (folder / "processors.json").write_text(json.dumps(PROCESSORS))
    (folder / "flight.yaml").write_text(
        yaml.safe_dump({"seed": 7, "revision": "abc123", "versions": {"Python": "3.11"}, "arguments": {"delay": 0.1}})
    )
    assert make(folder / "flight.bag") == [folder / "report.html"]
    return folder


@pytest.fixture(scope="module")
def page(full):
    return read(full / "report.html")


def test_a_whole_flight_has_every_section(page):
    assert tuple(page.ids) == SECTIONS


def test_it_says_what_was_flown_and_how_it_ended(page):
    assert "FAILED" in page.text and "Raven: was still 0.90 m up at the end" in page.text
    assert "simulated" in page.text and "marker noise 0.002 m" in page.text
    assert parameter_hash(PARAMETERS) in page.text
    for word in ("abc123", "Python 3.11", "seed 7", "delay 0.1", "1970-01-01"):
        assert word in page.text, word
    assert ["risc1", "fluffy_II", "ardrone", "none", "(0.90, 0.00, 0.00) m, 90°"] in page.rows


def test_what_the_programs_took_of_the_computer(page):
    assert ["controller", "0.250", "82\u202fMB"] in page.rows
    for text in ("0.38 cores", "176 MB", "0.40 cores, most by browser (0.30)", "1.0 %"):
        assert text in page.text, text


def test_its_figures_are_those_of_the_bag(page):
    rows = {row[0]: row for row in page.rows if row}
    assert rows["datagram to /cortex_raw"][1:] == ["1.00\u202fms"] * 4 + ["1000"]
    assert next(row for row in page.rows if row[:1] == ["fluffy_II"] and "ms" in row[-1])[-1] == "20.0\u202fms", (
        "the lag"
    )
    assert ["fluffy_II", "1000", "10", "0.50\u202f%", "0"] in page.rows, "markers"
    assert ["fluffy_II", "10", "1.00\u202f%", "1", "200\u202fms"] in page.rows, "states"
    assert ["3", "0.32\u202f%"] in [row[1:] for row in page.rows], "bodies refused"
    assert ["8.00\u202fs", "risc1", "hold", "state 120 ms old <b>", "0.20\u202fs"] in page.rows
    assert rows["fluffy_II: Green_pink"][1] != "0"


def test_the_page_has_words_for_every_decision_and_rule():
    text = package_file("data_extraction", "templates/sections.html").read_text(encoding="utf-8")
    words = [*(name for names in GATES.values() for name in names), *(rule.name for rule in Rule)]
    assert [word for word in words if '"%s": ' % word not in text] == []


def test_pictures_are_in_the_page_and_small(full, page):
    kinds = [image["src"].partition(";")[0] for image in page.images]
    assert kinds.count("data:image/jpeg") == 3
    assert kinds.count("data:image/svg+xml") == 10
    assert "green" in next(image["alt"] for image in page.images if "jpeg" in image["src"])
    assert (full / "report.html").stat().st_size < 3e6


def test_a_poor_bag_says_what_is_missing(tmp_path):
    rows = (row for row in full_rows(EVERY) if row[1] in ("/cortex_raw", "/risc1/vehicle_status"))
    write_bag(tmp_path / "lab.bag", rows)
    make(tmp_path / "lab.bag")
    page = read(tmp_path / "lab_report" / "report.html")
    assert tuple(page.ids) == ("flown", "map", "mocap", "fence", "battery", "contents", "missing")
    assert "not judged" in page.text and "simulated" not in page.text
    assert "parameters (SHA-256) unknown" in page.text
    for lacked in ("no /trajectory", "/mocap_time", "/estimator_status", "safety topic", "image_raw", "/angles"):
        assert lacked in page.text, lacked


def test_a_bag_of_the_original_release_is_matched_by_place(tmp_path):
    """References carry the name of their course and no stamp, lost markers 9999.999 m, and there are no phases."""
    rows = []
    for t_s, topic, message in full_rows(EVERY):
        if topic == "/trajectory":
            for reference in message.Obj:
                reference.name = "Circle"
            message.Obj = message.Obj[:1]
        if topic == "/mocap_data":
            for marker in message.Obj[0].marker:
                if np.isnan(marker.x):
                    marker.x = marker.y = marker.z = 9999.999
        if topic in ("/trajectory", "/cortex_raw", "/mocap_data"):
            rows.append((t_s, topic, message))
    write_bag(tmp_path / "legacy.bag", rows, unstamped=("/trajectory",))
    make(tmp_path / "legacy.bag", folder=tmp_path / "out")
    page = read(tmp_path / "out" / "report.html")
    assert "tracking" in page.ids and "(Circle)" in page.text
    assert next(row for row in page.rows if row[:1] == ["fluffy_II"])[-1] == "20.0\u202fms", "lag: both on one clock"
    assert "no stamps" in page.text
    assert "no /trajectory_phase" in page.text
    assert ["fluffy_II", "1000", "10", "0.50\u202f%", "0"] in page.rows


def test_topics_of_other_types_are_named_and_left_out(tmp_path):
    rows = [row for row in full_rows(EVERY) if row[1] in ("/cortex_raw", "/risc1/safety")]
    rows += [(1.0, "/trajectory", Path()), (1.1, "/robot/safety", Bool(True)), (1.2, "/joy", String("x"))]
    write_bag(tmp_path / "other.bag", sorted(rows, key=lambda row: row[0]))
    make(tmp_path / "other.bag", folder=tmp_path)
    page = read(tmp_path / "report.html")
    assert {"map", "ladder", "fence"} <= set(page.ids) and "tracking" not in page.ids
    assert re.search("/trajectory was not read[^.]* nav_msgs/Path[^.]* Trajectories[.]", page.text)
    assert re.search("/robot/safety was not read[^.]* std_msgs/Bool[^.]* Safety[.]", page.text)
    assert "/joy was not read" in page.text and page.text.count("was not read") == 3


def test_a_bag_from_when_phases_were_text_is_read_without_them(tmp_path):
    texts = {
        "/trajectory_phase": "fluffy_II: course; albatross: course", "/risc1/safety": "ok", "/operator/phase": "fly",
        "/operator/result": "ok",
    }  # fmt: skip
    rows = [row for row in full_rows(5) if row[1] in (*texts, "/cortex_raw", "/trajectory")]
    rows = [(t_s, topic, String(texts[topic]) if topic in texts else message) for t_s, topic, message in rows]
    write_bag(tmp_path / "older.bag", rows)
    make(tmp_path / "older.bag", folder=tmp_path)
    page = read(tmp_path / "report.html")
    assert "no /trajectory_phase" in page.text and "ladder" not in page.ids
    for topic in texts:
        assert topic + " was not read" in page.text


@pytest.mark.parametrize(
    ("topic", "begin_s"),
    [
        ("/cortex_raw", 10.0),
        pytest.param("/ground_truth", 0.0, marks=pytest.mark.release),
        pytest.param("/trajectory", 10.0, marks=pytest.mark.release),
        pytest.param("/ground_truth", 10.0, marks=pytest.mark.release),
        pytest.param("/cortex_raw", 0.0, marks=pytest.mark.release),
        pytest.param("/trajectory", 0.0, marks=pytest.mark.release),
    ],
)
def test_numbers_that_are_none_stop_no_report(tmp_path, topic, begin_s):
    """From begin_s on, x of a vehicle is NaN although it is marked visible."""
    rows = list(full_rows(5))
    for t_s, name, message in rows:
        for item in message.Obj if name == topic and t_s >= begin_s else ():
            item.x = item.x if item.name == NAMES[0] else NAN
    write_bag(tmp_path / "flight.bag", rows)
    (tmp_path / "fleet.yaml").write_text(yaml.safe_dump(FLEET))
    make(tmp_path / "flight.bag")
    page = read(tmp_path / "report.html")
    assert {"result", "map", "tracking", "fence", "bearings"} <= set(page.ids)
    assert "nan" not in page.text.lower().split()


def test_the_fence_of_a_vehicle_of_unknown_type_has_no_limit(tmp_path):
    rows = [row for row in full_rows(20) if row[1] == "/cortex_raw"]
    for _, _, message in rows:
        message.Obj[0].name = "Ghost"
    write_bag(tmp_path / "ghost.bag", rows)
    make(tmp_path / "ghost.bag", folder=tmp_path)
    of_fence = {row[0]: row[-2:] for row in read(tmp_path / "report.html").rows if len(row) == 6}
    assert of_fence["Ghost"] == ["type unknown"] * 2
    assert all(cell.endswith(" m") for cell in of_fence["albatross"])


def test_what_was_not_judged_is_not_said_to_be(tmp_path):
    """The only vehicle with a reference was never visible while it had one."""
    rows = [row for row in full_rows(5) if row[1] == "/cortex_raw" and row[0] < 5.0]
    rows += [row for row in full_rows(5) if row[1] == "/trajectory" and row[0] > 6.0]
    write_bag(tmp_path / "apart.bag", rows)
    make(tmp_path / "apart.bag", folder=tmp_path)
    page = read(tmp_path / "report.html")
    assert "too short" in page.text and "was judged" not in page.text


def test_a_lost_end_and_the_counters_beginning_are_said(tmp_path):
    """The last 5 s have no frame; nothing else changes, and no vehicle leaves the lowest failsafe level."""
    silent = ("/mocap_data", "/cortex_raw", "/ground_truth", "/trajectory")
    rows = [row for row in full_rows(5) if row[1] in (*silent, "/estimator_status", "/risc1/vehicle_status")]
    rows = [row for row in rows if row[0] < 15.0 or row[1] not in silent] + [(1.0, "/risc1/safety", Safety())]
    write_bag(tmp_path / "end.bag", sorted(rows, key=lambda row: row[0]))
    (tmp_path / "flight.yaml").write_text("arguments:\nversions:\n")
    make(tmp_path / "end.bag", folder=tmp_path)
    page = read(tmp_path / "report.html")
    assert "1 gaps" in page.text and "4.9 s before the end" in page.text
    assert {"gates", "ladder", "fence"} <= set(page.ids)
    assert not [row for row in page.rows if {"hold", "land"} & set(row)], "no vehicle left the lowest failsafe level"


def test_of_many_events_the_page_shows_the_end(tmp_path):
    rows = [(0.1 * k, "/operator/phase", OperatorState(text="%d" % k)) for k in range(100)]
    rows += [(10.0, "/operator/result", OperatorState(result=OperatorResult.OK))]
    write_bag(tmp_path / "many.bag", rows)
    make(tmp_path / "many.bag", folder=tmp_path)
    page = read(tmp_path / "report.html")
    texts = [row[2] for row in page.rows if row[1:2] == ["operator"]]
    assert len(texts) == 60 and texts[0] == "waiting: 0" and texts[-1] == "result: ok"
    assert "41 further" in page.text


@pytest.fixture
def short(tmp_path):
    """Bag of the first second of a vehicle, nothing but its states."""
    write_bag(tmp_path / "flight.bag", [row for row in full_rows(20) if row[1] == "/cortex_raw" and row[0] < 1.0])
    return tmp_path / "flight.bag"


def test_command_line(short, tmp_path, capsys):
    assert main([str(short), "--out", str(tmp_path / "new" / "folder")]) == 0
    captured = capsys.readouterr()
    assert captured.out.strip().endswith("report.html") and "reading" in captured.err and "%" in captured.err
    read(tmp_path / "new" / "folder" / "report.html")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["none.bag"], "none.bag"),
        (["{full}/fleet.yaml"], "rosbag reindex"),
        (["{full}/flight.bag", "--fleet", "nowhere.yaml"], "nowhere.yaml"),
        (["{full}/flight.bag", "--out", "{full}/fleet.yaml"], "fleet.yaml"),
        (["{tmp}/talk.bag"], "/chatter"),
    ],
)
def test_wrong_use_is_one_clear_line(full, tmp_path, capsys, arguments, message):
    write_bag(tmp_path / "talk.bag", [(0.0, "/chatter", String("hello"))])
    assert main([item.format(full=full, tmp=tmp_path) for item in arguments]) == 1
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert last.startswith("maap report: ") and message in last


def test_a_pdf_without_its_program_is_one_clear_line(short, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "weasyprint", None)  # Python then raises ImportError, as for a missing module
    assert main([str(short), "--pdf"]) == 1
    assert INSTALL in capsys.readouterr().err
    assert (tmp_path / "report.html").exists()


def test_a_pdf_is_the_page_on_paper(short, tmp_path, capsys):
    pytest.importorskip("weasyprint", reason=INSTALL, exc_type=ImportError)
    assert main([str(short), "--pdf"]) == 0
    assert "report.pdf" in capsys.readouterr().out
    data = (tmp_path / "report.pdf").read_bytes()
    assert data.startswith(b"%PDF") and len(data) > 20000


@pytest.mark.release
def test_a_whole_flight_is_printed(full, tmp_path):
    pytest.importorskip("weasyprint", reason=INSTALL, exc_type=ImportError)
    path = write_pdf(full / "report.html", tmp_path / "report.pdf")
    data = path.read_bytes()
    assert data.startswith(b"%PDF") and len(data) > 50000
