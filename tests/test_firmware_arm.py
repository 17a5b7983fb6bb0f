"""dueppm as machine code of the Arduino Due, in an emulator: from messages on the line to edges of the signal."""

import itertools
import random
import struct

import due
import pytest

from rosserial_python import protocol

CONTROLS, PPM_STATUS = 100, 125
FRAME_US, CHANNELS, PULSE_US = 20000, 4, 250  # as shipped
STATUS = struct.Struct("<IIIIBI4HIIBfIfI")  # a PpmStatus of four channels
LAST_PERIOD_US = 900  # the shortest channel: an interrupt must not come later than that
HELD, HELD_US = (0.124, -0.456, 0.788, 0.2), (1562, 1272, 1600, 1894)  # a command of whole ticks, and its channels
SETTLED_US = 300_000  # until it is in the signal: the line is behind by then, and the slew limit takes 90 ms


def controls(phi, theta, psi, throttle, name=b"IRIS"):
    body = struct.pack("<IIII6sI", 1, 1700000000, 5, 6, b"cortex", 1)
    return protocol.encode(
        CONTROLS, body + struct.pack("<I", len(name)) + name + struct.pack("<4d", phi, theta, psi, throttle)
    )


@pytest.fixture(scope="module")
def shipped(tmp_path_factory):
    """(image, address of loop()) of the sketch as it is."""
    return due.build(due.FIRMWARE / "dueppm", tmp_path_factory.mktemp("shipped"))


def periods(board, pulse_high=False):
    """[(begin, length, length of its pulse)] of the signal, in ticks; the first pulse, which starts it, left out."""
    begins = [ticks for ticks, level in board.edges if level == pulse_high]
    ends = {before[0]: after[0] for before, after in itertools.pairwise(board.edges) if before[1] == pulse_high}
    found = [(begin, after - begin, ends[begin] - begin) for begin, after in itertools.pairwise(begins)]
    return found[1:]


def frames_us(board, channels=CHANNELS, frame_us=FRAME_US, pulse_us=PULSE_US, pulse_high=False):
    """[(begin, (channel times))] in microseconds, of signals in which every frame is well-formed."""
    found, now = [], []
    for begin, length, pulse in periods(board, pulse_high):
        assert pulse == pulse_us * due.TICKS_PER_US
        now.append((begin, length))
        if length > 2200 * due.TICKS_PER_US:
            assert length >= 3000 * due.TICKS_PER_US
            if found or len(now) == channels + 1:  # the first frame lacks what was before the first pulse
                assert len(now) == channels + 1
                assert sum(ticks for _, ticks in now) == frame_us * due.TICKS_PER_US
                times = tuple(ticks / due.TICKS_PER_US for _, ticks in now[:-1])
                assert all(900 <= time <= 2100 for time in times)
                found.append((now[0][0] / due.TICKS_PER_US, times))
            now = []
        assert len(now) <= channels
    return found


def fly(board, messages, every_us=22000):
    for message in messages:
        board.uart.receive(message)
        board.run(every_us)


def load(board, commands, rng):
    """Send messages back to back, with beginnings of packets between them."""
    for command in commands:
        false_start = bytes((0xFF, 0xFE, 200, 0, 55)) * rng.randrange(4)
        board.uart.receive(controls(*command) + false_start)
        board.run(14_000)


def statuses(board):
    """Fields of the PpmStatus messages that the board has sent."""
    payloads = [packet.payload for packet in packets(board) if packet.topic_id == PPM_STATUS]
    return [STATUS.unpack(payload) for payload in payloads]


def packets(board):
    data, found = bytes(board.uart.sent), []
    while data:
        length = struct.unpack_from("<H", data, 2)[0]
        packet, data = data[: length + protocol.OVERHEAD], data[length + protocol.OVERHEAD :]
        if len(packet) < length + protocol.OVERHEAD:
            break
        assert packet == protocol.encode(struct.unpack_from("<H", packet, 5)[0], packet[7:-1])
        found.append(protocol.Packet(struct.unpack_from("<H", packet, 5)[0], packet[7:-1]))
    return found


