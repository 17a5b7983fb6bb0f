"""Appendix C for real: one command on the base station flies three vehicles from three laptops, over ssh.

Four hosts with the thesis' addresses in network namespaces that have no way out (four_hosts.py), and the virtual lab
as a fifth. What reached the vehicles is read off the wire (wire_log.py), not asked of the nodes.
"""

import html
import json
import math
import re
import select
import socket
import subprocess
import sys
import time

import numpy as np
import pytest
import yaml
from flying import judged
from four_hosts import (
    ADDRESSES,
    COMPUTERS,
    LAUNCH_FILE,
    LIGHT,
    LOSS,
    RATE_HZ,
    RESULT,
    ROOT,
    VEHICLE_OF,
    fly,
    moves,
    orders_landing,
    planned_nodes,
    wait_until,
)
from netlab import NetLab, unsupported
from wire_log import ask_for_times, receive

from data_extraction.bags import Bag
from data_extraction.report.computers import ComputerCollector
from risc_control.safety import SafetyLimits
from risc_control.vehicles import greatest_command
from risc_lab.lab import load_fleet, load_vehicle_type
from risc_lab.ros.launching import Launch, PortReservation, free_tcp_port, marked_processes

LIMITS = SafetyLimits()
ARDRONE = load_vehicle_type("ardrone")
LATE_S = 0.25  # a command is on its way, and the computer is busy with other things
HANDLING_S = 0.05  # from the decision to the vehicle's network card
DECISION_S = 0.01  # from the look at a state's age to the command
REPEAT_S = 1.0 / 30.0  # how long the driver repeats a command: until the next one
CLOCK_ERROR_S = 0.05
# TCP sends lost packets again about 0.04, 0.12, 0.28 and 0.6 s later: after a longer cut a vehicle may rightly land.
SHORT_CUT_S, LONGEST_SHORT_CUT_S = 0.2, 0.25
LANDING_S = 4.0  # from a metre
FLOOR_M = 0.15  # a vehicle whose centre is lower is on the floor
END_S = 90.0  # for Ctrl-C; a computer that is gone costs roslaunch 20 to 40 s
GONE_S = 8.0  # from the end of roslaunch to that of the last process; after that the guards of the sessions would kill
# A place for each, far from the others, which would land with one that comes near. An aircraft that gets no commands
# any more keeps its last tilt for a second, 1 to 4 degrees, and drifts: the net is wider than that.
APART = ("course:=origin", "course_options:={spacing_m: 3.0}")
pytestmark = pytest.mark.alone
LAPTOPS = tuple(VEHICLE_OF)
LAPTOP_OF = {vehicle: laptop for laptop, vehicle in VEHICLE_OF.items()}
SECOND_SET = {"joystick_controller", "joy_node"}  # on each laptop


@pytest.fixture(scope="module")
def namespaces():
    """Skip tests that need more than one computer where no namespaces can be made."""
    if unsupported():
        pytest.skip("NO FOUR HOSTS, THEY ARE NOT TESTED: " + unsupported())


def measured(text, *values):
    """Figures for docs/many_machines.md, shown by pytest -rP."""
    print("measured: " + text % values)


def vehicle_ends_landed(hosts, vehicle):
    """Assert that it took off once, has landed without an emergency stop, and that no vehicle hit anything."""
    figures = hosts.statistics["vehicles"][vehicle]
    counts = figures["host"]
    assert (figures["phase"], counts["take_offs"], counts.get("emergencies", 0)) == ("landed", 1, 0), figures
    assert hosts.statistics["crashes"] == []


def landing_ordered(hosts, vehicle, since_s):
    """Time [s] at which the first order to land since since_s reached the vehicle."""
    times = [c.time_s for c in hosts.commands(vehicle) if c.time_s >= since_s and orders_landing(c)]
    assert times, "%s was never told to land" % vehicle
    return times[0]


