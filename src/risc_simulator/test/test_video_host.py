"""The video of the virtual lab on the wire: real lab, real camera process, seen by a client of the protocol."""

import os
import socket
import subprocess
import threading
import time

import av
import cv2
import numpy as np
import pytest
from addresses import free_port, own_net

from ardrone_autonomy.protocol.navdata import Navdata, Tag
from ardrone_autonomy.protocol.video import FrameType, StreamParser
from risc_lab.camera import Camera, cortex_to_camera
from risc_lab.lab import FleetLandmark, FleetVehicle, Start
from risc_lab.lab.calibration import FRONT_MOUNT, load_calibration
from risc_lab.lab.fleet import Fleet, MocapEndpoint
from risc_simulator import wires
from risc_simulator.faults import FaultEvent, parse_fault
from risc_simulator.vehicles.ardrone import CAMERAS
from risc_simulator.virtual_lab import LabOptions, VirtualLab
from risc_simulator.world import REST_HEIGHT_M

DISC_M = (2.3, 0.3, 0.25)
PATIENCE_S = 60.0  # for a camera process to start on a busy computer
GREEN_HUE, GREEN_TOLERANCE = 66, 8


@pytest.fixture
def make_lab():
    """Makes a lab, in its own thread, with two vehicles on the floor, one of them facing a disc."""
    running = []
    stop = threading.Event()

    def make(**options):
        lab = VirtualLab(make_fleet(), seed=4, **options)
        thread = threading.Thread(target=lab.run, args=(stop,))
        thread.start()
        running.append((lab, thread))
        return lab

    yield make
    stop.set()
    for lab, thread in running:
        thread.join(15.0)
        lab.close()
        assert not thread.is_alive()


@pytest.fixture
def lab(make_lab):
    return make_lab()


@pytest.fixture(scope="module")
def shared_lab():
    """A lab for tests that do not change it. They come last, because the earlier ones count the camera processes."""
    lab, stop = VirtualLab(make_fleet(), seed=4), threading.Event()
    thread = threading.Thread(target=lab.run, args=(stop,))
    thread.start()
    yield lab
    stop.set()
    thread.join(15.0)
    lab.close()
    assert not thread.is_alive()


def make_fleet():
    net, port = own_net(), free_port()
    vehicles = tuple(
        FleetVehicle("risc%d" % (k + 1), name, "ardrone", "%s.1.%d" % (net, k + 1), Start((0.5, y, 0.0)))
        for k, (name, y) in enumerate([("fluffy_II", 0.0), ("Raven", -1.0)])
    )
    mocap = MocapEndpoint(net + ".0.1", stream_port=port, interface="127.0.0.1")
    disc = FleetLandmark("Green_pink", DISC_M, facing_deg=180.0)
    return Fleet("two", mocap, vehicles, (disc,))


class Client:
    """Reads pictures as any client does."""

    def __init__(self, address):
        self.socket = socket.create_connection((address, 5555), PATIENCE_S)
        self._parser, self._decoder = StreamParser(), None
        self._packets = []

    def packet(self):
        """The next packet; raises socket.timeout when none comes."""
        while not self._packets:
            data = self.socket.recv(1 << 16)
            assert data, "the vehicle hung up"
            self._packets = self._parser.feed(data)
        return self._packets.pop(0)

    def picture(self):
        """(header, (h, w, 3) BGR) of the next picture that can be decoded."""
        while True:
            header, payload = self.packet()
            if header.frame_type == FrameType.IDR:
                self._decoder = av.CodecContext.create("h264", "r")
            if self._decoder is not None:
                (frame,) = self._decoder.decode(av.Packet(payload))
                return header, frame.to_ndarray(format="bgr24")[: header.display_height_px, : header.display_width_px]

    def close(self):
        self.socket.close()


@pytest.fixture
def client(lab):
    client = Client(lab.fleet.vehicles[0].address)
    yield client
    client.close()


@pytest.fixture
def shared_client(shared_lab):
    client = Client(shared_lab.fleet.vehicles[0].address)
    yield client
    client.close()


def children():
    """Ids of the camera processes that this process has started."""
    command = ["pgrep", "-P", str(os.getpid()), "-f", "risc_simulator.video.camera_process"]
    return [int(pid) for pid in subprocess.run(command, stdout=subprocess.PIPE, check=False).stdout.split()]


def green_centre(picture):
    """Centre (2,) [px] of the largest green area."""
    hsv = cv2.cvtColor(picture, cv2.COLOR_BGR2HSV)
    mask = (abs(hsv[..., 0].astype(int) - GREEN_HUE) < GREEN_TOLERANCE) & (hsv[..., 1] > 90) & (hsv[..., 2] > 60)
    count, _, sizes, centres = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    assert count > 1, "nothing green in the picture"
    return centres[1 + np.argmax(sizes[1:, cv2.CC_STAT_AREA])]