CONFIGURATIONS = [
    {},
    {"kChannels": 8, "kFrameUs": 20000},
    {"kChannels": 8, "kFrameUs": 22500, "kPulseUs": 400, "kPulseHigh": True},
    {
        "kChannels": 7,
        "kFrameUs": 22000,
        "kRollChannel": 7,
        "kThrottleChannel": 4,
        "kYawChannel": 1,
        "kPitchTravelUs": -450,
    },
]
BETWEEN = [  # of the second tier: nothing that is not in one of these
    {"kChannels": 5, "kFrameUs": 20500, "kPulseUs": 300},
    {"kChannels": 6, "kFrameUs": 22000, "kPulseHigh": True},
    {"kChannels": 7, "kFrameUs": 22500, "kPulseUs": 400, "kPulseHigh": True},
    {"kThrottleChannel": 1, "kRollChannel": 2, "kPitchChannel": 3},  # TAER
]


@pytest.mark.parametrize(
    "constants",
    [*CONFIGURATIONS, *(pytest.param(constants, marks=pytest.mark.release) for constants in BETWEEN)],
    ids=lambda constants: "-".join(map(str, constants.values())) or "shipped",
)
def test_every_channel_is_what_the_message_says(tmp_path, constants):
    board = due.Due(*due.build(due.configured(tmp_path, **constants), tmp_path))
    setting = {
        "kChannels": 4,
        "kFrameUs": 20000,
        "kPulseUs": 250,
        "kPulseHigh": False,
        "kRollChannel": 1,
        "kPitchChannel": 2,
        "kThrottleChannel": 3,
        "kYawChannel": 4,
        "kPitchTravelUs": 500,
    } | constants
    shape = [setting[name] for name in ("kChannels", "kFrameUs", "kPulseUs", "kPulseHigh")]

    def expected(phi, theta, psi, throttle_us):
        channels = [1500.0] * setting["kChannels"]
        channels[setting["kRollChannel"] - 1] += 500 * phi
        channels[setting["kPitchChannel"] - 1] += setting["kPitchTravelUs"] * theta
        channels[setting["kYawChannel"] - 1] += 500 * psi
        channels[setting["kThrottleChannel"] - 1] = throttle_us
        return pytest.approx(channels, abs=0.5 / due.TICKS_PER_US + 1e-9)  # half a tick, of the 1 us that is allowed

    board.run(60_000)
    assert frames_us(board, *shape)[-1][1] == expected(0, 0, 0, 950)
    fly(board, 6 * [controls(0, 0, 0, -1)])
    assert frames_us(board, *shape)[-1][1] == expected(0, 0, 0, 1000)
    for phi, theta, psi, throttle in ((0.123, -0.456, 0.789, 0.2), (-1, 1, -1, 1), (1, -1, 1, -1)):
        fly(board, 14 * [controls(phi, theta, psi, throttle)])
        assert frames_us(board, *shape)[-1][1] == expected(phi, theta, psi, 1500 + 500 * throttle)


def test_the_worst_jitter_of_a_channel(shipped, capsys):
    """Under the full load of the line: first with changing commands, then with a constant one, whose channels are
    known. The timer itself makes the edges: only a late interrupt could move them."""
    rng = random.Random(4)
    worst, off_us = {}, {"channel": [], "pulse": [], "frame": []}
    for priorities in (True, False):
        board = due.Due(*shipped, rng=rng, priorities=priorities)
        board.run(50_000)
        board.uart.receive(protocol.REQUEST_TOPICS)
        fly(board, 6 * [controls(0, 0, 0, -1)])
        load(board, [[rng.uniform(-0.1, 0.1) for _ in range(4)] for _ in range(40)], rng)
        settled_us = board.now / due.CYCLES_PER_US + SETTLED_US
        load(board, 45 * [HELD], rng)
        frames = frames_us(board)
        settled = [channels for begin, channels in frames if begin > settled_us]
        assert len(frames) > 60 and len(settled) > 14
        off_us["channel"] += [us - held_us for channels in settled for us, held_us in zip(channels, HELD_US)]
        off_us["pulse"] += [pulse / due.TICKS_PER_US - PULSE_US for _, _, pulse in periods(board)]
        off_us["frame"] += [after[0] - before[0] - FRAME_US for before, after in itertools.pairwise(frames)]
        worst[priorities] = max(board.entered_after) / due.CYCLES_PER_US, max(board.told_after) / due.CYCLES_PER_US
        told_us = statuses(board)[-1][15]
        assert 0 < told_us <= worst[priorities][1], "the board measures it too, after its first instructions"
        assert statuses(board)[-1][16] == 0
        assert max(board.told_after) / due.CYCLES_PER_US < LAST_PERIOD_US / 10
    most_us = {of: max(map(abs, errors_us)) for of, errors_us in off_us.items()}
    assert all(us < 1e-6 for us in most_us.values()), most_us
    with capsys.disabled():
        print(
            "\nPPM: worst jitter of %s; simulated, %d cycles an instruction; interrupt entered after %.1f us, period "
            "told after %.1f us of %d us (without priorities: %.1f, %.1f us)"
            % (
                ", ".join("a %s %.3f us (of %d)" % (of, us, len(off_us[of])) for of, us in most_us.items()),
                due.CYCLES,
                *worst[True],
                LAST_PERIOD_US,
                *worst[False],
            )
        )


