"""The virtual Cortex host over real loopback sockets; only the test moves its world and its clock."""

import select
import socket
import struct
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cortex_ros import wire
from cortex_ros.wire import Command
from risc_simulator.cortex_host import CortexHost
from risc_simulator.faults import Bodies, FaultEvent
from risc_simulator.models.mocap_cameras import CameraParams, MocapCameras

HOST = "127.88.0.1"
GROUP = "225.1.1.1"
PERIOD_S = 0.005
DELAY_S = 0.003


@dataclass(frozen=True)
class Endpoint:
    host: str = HOST
    command_port: int = 0
    stream_group: str = GROUP
    stream_port: int = 45678
    interface: str = "192.0.2.254"  # the client's network card, on another computer: the host ignores it
    rate_hz: float = 200.0
    reported_delay_s: float = DELAY_S


class World:
    """Two vehicles and a landmark; the first vehicle moves 1 m/s along x."""

    def __init__(self, vehicles=2):
        self.time_s = 0.0
        self.layout = tuple(("vehicle_%d" % k, 3) for k in range(vehicles)) + (("Landmark_A", 3),)
        self._start_m = np.array(
            [[[0.0, k, 1.0], [0.1, k, 1.0], [0.0, k, 1.125]] for k in range(vehicles)]
            + [[[1.0, 1.0, 0.0], [1.1, 1.0, 0.0], [1.0, 1.2, 0.0]]]
        ).reshape(-1, 3)

    def markers_m(self):
        markers_m = self._start_m.copy()
        markers_m[:3, 0] += self.time_s
        return markers_m


class Lab:
    """A host and its loop, with simulated time."""

    def __init__(self, world=None, endpoint=None, cameras=None, **options):
        self.world = World() if world is None else world
        self.now_s = DELAY_S
        self.send_late_s = 0.0
        self.host = CortexHost(
            self.world,
            Endpoint() if endpoint is None else endpoint,
            MocapCameras(CameraParams.ideal()) if cameras is None else cameras,
            clock=lambda: self.now_s + self.send_late_s,
            **options,
        )
        self._clients = []

    def client(self, address="127.0.0.1"):
        """A client's command socket."""
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.bind((address, 0))
        sock.settimeout(15.0)
        self._clients.append(sock)
        return sock

    def step(self, frames=1, period_s=PERIOD_S):
        """Run the loop of the virtual lab for some frames."""
        for _ in range(frames):
            self.world.time_s += period_s
            self.now_s = self.world.time_s + DELAY_S
            self.host.tick(self.now_s)

    def serve(self):
        """Let the host answer all requests that are waiting."""
        while True:
            ready = select.select(self.host.sockets(), [], [], 0.0)[0]
            if not ready:
                return
            for sock in ready:
                self.host.on_readable(sock, self.now_s)

    def send(self, client, datagram):
        client.sendto(datagram, self.host.address)
        self.serve()

    def ask(self, client, datagram):
        """The decoded answer, which must come from the command port."""
        self.send(client, datagram)
        answer, sender = client.recvfrom(65536)
        assert sender == self.host.address
        return wire.decode_packet(answer)

    def text(self, client, text):
        return self.ask(client, wire.encode_text(Command.GENERAL_REQUEST, text))

    def frame(self, client):
        packet = self.ask(client, wire.encode_packet(Command.REQUEST_FRAME))
        assert packet.command == Command.FRAME_OF_DATA
        return packet.content

    def close(self):
        self.host.close()
        for client in self._clients:
            client.close()


@pytest.fixture
def make_lab():
    labs = []

    def make(*args, **kwargs):
        labs.append(Lab(*args, **kwargs))
        return labs[-1]

    yield make
    for lab in labs:
        lab.close()


@pytest.fixture
def lab(make_lab):
    return make_lab()


@pytest.fixture
def listen():
    """Makes stream sockets in the group on loopback; several may share a port."""
    opened = []

    def make(port=0):
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind((GROUP, port))
        sock.setsockopt(
            socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(GROUP) + socket.inet_aton("127.0.0.1")
        )
        sock.settimeout(15.0)
        opened.append(sock)
        return sock

    yield make
    for sock in opened:
        sock.close()


def received(sock):
    """Everything that has already arrived: [(datagram, sender), ...]."""
    out = []
    while select.select([sock], [], [], 0.0)[0]:
        out.append(sock.recvfrom(65536))
    return out


