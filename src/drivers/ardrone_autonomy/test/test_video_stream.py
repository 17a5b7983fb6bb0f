import collections
import gc
import os
import socket
import threading
import time

import pytest
from scripted_drone import free_address
from scripted_video import PICTURES_PER_IDR, RATE_HZ, ScriptedVideo, bar_number, encoded, seen_channel

from ardrone_autonomy import video_stream
from ardrone_autonomy.protocol import VIDEO_PORT
from ardrone_autonomy.protocol.video import Codec, FrameType, parse_header
from ardrone_autonomy.video_clock import LEAST_STEP_S
from ardrone_autonomy.video_stream import VideoStream
from risc_lab.testing import wait_for
from risc_simulator.video.stream_writer import StreamWriter

LIMIT_S = 20.0


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(video_stream, "RETRY_S", 0.1)
    monkeypatch.setattr(video_stream, "CONNECT_TIMEOUT_S", 0.5)


@pytest.fixture
def patient(monkeypatch):
    """Show every picture, even if a busy computer reads many at once."""
    monkeypatch.setattr(video_stream, "MAX_BACKLOG", 1000)


@pytest.fixture
def address():
    return free_address()


class Viewer:
    """A VideoStream; records its pictures and reports."""

    def __init__(self, address, wanted=True, **options):
        self.pictures = []
        self.reports = []
        self.stream = VideoStream(address, self.on_picture, self.on_report, **options)
        self.stream.want(wanted)
        self.stream.start()

    def on_picture(self, picture):
        self.pictures.append(picture)

    def on_report(self, level, text):
        self.reports.append((level, text))

    def texts(self, level):
        return [text for l, text in self.reports if l == level]  # noqa: E741

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stream.stop()

    def wait_for_more(self, count=3):
        target = len(self.pictures) + count
        wait_for(lambda: len(self.pictures) >= target)
        return self.pictures[-count:]


@pytest.mark.parametrize("header_bytes", [64, 68])
def test_pictures_arrive_one_by_one(address, patient, header_bytes):
    with ScriptedVideo(address, header_bytes=header_bytes), Viewer(address, latency_s=0.05) as viewer:
        pictures = viewer.wait_for_more(25)
        assert viewer.stream.connected
    for picture, following in zip(pictures, pictures[1:]):
        assert picture.rgb.shape == (360, 640, 3)
        assert seen_channel(picture.rgb) == 0
        assert picture.header.header_bytes == header_bytes
        assert following.header.frame_number == picture.header.frame_number + 1
        assert bar_number(following.rgb) == (bar_number(picture.rgb) + 1) % PICTURES_PER_IDR
        assert picture.received_s <= following.received_s
        assert picture.exposure_s <= following.exposure_s <= following.received_s - 0.05
        if following.received_s - picture.received_s >= LEAST_STEP_S:  # not when a busy computer read both at once
            assert picture.exposure_s < following.exposure_s
    assert pictures[0].received_s <= time.monotonic()
    stream = viewer.stream
    assert stream.shown == len(viewer.pictures)
    assert (stream.decoder.errors, stream.skipped, stream.parser.skipped_bytes, stream.connections) == (0, 0, 0, 1)
    assert viewer.reports == [("info", "video from %s:%d" % (address, VIDEO_PORT))]


