"""The link to an autopilot in simulated time: which senders it accepts, what it sends when, loss and return."""

import random

import pytest
import scripted_autopilot
from bench import Bench
from pymavlink.dialects.v10 import ardupilotmega as version_1
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from roscopter import orders
from roscopter.autopilot import LOST_S, RELEASES, STOP_S

STICKS = (1400, 1600, 1200, 1500, 1000, 1800, 1500, 1500)
RELEASE = [0] * 8
SWITCH = 6  # channel


def overrides(bench):
    return [
        [getattr(message, "chan%d_raw" % k) for k in range(1, 9)]
        for message in bench.vehicle.named("RC_CHANNELS_OVERRIDE")
    ]


def heartbeat(bench, system, component=1, kind=mavlink.MAV_TYPE_QUADROTOR, autopilot=3, base_mode=209):
    packer = mavlink.MAVLink(None, system, component)
    bench.noise += mavlink.MAVLink_heartbeat_message(kind, autopilot, base_mode, 9, 4, 3).pack(packer)


@pytest.fixture(params=[1, 2], ids=["MAVLink 1", "MAVLink 2"])
def version(request):
    return request.param


# ------------------------------------------------------------------------------------------- heartbeats and streams


def test_a_ground_stations_heartbeat_every_second_from_the_start(version):
    bench = Bench(version).run(10.0)
    beats = bench.vehicle.named("HEARTBEAT")
    assert 9 <= len(beats) <= 11
    assert {(beat.type, beat.autopilot, beat.get_srcSystem()) for beat in beats} == {(6, 8, 255)}
    steps_s = [after - before for before, after in zip(bench.vehicle.beats, bench.vehicle.beats[1:])]
    assert max(steps_s) == pytest.approx(1.0, abs=0.06)


def test_it_talks_the_version_that_the_vehicle_talks(version):
    bench = Bench(version).connect().run(3.0)
    talked = {packet[0] for when_s, packet in bench.packets if when_s > bench.now_s - 2.0}
    assert talked == {0xFE if version == 1 else 0xFD}
    assert bench.autopilot.version == version


def test_the_first_words_are_version_1_which_everybody_understands():
    assert Bench(2).packets[0][1][0] == 0xFE


@pytest.mark.parametrize("rate_hz", [1, 4, 10])
def test_streams_come_at_the_rate_that_is_asked_and_the_battery_at_least_twice_a_second(version, rate_hz):
    bench = Bench(version, mavlink_rate=rate_hz).connect().run(20.0)
    bench.messages.clear()
    bench.run(10.0)
    for name, least_hz in (("ATTITUDE", rate_hz), ("SYS_STATUS", max(rate_hz, 2)), ("VFR_HUD", rate_hz)):
        assert len(bench.named(name)) == pytest.approx(10.0 * least_hz, rel=0.2), name
    assert bench.autopilot.missing_streams() == []


def test_a_stream_that_stays_away_is_asked_for_again_and_the_others_are_not(version):
    bench = Bench(version).connect().run(4.0)
    asked = {message.req_stream_id for message in bench.vehicle.named("REQUEST_DATA_STREAM")}
    assert asked == set(scripted_autopilot.STREAMS)
    bench.vehicle.heard.clear()
    bench.run(20.0)
    assert bench.vehicle.named("REQUEST_DATA_STREAM") == []  # all streams arrive
    del bench.vehicle._rates[mavlink.MAV_DATA_STREAM_EXTRA1]
    bench.run(10.0)
    again = [message.req_stream_id for message in bench.vehicle.named("REQUEST_DATA_STREAM")]
    assert set(again) == {mavlink.MAV_DATA_STREAM_EXTRA1}
    assert bench.autopilot.missing_streams() == []


def test_a_stream_that_never_comes_is_asked_for_ever_more_rarely():
    bench = Bench()
    bench.vehicle.slow = ("vfr_hud",)
    bench.connect().run(200.0)
    assert bench.autopilot.missing_streams() == ["EXTRA2"]
    asked = [m for m in bench.vehicle.named("REQUEST_DATA_STREAM") if m.req_stream_id == mavlink.MAV_DATA_STREAM_EXTRA2]
    assert 10 <= len(asked) <= 20