def frames(sock):
    """The frames that have already arrived on a stream socket."""
    packets = [wire.decode_packet(datagram) for datagram, _ in received(sock)]
    return [packet.content for packet in packets if packet.command == Command.FRAME_OF_DATA]


def unpack(format_, packet):
    assert packet.command == Command.GENERAL_REPLY
    return struct.unpack(format_, packet.content)[0]


IDENTITY = wire.Identity("Cortex", (1, 5, 3, 1))
HELLO = wire.encode_identity(Command.HELLO_WORLD, wire.Identity("ClientTest", (4, 1, 3, 1)))
EMPTY_REPLY = (Command.GENERAL_REPLY, b"")
UNRECOGNIZED = (Command.UNRECOGNIZED_REQUEST, b"")


# --- discovery and definitions ------------------------------------------------------------------------------------


def test_hello_and_directed_query_are_answered(lab):
    client = lab.client()
    assert lab.ask(client, HELLO) == (Command.HERE_I_AM, IDENTITY)
    assert lab.ask(client, wire.encode_packet(Command.ARE_YOU_THERE)) == (Command.HERE_I_AM, IDENTITY)
    assert received(client) == []
    assert lab.host.statistics()["requests"] == {"ARE_YOU_THERE": 1, "HELLO_WORLD": 1}


def test_a_broadcast_hello_finds_every_host_at_its_own_address(make_lab):
    first = make_lab()
    second = make_lab(endpoint=Endpoint(host="127.88.0.2", command_port=first.host.address[1]))
    client = first.client()
    client.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    client.sendto(HELLO, ("127.255.255.255", first.host.address[1]))
    first.serve()
    second.serve()
    answers = received(client)
    assert sorted(sender for _, sender in answers) == [first.host.address, second.host.address]
    assert {wire.decode_packet(answer) for answer, _ in answers} == {(Command.HERE_I_AM, IDENTITY)}


def test_start_is_announced_on_the_stream(make_lab, listen):
    stream = listen()
    make_lab(endpoint=Endpoint(stream_port=stream.getsockname()[1]))
    ((datagram, sender),) = received(stream)
    assert wire.decode_packet(datagram) == (Command.HERE_I_AM, IDENTITY)
    assert sender[0] == HOST


def test_body_definitions(make_lab):
    lab = make_lab(templates={"vehicle_1": SimpleNamespace(marker_names=("nose", "tail", "top"))})
    packet = lab.ask(lab.client(), wire.encode_packet(Command.REQUEST_BODYDEFS))
    assert packet.command == Command.BODYDEFS
    assert [(body.name, body.marker_names) for body in packet.content.bodies] == [
        ("vehicle_0", ["M1", "M2", "M3"]),
        ("vehicle_1", ["nose", "tail", "top"]),
        ("Landmark_A", ["M1", "M2", "M3"]),
    ]
    assert packet.content.analog_channels == [] and packet.content.force_plates == 0


def test_template_with_other_markers_is_refused():
    with pytest.raises(ValueError, match="'vehicle_0' .* 3 markers, .* 1"):
        Lab(templates={"vehicle_0": SimpleNamespace(marker_names=("nose",))})


# --- polling ------------------------------------------------------------------------------------------------------


def test_polling_before_live_mode_shows_the_start_and_does_not_move(lab):
    client = lab.client()
    lab.step(10)
    first, second = lab.frame(client), lab.frame(client)
    assert (first.number, second.number) == (0, 0)
    assert [body.name for body in first.bodies] == ["vehicle_0", "vehicle_1", "Landmark_A"]
    assert first.bodies[0].markers_mm.tolist() == [[0.0, 0.0, 1000.0], [100.0, 0.0, 1000.0], [0.0, 0.0, 1125.0]]
    assert first.delay_s == np.float32(DELAY_S)
    assert lab.host.statistics()["frames_exposed"] == 0


def test_polling_in_live_mode_gives_the_newest_frame_and_its_age(lab):
    client = lab.client()
    assert lab.text(client, "LiveMode") == EMPTY_REPLY
    assert lab.host.live
    lab.step(20)
    frame = lab.frame(client)
    assert frame.number == 20
    assert frame.bodies[0].markers_mm[0] == pytest.approx([100.0, 0.0, 1000.0])
    assert frame.delay_s == np.float32(DELAY_S)
    lab.now_s += 0.0015  # a poll between two frames
    assert lab.frame(client).delay_s == pytest.approx(DELAY_S + 0.0015, abs=1e-7)


