"""Effects of each fault on frames, vehicles, links and hosts, in simulated time."""

import math
import socket

import numpy as np
import pytest
from addresses import own_net
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from test_injector import FRAME_S, Lab

from ardrone_autonomy.protocol.navdata import Navdata, Tag, peek
from cortex_ros import wire
from risc_lab.lab import load_fleet
from risc_lab.lab.yaml_reader import package_file
from risc_simulator.faults import parse_fault
from risc_simulator.models.flight import FlightPhase, Setpoint
from risc_simulator.vehicles.iris.firmware import RcFrame
from risc_simulator.vehicles.iris.host import system_id
from risc_simulator.virtual_lab import VirtualLab
from risc_simulator.wires import Wires
from risc_simulator.world import X


def picture(text, vehicles=3, seed=1, frames=1):
    """(Lab, [(exact, seen)]) of frames, 5 ms apart, while the fault `text` acts."""
    lab, found = Lab(vehicles, seed), []
    lab.add(text)
    for _ in range(frames):
        exact = lab.exact()
        (seen,) = lab.seen(exact)
        found.append((exact, seen))
        lab.run(FRAME_S)
    return lab, found


def others_are_as_they_were(lab, exact, seen, meant="risc2"):
    for name in lab.world.vehicles:
        if name != meant:
            np.testing.assert_array_equal(lab.markers(seen, name), lab.markers(exact, name))
    count = sum(len(vehicle.markers_m) for vehicle in lab.world.vehicles.values())
    np.testing.assert_array_equal(seen.markers_m[count:], exact.markers_m[count:])


# --- frames


def test_marker_swap_exchanges_the_same_two_labels():
    lab, found = picture("marker_swap:risc2", frames=3)
    swapped = set()
    for exact, seen in found:
        before, after = lab.markers(exact, "risc2"), lab.markers(seen, "risc2")
        wrong = np.flatnonzero((before != after).any(axis=1))
        assert len(wrong) == 2
        np.testing.assert_array_equal(after[wrong], before[wrong[::-1]])
        swapped.add(tuple(wrong))
        others_are_as_they_were(lab, exact, seen)
    assert len(swapped) == 1


def test_marker_swap_with_a_probability_comes_and_goes_with_other_labels():
    lab, found = picture("marker_swap:9,risc2,severity=0.2", frames=1000)
    swapped = [
        tuple(np.flatnonzero((lab.markers(a, "risc2") != lab.markers(b, "risc2")).any(axis=1))) for a, b in found
    ]
    share = sum(map(bool, swapped)) / len(swapped)
    assert 0.15 < share < 0.25 and {len(labels) for labels in swapped} == {0, 2}
    assert len(set(swapped)) > 4


def test_name_exchange_exchanges_two_vehicles():
    lab, ((exact, seen),) = picture("name_exchange:risc2")
    changed = [name for name in lab.world.vehicles if (lab.markers(seen, name) != lab.markers(exact, name)).any()]
    assert len(changed) == 2 and "risc2" in changed
    counts = [len(lab.world.vehicles[name].markers_m) for name in changed]
    least = min(counts)
    for one, other in (changed, changed[::-1]):
        np.testing.assert_array_equal(lab.markers(seen, one)[:least], lab.markers(exact, other)[:least])
        assert np.isnan(lab.markers(seen, one)[least:]).all()
    with pytest.raises(ValueError, match="one vehicle.* two"):
        Lab(1).add("name_exchange")


def test_ghost_marker_takes_a_label_and_the_marker_goes_without():
    lab, ((exact, seen),) = picture("ghost_marker:0.2,risc2")
    moved_m = np.linalg.norm(lab.markers(seen, "risc2") - lab.markers(exact, "risc2"), axis=1)
    assert sorted(moved_m) == pytest.approx([0.0] * (len(moved_m) - 1) + [0.2])
    np.testing.assert_array_equal(seen.unidentified_m, lab.markers(exact, "risc2")[[moved_m.argmax()]])
    others_are_as_they_were(lab, exact, seen)