def test_channels_come_once_of_an_autopilot_that_sends_both():
    bench = Bench(version=1).connect().run(5.0)
    bench.messages.clear()
    bench.run(5.0)
    assert bench.named("RC_CHANNELS") and not bench.named("RC_CHANNELS_RAW")
    bench.vehicle.slow = ("rc_channels",)
    bench.run(10.0)
    assert bench.named("RC_CHANNELS_RAW")


# --------------------------------------------------------------------------------------------------- who is the vehicle


def test_others_on_the_link_are_not_the_vehicle(version):
    bench = Bench(version)
    bench.vehicle.is_silent = True
    heartbeat(bench, 255, 190, mavlink.MAV_TYPE_GCS, 8)  # another ground station
    heartbeat(bench, 1, 154, mavlink.MAV_TYPE_GIMBAL, 3)  # the vehicle's gimbal
    heartbeat(bench, 51, 68, mavlink.MAV_TYPE_GENERIC, 8)  # its radio
    bench.run(1.0)
    assert bench.autopilot.target is None and bench.messages == []
    bench.vehicle.is_silent = False
    bench.connect()
    assert bench.autopilot.target == (1, 1)
    heartbeat(bench, 1, 154, mavlink.MAV_TYPE_GIMBAL, 3)
    heartbeat(bench, 255, 190, mavlink.MAV_TYPE_GCS, 8)
    heartbeat(bench, 2)
    bench.run(3.0)
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in bench.messages} == {(1, 1)}
    assert bench.autopilot.mode == "STABILIZE" and not bench.autopilot.is_armed
    assert sum("system 2" in text for text in bench.said("warn")) == 1


@pytest.mark.parametrize("kind, warnings", [("ArduCopter", 0), ("ArduRover", 1)])
def test_a_type_that_does_not_fit_is_told(kind, warnings):
    bench = Bench(type=kind).connect()
    assert len(bench.said("warn")) == warnings


def test_a_second_vehicle_does_not_take_over_when_the_first_is_lost():
    bench = Bench().connect()
    bench.vehicle.is_silent = True
    for _ in range(10):
        heartbeat(bench, 2)
        bench.run(1.0)
    assert bench.autopilot.target == (1, 1) and not bench.autopilot.is_connected


# ------------------------------------------------------------------------------------------------- loss and return


def test_no_vehicle_is_one_line_and_it_is_found_whenever_it_comes():
    bench = Bench()
    bench.vehicle.is_silent = True
    bench.run(120.0)
    assert len(bench.reports) == 1 and "nothing" in bench.said("warn")[0]
    bench.vehicle.is_silent = False
    bench.connect()


@pytest.mark.parametrize("what, said", [("noise", "baud rate"), ("station", "system(s) 255"), ("frames", "heartbeat")])
def test_the_line_says_what_is_heard_instead(what, said):
    bench = Bench()
    bench.vehicle.is_silent = True
    if what == "noise":
        bench.noise += random.Random(1).randbytes(500)
    elif what == "station":
        heartbeat(bench, 255, 190, mavlink.MAV_TYPE_GCS, 8)
    else:
        bench.noise += mavlink.MAVLink_attitude_message(1, 0, 0, 0, 0, 0, 0).pack(mavlink.MAVLink(None, 1, 1))
    bench.run(10.0)
    assert said in bench.said("warn")[0]


def test_loss_and_return(version):
    bench = Bench(version).connect().run(5.0)
    bench.vehicle.is_silent = True
    lost_s = bench.until(lambda: not bench.autopilot.is_connected)
    assert lost_s == pytest.approx(LOST_S, abs=0.3)
    bench.run(60.0)
    assert len(bench.said("error")) == 1
    bench.vehicle.is_silent = False
    bench.until(lambda: bench.autopilot.is_connected, 2.0)
    assert bench.autopilot.counts["reconnects"] == 1


def test_a_vehicle_that_is_lost_and_comes_back_without_streams_is_asked_again(version):
    bench = Bench(version).connect().run(5.0)
    bench.vehicle.is_silent = True
    bench.run(5.0)
    bench.vehicle._rates.clear()
    bench.vehicle.is_silent = False
    bench.until(lambda: bench.autopilot.is_connected)
    bench.run(5.0)
    assert bench.autopilot.missing_streams() == []