def test_pause_freezes_the_frame_with_the_delay_it_was_sent_with(lab):
    client = lab.client()
    lab.text(client, "LiveMode")
    lab.step(3)
    lab.now_s += 0.002
    lab.frame(client)
    assert lab.text(client, "Pause") == EMPTY_REPLY
    lab.step(50)
    frame = lab.frame(client)
    assert (frame.number, frame.delay_s) == (3, np.float32(DELAY_S))
    lab.text(client, "LiveMode")
    lab.step(2)
    assert lab.frame(client).number == 5
    assert lab.host.statistics()["exposures_skipped"] == 0  # a pause is no loss


def test_get_frame_of_data_and_base_positions(lab):
    client = lab.client()
    lab.text(client, "LiveMode")
    lab.step(200)
    packet = lab.text(client, "GetFrameOfData")
    assert packet.command == Command.FRAME_OF_DATA and packet.content.number == 200
    base = lab.text(client, "GetFrameOfData=BasePositions").content
    assert base.bodies[0].markers_mm[1].tolist() == [100.0, 0.0, 1000.0]
    assert lab.text(client, "GetFrameOfData=Something") == UNRECOGNIZED


# --- text requests ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text, format_, value",
    [
        ("GetContextFrameRate", "<f", 200.0),
        ("GetConversionToMillimeters", "<f", 1.0),
        ("GetUpAxis", "<i", 2),
        ("GetContextAnalogSampleRate", "<f", 0.0),
        ("GetContextAnalogBitDepth", "<i", 16),
        ("PostGetPlayMode", "<i", 0),
    ],
)
def test_questions(lab, text, format_, value):
    assert unpack(format_, lab.text(lab.client(), text)) == value


@pytest.mark.parametrize(
    "text",
    [
        "LiveMode",
        "Pause",
        "SetOutputName=take_01",
        "StartRecording",
        "StopRecording",
        "ResetIDs",
        "ResetIDs=vehicle_1",
        "PostForward",
        "PostBackward",
        "PostPause",
    ],
)
def test_commands_are_accepted_and_may_be_repeated(lab, text):
    client = lab.client()
    assert [lab.text(client, text) for _ in range(3)] == [EMPTY_REPLY] * 3


@pytest.mark.parametrize(
    "text",
    [
        "",
        "livemode",
        "LiveMode ",
        "LiveMode=1",
        "GetUpAxis=2",
        "ResetIDs=stranger",
        "SetOutputName",
        "SetOutputName=",
        "SetOutputName=" + "n" * 252,
        "SkyCommand",
        "=",
        "x" * 60000,
    ],
)
def test_other_texts_are_not_recognized(lab, text):
    assert lab.text(lab.client(), text) == UNRECOGNIZED
    assert lab.host.statistics()["unrecognized_requests"] == 1


def test_recording_status_travels_with_the_frames(lab):
    client = lab.client()
    lab.text(client, "LiveMode")
    lab.step(4)
    assert lab.frame(client).recording is None
    lab.text(client, "SetOutputName=take_01")
    lab.text(client, "StartRecording")
    lab.step(1)
    lab.text(client, "StartRecording")  # a repeated request does not start another recording
    lab.step(2)
    assert lab.frame(client).recording == (1, 5, 0, "take_01.cap")
    lab.text(client, "StopRecording")
    lab.step(1)
    assert lab.frame(client).recording == (0, 5, 7, "take_01.cap")


def test_a_recording_that_ends_before_its_first_frame_was_none(lab):
    client = lab.client()
    lab.text(client, "LiveMode")
    lab.step(5)
    lab.text(client, "StartRecording")
    lab.text(client, "StopRecording")
    lab.step(2)
    assert lab.frame(client).recording is None