def assert_flown_on(hosts, vehicle, begin_s, end_s):
    """Assert that commands flew it all the time: no gap that would let the ladder land it, and no order to land."""
    assert begin_s < end_s, "there was no such time"
    times = [c.time_s for c in hosts.commands(vehicle) if begin_s <= c.time_s <= end_s and moves(c)]
    gaps = [later - earlier for earlier, later in zip([begin_s, *times], [*times, end_s])]
    assert max(gaps) < LIMITS.state_land_s + LATE_S, "%s was not flown for %.2f s" % (vehicle, max(gaps))
    ordered = [c for c in hosts.commands(vehicle) if begin_s <= c.time_s <= end_s and orders_landing(c)]
    assert ordered == [], "%s was told to land" % vehicle


def told_to(hosts, vehicle):
    """What the vehicle's node sent: sticks (k, 4), stamps (k,) [s] of the states that these answer, times (k,) [s].

    A stamp of NaN: they answer no state, the node brakes the vehicle. No two have equal sticks.
    """
    template = ARDRONE.laboratory[vehicle]
    most = greatest_command(ARDRONE)
    full = np.array((most.roll_rad, most.pitch_rad, ARDRONE.climb_max_m_s, most.yaw_rate_rad_s))
    told, stamps_s, sent_s = [], [], []
    with Bag(hosts.folder / "flight.bag") as bag:
        for _, _, message in bag.messages(["/commands_sent"]):
            for sent in message.commands:
                if sent.name == template:
                    told.append(np.array((sent.roll_rad, sent.pitch_rad, sent.climb, sent.yaw_rate_rad_s)) / full)
                    stamps_s.append(sent.answers.sec + 1e-9 * sent.answers.nanosec if sent.answers.sec else math.nan)
                    sent_s.append(sent.sent.sec + 1e-9 * sent.sent.nanosec)
    return np.array(told), np.array(stamps_s), np.array(sent_s)


def which_of(told, command):
    """The row of `told` (see `told_to`) that equals a command on the wire; None if there is none."""
    off = np.abs(told - command.arguments[1:5]).max(axis=1)
    which = int(off.argmin())
    return which if off[which] < 1e-6 else None


def assert_not_moved(hosts, vehicle, begin_s, end_s):
    """Assert that no command reached it but "level, hold altitude" and those by which its own node brakes it.

    begin_s: HANDLING_S after the last decision that may move it; time in which the computer stood still is not counted.
    """
    told, stamps_s, _ = told_to(hosts, vehicle)
    brakes = told[np.isnan(stamps_s)]
    moved = [c for c in hosts.commands(vehicle) if begin_s <= c.time_s <= end_s and moves(c)]
    moved = [c for c in moved if c.time_s - hosts.still_s(begin_s - HANDLING_S, c.time_s) >= begin_s]
    moved = [command for command in moved if which_of(brakes, command) is None]
    assert moved == [], "%s was moved, first %.2f s after the limit" % (vehicle, moved[0].time_s - begin_s)


def stands_after(hosts, template, since_s):
    """How long [s] after since_s motion capture saw the vehicle on the floor."""
    with Bag(hosts.folder / "flight.bag") as bag:
        for _, receipt_s, message in bag.messages(["/cortex_raw"]):
            heights_m = [entry.z for entry in message.Obj if entry.name == template]
            if receipt_s > since_s and heights_m and heights_m[0] < FLOOR_M:
                return receipt_s - since_s
    raise AssertionError("%s was never seen on the floor" % template)


def state_ages(hosts, vehicle):
    """[(time on the wire [s], age of the answered state then [s], is it the first time?)] of commands that moved it.

    The time for which the computer stood still, after the last moment at which the state could be answered, is
    subtracted from the age. Left out: commands after the end of the bag; of risc3 those after its cable was pulled,
    since their record may have been lost with the base station.
    """
    told, stamps_s, _ = told_to(hosts, vehicle)
    with Bag(hosts.folder / "flight.bag") as bag:
        end_s = bag.start_s + bag.duration_s - HANDLING_S
    if vehicle == "risc3":
        end_s = hosts.cuts["risc3"][0] - HANDLING_S
    ages, seen = [], set()
    for command in hosts.commands(vehicle):
        if moves(command) and command.time_s < end_s:
            which = which_of(told, command)
            assert which is not None, "no order explains what moved %s at %.3f s" % (vehicle, command.time_s)
            if not math.isnan(stamps_s[which]):
                still_s = hosts.still_s(stamps_s[which] + LIMITS.state_hold_s, command.time_s)
                ages.append((command.time_s, command.time_s - stamps_s[which] - still_s, which not in seen))
                seen.add(which)
    return ages