@pytest.fixture
def stamped():
    """The kernel stamps what arrives; it begins to do so some time after the first socket has asked for it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, video_stream._SO_TIMESTAMPNS, 1)
        probe.bind(("127.0.0.1", 0))

        def is_stamped_on_arrival():
            probe.sendto(b"", probe.getsockname())
            time.sleep(0.02)
            _, extras, _, _ = probe.recvmsg(1, socket.CMSG_SPACE(video_stream._TIMESPEC.size))
            return video_stream._age_s(extras) > 0.01

        wait_for(is_stamped_on_arrival)
        yield


def test_a_picture_was_received_when_it_came_not_when_a_busy_thread_read_it(address, stamped):
    is_busy, has_come = threading.Event(), threading.Event()
    pictures = []

    def on_picture(picture):
        pictures.append(picture)
        if len(pictures) == 1:
            is_busy.set()
            has_come.wait(LIMIT_S)

    writer = StreamWriter()
    units = [writer.picture(unit, 1000 + 33 * number) for number, unit in enumerate(encoded()[:2])]
    with socket.create_server((address, VIDEO_PORT)) as listener:
        stream = VideoStream(address, on_picture, lambda *_: None)
        stream.want(True)
        stream.start()
        connection, _ = listener.accept()
        with connection:
            connection.sendall(units[0])
            assert is_busy.wait(LIMIT_S)
            connection.sendall(units[1])
            sent_s = time.monotonic()
            time.sleep(0.2)
            has_come.set()
            wait_for(lambda: len(pictures) == 2)
            stream.stop()
    assert pictures[0].received_s <= pictures[1].received_s < sent_s + 0.1


def test_joining_in_the_middle_begins_with_an_idr(address, patient):
    with ScriptedVideo(address) as camera:
        with Viewer(address, wanted=False) as viewer:
            for _ in range(3):  # at arbitrary places of the stream
                time.sleep(1.3 / RATE_HZ)
                seen = len(viewer.pictures)
                viewer.stream.want(True)
                viewer.wait_for_more(2)
                assert viewer.pictures[seen].header.frame_type == FrameType.IDR
                assert bar_number(viewer.pictures[seen].rgb) == 0
                viewer.stream.want(False)
                wait_for(lambda: not camera.has_client)
            assert viewer.stream.decoder.errors == 0
            assert viewer.stream.connections == camera.clients == 3


def test_nobody_is_connected_while_nobody_wants_pictures(address):
    with ScriptedVideo(address) as camera, Viewer(address, wanted=False) as viewer:
        time.sleep(0.3)
        assert camera.clients == 0
        viewer.stream.want(True)
        viewer.wait_for_more()
        viewer.stream.want(False)
        wait_for(lambda: not camera.has_client)
        assert not viewer.stream.connected
        count = len(viewer.pictures)
        time.sleep(0.2)
        assert len(viewer.pictures) == count
        assert not viewer.texts("warn")


def test_comes_back_after_the_vehicle_has_gone_and_says_so_once(address):
    with ScriptedVideo(address) as camera, Viewer(address) as viewer:
        viewer.wait_for_more()
        with camera.dead():
            wait_for(lambda: "refused" in " ".join(viewer.texts("warn")))
            count = len(viewer.pictures)
            time.sleep(0.5)  # some attempts
            assert len(viewer.pictures) == count
        viewer.wait_for_more()
        assert seen_channel(viewer.pictures[-1].rgb) == 0
        assert viewer.pictures[-1].connection == viewer.stream.connections == 2
        assert len(viewer.texts("warn")) <= 2  # closed, refused
        assert len(viewer.texts("info")) == 2
        assert not viewer.texts("error")


def test_starts_before_the_vehicle_does(address):
    with Viewer(address) as viewer:
        wait_for(lambda: viewer.texts("warn"))
        assert "%s:%d" % (address, VIDEO_PORT) in viewer.texts("warn")[0]
        time.sleep(0.3)
        with ScriptedVideo(address):
            viewer.wait_for_more()
        assert "refused" in viewer.texts("warn")[0]


def test_a_cut_connection_is_opened_again(address):
    with ScriptedVideo(address) as camera, Viewer(address) as viewer:
        viewer.wait_for_more()
        camera.hang_up()
        wait_for(lambda: viewer.stream.connections == 2)
        viewer.wait_for_more()
        assert viewer.stream.decoder.errors == 0
        assert "closed" in viewer.texts("warn")[0]


def test_a_silent_connection_is_given_up(address, monkeypatch):
    with ScriptedVideo(address) as camera, Viewer(address) as viewer:
        viewer.wait_for_more()
        camera.silent = True
        monkeypatch.setattr(video_stream, "SILENCE_S", 0.4)
        wait_for(lambda: viewer.stream.connections >= 3)
        assert ["nothing arrives" in text for text in viewer.texts("warn")] == [True]
        camera.silent = False
        viewer.wait_for_more()


def test_an_address_that_does_not_answer():
    address = free_address()
    full = socket.create_server((address, VIDEO_PORT), backlog=0)  # accepts no client: its queue is full
    fillers = [socket.socket() for _ in range(3)]
    try:
        for filler in fillers:
            filler.setblocking(False)
            filler.connect_ex((address, VIDEO_PORT))
        with Viewer(address) as viewer:
            wait_for(lambda: viewer.texts("warn"))
            assert "does not answer" in viewer.texts("warn")[0]
    finally:
        for sock in (full, *fillers):
            sock.close()


def test_garbage_between_the_pictures_is_skipped(address):
    with ScriptedVideo(address) as camera, Viewer(address) as viewer:
        viewer.wait_for_more()
        camera.noise = b"no picture PaVE" * 20 + b"PaVE" + bytes(100)
        wait_for(lambda: viewer.stream.parser.bad_headers)
        pictures = viewer.wait_for_more(5)
        assert [seen_channel(picture.rgb) for picture in pictures] == [0] * 5
        assert viewer.stream.connections == 1


def test_damaged_pictures_are_hidden_and_counted(address):
    def spoil(data):
        picture = bytearray(data)
        if parse_header(picture).frame_number % 25 == 3:
            for i in range(90, len(picture), 3):
                picture[i] ^= 0x5A
        return bytes(picture)

    with ScriptedVideo(address, alter=spoil), Viewer(address) as viewer:
        wait_for(lambda: viewer.stream.decoder.errors >= 3)
        assert viewer.stream.connections == 1
        assert all(seen_channel(picture.rgb) == 0 for picture in viewer.pictures)
        numbers = {picture.header.frame_number % 25 for picture in viewer.pictures}
        assert 3 not in numbers
        assert numbers


def test_another_codec_is_explained(address, monkeypatch):
    def as_p264(data):
        return data[:5] + bytes([Codec.P264]) + data[6:]

    with ScriptedVideo(address, alter=as_p264) as camera, Viewer(address) as viewer:
        wait_for(lambda: viewer.stream.decoder.foreign)
        monkeypatch.setattr(video_stream, "UNUSABLE_S", 0.5)
        wait_for(lambda: viewer.stream.connections >= 2)
        assert ["video_codec" in text for text in viewer.texts("warn")] == [True]
        camera.alter = lambda data: data
        viewer.wait_for_more()


def test_pictures_that_never_decode_lead_to_a_new_connection(address, monkeypatch):
    monkeypatch.setattr(video_stream, "UNUSABLE_S", 0.5)

    def without_idr(data):
        return data if parse_header(data).frame_type != FrameType.IDR else b""

    with ScriptedVideo(address, alter=without_idr), Viewer(address) as viewer:
        wait_for(lambda: viewer.stream.connections >= 2)
        assert "decoded" in viewer.texts("warn")[0]
        assert not viewer.pictures


def test_a_switch_of_the_camera(address):
    channels = [0]
    with ScriptedVideo(address, channel=lambda: channels[0]), Viewer(address) as viewer:
        viewer.wait_for_more()
        channels[0] = 1
        wait_for(lambda: seen_channel(viewer.pictures[-1].rgb) == 1)
        by_stream = {}
        for picture in viewer.pictures:
            by_stream.setdefault(picture.header.stream_id, set()).add(seen_channel(picture.rgb))
        assert sorted(by_stream.values(), key=min) == [{0}, {1}]
        assert viewer.stream.decoder.errors == 0


class BurstServer:
    """Sends given bytes on demand to one client."""

    def __init__(self, address):
        self._listener = socket.create_server((address, VIDEO_PORT))
        self._client = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._listener.close()
        self._client.close()

    def hang_up(self):
        self._client.close()
        self._client = None

    def send(self, data):
        if self._client is None:
            self._client, _ = self._listener.accept()
        self._client.sendall(data)


@pytest.mark.parametrize(("count", "per_idr"), [(57, 10), (57, 1000), (4, 10)])
def test_a_backlog_is_skipped_up_to_the_newest_pictures(address, count, per_idr):
    units = encoded(0, 60 if per_idr > 60 else per_idr)
    writer = StreamWriter()
    data = [writer.picture(units[i % len(units)], 33 * i) for i in range(count + 3)]
    resume = threading.Event()
    with BurstServer(address) as server, Viewer(address, wanted=False) as viewer:
        keep = viewer.on_picture

        def slow(picture):
            keep(picture)
            resume.wait(LIMIT_S)

        viewer.stream._on_picture = slow
        viewer.stream.want(True)
        server.send(data[0])
        wait_for(lambda: viewer.pictures)
        server.send(b"".join(data[1 : 1 + count]))
        time.sleep(0.2)  # until the kernel has it all
        resume.set()
        wait_for(lambda: viewer.stream.shown + viewer.stream.skipped == 1 + count)
        for picture in data[1 + count :]:
            server.send(picture)
        wait_for(lambda: viewer.pictures[-1].header.frame_number == count + 2)
        numbers = [picture.header.frame_number for picture in viewer.pictures]
        assert numbers[0] == 0
        if count <= video_stream.MAX_BACKLOG:
            assert numbers == list(range(count + 3))
        else:
            assert numbers[1:] == list(range(count - video_stream.MAX_BACKLOG + 1, count + 3))
        assert viewer.stream.decoder.errors == 0
        assert viewer.stream.decoder.missing == 0, "they came, they were not wanted"
        if per_idr == 10 and count == 57:  # pictures before the newest IDR need not even be decoded
            assert viewer.stream.decoder.decoded < 15
        for picture in viewer.pictures:
            assert seen_channel(picture.rgb) == 0


def test_a_new_connection_continues_nothing(address):
    writer, units = StreamWriter(), encoded()
    first, second, third, idr = (writer.picture(unit, 0) for unit in (*units[:3], units[0]))
    with BurstServer(address) as server, Viewer(address) as viewer:
        server.send(first + second[: len(second) // 2])
        wait_for(lambda: viewer.stream.parser._buffer)
        server.hang_up()
        server.send(second + third + idr)
        wait_for(lambda: len(viewer.pictures) == 2)
        assert [picture.header.frame_number for picture in viewer.pictures] == [0, 3]
        parser = viewer.stream.parser
        assert (parser.packets, parser.broken_payloads, parser.skipped_bytes) == (4, 0, 0)


def test_a_failing_consumer_does_not_end_the_video(address):
    with ScriptedVideo(address), Viewer(address) as viewer:
        viewer.wait_for_more()
        keep = viewer.on_picture

        def fail(_picture):
            viewer.stream._on_picture = keep
            raise RuntimeError("no room for it")

        viewer.stream._on_picture = fail
        wait_for(lambda: viewer.texts("error"))
        assert "no room for it" in viewer.texts("error")[0]
        viewer.wait_for_more()


def open_files():
    return collections.Counter(os.readlink(descriptor) for descriptor in os.scandir("/proc/self/fd"))


def test_nothing_is_left_behind(address):
    gc.collect()
    before, threads = open_files(), set(threading.enumerate())
    with ScriptedVideo(address):
        for wanted in (True, False, True):
            with Viewer(address, wanted=wanted) as viewer:
                if wanted:
                    viewer.wait_for_more(1)
    with Viewer(address) as viewer:
        wait_for(lambda: viewer.texts("warn"))
    VideoStream(address, None, None).stop()  # never started
    assert open_files() <= before and set(threading.enumerate()) <= threads  # those of earlier tests may end meanwhile


def test_stop_is_prompt_in_every_state(address, monkeypatch):
    monkeypatch.setattr(video_stream, "RETRY_S", 30.0)
    with Viewer(address) as viewer:  # waits for the next attempt
        wait_for(lambda: viewer.texts("warn"))
        begin_s = time.monotonic()
    assert time.monotonic() - begin_s < 5.0


def test_want_may_be_called_after_the_end(address):
    viewer = Viewer(address, wanted=False)
    viewer.stream.stop()
    viewer.stream.want(True)
    assert viewer.stream.wanted