def test_playback_of_a_take_to_polling_clients(lab):
    client = lab.client()
    lab.text(client, "LiveMode")
    lab.text(client, "StartRecording")
    lab.step(5)
    lab.text(client, "PostForward")  # no playback in live mode
    assert unpack("<i", lab.text(client, "PostGetPlayMode")) == 0
    lab.text(client, "StopRecording")
    lab.step(3)
    lab.text(client, "Pause")
    assert lab.frame(client).number == 8
    lab.text(client, "PostForward")
    assert unpack("<i", lab.text(client, "PostGetPlayMode")) == 1
    seen = []
    for _ in range(6):
        lab.step()
        seen.append(lab.frame(client).number)
    assert seen == [1, 2, 3, 4, 5, 5]
    assert unpack("<i", lab.text(client, "PostGetPlayMode")) == 0
    lab.text(client, "PostBackward")
    lab.step()
    lab.step()
    lab.text(client, "PostPause")
    lab.step(5)
    assert lab.frame(client).number == 3
    lab.text(client, "PostBackward")
    assert unpack("<i", lab.text(client, "PostGetPlayMode")) == -1


def test_play_without_a_take_stays_paused(lab):
    client = lab.client()
    lab.text(client, "PostForward")
    lab.step(3)
    assert unpack("<i", lab.text(client, "PostGetPlayMode")) == 0
    assert lab.frame(client).number == 0


# --- the stream ---------------------------------------------------------------------------------------------------


def test_multicast_reaches_two_clients_from_the_address_that_also_replies(make_lab, listen):
    first = listen()
    second = listen(first.getsockname()[1])
    lab = make_lab(endpoint=Endpoint(stream_port=first.getsockname()[1]))
    commands = [lab.client(), lab.client()]
    lab.step(3)
    assert frames(first) == [] and frames(second) == []  # not before LiveMode
    for client in commands:
        assert lab.text(client, "LiveMode") == EMPTY_REPLY
    lab.step(50)
    packets = received(first)
    assert [wire.decode_packet(datagram).content.number for datagram, _ in packets] == list(range(1, 51))
    assert {sender[0] for _, sender in packets} == {HOST}
    assert received(second) == packets
    assert {lab.frame(client).number for client in commands} == {50}
    lab.text(commands[0], "Pause")
    lab.step(5)
    assert frames(second) == []
    statistics = lab.host.statistics()
    assert (statistics["frames_exposed"], statistics["frames_sent"], statistics["clients"]) == (50, 50, 2)


@pytest.mark.parametrize("interface", ["", "127.0.0.1", HOST])
def test_stream_goes_out_by_the_card_of_the_host_or_by_the_one_given(make_lab, listen, interface):
    stream = listen()
    lab = make_lab(endpoint=Endpoint(stream_port=stream.getsockname()[1]), live_on_start=True, interface=interface)
    card = lab.host._stream_socket.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, 4)
    assert socket.inet_ntoa(card) == (interface or HOST)
    lab.step(3)
    assert [frame.number for frame in frames(stream)] == [1, 2, 3]


def test_two_hosts_on_one_machine(make_lab, listen):
    stream = listen()
    port = stream.getsockname()[1]
    first = make_lab(endpoint=Endpoint(stream_port=port), live_on_start=True)
    other = Endpoint(host="127.88.0.2", command_port=first.host.address[1], stream_port=port)
    second = make_lab(world=World(vehicles=1), endpoint=other, live_on_start=True)
    received(stream)
    first.step(2)
    second.step(1)
    seen = [(sender[0], len(wire.decode_packet(datagram).content.bodies)) for datagram, sender in received(stream)]
    assert seen == [(HOST, 3), (HOST, 3), ("127.88.0.2", 2)]
    assert [len(lab.frame(lab.client()).bodies) for lab in (first, second)] == [3, 2]


def test_without_a_clock_the_time_of_the_tick_counts(listen):
    stream = listen()
    world = World()
    endpoint = Endpoint(stream_port=stream.getsockname()[1])
    host = CortexHost(world, endpoint, MocapCameras(), live_on_start=True)
    world.time_s = 1.0
    host.tick(1.004)
    host.close()
    assert frames(stream)[0].delay_s == np.float32(1.004 - 1.0)


def test_one_frame_a_period_whatever_the_ticks(make_lab):
    lab = make_lab(live_on_start=True)
    lab.step(100, period_s=0.001)  # world faster than the cameras
    assert lab.host.statistics()["frames_exposed"] == 21  # the periods 0 to 20
    lab.host.tick(lab.now_s)  # world has not moved
    lab.step(10, period_s=0.0)
    assert lab.host.statistics()["frames_exposed"] == 21
    assert lab.host.statistics()["exposures_skipped"] == 0