def computers_of(bag_path):
    """{vehicle: Computer} of a bag."""
    collector = ComputerCollector()
    with Bag(bag_path) as bag:
        for message in bag.messages(filter(collector.wants, bag.topics)):
            collector(*message)
    return collector.result(0.0)


@pytest.mark.usefixtures("namespaces")
def test_the_hosts_have_no_way_out():
    """Before anything uses the thesis' addresses: they exist only here."""
    with NetLab(ADDRESSES) as net:
        net.assert_isolated()
        command = ["/usr/bin/python3", "-c", "import socket; socket.create_connection(('192.0.2.1', 80), 1)"]
        for host in ADDRESSES:
            assert "Network is unreachable" in net.run(host, command, check=False).stderr


def test_the_times_on_the_wire_are_the_kernels():
    """Even if the program that logs them is busy."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        ask_for_times(receiver)

        def is_stamped_on_arrival():
            before_s = time.time()
            receiver.sendto(b"x", receiver.getsockname())
            select.select([receiver], [], [])
            after_s = time.time()
            time.sleep(0.02)  # busy
            packet, time_s = receive(receiver)
            assert packet == b"x"
            return before_s - 1e-5 <= time_s <= after_s + 1e-5  # rounding

        # the kernel needs a moment to enable stamps for the first socket that asks; until then the reader's time counts
        wait_until(is_stamped_on_arrival, "a stamp of the arrival")


# ------------------------------------------------------------------ one command


@pytest.fixture(scope="module")
def flight(namespaces, tmp_path_factory):
    """The whole graph, up, once around and home."""

    def scenario(hosts):
        hosts.launch("duration:=8")
        hosts.ready_s = hosts.wait_for("operator: phase takeoff")
        hosts.course_s = hosts.wait_for("on course for")
        hosts.wait_for(RESULT + " ok")
        hosts.end(GONE_S)

    hosts = fly(tmp_path_factory.mktemp("flight"), scenario, test_one_command_flies_three_vehicles_and_brings_them_home)
    measured("ready for take-off %.1f s after the command, on the course after %.1f s", hosts.ready_s, hosts.course_s)
    measured("Ctrl-C took %.1f s", hosts.ended_s)
    return hosts


@pytest.mark.release  # the same launch file, to the end of its course; `outages` ends it otherwise
def test_one_command_flies_three_vehicles_and_brings_them_home(flight):
    for vehicle in LAPTOP_OF:
        vehicle_ends_landed(flight, vehicle)


@pytest.mark.release
def test_ctrl_c_leaves_nothing_on_any_host(flight):
    assert flight.ended_s < END_S
    assert flight.left == {}


# ------------------------------------------------------------------ cables and the base station


@pytest.fixture(scope="module")
def outages(namespaces, tmp_path_factory):
    """Links are out for 0.2, 1 and 10 s; then the base station loses its power, comes back and launches again.

    The one for 10 s is a pulled cable; for the others the switch drops what comes, since a card that has lost its
    carrier takes up to a second to come back.
    """

    arguments = ("duration:=60", "record_hz:=1", *APART)
    planned = planned_nodes(*arguments)

    def scenario(hosts):
        hosts.planned = planned
        hosts.launch(*arguments)
        hosts.wait_for("on course for")
        hosts.found = {computer: hosts.nodes_on(computer) for computer in COMPUTERS}
        hosts.groups = hosts.net.run("risc1", ["cat", "/proc/net/igmp"]).stdout
        hosts.cuts = {"risc1": hosts.cut("risc2", SHORT_CUT_S, LONGEST_SHORT_CUT_S)}
        time.sleep(1.5)
        hosts.net.link("risc4", "down")
        begin_s = time.time()
        hosts.cuts["risc2"] = hosts.cut("risc3", 1.0)
        time.sleep(max(0.0, begin_s + 10.0 - time.time()))
        hosts.cuts["risc3"] = begin_s, time.time()
        hosts.net.link("risc4", "up")
        time.sleep(2.0)  # whatever comes late comes now
        hosts.crash_s = time.time()
        hosts.net.power_off("risc1")
        hosts.guard_s = wait_until(lambda: not hosts.left_on("risc2", "risc3"), "the guards end the nodes")
        hosts.survivors = hosts.nodes_on("risc4")
        hosts.survivors_pids = hosts.node_pids("risc4")
        hosts.net.power_on("risc1")
        hosts.launch("operator:=false", name="second")  # its joysticks are not there: joy_node waits for them
        hosts.sets = []

        def all_there():
            hosts.sets.append([hosts.nodes_on(laptop) for laptop in LAPTOPS])
            hosts.second_pids = hosts.node_pids("risc4")
            complete = all(set(nodes) >= SECOND_SET for nodes in hosts.sets[-1])
            return complete and hosts.second_pids - hosts.survivors_pids

        hosts.second_s = wait_until(all_there, "the second launch starts its nodes")
        hosts.pids = {computer: hosts.node_pids(computer) for computer in COMPUTERS}
        hosts.beside_code = hosts.launch_beside("beside")
        hosts.beside_pids = {computer: hosts.node_pids(computer) for computer in COMPUTERS}
        hosts.sets.append([hosts.nodes_on(laptop) for laptop in LAPTOPS])
        hosts.end(END_S)

    def checks(hosts):
        bag = hosts.folder / "flight.bag"  # which was open when the base station lost its power
        (hosts.folder / "flight.bag.active").rename(bag)
        subprocess.run(["rosbag", "reindex", str(bag)], stdout=subprocess.DEVNULL, check=True)
        test_a_link_that_is_out_for_02_s_ends_no_flight(hosts)
        for vehicle in ("risc2", "risc3"):
            test_a_link_that_is_out_for_longer_lands_its_vehicle(hosts, vehicle)
        test_no_command_answers_a_state_older_than_its_limit(hosts)
        test_what_moves_a_vehicle_on_the_wire_is_younger_than_its_limit(hosts)
        test_a_base_station_without_power_lands_what_flies(hosts)

    return fly(tmp_path_factory.mktemp("outages"), scenario, checks, forgetful=["risc4"])


def test_every_node_runs_on_its_machine(outages):
    assert outages.found == outages.planned


def test_frames_come_by_multicast(outages):
    membership = "010101E1"  # 225.1.1.1, as the kernel writes it
    card = outages.groups.split("eth0", 1)[1]
    assert membership in card
    with Bag(outages.folder / "flight.bag") as bag:
        count = bag.topics["/mocap_data"]
    assert count > 20.0 * RATE_HZ, "frames of at least 20 s"


def test_the_radios_lose_what_they_should(outages):
    measured("radio: %s lost %r", "tc netem" if outages.lossy_kernel else "the virtual lab", outages.lost)
    assert set(outages.lost) == set(LAPTOP_OF)
    for vehicle, fraction in outages.lost.items():
        assert 0.3 * LOSS < fraction < 3.0 * LOSS, vehicle


def test_the_report_shows_the_latency_of_every_host(outages):
    bag = outages.folder / "flight.bag"
    done = subprocess.run(
        [sys.executable, "-m", "data_extraction.report", str(bag), "--out", str(outages.folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert done.returncode == 0, done.stdout
    page = (outages.folder / "report.html").read_text(encoding="utf-8")
    rows = [
        [html.unescape(re.sub("<[^>]+>", "", cell)).strip() for cell in re.findall("<t[dh].*?</t[dh]>", row, re.DOTALL)]
        for row in re.findall("<tr>.*?</tr>", page, re.DOTALL)
    ]
    for vehicle, laptop in LAPTOP_OF.items():
        (row,) = [row for row in rows if row[:1] + row[2:3] == [vehicle, laptop]]  # column 2: on what it is sent
        p50, p95, p99, largest = (float(cell.split()[0]) for cell in row[3:7])
        assert 0.0 < p50 <= p95 <= p99 <= largest and int(row[7]) > 200, row
        measured(
            "commands of %s by %s: p50 %.1f ms, p95 %.1f ms, p99 %.1f ms, oldest state answered there %s",
            vehicle,
            laptop,
            p50,
            p95,
            p99,
            row[8],
        )
    for row in rows:
        if len(row) == 6 and "ms" in row[1]:
            measured("%s", " | ".join(row))


def test_a_link_that_is_out_for_02_s_ends_no_flight(outages):
    begin_s, end_s = outages.cuts["risc1"]
    assert_not_moved(outages, "risc1", begin_s + LIMITS.state_hold_s + HANDLING_S, end_s)
    assert_flown_on(outages, "risc1", begin_s, outages.crash_s)


@pytest.mark.parametrize("vehicle", ["risc2", "risc3"])
def test_a_link_that_is_out_for_longer_lands_its_vehicle(outages, vehicle):
    """Ordered by its own node, while no one can reach that; commands that come late, even minutes, move nothing."""
    begin_s, end_s = outages.cuts[vehicle]
    ordered_s = landing_ordered(outages, vehicle, begin_s)
    measured("link out for %.1f s: %s told to land after %.3f s", end_s - begin_s, vehicle, ordered_s - begin_s)
    assert ordered_s < end_s
    assert ordered_s - begin_s < LIMITS.state_land_s + LATE_S
    assert_not_moved(outages, vehicle, begin_s + LIMITS.state_hold_s + HANDLING_S, time.time())
    vehicle_ends_landed(outages, vehicle)


def test_no_command_answers_a_state_older_than_its_limit(outages):
    """By the clocks of the laptops; the largest of the whole flight, with everything that the outages delayed.

    The time for which the computer stood still between the check of a state's age and the command is allowed, too.
    """
    computers = computers_of(outages.folder / "flight.bag")
    assert set(computers) == set(LAPTOP_OF)
    for vehicle, computer in computers.items():
        measured("oldest state that a command of %s answered: %.1f ms", vehicle, computer.oldest_ms)
        _, stamps_s, sent_s = told_to(outages, vehicle)
        answered = ~np.isnan(stamps_s)
        still_s = max(map(outages.still_s, stamps_s[answered] + LIMITS.state_hold_s, sent_s[answered]))
        assert 0.0 < computer.oldest_ms < 1e3 * (LIMITS.state_hold_s + DECISION_S + still_s)


def test_what_moves_a_vehicle_on_the_wire_is_younger_than_its_limit(outages):
    """Command by command, also after the short outage, when all delayed messages come at once."""
    limit_s = LIMITS.state_hold_s + HANDLING_S
    for vehicle in LAPTOP_OF:
        ages = state_ages(outages, vehicle)
        oldest_s = max(age_s for _, age_s, is_first in ages if is_first)
        repeated_s = max(age_s for _, age_s, _ in ages)
        measured(
            "oldest state that %d commands to %s on the wire answered: %.1f ms, repeated %.1f ms",
            len(ages),
            vehicle,
            1e3 * oldest_s,
            1e3 * repeated_s,
        )
        assert oldest_s < limit_s
        assert repeated_s < limit_s + REPEAT_S
    _, end_s = outages.cuts["risc1"]
    assert [1 for time_s, age_s, _ in state_ages(outages, "risc1") if end_s < time_s < end_s + 2.0]


def test_a_base_station_without_power_lands_what_flies(outages):
    ordered_s = landing_ordered(outages, "risc1", outages.crash_s)
    measured("base station dead: risc1 told to land after %.3f s", ordered_s - outages.crash_s)
    assert ordered_s - outages.crash_s < LIMITS.state_land_s + LATE_S + 0.5  # when exactly its power went is not known
    vehicle_ends_landed(outages, "risc1")


def test_nodes_do_not_outlive_the_launch_that_started_them(outages):
    measured("base station dead: the laptops' nodes were gone after %.1f s", outages.guard_s)
    assert outages.guard_s < END_S
    assert outages.left == {}, "nor the second one"


def test_a_second_launch_starts_no_second_set(outages):
    """On risc4, where sshd has noticed nothing, the nodes of the first launch still ran when the second came."""
    assert "joystick_controller" in outages.survivors
    for nodes in (nodes for sample in outages.sets for nodes in sample):
        assert len(set(nodes)) == len(nodes), "two sets: %s" % nodes
    assert all(set(nodes) >= SECOND_SET for nodes in outages.sets[-1]), "the second launch has all of them"
    assert not outages.survivors_pids & outages.second_pids, "and nothing of the first is left"


def test_a_launch_beside_one_that_is_alive_is_refused(outages):
    """By the laptops, before it has done anything on the base station: what runs is what ran."""
    log = outages.log("beside")
    assert outages.beside_code != 0 and "already runs" in log, log
    for computer, pids in outages.pids.items():
        assert pids and pids <= outages.beside_pids[computer], computer


# ------------------------------------------------------------------ hosts, sshd and clocks


@pytest.fixture(scope="module")
def accidents(namespaces, tmp_path_factory):
    """Two laptops' clocks are wrong by 50 ms; one laptop's sshd dies in flight, another laptop loses its power.

    For releases: a vehicle whose laptop is gone lands in `outages`, too; what is left has tests without a flight: the
    guard of a session (test_env_loader.py), the vehicle's own watchdog (test_ardrone_host.py), clocks in the report
    (test_report_collectors.py).
    """

    def scenario(hosts):
        hosts.launch("duration:=20", *APART)
        hosts.wait_for("on course for")
        hosts.course_s = time.time()
        time.sleep(5.0)
        hosts.sshd_s = time.time()
        hosts.net.sshd("risc4", "stop")
        hosts.gone_s = wait_until(lambda: not hosts.left_on("risc4"), "the nodes end")
        hosts.power_s = time.time()
        hosts.net.power_off("risc3")
        hosts.wait_for("operator: phase home")
        hosts.home_s = hosts.logged_s("operator: phase home")
        assert hosts.power_s < hosts.home_s, "the course ended before the accidents"
        hosts.wait_for("operator: phase land")
        time.sleep(LANDING_S)
        hosts.end(END_S)

    def checks(hosts):
        test_clocks_that_are_wrong_by_50_ms_end_no_flight(hosts)
        test_when_sshd_dies_its_vehicle_lands_and_the_others_fly_on(hosts)
        test_when_a_laptop_dies_its_vehicle_lands_by_itself_and_the_others_fly_on(hosts)
        test_the_vehicle_that_is_left_comes_home_and_the_operator_names_the_others(hosts)

    ahead_s = {"risc2": -CLOCK_ERROR_S, "risc3": CLOCK_ERROR_S}
    return fly(tmp_path_factory.mktemp("accidents"), scenario, checks, ahead_s=ahead_s)


@pytest.mark.release
def test_clocks_that_are_wrong_by_50_ms_end_no_flight(accidents):
    for vehicle in LAPTOP_OF:
        assert_flown_on(accidents, vehicle, accidents.course_s, accidents.sshd_s)


@pytest.mark.release
def test_a_clock_that_is_behind_is_noticed_and_corrected(accidents):
    """A message cannot be received before it was sent: the difference shows, less what the messages took."""
    computers = computers_of(accidents.folder / "flight.bag")
    behind_ms = {vehicle: computer.behind_ms for vehicle, computer in computers.items()}
    measured("clocks: behind by at least %s ms", behind_ms)
    assert 0.5 * CLOCK_ERROR_S < 1e-3 * behind_ms["risc1"] <= CLOCK_ERROR_S
    assert behind_ms["risc2"] == behind_ms["risc3"] == 0.0


@pytest.mark.release
def test_when_sshd_dies_its_vehicle_lands_and_the_others_fly_on(accidents):
    ordered_s = landing_ordered(accidents, "risc3", accidents.sshd_s)
    measured(
        "sshd dead: risc3 told to land after %.2f s, its nodes gone after %.2f s",
        ordered_s - accidents.sshd_s,
        accidents.gone_s,
    )
    assert_not_moved(accidents, "risc3", ordered_s + LATE_S, time.time())
    vehicle_ends_landed(accidents, "risc3")
    for vehicle in ("risc1", "risc2"):
        assert_flown_on(accidents, vehicle, accidents.sshd_s, accidents.power_s)


@pytest.mark.release
def test_when_a_laptop_dies_its_vehicle_lands_by_itself_and_the_others_fly_on(accidents):
    """Nothing reaches it any more: the vehicle's own watchdog has it hover, then land."""
    later = [c for c in accidents.commands("risc2") if c.time_s > accidents.power_s + LATE_S]
    assert later == []
    vehicle_ends_landed(accidents, "risc2")
    assert accidents.statistics["vehicles"]["risc2"]["host"]["com_losses"] == 1
    measured("laptop dead: risc2 stood after %.1f s", stands_after(accidents, "albatross", accidents.power_s))
    assert_flown_on(accidents, "risc1", accidents.power_s, accidents.home_s)