def test_a_reboot_is_noticed_and_streams_come_again(version):
    bench = Bench(version).connect().run(5.0)
    outcomes = []
    bench.vehicle.answers[mavlink.MAV_CMD_COMPONENT_ARM_DISARM] = mavlink.MAV_RESULT_IN_PROGRESS
    bench.autopilot.begin(orders.Arm(True, 60.0), outcomes.append, bench.now_s)
    bench.vehicle.reboot()
    bench.run(8.0)
    assert bench.autopilot.counts["reboots"] == 1
    assert not outcomes[0].is_done and "rebooted" in outcomes[0].why
    assert bench.autopilot.missing_streams() == []


def test_a_device_that_is_gone_ends_orders_and_stops_heartbeats():
    bench = Bench().connect()
    outcomes = []
    bench.vehicle.is_deaf = True
    bench.autopilot.begin(orders.Arm(True, 60.0), outcomes.append, bench.now_s)
    bench.autopilot.closed(bench.now_s)
    assert not outcomes[0].is_done and "not there" in outcomes[0].why
    sent = len(bench.packets)
    bench.vehicle.is_silent = True
    bench.run(10.0)
    assert len(bench.packets) == sent
    bench.vehicle.is_silent = bench.vehicle.is_deaf = False
    bench.autopilot.opened(bench.now_s)
    bench.connect()


def test_lost_messages_are_counted():
    bench = Bench().connect().run(5.0)
    before = bench.autopilot.counts["lost messages"]
    bench.vehicle._encoder.seq = (bench.vehicle._encoder.seq + 7) % 256
    bench.run(1.0)
    assert bench.autopilot.counts["lost messages"] - before == 7


# ------------------------------------------------------------------------------------------------------- what it says


@pytest.mark.parametrize(
    "severity, level",
    [(0, "fatal"), (1, "fatal"), (2, "error"), (3, "error"), (4, "warn"), (5, "info"), (6, "info"), (7, "debug")],
)
def test_a_text_has_its_severity(version, severity, level):
    bench = Bench(version).connect()
    bench.vehicle.send("statustext", severity=severity, text=b"battery failsafe")
    bench.step()
    assert (level, "autopilot: battery failsafe") in bench.reports


def test_a_text_in_pieces_is_one_line():
    bench = Bench().connect()
    long = b"PreArm: " + b"0123456789" * 12
    pieces = [long[k : k + 50] for k in range(0, len(long), 50)]
    for number, piece in enumerate(pieces):
        bench.vehicle.send("statustext", severity=4, text=piece, id=7, chunk_seq=number)
    bench.step()
    assert bench.said("warn") == ["autopilot: " + long.decode()]


def test_a_text_whose_end_is_lost_is_told_all_the_same():
    bench = Bench().connect()
    bench.vehicle.send("statustext", severity=4, text=b"x" * 50, id=7, chunk_seq=0)
    bench.run(2.0)
    assert bench.said("warn") == ["autopilot: " + "x" * 50]


# ------------------------------------------------------------------------------------------------------- overrides


def send_for(bench, seconds, sticks=STICKS):
    for _ in range(round(10 * seconds)):
        bench.autopilot.override(sticks, bench.now_s, bench.now_s)
        bench.run(0.1)


def test_nothing_is_overridden_unless_that_is_enabled(version):
    """Control arm: the tests below, with the option on."""
    bench = Bench(version).connect()
    send_for(bench, 2.0)
    bench.autopilot.release(bench.now_s)
    bench.run(2.0)
    assert overrides(bench) == []
    assert len(bench.said("warn")) == 1 and "--enable-rc-control" in bench.said("warn")[0]


def test_eight_channels_arrive_unchanged(version):
    bench = Bench(version, enable_rc_control=True).connect()
    send_for(bench, 2.0)
    assert overrides(bench) == [list(STICKS)] * 20
    assert bench.vehicle.channels_us() == list(STICKS)


def test_channels_are_released_when_the_sender_falls_silent(version):
    bench = Bench(version, enable_rc_control=True).connect()
    send_for(bench, 1.0)
    bench.run(0.3)
    assert RELEASE not in overrides(bench)
    bench.run(0.3)
    assert RELEASE in overrides(bench)
    assert bench.vehicle.channels_us() == list(scripted_autopilot.RADIO_US)
    bench.run(3.0)
    assert overrides(bench)[10:] == [RELEASE] * RELEASES
    send_for(bench, 0.5)
    assert overrides(bench)[-1] == list(STICKS)  # the sender is back