@pytest.mark.parametrize("angle_deg", [180.0, 90.0, -30.0])
def test_flip_turns_a_body_about_its_own_vertical_axis(angle_deg):
    """The body is tilted, so its vertical axis is not that of the room."""
    lab = Lab()
    vehicle = lab.world.vehicles["risc2"]
    vehicle.schedule(0.0, Setpoint(roll_rad=0.3, pitch_rad=-0.2))
    lab.run(0.3)
    lab.add("flip:risc2,severity=%g" % angle_deg)
    exact = lab.exact()
    (seen,) = lab.seen(exact)
    lab.world._x[X.PHI : X.PSI + 1, 1] = turned(lab.world._x[X.PHI : X.PSI + 1, 1], math.radians(angle_deg))
    expected = lab.markers(lab.exact(), "risc2")
    np.testing.assert_allclose(lab.markers(seen, "risc2"), expected, atol=1e-9)
    others_are_as_they_were(lab, exact, seen)


def turned(euler_rad, angle_rad):
    """Roll, pitch and yaw after a turn about the body's down axis."""
    (f, t, p), (c, s) = euler_rad, (math.cos(angle_rad), math.sin(angle_rad))
    cf, sf, ct, st, cp, sp = (function(a) for a in (f, t, p) for function in (math.cos, math.sin))
    body_to_room = np.array(
        [
            [ct * cp, sf * st * cp - cf * sp, cf * st * cp + sf * sp],
            [ct * sp, sf * st * sp + cf * cp, cf * st * sp - sf * cp],
            [-st, sf * ct, cf * ct],
        ]
    ) @ [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    r = body_to_room
    return math.atan2(r[2, 1], r[2, 2]), -math.asin(r[2, 0]), math.atan2(r[1, 0], r[0, 0])


def test_flip_of_a_body_of_which_too_little_is_seen_changes_nothing():
    lab = Lab()
    lab.add("flip:risc2")
    exact = lab.exact()
    lab.markers(exact, "risc2")[2:] = np.nan
    np.testing.assert_array_equal(lab.seen(exact)[0].markers_m, exact.markers_m)


def test_freeze_repeats_the_picture_under_fresh_times():
    lab, found = picture("freeze:risc2", frames=3)
    lab.world.vehicles["risc1"].schedule(0.0, Setpoint(pitch_rad=-0.2))
    for exact, seen in found:
        np.testing.assert_array_equal(lab.markers(seen, "risc2"), lab.markers(found[0][0], "risc2"))
        others_are_as_they_were(lab, exact, seen)
        assert seen.time_s == exact.time_s
    lab, found = picture("freeze", frames=3)
    for exact, seen in found:
        np.testing.assert_array_equal(seen.markers_m, found[0][0].markers_m)
        assert seen.time_s == exact.time_s


@pytest.mark.parametrize("share, hidden", [(1.0, None), (0.5, 0.5), (0.0, 0.0)])
def test_occlusion_hides_the_same_share_of_the_markers(share, hidden):
    lab, found = picture("occlusion:risc2,severity=%g" % share, frames=3)
    lost = [np.isnan(lab.markers(seen, "risc2")).all(axis=1) for _, seen in found]
    assert all((one == lost[0]).all() for one in lost)
    assert lost[0].sum() == round(share * len(lost[0]))
    others_are_as_they_were(lab, *found[0])


def test_garbage_is_elsewhere_in_each_frame():
    lab, found = picture("garbage:risc2", frames=2)
    first, second = (lab.markers(seen, "risc2") for _, seen in found)
    assert np.abs(first - second).max() > 0.5 and np.abs(first).max() <= 3.0
    others_are_as_they_were(lab, *found[0])


def test_clock_step_moves_the_time_of_frames():
    (_, ((exact, older),)), (_, ((_, younger),)) = picture("clock_step:1"), picture("clock_step:-1")
    assert (older.time_s, younger.time_s) == (exact.time_s - 1.0, exact.time_s + 1.0)
    np.testing.assert_array_equal(older.markers_m, exact.markers_m)


def test_wrong_unit_and_wrong_axes_change_all_that_is_seen():
    lab, ((exact, seen),) = picture("wrong_unit:0.001")
    np.testing.assert_allclose(seen.markers_m, 1e-3 * exact.markers_m)
    lab, ((exact, seen),) = picture("wrong_axes")
    np.testing.assert_array_equal(seen.markers_m[:, 1], exact.markers_m[:, 2])
    np.testing.assert_array_equal(seen.markers_m[:, 0], exact.markers_m[:, 0])
    np.testing.assert_array_equal(seen.markers_m[:, 2], -exact.markers_m[:, 1])  # turned, not mirrored


@pytest.mark.parametrize("name, axis, value_m", [("nan_markers", 1, math.nan), ("sentinel_markers", 0, 9999.999)])
def test_bad_coordinates_are_in_packets_and_in_frames(name, axis, value_m):
    lab = Lab()
    exact = lab.exact()
    lab.add("%s:risc2" % name)
    arrived = []
    lab.stream.carry(exact, None, 0.0, lambda seen, *_: arrived.append(seen))
    bad = lab.markers(arrived[0], "risc2")
    np.testing.assert_array_equal(bad[:, axis], value_m)
    np.testing.assert_array_equal(np.delete(bad, axis, 1), np.delete(lab.markers(exact, "risc2"), axis, 1))
    others_are_as_they_were(lab, exact, arrived[0])
    packet, _ = wire.FrameEncoder(exact.layout, 1000.0).encode(7, exact.markers_m)
    lab.stream.carry(bytes(packet), None, 0.0, lambda seen, *_: arrived.append(seen))
    changed_bytes = np.flatnonzero(np.frombuffer(packet, np.uint8) != np.frombuffer(arrived[1], np.uint8))
    count = len(bad)
    assert 0 < len(changed_bytes) <= 4 * count and np.ptp(changed_bytes) < 12 * count
    frame = wire.decode_frame(wire.split_packet(arrived[1])[1])  # no client can take it for valid
    for body in frame.bodies:
        assert np.isnan(body.markers_mm).all() == (body.name == lab.world.vehicles["risc2"].template)
    reply = wire.encode_packet(wire.Command.GENERAL_REPLY, bytes(packet[4:]))
    lab.stream.carry(reply, None, 0.0, lambda data, *_: arrived.append(data))
    assert arrived[2] == reply, "other packets stay"


def test_bad_coordinates_may_be_those_of_a_share_of_the_markers():
    lab, bad = Lab(), []
    lab.add("nan_markers:risc2,severity=0.3,duration_s=60")
    for _ in range(400):
        lab.stream.carry(lab.exact(), None, 0.0, lambda seen, *_: bad.append(lab.markers(seen, "risc2")[:, 1]))
    assert np.isnan(bad).mean() == pytest.approx(0.3, abs=0.05)


# --- streams of datagrams


def arrivals(text, duration_s=60.0, channel="cortex/stream"):
    """Arrival times [s] of datagrams that are sent every 5 ms."""
    wires = Wires(1)
    one, found = wires.wire(channel), []
    wires.add(parse_fault(text))
    for k in range(round(duration_s / FRAME_S)):
        one.carry(k, None, k * FRAME_S, lambda data, _, at_s: found.append(at_s))
    return np.array(found)


def test_loss_is_a_share_one_by_one():
    assert len(arrivals("loss:0.3,duration_s=inf")) / 12000 == pytest.approx(0.7, abs=0.02)


@pytest.mark.parametrize("length_s", [0.02, 0.2, 1.0])
def test_bursts_are_silences_of_one_length(length_s):
    gaps_s = np.diff(arrivals("burst:%g,duration_s=inf" % length_s))
    silences_s = gaps_s[gaps_s > 1.5 * FRAME_S]
    np.testing.assert_allclose(silences_s, length_s, atol=1.01 * FRAME_S)
    assert 60.0 / (7.0 * length_s) < len(silences_s) < 60.0 / (1.5 * length_s)


@pytest.mark.parametrize("share", [0.1, 0.3, 0.7])
def test_intermittent_is_silent_for_its_share_of_the_time(share):
    times_s = arrivals("intermittent:%g,duration_s=inf" % share, 200.0)
    assert len(times_s) / 40000 == pytest.approx(1.0 - share, abs=0.05)
    silences_s = np.diff(times_s)[np.diff(times_s) > 1.5 * FRAME_S]
    assert 400 < len(silences_s) < 1000 and np.ptp(silences_s) > 0.1


# --- vehicles


def test_a_low_battery_holds_no_more_and_does_not_recover():
    lab = Lab()
    one, other = lab.world.vehicles["risc1"], lab.world.vehicles["risc2"]
    lab.add("battery_low:20,risc1,duration_s=0.5")
    lab.run(1.0)
    assert one.battery_pct == pytest.approx(20.0, abs=0.3) and other.battery_pct > 99.0
    lab.add("battery_low:50,risc1")
    lab.run(0.1)
    assert one.battery_pct < 20.0, "it charges nothing"


def test_a_failing_battery_empties_at_its_rate():
    lab = Lab()
    lab.add("battery_failing:10,risc1@0.5")
    lab.run(2.5)
    assert lab.world.vehicles["risc1"].battery_pct == pytest.approx(80.0, abs=0.6)


def test_a_lost_motor_cuts_those_of_an_ardrone():
    lab = Lab()
    lab.add("motor_loss:risc1@0.5")
    lab.run(0.6)
    vehicle = lab.world.vehicles["risc1"]
    assert vehicle.phase is FlightPhase.EMERGENCY and vehicle.state.motor_pwm == (0, 0, 0, 0)
    lab.run(1.0)
    assert vehicle.height_m < 0.1 and [v.phase for v in lab.world.vehicles.values()][1:] == [FlightPhase.HOVERING] * 2


def test_a_lost_motor_turns_an_iris_over():
    lab = Lab(kind="iris")
    lab.add("motor_loss:risc1@0.1")
    vehicle, rolls = lab.world.vehicles["risc1"], []
    lab.run(0.1)
    for _ in range(60):
        lab.run(FRAME_S)
        rolls.append(abs(vehicle.state.phi))
    assert max(rolls) > 1.0 and rolls == sorted(rolls) and vehicle.state.motor_pwm[0] > 0
    lab.run(0.5)
    assert [crash.namespace for crash in lab.world.crashes] == ["risc1"]


def test_a_pilot_who_takes_over_stops_it_and_stays_whatever_is_sent():
    lab = Lab(1, kind="iris")
    vehicle = lab.world.vehicles["risc1"]

    def fly(duration_s):
        for _ in range(round(duration_s / FRAME_S)):
            vehicle.schedule(lab.world.time_s, RcFrame((1500, 1450, 1440, 1500)))  # forward, and a little up
            lab.run(FRAME_S)

    fly(0.8)
    speed_m_s, height_m = np.linalg.norm(vehicle.state.velocity_m_s), vehicle.height_m
    lab.add("pilot_takeover:2,risc1,severity=0.2")
    fly(1.9)
    assert speed_m_s > 0.3 and np.linalg.norm(vehicle.state.velocity_m_s) < 0.3 * speed_m_s
    assert abs(vehicle.height_m - height_m) < 0.5 and vehicle.firmware.channels_us[1] > 1490
    fly(0.4)
    assert vehicle.firmware.channels_us == (1500, 1450, 1440, 1500, 0, 0, 0, 0)


def test_gusts_rise_to_their_speed_and_fall_again():
    lab = Lab()
    lab.add("gust:3,risc1,duration_s=6@0.5")
    found = []
    for _ in range(1400):
        lab.run(FRAME_S)
        found.append(lab.world._u[6:9].copy())
    speeds = np.linalg.norm(np.array(found)[:, :, 0], axis=1)
    assert speeds.max() == pytest.approx(3.0, abs=0.01) and np.abs(np.diff(speeds)).max() < 0.12
    assert (speeds[:99] == 0.0).all() and (speeds[1301:] < 1e-12).all()
    assert 3 <= (np.diff(np.sign(np.diff(speeds))) < 0).sum() <= 13
    assert not np.array(found)[:, :, 1:].any()


def test_added_mass_sinks_until_the_loop_has_learned_it_and_goes_again():
    lab = Lab(1)
    vehicle = lab.world.vehicles["risc1"]
    mass_kg, height_m = vehicle.plant.mass_kg, vehicle.height_m
    lab.add("added_mass:0.2,duration_s=1")
    lab.run(0.5)
    assert vehicle.plant.mass_kg == pytest.approx(1.2 * mass_kg) and vehicle.height_m < height_m - 0.01
    felt_n = -vehicle.plant.mass_kg * vehicle.state.specific_force_m_s2[2]
    assert felt_n == pytest.approx(1.2 * mass_kg * 9.81, rel=0.1)
    lab.run(1.0)
    assert vehicle.plant.mass_kg == pytest.approx(mass_kg, rel=1e-12)


# --- what vehicles say, links and hosts of the virtual lab


@pytest.fixture
def lab(clock):
    """(Virtual lab of two AR.Drones and an IRIS+, whose steps advance the clock; socket of a client)."""
    lab = VirtualLab(default_fleet_of("mixed3.yaml"), subnet=own_net(), seed=3, live=True)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(5.0)
        yield lab, client
    lab.close()


def default_fleet_of(name):
    return load_fleet(package_file("..", "launch/fleets") / name)


def steps(lab, duration_s):
    for _ in range(round(duration_s / FRAME_S)):
        lab.step()


def ask(client, address, packet, lab):
    """Return the host's answer within 20 steps, or None."""
    client.setblocking(False)
    client.sendto(packet, address)
    for _ in range(20):
        lab.step()
        try:
            return client.recv(65536)
        except BlockingIOError:
            pass
    return None


HELLO = wire.encode_identity(wire.Command.HELLO_WORLD, wire.Identity("test", (1, 1, 0, 0)))


def test_the_cortex_host_is_gone_and_comes_again_with_nothing_known(lab):
    lab, client = lab
    host, address = lab.cortex_host, lab.cortex_host.address
    host._live_on_start = False  # as when a client has started the stream
    steps(lab, 0.1)
    assert ask(client, address, HELLO, lab) and host.statistics()["clients"] == 1
    lab.inject(parse_fault("host_restart:0.5"))
    steps(lab, 0.02)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(address)  # the address is free
    sent = host.statistics()["frames_sent"]
    assert ask(client, address, HELLO, lab) is None and host.statistics()["frames_sent"] == sent
    steps(lab, 0.6)
    assert host.address == address and ask(client, address, HELLO, lab)
    assert host.statistics()["clients"] == 1 and not host.live and host.statistics()["frames_sent"] == sent
    assert ask(client, address, wire.encode_text(wire.Command.GENERAL_REQUEST, "LiveMode"), lab)
    steps(lab, 0.1)
    assert 0 < host._number <= 60 and host.statistics()["frames_sent"] > sent


def test_a_cortex_host_whose_address_is_taken_waits_for_it(lab):
    lab, client = lab
    address = lab.cortex_host.address
    lab.inject(parse_fault("host_restart:0.1"))
    steps(lab, 0.02)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as thief:
        thief.bind(address)
        steps(lab, 1.5)
        assert lab.cortex_host.sockets() == []
    steps(lab, 1.1)
    assert ask(client, address, HELLO, lab)


def heard(lab, client, duration_s, says, every_s=0.2):
    """Datagrams that arrive while the lab runs; says() gives the (address, datagram) pairs to send every every_s."""
    found = []
    client.setblocking(False)
    for k in range(round(duration_s / FRAME_S)):
        if k % round(every_s / FRAME_S) == 0:
            for address, datagram in says():
                client.sendto(datagram, address)
        lab.step()
        try:
            while True:
                found.append(client.recv(65536))
        except BlockingIOError:
            pass
    return found


def test_an_ardrone_repeats_what_it_said_and_then_its_link_is_gone(lab):
    lab, client = lab
    host = lab.vehicle_hosts["risc1"]
    navdata, at = (host.address, host.ports.navdata), (host.address, host.ports.at)

    def says():
        yield navdata, b"\x01\0\0\0"
        for k, command in enumerate((b'CONFIG=%d,"general:navdata_demo","FALSE"', b"CTRL=%d,5,0", b"COMWDG=%d")):
            yield at, b"AT*" + command % (3 * lab.frame + k + 1) + b"\r"

    def times(packets):
        return {Navdata(packet).option(Tag.TIME) for packet in packets}

    heard(lab, client, 0.4, says)
    fresh = heard(lab, client, 0.4, says)
    lab.inject(parse_fault("navdata_freeze:risc1,duration_s=0.85"))
    stuck = heard(lab, client, 0.8, says)
    assert len(times(fresh)) > 60 and len(stuck) > 120 and len(times(stuck)) == 1, "and the check sum fits"
    numbers = [peek(packet).sequence for packet in fresh + stuck]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    lab.inject(parse_fault("link_blackhole:0.65,risc1"))
    assert len(heard(lab, client, 0.6, says)) <= 1  # it was in transit
    assert len(times(heard(lab, client, 0.4, says))) > 60


def test_an_iris_repeats_what_it_said_and_its_cable_stays(lab):
    lab, client = lab
    (name,) = (name for name, vehicle in lab.world.vehicles.items() if vehicle.type.name == "iris")
    host, codec = lab.vehicle_hosts[name], mavlink.MAVLink(None, 255, 190)

    def says():
        for message in (
            codec.heartbeat_encode(6, 8, 0, 0, 4),
            codec.request_data_stream_encode(system_id(host.address), 1, mavlink.MAV_DATA_STREAM_EXTRA1, 20, 1),
        ):
            yield (host.address, host.ports.telemetry), message.pack(codec)

    def messages(duration_s):
        parser, found = mavlink.MAVLink(None), []
        for datagram in heard(lab, client, duration_s, says):
            found += parser.parse_buffer(datagram) or []  # raises on damaged data
        return found

    def times(messages):
        return [message.time_boot_ms for message in messages if message.get_type() == "ATTITUDE"]

    messages(1.0)
    fresh = times(messages(1.0))
    lab.inject(parse_fault("navdata_freeze:%s,duration_s=2.1" % name))
    stuck = messages(2.0)
    assert len(set(fresh)) > 15 and len(times(stuck)) > 30 and len(set(times(stuck))) == 1
    numbers = [message.get_seq() for message in stuck]
    assert [(after - before) % 256 for before, after in zip(numbers, numbers[1:])] == [1] * (len(numbers) - 1)
    lab.inject(parse_fault("link_blackhole:1.05,%s" % name))
    assert len(messages(1.0)) <= 1
    assert lab.wires.stream("%s/arduino" % name).acting == () != lab.wires.wire("%s/radio" % name).acting
    assert len(set(times(messages(1.0)))) > 15