def test_a_message_reaches_the_signal_within_its_way_over_the_line_and_two_frames(shipped, capsys):
    board = due.Due(*shipped, rng=random.Random(5))
    board.run(50_000)
    fly(board, 6 * [controls(0, 0, 0, -1)])
    delays_ms, rng = [], random.Random(6)
    for k in range(20):
        board.run(rng.randrange(20_000))
        sent_us, roll = board.now / due.CYCLES_PER_US, 0.05 if k % 2 else -0.05
        fly(board, [controls(roll, 0, 0, -1)], 60_000)
        found = [begin for begin, channels in frames_us(board) if begin > sent_us and channels[0] == 1500 + 500 * roll]
        delays_ms.append((found[0] - sent_us) / 1e3)
    line_ms = len(controls(0, 0, 0, 0)) * 10 / 57.6
    assert line_ms < min(delays_ms) and max(delays_ms) < line_ms + 2 * FRAME_US / 1e3
    with capsys.disabled():
        print(
            "\nPPM: from a message's first byte to the beginning of its frame %.1f ms on average, %.1f ms at most "
            "(simulated; %.1f ms of it on the line)" % (sum(delays_ms) / len(delays_ms), max(delays_ms), line_ms)
        )


def test_noise_does_not_reach_the_signal(shipped):
    board, rng = due.Due(*shipped, rng=random.Random(7)), random.Random(8)
    board.run(50_000)
    pieces = [b"\xff", b"\xfe", b"\xff\xfe", protocol.REQUEST_TOPICS, controls(1, 1, 1, 1)[:40], bytes(9), b"\x64\x00"]
    for _ in range(60):
        board.uart.receive(b"".join(rng.choice([*pieces, rng.randbytes(rng.randrange(60))]) for _ in range(3)))
        board.run(20_000)
    seen = frames_us(board)
    assert len(seen) > 50
    assert {channels for _, channels in seen} == {(1500, 1500, 950, 1500)}
    assert statuses(board)[-1][4] == 0  # WAITING
    assert board.uart.lost == 0


def test_silence_ends_in_failsafe_and_messages_are_believed_again(shipped):
    board = due.Due(*shipped)
    board.run(50_000)
    board.uart.receive(protocol.REQUEST_TOPICS)
    fly(board, 6 * [controls(0, 0, 0, -1)] + 20 * [controls(0.5, 0, 0, 0.2)])
    stopped_us = board.now / due.CYCLES_PER_US
    assert frames_us(board)[-1][1] == (1750, 1500, 1600, 1500)
    board.run(900_000)
    falls = [begin for begin, channels in frames_us(board) if begin > stopped_us and channels[2] < 1600]
    assert 440_000 < falls[0] - stopped_us < 500_000
    assert frames_us(board)[-1][1] == (1500, 1500, 950, 1500)
    assert statuses(board)[-1][4] == 3  # FAILSAFE
    fly(board, 20 * [controls(0.5, 0, 0, 0.2)])
    assert frames_us(board)[-1][1] == (1500, 1500, 950, 1500), "the throttle does not jump back"
    fly(board, 6 * [controls(0, 0, 0, -1)] + 20 * [controls(0.5, 0, 0, 0.2)])
    assert frames_us(board)[-1][1] == (1750, 1500, 1600, 1500)