def test_channels_are_given_back_once_a_lost_device_is_there_again():
    bench = Bench(enable_rc_control=True).connect()
    send_for(bench, 0.5)
    bench.autopilot.closed(bench.now_s)
    bench.vehicle.is_silent = True
    bench.run(3.0)
    assert RELEASE not in overrides(bench), "no autopilot would have received it"
    bench.vehicle.is_silent = False
    bench.autopilot.opened(bench.now_s)
    bench.run(2.0)
    assert overrides(bench)[-RELEASES - 1 :] == [list(STICKS), *[RELEASE] * RELEASES]


def test_the_time_to_release_is_an_option():
    bench = Bench(enable_rc_control=True, rc_timeout=2000).connect()
    send_for(bench, 0.5)
    bench.run(1.5)
    assert RELEASE not in overrides(bench)
    bench.run(1.0)
    assert RELEASE in overrides(bench)


def test_channels_are_given_back_at_the_end():
    bench = Bench(enable_rc_control=True).connect()
    bench.autopilot.send_last_words()
    bench.run(0.1)
    assert overrides(bench) == []
    send_for(bench, 0.2)
    bench.autopilot.send_last_words()
    bench.step()
    assert overrides(bench)[-1] == RELEASE


def test_values_that_are_no_channel_times_are_refused():
    bench = Bench(enable_rc_control=True).connect()
    for wrong in (700, 2500, 70000, 1):
        bench.autopilot.override((wrong, *STICKS[1:]), bench.now_s, bench.now_s)
    assert bench.autopilot.counts["refused send_rc"] == 4
    assert len(bench.said("warn")) == 1  # not one for each
    bench.autopilot.override((0, 65535, *STICKS[2:]), bench.now_s, bench.now_s)
    bench.run(0.1)
    assert overrides(bench) == [[0, 65535, *STICKS[2:]]]


def test_sticks_that_have_waited_for_the_device_are_not_sent():
    bench = Bench(enable_rc_control=True).connect()
    bench.autopilot.override(STICKS, bench.now_s - 0.6, bench.now_s)
    bench.run(0.1)
    assert overrides(bench) == []
    bench.autopilot.override(STICKS, bench.now_s - 0.4, bench.now_s)
    bench.run(0.1)
    assert overrides(bench) == [list(STICKS)]


def test_the_pilots_switch_gives_and_takes(version):
    options = {"enable_rc_control": True, "enable_autonomous_control": True, "autonomous_channel_id": SWITCH}
    bench = Bench(version, **options).connect().run(2.0)
    send_for(bench, 1.0)
    assert overrides(bench) == []
    bench.vehicle.radio_us[SWITCH - 1] = 1800
    bench.run(1.0)
    send_for(bench, 1.0)
    sent = overrides(bench)
    assert len(sent) == 10 and sent[0][SWITCH - 1] == 65535  # the switch stays the pilot's
    assert bench.vehicle.channels_us()[0] == STICKS[0]
    bench.vehicle.radio_us[SWITCH - 1] = 1000
    send_for(bench, 1.0)
    assert overrides(bench)[-1] == RELEASE
    assert bench.vehicle.channels_us()[0] == scripted_autopilot.RADIO_US[0]


def test_a_switch_that_is_not_heard_is_off():
    bench = Bench(enable_rc_control=True, enable_autonomous_control=True)
    bench.vehicle.radio_us[SWITCH - 1] = 1800
    bench.connect().run(2.0)
    send_for(bench, 0.5)
    bench.vehicle.slow = ("rc_channels", "rc_channels_raw")
    send_for(bench, 3.0)
    assert overrides(bench)[-1] == RELEASE


# ------------------------------------------------------------------------------------------------------- watchdog


def fly(bench, seconds, is_fed):
    for _ in range(round(4 * seconds)):
        if is_fed:
            bench.autopilot.feed_watchdog(True, bench.now_s)
        bench.autopilot.override(STICKS, bench.now_s, bench.now_s)
        bench.run(0.25)


@pytest.mark.parametrize("is_enabled", [True, False])
def test_the_watchdog_takes_the_sticks_away(is_enabled):
    bench = Bench(enable_rc_control=True, enable_watchdog=is_enabled).connect()
    fly(bench, 5.0, is_fed=True)
    assert overrides(bench)[-1] == list(STICKS)
    fly(bench, 6.0, is_fed=False)
    assert overrides(bench)[-1] == (RELEASE if is_enabled else list(STICKS))
    assert bench.vehicle.mode == 0  # --enable-ros-failsafe is off
    fly(bench, 1.0, is_fed=True)
    assert overrides(bench)[-1] == list(STICKS)