def video_statistics(lab, name, pictures):
    """Video counters of a vehicle, once they show `pictures` pictures: these are counted after they are sent."""
    deadline_s = time.monotonic() + PATIENCE_S
    while True:
        counters = lab.statistics()["vehicles"][name]["video"]
        if counters["pictures"] >= pictures:
            return counters
        assert time.monotonic() < deadline_s, "%d pictures were sent, these were counted: %s" % (pictures, counters)
        time.sleep(0.01)


def test_pictures_keep_their_rhythm_and_their_clock(lab, client):
    headers = [client.packet().header for _ in range(40)]
    assert headers[0].frame_type == FrameType.IDR, "the first watcher gets the beginning of the stream"
    numbers = [header.frame_number for header in headers]
    assert numbers == list(range(numbers[0], numbers[0] + 40))
    times = np.array([header.timestamp_ms for header in headers]) * (30.0 / 1000.0)  # in periods
    assert (np.diff(times) > 0.0).all()
    # pictures that a slow computer skips are counted, and the schedule is kept; exposures are on the lab's 5 ms grid
    skipped = video_statistics(lab, "risc1", 40)["skipped"]
    behind = 0.5 + lab.statistics()["late_ms"]["max"] * (30.0 / 1000.0)  # lag of the world behind the clock
    assert 39 - behind < times[-1] - times[0] < 39 + skipped + 1 + behind
    if skipped == 0:
        late = times - np.arange(40.0)  # the earliest of twenty is on time
        assert late[20:].min() - late[:20].min() == pytest.approx(0.0, abs=0.3)
        assert np.median(np.diff(times)) == pytest.approx(1.0, abs=0.18)
    assert any(header.frame_type == FrameType.P for header in headers)
    assert abs(headers[-1].timestamp_ms - 1e3 * lab.now_s()) < 2000.0


def test_switching_the_camera_changes_stream_and_picture(lab, client):
    header, _ = client.picture()
    lab.vehicle_hosts["risc1"].configuration.write("video:video_channel", "1", None)
    lab.vehicle_hosts["risc1"]._obey_configuration()
    deadline_s = time.monotonic() + PATIENCE_S
    while True:
        now, picture = client.picture()
        if now.stream_id != header.stream_id:
            break
        assert time.monotonic() < deadline_s, "the stream never changed"
    assert now.frame_type == FrameType.IDR
    with pytest.raises(AssertionError, match="nothing green"):
        green_centre(picture)  # the floor


def test_a_link_that_is_lost_for_long_loses_pictures_and_goes_on_with_a_keyframe(lab, client, monkeypatch):
    monkeypatch.setattr(wires, "MAX_HELD_BYTES", 100)  # pictures of an empty floor are small
    client.picture()
    number = client.packet().header.frame_number
    lab.inject(parse_fault("link_blackhole:1.5,risc1"))
    client.socket.settimeout(0.5)
    with pytest.raises(socket.timeout):
        for _ in range(200):
            number = client.packet().header.frame_number
    client.socket.settimeout(PATIENCE_S)
    header = client.packet().header
    while header.frame_number == number + 1:  # what was held up
        number, header = header.frame_number, client.packet().header
    assert header.frame_number > number + 1 and header.frame_type == FrameType.IDR


def test_faults_on_the_wire_act_on_the_stream(lab, client):
    """Injected while the camera process runs: pictures come later, all and in order; then the connection is cut."""

    client.packet()
    lab.inject(FaultEvent("delay", severity=1.0, channel="risc1/video"))
    begins_s, headers = lab.now_s(), []
    while not headers or 1e-3 * headers[-1].timestamp_ms < begins_s:  # earlier pictures are in transit
        headers.append(client.packet().header)
    assert lab.now_s() - 1e-3 * headers[-1].timestamp_ms >= 1.0
    numbers = [header.frame_number for header in headers]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    lab.inject(parse_fault("cut:channel=risc1/video"))
    with pytest.raises(ConnectionResetError):
        for _ in range(1000):
            client.packet()
    lab.end_faults()
    again = Client(lab.fleet.vehicles[0].address)
    again.picture()
    again.close()
    counts = lab.statistics()["wires"]["risc1/video"]
    assert counts["cut"] == 1 and counts["later"] > 0 and counts["sent"] == counts["delivered"] + 1


def test_faults_of_the_wire_reach_a_camera_process_that_starts_later(make_lab):
    lab = make_lab(events=[FaultEvent("cut", channel="risc2/video")])
    client = Client(lab.fleet.vehicles[1].address)
    with pytest.raises(ConnectionResetError):
        client.packet()
    client.close()


def test_nothing_runs_before_somebody_watches_and_nothing_is_left_behind(lab):
    assert children() == []
    client = Client(lab.fleet.vehicles[1].address)
    client.picture()
    assert len(children()) == 1
    assert video_statistics(lab, "risc2", 1)["pictures"] >= 1
    client.close()
    lab._video.close()  # as close() does; the fixture closes the rest
    assert children() == []