def test_slow_cameras_in_a_fast_world(make_lab):
    lab = make_lab(endpoint=Endpoint(rate_hz=60.0), live_on_start=True)
    lab.step(200)  # one second
    assert lab.host.statistics()["frames_exposed"] == 61
    assert lab.host.statistics()["exposures_skipped"] == 0


def test_periods_that_the_world_jumped_over_are_counted_and_numbers_stay_continuous(make_lab):
    lab = make_lab(live_on_start=True)
    client = lab.client()
    lab.step(2)
    lab.step(1, period_s=4 * PERIOD_S)
    assert lab.frame(client).number == 3
    assert lab.host.statistics()["exposures_skipped"] == 3


def test_late_in_a_long_run_there_is_still_one_frame_a_period(make_lab):
    """The world accumulates its time in floating point; this must not skip or repeat an exposure."""
    lab = make_lab(live_on_start=True)
    for start_s in (0.0, 5000.0, 86400.0):
        lab.world.time_s = start_s
        lab.host.tick(start_s)
        before = lab.host.statistics()
        lab.step(300)
        after = lab.host.statistics()
        assert after["frames_exposed"] - before["frames_exposed"] == 300
        assert after["exposures_skipped"] == before["exposures_skipped"]


def test_lost_markers_are_the_sentinel_on_the_wire(make_lab, listen):
    stream = listen()
    lab = make_lab(endpoint=Endpoint(stream_port=stream.getsockname()[1]), live_on_start=True)
    received(stream)
    lab.host.wires.add(FaultEvent("occlusion"), Bodies(("vehicle_1", "Landmark_A"), (), {}))
    lab.step()
    datagram, _ = received(stream)[0]
    assert datagram.count(bytes.fromhex("7f96184b" * 3)) == 6
    bodies = wire.decode_packet(datagram).content.bodies
    assert [np.isnan(body.markers_mm[:, 0]).tolist() for body in bodies] == [[False] * 3, [True] * 3, [True] * 3]


def test_ghosts_are_unidentified_markers(make_lab, listen):
    stream = listen()
    params = CameraParams(noise_std_m=0.0, occlusions_per_marker_hz=0.0, ghosts_hz=100.0)
    lab = make_lab(
        endpoint=Endpoint(stream_port=stream.getsockname()[1]), cameras=MocapCameras(params, seed=1), live_on_start=True
    )
    lab.step(100)
    loose = np.concatenate([frame.unidentified_mm for frame in frames(stream)])
    assert len(loose) > 100
    assert (loose >= np.array(params.volume_min_m) * 1e3).all() and (loose <= np.array(params.volume_max_m) * 1e3).all()


def test_fifty_bodies(make_lab):
    lab = make_lab(world=World(vehicles=49), live_on_start=True)
    lab.step()
    client = lab.client()
    assert len(lab.frame(client).bodies) == 50
    assert len(lab.ask(client, wire.encode_packet(Command.REQUEST_BODYDEFS)).content.bodies) == 50


class CrowdedCameras(MocapCameras):
    """Sees more loose markers than a datagram holds, from the second frame on."""

    def observe(self, time_s, layout, exact_m):
        seen = super().observe(time_s, layout, exact_m)
        return seen._replace(unidentified_m=np.zeros((5500, 3))) if time_s > 0.0 else seen


def test_a_frame_too_large_for_a_datagram_is_counted_and_not_sent(make_lab, caplog):
    lab = make_lab(cameras=CrowdedCameras(CameraParams.ideal()), live_on_start=True)
    lab.step(3)
    statistics = lab.host.statistics()
    assert (statistics["frames_exposed"], statistics["frames_sent"], statistics["oversize_frames"]) == (3, 0, 3)
    assert [record.levelname for record in caplog.records] == ["ERROR"]
    assert "5500 unidentified markers" in caplog.text and "65503" in caplog.text
    assert lab.frame(lab.client()).number == 0