@pytest.mark.parametrize("kind, mode", [("ArduCopter", 9), ("ArduRover", 4)])
def test_the_failsafe_lands_once(kind, mode):
    options = {"enable_watchdog": True, "enable_ros_failsafe": True, "type": kind}
    bench = Bench(**options).connect()
    bench.run(6.0)
    assert bench.vehicle.mode == 0  # disarmed: nothing to land
    bench.vehicle.is_armed = True
    bench.run(6.0)
    assert bench.vehicle.mode == mode
    bench.vehicle.mode = 2  # the pilot takes over
    bench.run(10.0)
    assert bench.vehicle.mode == 2


def test_false_on_the_watchdog_counts_at_once():
    bench = Bench(enable_watchdog=True, enable_ros_failsafe=True).connect()
    bench.vehicle.is_armed = True
    bench.autopilot.feed_watchdog(True, bench.now_s)
    bench.run(1.5)
    bench.autopilot.feed_watchdog(False, bench.now_s)
    bench.run(0.1)
    assert bench.vehicle.mode == 9


def test_the_failsafe_does_not_wait_for_an_order_that_waits():
    bench = Bench(enable_watchdog=True, enable_ros_failsafe=True).connect()
    bench.vehicle.is_armed = True
    bench.vehicle.answers[mavlink.MAV_CMD_COMPONENT_ARM_DISARM] = mavlink.MAV_RESULT_IN_PROGRESS
    bench.autopilot.begin(orders.Arm(False, 60.0), lambda _outcome: None, bench.now_s)
    bench.run(5.0)
    assert bench.vehicle.mode == 9


def test_a_device_that_comes_and_goes_does_not_feed_the_watchdog():
    bench = Bench(enable_watchdog=True).connect()
    for _ in range(8):
        bench.autopilot.closed(bench.now_s)
        bench.autopilot.opened(bench.now_s)
        bench.run(0.5)
    assert any("watchdog" in text for text in bench.said("error"))


# ---------------------------------------------------------------------------------------------------- emergency stop


def kills(bench):
    return [(m.command, m.param1, m.param2) for m in bench.vehicle.named("COMMAND_LONG")]


def test_the_emergency_stop_goes_out_at_once_and_until_the_vehicle_is_disarmed(version):
    bench = Bench(version).connect()
    bench.vehicle.is_armed = True
    bench.run(2.0)
    before = len(bench.packets)
    bench.autopilot.emergency_stop(bench.now_s)
    assert len(bench.packets) == before + 1  # without waiting for anything
    bench.run(STOP_S + 1.0)
    assert set(kills(bench)) == {(400, 0.0, 21196.0)} and not bench.vehicle.is_armed
    count = len(kills(bench))
    assert 5 <= count <= 12
    bench.run(5.0)
    assert len(kills(bench)) == count


def test_the_emergency_stop_wins_against_a_bad_radio():
    bench = Bench().connect()
    bench.vehicle.is_armed, bench.vehicle.ignores = True, 10
    bench.run(2.0)
    bench.autopilot.emergency_stop(bench.now_s)
    bench.run(STOP_S)
    assert not bench.vehicle.is_armed


def test_an_emergency_stop_that_is_not_confirmed_is_told():
    bench = Bench().connect()
    bench.vehicle.is_armed, bench.vehicle.obeys_disarm = True, False
    bench.run(2.0)
    bench.autopilot.emergency_stop(bench.now_s)
    bench.run(STOP_S + 0.2)
    assert 18 <= len(kills(bench)) <= 21
    assert "does not tell" in bench.said("error")[-1]


def test_an_emergency_stop_ends_an_order_to_arm_and_forbids_a_new_one():
    bench = Bench().connect()
    arm, again = [], []
    bench.vehicle.answers[400] = mavlink.MAV_RESULT_IN_PROGRESS
    bench.autopilot.begin(orders.Arm(True, 10.0), arm.append, bench.now_s)
    bench.autopilot.emergency_stop(bench.now_s)
    assert len(arm) == 1 and not arm[0].is_done
    bench.autopilot.begin(orders.Arm(True, 10.0), again.append, bench.now_s)
    assert not again[0].is_done
    bench.run(4.0)
    assert kills(bench).count((400, 1.0, 0.0)) == 1