def test_no_frame_mixes_two_messages(tmp_path, shipped):
    """Each message has one fraction for all sticks, and comes as a frame begins. A sketch without the second buffer
    mixes them: the control arm."""
    unprotected = due.configured(
        tmp_path,
        [
            ("sticks.h", "Goal& goal = goals_[next & 1];", "Goal& goal = goals_[0];"),
            ("sticks.h", "const Goal& goal = goals_[published & 1];", "const Goal& goal = goals_[0];"),
        ],
    )
    mixed = {}
    for name, build in (("shipped", shipped), ("unprotected", due.build(unprotected, tmp_path))):
        board = due.Due(*build, fine=True)
        board.run(50_000)
        fly(board, 6 * [controls(0, 0, 0, -1)])
        fly(board, 4 * [controls(-0.9, -0.9, -0.9, -0.9)])
        fraction = -0.9
        line_us = len(controls(0, 0, 0, 0)) * 10 / 57600 * 1e6
        for early_us in range(-20, 180, 5):
            fraction = -1.75 - fraction
            message = controls(fraction, fraction, fraction, fraction)
            begin = frames_us(board)[-1][0]
            to_frame = (begin - board.now / due.CYCLES_PER_US - line_us - early_us) % FRAME_US
            board.run(to_frame)
            board.uart.receive(message)
            board.run(line_us + 1000)
        board.run(40_000)
        ends = [channels for _, channels in frames_us(board)][14:]
        mixed[name] = sum(len(set(channels)) > 1 for channels in ends)
    assert mixed["shipped"] == 0
    assert mixed["unprotected"] > 0


def test_an_interrupt_that_is_kept_waiting_costs_one_period(tmp_path, shipped):
    """Interrupts are masked for longer than any period. Without a check of the counter the timer would run a full
    round of 102 s: the control arm."""
    naive = due.configured(tmp_path, [("firmware.h", "if (delay + kMargin > period) {", "if (false) {")])
    for build, survives in ((shipped, True), (due.build(naive, tmp_path), False)):
        board = due.Due(*build)
        board.run(50_000)
        board.uart.receive(protocol.REQUEST_TOPICS)
        board.run(20_000)
        board.masked_until = board.now + 20_000 * due.CYCLES_PER_US
        before = len(board.edges)
        board.run(200_000)
        assert (len(board.edges) > before + 40) is survives
        if survives:
            assert statuses(board)[-1][16] > 0  # late_periods
            lengths = [length for _, length, _ in periods(board)][-10:]
            assert sum(lengths) == 2 * FRAME_US * due.TICKS_PER_US


def led_of(board, *messages):
    """(flashes, time on [ms]) of a second of the LED, in which these messages come, in turn, every 20 ms."""
    turns, lit = itertools.cycle(messages), []
    for _ in range(50):
        if messages:
            board.uart.receive(next(turns))
        for _ in range(4):
            board.run(5000)
            lit.append(board.led())
    return sum(now and not before for before, now in zip(lit[-1:] + lit[:-1], lit)), 5 * sum(lit)


def test_the_led_tells_the_state(shipped):
    """As in the table of firmware/README.md."""
    board = due.Due(*shipped)
    board.run(50_000)
    lowest, refused = controls(0, 0, 0, -1), controls(0, 0, 0, 7.0)
    seen = {"no host": led_of(board)}
    board.uart.receive(protocol.REQUEST_TOPICS)
    board.run(50_000)
    seen["host, no command"] = led_of(board)
    fly(board, 3 * [lowest])
    seen["follows"] = led_of(board, lowest)
    led_of(board, lowest, refused)
    seen["refuses"] = led_of(board, lowest, refused)
    led_of(board)
    seen["failsafe"] = led_of(board)
    expected = {
        "no host": (1, 50),
        "host, no command": (1, 500),
        "follows": (0, 1000),
        "refuses": (2, 200),
        "failsafe": (5, 500),
    }
    assert seen == {
        what: (flashes, pytest.approx(on_ms, abs=5 * (flashes + 1))) for what, (flashes, on_ms) in expected.items()
    }


def test_both_ports_compile(tmp_path):
    sketch = due.configured(tmp_path, [("dueppm.ino", "// #define USE_USBCON", "#define USE_USBCON")])
    due.compile_only(sketch, tmp_path)
