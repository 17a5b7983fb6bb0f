"""The recorder: everything that was sent is in the bag, in order, byte for byte, and no way to end it loses a bag."""

import contextlib
import functools
import io
import json
import os
import pathlib
import re
import resource
import signal
import socket
import subprocess
import sys
import time

import pytest
import rosbag
from talker import message_of, payload

from data_extraction.bags import Bag
from risc_lab.ros.launching import free_tcp_port

HERE = pathlib.Path(__file__).resolve().parent
RECORDER = str(HERE.parents[2] / "devel/lib/data_extraction/recorder")
WITH_SIGNALS = ("env", "--default-signal=INT,HUP")  # tests in the background may ignore them
STRING = "std_msgs/String"
BYTES = "std_msgs/UInt8MultiArray"
PATIENCE_S = 60.0  # far more than anything here takes
ROOM = 3 << 20  # [bytes] of the small disks


def wait_until(condition, what):
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s, "not within %g s: %s" % (PATIENCE_S, what)
        time.sleep(0.05)


class Lab:
    """A master of our own, talkers and recorders; all of them end with the test."""

    def __init__(self, folder, programs):
        self.folder = folder
        self._programs = programs
        port = free_tcp_port()
        self.environment = dict(
            os.environ, ROS_MASTER_URI="http://127.0.0.1:%d" % port, ROS_IP="127.0.0.1", ROS_HOME=str(folder)
        )
        self.environment.pop("ROS_HOSTNAME", None)
        self.master = self._start(["rosmaster", "--core", "-p", str(port)], stdout=subprocess.DEVNULL)
        wait_until(lambda: socket.socket().connect_ex(("127.0.0.1", port)) == 0, "a master")

    def _start(self, command, **options):
        options.setdefault("env", self.environment)
        process = self._programs.enter_context(subprocess.Popen(command, **options))
        self._programs.callback(process.kill)
        return process

    def run(self, *command):
        """Run a program to its end. Returns its standard output."""
        done = subprocess.run(command, env=self.environment, capture_output=True, text=True, timeout=PATIENCE_S)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def talker(self):
        """A function that publishes (talker.py); with wait=False it does not wait until that is done."""
        process = self._start(
            [sys.executable, str(HERE / "talker.py")], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

        def publish(topics, count, wait=True, **options):
            print(json.dumps(dict(options, topics=topics, count=count)), file=process.stdin, flush=True)
            if wait:
                assert process.stdout.readline() == "published\n"

        publish.process = process
        return publish

    def recorder(self, *arguments, disk=None, **options):
        """Start a recorder. disk: environment variables of bad_disk.c."""
        environment = dict(self.environment)
        if disk:
            library = self.folder / "bad_disk.so"
            self.run("cc", "-O2", "-shared", "-fPIC", "-o", str(library), str(HERE / "bad_disk.c"), "-ldl")
            environment.update(disk, LD_PRELOAD=str(library))
        name = "recorder%d" % time.monotonic_ns()
        command = [*WITH_SIGNALS, RECORDER, *arguments, "__name:=" + name]
        return self._start(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment, **options
        )


@pytest.fixture
def lab(tmp_path):
    with contextlib.ExitStack() as programs:
        yield Lab(tmp_path, programs)


def finish(recorder, number=signal.SIGINT):
    """End a recorder. Returns (exit code, its output)."""
    if number:
        recorder.send_signal(number)
    output, _ = recorder.communicate(timeout=PATIENCE_S)
    return recorder.returncode, output


def written(path):
    """Bytes of the bag that is being written."""
    active = pathlib.Path(str(path) + ".active")
    return active.read_bytes() if active.exists() else b""


def in_writing(path, *wanted):
    """Whether the bag that is being written holds these."""
    content = written(path)
    return all(text.encode() in content for text in wanted)


def counts(path):
    """{sum of messages recorded and not recorded} by all recorders' diagnostics in the bag that is being written."""
    values = list(map(int, re.findall(rb"messages (?:not )?recorded.{4}(\d+)", written(path), re.DOTALL)))
    return set(map(sum, zip(values[::2], values[1::2])))


def wait_for(path, *wanted):
    wait_until(lambda: in_writing(path, *wanted), "%s in %s" % (wanted, path))


def raw_messages(path):
    """[(topic, type, bytes, time [s])] as rosbag reads them."""
    with rosbag.Bag(str(path)) as bag:
        return [(topic, message[0], message[1], time.to_sec()) for topic, message, time in bag.read_messages(raw=True)]


def texts(path, topic):
    """Texts of the std_msgs/String of a topic as data_extraction reads them, which must be what rosbag reads."""
    with Bag(path) as bag:
        found = [message.data for _, _, message in bag.messages([topic])] if topic in bag.topics else []
    with rosbag.Bag(str(path)) as bag:
        assert found == [message.data for _, message, _ in bag.read_messages(topics=[topic])]
    return found


def sent(tag, topic, count, size=0):
    return [payload(tag, topic, number, size) for number in range(count)]


def serialized(kind, text):
    buffer = io.BytesIO()
    message_of(kind, text).serialize(buffer)
    return buffer.getvalue()


def test_every_message_is_recorded_byte_for_byte_in_order(lab, inputs):
    """Ten topics at 200 Hz, from some bytes to more than a chunk; played and recorded again they are equal."""
    count = inputs(300, 1000)
    path = lab.folder / "flight.bag"
    recorder = lab.recorder("-O", str(path), "/small.*|/large", "/bytes[0-9]")
    topics = {"/small%d" % k: STRING for k in range(6)} | {"/bytes%d" % k: BYTES for k in range(3)}
    large = lab.talker()
    large({"/large": STRING}, 5, wait=False, hz=5, size=1 << 20)
    talk = lab.talker()
    talk(topics, count, size=300)
    wait_for(path, *(payload("", topic, count - 1) for topic in topics), payload("", "/large", 4))
    code, output = finish(recorder)
    assert code == 0, output
    assert "%d messages" % (9 * count + 5) in output
    recorded = raw_messages(path)
    assert {topic for topic, *_ in recorded} == {*topics, "/large"}
    for topic, kind in topics.items():
        assert [(k, b) for t, k, b, _ in recorded if t == topic] == [
            (kind, serialized(kind, text)) for text in sent("", topic, count, 300)
        ]
    assert texts(path, "/large") == sent("", "/large", 5, 1 << 20)
    times = [t for *_, t in recorded]
    assert times == sorted(times) and abs(times[-1] - time.time()) < PATIENCE_S

    again = lab.folder / "again.bag"
    large.process.kill()
    talk.process.kill()
    recorder = lab.recorder("-O", str(again), "/small.*|/large", "/bytes[0-9]")
    lab.run("rosbag", "play", "--quiet", "--wait-for-subscribers", "--queue", str(count), str(path))
    wait_for(again, *(payload("", topic, count - 1) for topic in topics), payload("", "/large", 4))
    assert finish(recorder)[0] == 0
    assert sorted(r[:3] for r in raw_messages(again)) == sorted(r[:3] for r in recorded)


@contextlib.contextmanager
def small_disk(kind, folder):
    """Context manager: (folder with room for ROOM bytes, options of the recorder's process)."""
    if kind == "file as large as it may be":
        limit = functools.partial(resource.setrlimit, resource.RLIMIT_FSIZE, (ROOM, ROOM))
        yield folder, {"preexec_fn": limit}
        return
    disk = folder / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=%d" % ROOM, "tmpfs", str(disk)]
    done = subprocess.run(mount, capture_output=True, text=True)
    if done.returncode != 0:
        pytest.skip("no small disk without the right to mount one: " + done.stderr.strip())
    try:
        yield disk, {}
    finally:
        subprocess.run(["umount", "--lazy", str(disk)], check=True)


@pytest.mark.parametrize("kind", ["full disk", "file as large as it may be"])
def test_what_fitted_is_a_complete_bag(lab, kind):
    with small_disk(kind, lab.folder) as (folder, options):
        path = folder / "flight.bag"
        recorder = lab.recorder("-O", str(path), "/a|/b", **options)
        lab.talker()({"/a": STRING, "/b": STRING}, 500, wait=False, size=5000)
        code, output = finish(recorder, number=None)
        assert code == 1
        found = {topic: texts(path, topic) for topic in ("/a", "/b")}
        for topic, have in found.items():
            assert have == sent("", topic, 500, 5000)[: len(have)]
        count = sum(map(len, found.values()))
        assert count * 5000 > ROOM // 2
        assert str(path) in output and "%d messages" % count in output and output.count("ERROR") == 1
        assert not pathlib.Path(str(path) + ".active").exists()


def test_a_broken_disk_leaves_what_can_be_indexed(lab):
    path = lab.folder / "flight.bag"
    recorder = lab.recorder("-O", str(path), "/a", disk={"BAD_DISK_WRITES": "4"})  # one for the header, one a chunk
    lab.talker()({"/a": STRING}, 500, wait=False, size=10000)
    code, output = finish(recorder, number=None)
    assert code == 1
    active = str(path) + ".active"
    assert active in output and output.count("ERROR") == 1
    assert not path.exists()
    lab.run("rosbag", "reindex", "--quiet", active)
    pathlib.Path(active).rename(path)
    have = texts(path, "/a")
    assert have == sent("", "/a", 500, 10000)[: len(have)] and "%d messages" % len(have) in output and len(have) > 100


def test_the_folder_of_a_bag_is_made(lab):
    path = lab.folder / "flights" / "of today" / "flight.bag"
    recorder = lab.recorder("-O", str(path), "/a")
    wait_until(pathlib.Path(str(path) + ".active").exists, "the bag")
    code, output = finish(recorder)
    assert code == 0 and path.exists(), output


def test_a_folder_that_cannot_be_written_ends_it_at_once(lab):
    for name in ("/proc/no/such/folder/flight", "/proc/flight"):
        code, output = finish(lab.recorder("-O", name, "/a"), number=None)
        assert code == 1 and name in output


def test_every_way_to_end_it_completes_the_bag(lab):
    """One after the other; the last one without a master."""
    talk = lab.talker()
    for way, number in enumerate((signal.SIGTERM, signal.SIGHUP, signal.SIGINT, signal.SIGINT)):
        path, topic = lab.folder / ("flight%d.bag" % way), "/a%d" % way
        recorder = lab.recorder("-O", str(path), topic)
        talk({topic: STRING}, 20)
        wait_for(path, payload("", topic, 19))
        if way == 3:
            lab.master.kill()
            lab.master.wait()
        code, output = finish(recorder, number)
        assert code == 0, (way, output)
        assert texts(path, topic) == sent("", topic, 20) and "20 messages" in output, way


def test_a_killed_recorder_loses_a_second_and_the_next_one_nothing(lab):
    path = lab.folder / "flight.bag"
    active = pathlib.Path(str(path) + ".active")
    recorder = lab.recorder("-O", str(path), "/a")
    lab.talker()({"/a": STRING}, 20)
    wait_for(path, payload("", "/a", 19))
    recorder.kill()
    recorder.wait()
    recorder = lab.recorder("-O", str(path), "/a")
    wait_until(lambda: len(list(lab.folder.glob("*.active"))) == 2, "a bag of its own")
    lab.talker()({"/a": STRING}, 30, tag="second")
    wait_for(path, payload("second", "/a", 29))
    assert finish(recorder)[0] == 0
    assert texts(path, "/a") == sent("second", "/a", 30)
    (earlier,) = lab.folder.glob("flight_*.bag.active")
    assert not active.exists()
    lab.run("rosbag", "reindex", "--quiet", str(earlier))
    whole = earlier.rename(lab.folder / "earlier.bag")
    assert texts(whole, "/a") == sent("", "/a", 20)


def test_no_earlier_recording_is_lost(lab):
    """-O appends .bag as rosbag does; a bag that was there keeps its bytes under another name."""
    path = lab.folder / "flight.bag"
    path.write_text("first")
    talk = lab.talker()
    for tag, topic in (("second", "/a"), ("third", "/b")):
        recorder = lab.recorder("-O", str(lab.folder / "flight"), "/a|/b")
        talk({topic: STRING}, 3, tag=tag)
        wait_for(path, payload(tag, topic, 2))
        assert finish(recorder)[0] == 0
    assert texts(path, "/b") == sent("third", "/b", 3)
    earlier = sorted(lab.folder.glob("flight_*.bag"))
    assert len(earlier) == 2
    contents = [file.read_bytes() for file in earlier]
    assert b"first" in contents and sum(payload("second", "/a", 2).encode() in content for content in contents) == 1


def test_two_recorders_do_not_write_one_bag(lab):
    path = lab.folder / "flight.bag"
    recorder = lab.recorder("-O", str(path), "/a")
    lab.talker()({"/a": STRING}, 20)
    wait_for(path, payload("", "/a", 19))
    code, output = finish(lab.recorder("-O", str(path), "/a"), number=None)
    assert code == 1 and str(path) in output
    assert finish(recorder)[0] == 0
    assert texts(path, "/a") == sent("", "/a", 20)


def test_a_prefix_is_followed_by_the_time(lab):
    recorder = lab.recorder("-o", str(lab.folder / "flight"), "/a")
    lab.talker()({"/a": STRING}, 1)
    (active,) = lab.folder.glob("flight_20*.bag.active")
    wait_for(active.with_suffix(""), payload("", "/a", 0))
    assert finish(recorder)[0] == 0
    (path,) = lab.folder.glob("flight_20*.bag")
    assert texts(path, "/a") == sent("", "/a", 1)


def test_what_it_does_not_understand_it_does_not_record(lab):
    for arguments in ("-O x", "/a", "-O x (", "-O x -l /a /a", "-O x -l /a=0 /a", "-O x -z /a", "/a -O"):
        code, output = finish(lab.recorder(*arguments.split(), cwd=str(lab.folder)), number=None)
        assert code == 1 and "FATAL" in output, arguments
        assert not list(lab.folder.glob("x*")), arguments


def test_a_clock_that_is_set_back_stops_nothing(lab):
    """Rates are limited in ROS time, which a simulation or a person may set back, to 0 even."""
    lab.run("rosparam", "set", "/use_sim_time", "true")
    path = lab.folder / "flight.bag"
    recorder = lab.recorder("-O", str(path), "-l", "/limited=1", "/limited|/free")
    talk = lab.talker()
    stop = time.monotonic() + PATIENCE_S
    for tag, clock_s in (("first", 100.0), ("back", 50.0), ("zero", 0.0), ("on", 200.0)):
        while not in_writing(path, "%s /limited" % tag):
            talk({"/limited": STRING, "/free": STRING}, 5, hz=50, tag=tag, clock=clock_s)
            assert time.monotonic() < stop, "nothing is recorded with the clock at %g s" % clock_s
    assert finish(recorder)[0] == 0
    recorded = raw_messages(path)
    limited = [(text, t) for topic, _, text, t in recorded if topic == "/limited"]
    assert 4 <= len(limited) < len(recorded) / 4
    assert {round(t) for _, t in limited} == {0, 50, 100, 200}


def test_what_waits_for_a_slow_disk_is_bounded_and_what_is_left_out_is_counted(lab):
    """Small messages, whose overhead is larger than their text."""
    count = 40000
    path, told, stuck = lab.folder / "flight.bag", lab.folder / "told.bag", lab.folder / "stuck"
    recorder = lab.recorder("-b", "1", "-O", str(path), "/a", disk={"BAD_DISK_WHILE": str(stuck)})
    listener = lab.recorder("-O", str(told), "/diagnostics")
    wait_for(told, str(path))  # all was well
    stuck.touch()
    lab.talker()({"/a": STRING}, count, hz=1e6)
    wait_until(lambda: count in counts(told), "all messages to be counted")
    stuck.unlink()
    code, output = finish(recorder)
    assert code == 1 and finish(listener)[0] == 0
    have = texts(path, "/a")
    assert have[:1000] == sent("", "/a", 1000)
    assert " %d were not" % (count - len(have)) in output and 1000 < len(have) < count
    with Bag(told) as bag:
        statuses = [status for *_, message in bag.messages() for status in message.status if str(path) in str(status)]
    dropped = {entry.key: entry.value for entry in statuses[-1].values}["messages not recorded"]
    assert statuses[0].level == 0 and statuses[-1].level == 1
    assert int(dropped) == count - len(have)


def test_connections_keep_who_sent_what(lab):
    """Two publishers on one topic, one latched; rosbag play latches what was latched."""
    path = lab.folder / "flight.bag"
    first, second = lab.talker(), lab.talker()
    topics = {"/a": STRING, "/latched": STRING}
    first(topics, 1, tag="before", latch=True)
    recorder = lab.recorder("-O", str(path), "/a|/latched")
    second({"/a": STRING}, 10, tag="second")
    first({"/a": STRING}, 10, tag="first")
    wait_for(path, payload("first", "/a", 9), payload("second", "/a", 9), payload("before", "/latched", 0))
    assert finish(recorder)[0] == 0
    found = texts(path, "/a")
    for tag, count in (("before", 1), ("second", 10), ("first", 10)):
        assert [text for text in found if text.startswith(tag)] == sent(tag, "/a", count)
    with rosbag.Bag(str(path)) as bag:
        connections = [(c.topic, c.header["callerid"], c.header["latching"]) for c in bag._get_connections()]
    who = {topic: {tuple(rest) for name, *rest in connections if name == topic} for topic in topics}
    assert len(connections) == 3 and len(who["/a"]) == 2
    assert who["/latched"] < who["/a"] and {latching for _, latching in who["/a"]} == {b"0", b"1"}


def test_a_topic_may_change_its_type(lab):
    path = lab.folder / "flight.bag"
    recorder = lab.recorder("-O", str(path), "/a")
    talk = lab.talker()
    talk({"/a": STRING}, 10)
    wait_for(path, payload("", "/a", 9))
    talk.process.stdin.close()
    talk.process.wait()
    lab.talker()({"/a": BYTES}, 10, tag="bytes")
    wait_for(path, payload("bytes", "/a", 9))
    assert finish(recorder)[0] == 0
    assert [(kind, text) for _, kind, text, _ in raw_messages(path)] == [
        (STRING, serialized(STRING, text)) for text in sent("", "/a", 10)
    ] + [(BYTES, serialized(BYTES, text)) for text in sent("bytes", "/a", 10)]
    with Bag(path) as bag:
        assert bag.topics == {"/a": 20} and len(list(bag.messages())) == 20


def test_what_it_says_itself_is_recorded_too(lab):
    """Its own messages do not go over a socket."""
    path = lab.folder / "flight.bag"
    recorder = lab.recorder("-O", str(path), "/diagnostics")
    wait_for(path, "messages not recorded")
    assert finish(recorder)[0] == 0
    with Bag(path) as bag:
        assert [message.status[0].level for _, _, message in bag.messages(["/diagnostics"])]