def test_cameras_that_start_with_the_lab_are_ready_before_anybody_watches(make_lab, monkeypatch):
    """A client then waits for one picture, not for a process to start; no picture is made before a client connects."""
    lab = make_lab(cameras_ahead=True)
    (pid,) = children()
    deadline_s = time.monotonic() + PATIENCE_S
    while not lab.cameras_ready:
        assert time.monotonic() < deadline_s, "the cameras never were ready"
        time.sleep(0.05)
    time.sleep(0.3)
    assert video_statistics(lab, "risc1", 0)["pictures"] == video_statistics(lab, "risc2", 0)["pictures"] == 0
    came = []  # (number of the newest exposure, whether the cameras were ready) when a client was accepted
    station = lab._video.stations["risc1"]
    accept = station.accept
    monkeypatch.setattr(station, "accept", lambda: (came.append((lab.frame, lab.cameras_ready)), accept()))
    client = Client(lab.fleet.vehicles[0].address)
    try:
        header, picture = client.picture()
        ((frame, were_ready),) = came
        assert were_ready
        assert header.timestamp_ms == round(1e3 * (frame + 1) / lab.fleet.mocap.rate_hz), "of the next exposure"
        green_centre(picture)
        assert children() == [pid]
        assert video_statistics(lab, "risc2", 0)["pictures"] == 0
    finally:
        client.close()


@pytest.mark.parametrize(("told", "started"), [({}, 1), ({"cameras_on_demand": True}, 0)])
def test_cameras_start_with_the_lab_unless_it_is_told_otherwise(told, started):
    lab = LabOptions(**told).make_lab(make_fleet())
    try:
        assert len(children()) == started
    finally:
        lab.close()


def test_a_camera_process_that_died_is_started_again(lab):
    address = lab.fleet.vehicles[0].address
    first = Client(address)
    first.picture()
    (pid,) = children()
    os.kill(pid, 9)
    again = Client(address)
    try:
        while first.packet().header.frame_number > 0:  # what had been sent before
            pass
        first.picture()
        again.picture()
        assert children() != [pid]
    finally:
        first.close()
        again.close()


def test_the_picture_shows_the_disc_where_the_geometry_says(shared_lab, shared_client):
    header, picture = shared_client.picture()
    assert picture.shape == (360, 640, 3)
    assert header.encoded_px == (640, 368) and header.display_px == (640, 360)
    point = cortex_to_camera(DISC_M, (0.5, 0.0, REST_HEIGHT_M), np.diag([1.0, -1.0, -1.0]), FRONT_MOUNT)
    expected = Camera(load_calibration(CAMERAS[0].calibration)).project(point)
    assert np.linalg.norm(green_centre(picture) - expected) < 1.5


def test_navdata_tell_size_and_number_of_the_newest_picture(shared_lab, shared_client):
    address = shared_lab.fleet.vehicles[0].address
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        ground.settimeout(PATIENCE_S)
        sent, told = {}, {}
        deadline_s = time.monotonic() + PATIENCE_S
        while len(sent.keys() & told.keys()) < 10:
            assert time.monotonic() < deadline_s, "pictures %s, told of %s" % (sent, told)
            header = shared_client.packet().header
            sent[header.frame_number] = header.payload_bytes
            ground.sendto(b"\1\0\0\0", (address, 5554))
            ground.sendto(b'AT*CONFIG=1,"general:navdata_demo","FALSE"\r', (address, 5556))
            option = None
            while option is None:  # bootstrap packets have none
                option = Navdata(ground.recv(65536)).option(Tag.VIDEO_STREAM)
            told[option.frame_number] = option.frame_size
    both = sent.keys() & told.keys()
    assert {number: told[number] for number in both} == {number: sent[number] for number in both}
    assert list(told) == sorted(told)


def test_a_second_watcher_joins_in_the_middle(shared_lab, shared_client):
    shared_client.picture()
    late = Client(shared_lab.fleet.vehicles[0].address)
    try:
        _, picture = late.picture()
        np.testing.assert_allclose(green_centre(picture), green_centre(shared_client.picture()[1]), atol=1.0)
    finally:
        late.close()


@pytest.mark.parametrize("brightness", [-0.1, 11.0, float("nan")])
def test_impossible_light_is_refused(shared_lab, brightness):
    with pytest.raises(ValueError, match="0 to 10"):
        shared_lab.set_light(brightness)


def test_light_and_board_are_seen(shared_lab, shared_client):
    _, bright = shared_client.picture()
    shared_lab.set_light(0.3)
    deadline_s = time.monotonic() + PATIENCE_S
    while shared_client.picture()[1].mean() > 0.6 * bright.mean():
        assert time.monotonic() < deadline_s, "the light never went down"
    shared_lab.set_light(1.0)
    shared_lab.move_board("risc1", 600.0)
    while not cv2.findChessboardCornersSB(cv2.cvtColor(shared_client.picture()[1], cv2.COLOR_BGR2GRAY), (8, 6))[0]:
        assert time.monotonic() < deadline_s + PATIENCE_S, "no checkerboard was seen"