def test_a_world_that_never_fits_a_datagram_is_refused_at_once():
    world = World()
    world.layout, world.markers_m = (("cloud", 5500),), lambda: np.zeros((5500, 3))
    with pytest.raises(wire.PacketTooLargeError, match="5500 markers"):
        Lab(world=world)
    world.layout, world.markers_m = tuple(("body%d" % k, 1) for k in range(101)), lambda: np.zeros((101, 3))
    with pytest.raises(ValueError, match="101 bodies"):
        Lab(world=world)


# --- what must not kill it ----------------------------------------------------------------------------------------


def assert_alive(lab):
    client = lab.client()
    assert lab.ask(client, HELLO) == (Command.HERE_I_AM, IDENTITY)
    client.close()


def test_unknown_commands_are_answered_as_such(lab):
    client = lab.client()
    for code in (0x0180, 0x0181, 0x0200, 9, 18, 0xFFFF):
        assert lab.ask(client, wire.encode_packet(code, b"xyz")) == (Command.UNRECOGNIZED_COMMAND, b"")
    assert lab.host.statistics()["unknown_commands"] == 6


@pytest.mark.parametrize("code", [2, 3, 11, 13, 15, 16, 0x5678])
def test_what_only_hosts_send_is_not_answered(lab, code):
    """Otherwise two hosts that hear each other would answer each other endlessly."""
    client = lab.client()
    lab.send(client, wire.encode_packet(code, bytes(200)))
    assert received(client) == []
    assert lab.host.statistics()["unexpected"] == 1


@pytest.mark.parametrize(
    "datagram",
    [
        b"",
        b"\x00",
        HELLO[:3],
        HELLO[:-1],
        HELLO + b"x",
        struct.pack("<HH", 0, 0),
        struct.pack("<HH", 12, 9),
        wire.encode_packet(14),
        wire.encode_packet(14, b"LiveMode"),
        struct.pack("<HH", 14, 65535) + bytes(65503),
    ],
    ids=lambda datagram: "%d bytes" % len(datagram),
)
def test_malformed_datagrams_are_counted_and_not_answered(lab, datagram):
    client = lab.client()
    lab.send(client, datagram)
    assert received(client) == []
    assert lab.host.statistics()["malformed"] == 1
    assert not lab.host.live
    assert_alive(lab)


def test_skeleton_push_has_no_answer(lab):
    client = lab.client()
    lab.send(client, wire.encode_packet(17, struct.pack("<HHii", 13, 60, 1, -1) + b"Root\0" + bytes(60)))
    assert received(client) == []
    assert lab.host.statistics()["requests"] == {"PUSH_BASEPOSITION": 1}


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(
    datagrams=st.lists(
        st.one_of(
            st.binary(max_size=200),
            st.builds(wire.encode_packet, st.integers(0, 20), st.binary(max_size=60)),
            st.builds(lambda text: wire.encode_packet(14, text + b"\0"), st.binary(max_size=40)),
        ),
        max_size=8,
    )
)
def test_random_datagrams_do_not_kill_it(lab, datagrams):
    client = lab.client()
    for datagram in datagrams:
        lab.send(client, datagram)
    lab.step()
    for answer, _ in received(client):
        wire.decode_packet(answer)
    client.close()
    assert_alive(lab)


def test_a_flood_does_not_hold_up_the_loop(lab):
    client = lab.client()
    for _ in range(100):
        client.sendto(wire.encode_packet(Command.REQUEST_BODYDEFS), lab.host.address)
    command_socket = lab.host.sockets()[0]
    lab.host.on_readable(command_socket, lab.now_s)
    assert lab.host.statistics()["requests"] == {"REQUEST_BODYDEFS": 64}
    lab.serve()
    assert lab.host.statistics()["requests"] == {"REQUEST_BODYDEFS": 100}


def test_many_clients_are_remembered_up_to_a_bound(lab):
    for _ in range(70):
        client = lab.client()
        lab.ask(client, HELLO)
        client.close()
    assert lab.host.statistics()["clients"] == 64