@pytest.mark.release
def test_the_vehicle_that_is_left_comes_home_and_the_operator_names_the_others(accidents):
    log = accidents.log("flight")
    failed = {vehicle for vehicle in LAPTOP_OF if re.search("phase.*%s.*; the others fly on" % vehicle, log)}
    assert failed == {"risc2", "risc3"}
    assert_flown_on(accidents, "risc1", accidents.course_s, accidents.home_s)
    vehicle_ends_landed(accidents, "risc1")


@pytest.mark.release
def test_ctrl_c_ends_a_launch_although_a_laptop_is_dead(accidents):
    measured("Ctrl-C with a dead laptop took %.1f s", accidents.ended_s)
    assert accidents.ended_s < END_S
    assert accidents.left == {}


# ------------------------------------------------------------------ one computer


def fly_on_one_computer(folder):
    """Up, to the course and home. Returns (what roslaunch printed, the virtual lab's statistics)."""
    folder.mkdir()
    reservation, master_port = PortReservation(), free_tcp_port()
    fleet = load_fleet(ROOT / "launch/fleets/ardrones3.yaml").in_subnet(reservation.subnet).to_dict()
    fleet["mocap"]["rate_hz"] = RATE_HZ
    (folder / "fleet.yaml").write_text(yaml.safe_dump(fleet))
    arguments = {"machine": "local", "lab": "true", "fleet": folder / "fleet.yaml", "bag": folder / "flight.bag"}
    arguments.update({"duration": 1.0, "statistics": folder / "virtual_lab.json"})
    arguments.update(light.split(":=") for light in LIGHT)
    launch = Launch(LAUNCH_FILE, arguments, folder, master_port)
    try:
        log = launch.log_path
        wait_until(lambda: RESULT in log.read_text(errors="replace") or not launch.running(), "the flight ends")
    finally:
        killed = launch.stop()
        reservation.close()
    assert killed == [], "Ctrl-C did not end these"
    assert marked_processes(launch.identity) == {}
    return log.read_text(errors="replace"), json.loads((folder / "virtual_lab.json").read_text())


@pytest.mark.release  # `flight` flies the file on four
def test_the_same_file_flies_on_one_computer(tmp_path):
    """machine:=local lab:=true, what a reader tries first."""
    log, statistics = fly_on_one_computer(tmp_path / "flight")
    is_ok = RESULT + " ok" in log
    judged((0 if is_ok else 1, log, {"lab_late_ms": statistics["late_ms"]}, tmp_path))
    assert is_ok, log
    for vehicle, figures in statistics["vehicles"].items():
        assert (figures["phase"], figures["host"]["take_offs"]) == ("landed", 1), vehicle
    assert statistics["crashes"] == []