def test_an_emergency_stop_goes_on_when_the_node_ends():
    bench = Bench().connect()
    bench.vehicle.ignores, bench.vehicle.is_armed = 1, True
    bench.autopilot.emergency_stop(bench.now_s)
    bench.autopilot.send_last_words()
    bench.step()
    assert not bench.vehicle.is_armed


def test_an_emergency_stop_takes_the_sticks_away():
    bench = Bench(enable_rc_control=True).connect()
    bench.vehicle.is_armed, bench.vehicle.obeys_disarm = True, False
    send_for(bench, 1.0)
    bench.autopilot.emergency_stop(bench.now_s)
    send_for(bench, 1.0)
    assert overrides(bench)[10:] == [RELEASE] * RELEASES


def test_an_emergency_stop_goes_to_everybody_when_no_vehicle_was_heard():
    bench = Bench()
    bench.vehicle.is_silent = True
    bench.vehicle.is_armed = True
    bench.run(1.0)
    bench.autopilot.emergency_stop(bench.now_s)
    bench.run(1.0)
    assert not bench.vehicle.is_armed
    assert {message.target_system for message in bench.vehicle.named("COMMAND_LONG")} == {0}


def test_an_emergency_stop_goes_to_a_vehicle_that_is_silent():
    bench = Bench().connect()
    bench.vehicle.is_armed = bench.vehicle.is_silent = True
    bench.run(10.0)
    bench.autopilot.emergency_stop(bench.now_s)
    bench.run(0.1)
    assert not bench.vehicle.is_armed


# ------------------------------------------------------------------------------------------------- damaged telemetry


@pytest.mark.parametrize("dialect", [version_1, mavlink])
def test_damaged_bytes_never_become_a_message(dialect, inputs):
    """Every message that is decoded was sent: no wrong battery, no wrong mode."""
    numbers = random.Random(3)
    bench = Bench(1 if dialect is version_1 else 2).connect().run(3.0)
    packer = dialect.MAVLink(None, 1, 1)
    sent = set()
    bench.vehicle.is_silent = True
    for _ in range(inputs(2000, 50_000)):
        packer.seq = numbers.randrange(256)
        angles = [numbers.uniform(-1.0, 1.0) for _ in range(6)]
        frame = dialect.MAVLink_attitude_message(100_000, *angles).pack(packer)
        sent.add(frame)
        frame = bytearray(frame)
        if numbers.random() < 0.5:
            frame[numbers.randrange(len(frame))] ^= 1 << numbers.randrange(8)
        bench.messages.clear()
        bench.messages += bench.autopilot.receive(bytes(frame), bench.now_s)
        assert {bytes(message.get_msgbuf()) for message in bench.messages} <= sent


@pytest.mark.parametrize("dialect", [version_1, mavlink], ids=["MAVLink 1", "MAVLink 2"])
def test_no_sound_message_whatever_is_in_it_stops_the_link(dialect, inputs):
    """Every message of the dialect with random content, from the vehicle, while orders run."""
    numbers = random.Random(7)
    version = 1 if dialect is version_1 else 2
    bench = Bench(version, enable_rc_control=True, enable_autonomous_control=True, enable_watchdog=True).connect()
    bench.vehicle.is_silent = True
    outcomes = []
    for kind in dialect.mavlink_map.values():
        for _ in range(inputs(2, 40)):
            bench.autopilot.begin(orders.Arm(True, 3.0), outcomes.append, bench.now_s)
            bench.autopilot.send_mission([orders.Item(16)] * 3, outcomes.append, bench.now_s)
            size = kind.unpacker.size
            payload = bytes(numbers.choice((0, 255, numbers.randrange(256))) for _ in range(size))
            frame = bytearray(
                bytes([0xFE, size, numbers.randrange(256), 1, 1, kind.id])
                if version == 1
                else bytes([0xFD, size, 0, 0, numbers.randrange(256), 1, 1, *kind.id.to_bytes(3, "little")])
            )
            frame += payload
            checksum = dialect.x25crc(frame[1:] + bytes([kind.crc_extra])).crc
            bench.noise += frame + checksum.to_bytes(2, "little")
            before = bench.autopilot.reader.frames
            bench.step()
            assert bench.autopilot.reader.frames == before + 1, kind.msgname
    assert len(outcomes) > 100