def test_who_comes_who_pauses_and_who_talks_nonsense_is_said_once_and_then_counted(make_lab, caplog):
    caplog.set_level("INFO")
    lab = make_lab()
    good, bad = lab.client(), lab.client()
    names = ["127.0.0.1:%d" % client.getsockname()[1] for client in (good, bad)]
    lab.ask(good, wire.encode_identity(Command.HELLO_WORLD, wire.Identity("ClientTest", (2, 1, 0, 2))))
    for _ in range(3):
        lab.text(good, "LiveMode")
        lab.text(good, "LiveMode")  # it is live already
        lab.text(bad, "Pause")
        lab.send(bad, b"x")
        lab.text(bad, "MakeCoffee")
    notices = lab.host.statistics()["notices"]
    assert notices["events"] == {
        "says hello": {names[0]: 1},
        "is a client": {names[0]: 1, names[1]: 1},
        "starts the stream": {names[0]: 3},
    }
    assert notices["complaints"] == {
        "pauses the stream of all clients": {names[1]: 3},
        "sends malformed packets": {names[1]: 3},
        "sends an unknown request": {names[1]: 3},
    }
    assert len(caplog.records) == 7, caplog.text
    assert any("ClientTest" in record.getMessage() and names[0] in record.getMessage() for record in caplog.records)


def test_an_address_that_cannot_be_reached_is_counted(make_lab, caplog):
    lab = make_lab(endpoint=Endpoint(stream_group="192.0.2.77"), live_on_start=True)
    lab.step(3)  # packets from a loopback address cannot leave this computer
    statistics = lab.host.statistics()
    assert statistics["send_errors"] == 4  # the announcement and three frames
    assert (statistics["frames_exposed"], statistics["frames_sent"]) == (3, 0)
    assert len(caplog.records) == 1


def test_address_errors_name_cause_and_cure(make_lab):
    first = make_lab()
    with pytest.raises(OSError, match=r"127\.88\.0\.1:%d.*in use" % first.host.address[1]):
        Lab(endpoint=Endpoint(command_port=first.host.address[1]))
    with pytest.raises(OSError, match="192.0.2.254"):
        Lab(endpoint=Endpoint(host="192.0.2.254"))
    for interface in ("192.0.2.254", "eth9"):
        with pytest.raises(OSError, match="interface %s" % interface) as info:
            Lab(interface=interface)
        assert info.value.errno is not None


def test_close_frees_the_port_and_may_be_repeated(make_lab):
    lab = make_lab()
    port = lab.host.address[1]
    lab.host.close()
    lab.host.close()
    assert lab.host.sockets() == []
    again = make_lab(endpoint=Endpoint(command_port=port))
    assert_alive(again)


def test_describe_says_what_listens_where(make_lab, listen):
    port = listen().getsockname()[1]
    lab = make_lab(endpoint=Endpoint(stream_port=port))
    text = lab.host.describe()
    assert "%s:%d" % lab.host.address in text and "%s:%d" % (GROUP, port) in text
    assert "200 Hz" in text and "paused" in text and "vehicle_1" in text
    lab.host.set_live(True)
    assert "paused" not in lab.host.describe()


# --- faults -------------------------------------------------------------------------------------------------------


@pytest.fixture
def live(make_lab, listen):
    """(lab in live mode, its stream socket, a client)."""
    stream = listen()
    lab = make_lab(endpoint=Endpoint(stream_port=stream.getsockname()[1]), live_on_start=True)
    received(stream)
    return lab, stream, lab.client()


def test_silence_for_a_while(live):
    lab, stream, client = live
    lab.step(2)
    lab.host.wires.add(
        FaultEvent("blackhole", channel="cortex/*", severity=1.0, start_s=lab.now_s, duration_s=9.5 * PERIOD_S)
    )
    lab.step(5)
    lab.send(client, HELLO)
    lab.step(15)
    assert received(client) == []  # what came in the meantime is lost
    numbers = [frame.number for frame in frames(stream)]
    assert numbers == [1, 2] + list(range(12, 23))
    assert_alive(lab)


def test_frame_numbers_wrap_within_the_wires_range(live):
    lab, stream, _ = live
    lab.host._number = 2**31 - 2
    lab.step(3)
    assert [frame.number for frame in frames(stream)] == [2**31 - 1, 0, 1]


def test_reported_delay_is_the_one_that_happened(make_lab, listen):
    stream = listen()
    lab = make_lab(endpoint=Endpoint(stream_port=stream.getsockname()[1]), live_on_start=True)
    late_s = [0.0, 0.0004, 0.012, 0.0]
    for lab.send_late_s in late_s:
        lab.step()
    assert [frame.delay_s for frame in frames(stream)] == pytest.approx([DELAY_S + late for late in late_s], abs=1e-8)
