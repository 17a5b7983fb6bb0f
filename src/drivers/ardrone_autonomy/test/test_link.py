"""The connection state machine with a fake clock and a fake vehicle."""

import pytest

from ardrone_autonomy import link as link_module
from ardrone_autonomy.link import LOST_S, DroneLink, Phase
from ardrone_autonomy.piloting import HOVER, Sticks
from ardrone_autonomy.protocol import at
from ardrone_autonomy.protocol.navdata import ControlState, State, Tag
from risc_simulator.vehicles.ardrone.wire import NavdataEncoder, parse_datagram

WRITES = [("general:navdata_demo", "FALSE"), ("custom:session_id", "0badcafe"), ("control:outdoor", "TRUE")]
FORWARD = Sticks(1, 0.0, -0.5, 0.0, 0.0)
LEFT = Sticks(1, -0.5, 0.0, 0.0, 0.0)


class Bench:
    """A link in simulated time, and a vehicle that sends a packet every 5 ms."""

    def __init__(self, settle_s=0.0, command_timeout_s=0.0, writes=WRITES, land_timeout_s=0.0, lost_s=LOST_S):
        self.now_s = 100.0
        self.commands = []  # (time, AtCommand) that left the link
        self.datagrams = []  # times
        self.wake_ups = []  # times
        self.reports = []  # (level, text)
        self.link = DroneLink(
            self._on_command,
            self._on_wake_up,
            writes,
            "0badcafe",
            settle_s=settle_s,
            command_timeout_s=command_timeout_s,
            land_timeout_s=land_timeout_s,
            lost_s=lost_s,
            report=lambda *item: self.reports.append(item),
        )
        self.power_on()

    def power_on(self):
        """Reset the vehicle to its state at power-on."""
        self.speaks = True
        self.bits = int(State.BOOTSTRAP)
        self.control_state = ControlState.LANDED
        self.sequence = 0
        self.client = False
        self.deaf_to = 0  # number of next CONFIG commands that get lost
        self.ack_stuck = False
        self.written = []

    def _on_wake_up(self, data):
        assert data == b"\x01\x00\x00\x00"
        self.wake_ups.append(self.now_s)
        self.client = True

    def _on_command(self, data):
        parsed = parse_datagram(data)
        assert not parsed.malformed
        self.datagrams.append(self.now_s)
        for command in parsed.commands:
            self.commands.append((self.now_s, command))
            if command.name == "CONFIG":
                if self.deaf_to:
                    self.deaf_to -= 1
                    continue
                self.written.append(command.arguments)
                self.bits |= State.COMMAND_ACK
                if command.arguments[0] == "general:navdata_demo":
                    self.bits &= ~State.BOOTSTRAP
            elif command.name == "CTRL" and not self.ack_stuck:
                assert command.arguments == (at.CtrlMode.CLEAR_ACK, 0)
                self.bits &= ~State.COMMAND_ACK
            elif command.name == "COMWDG":
                self.bits &= ~State.COM_WATCHDOG

    def packet(self, sequence=None):
        self.sequence = self.sequence + 1 if sequence is None else sequence
        if self.bits & State.BOOTSTRAP:
            return NavdataEncoder().finish(int(self.bits), self.sequence)
        encoder = NavdataEncoder([Tag.DEMO])
        encoder.put(Tag.DEMO, ctrl_state=self.control_state << 16)
        return encoder.finish(int(self.bits), self.sequence)

    def run(self, duration_s, step_s=0.001):
        """Let time pass; a packet every fifth step."""
        for step in range(int(round(duration_s / step_s))):
            self.now_s += step_s
            if self.speaks and self.client and step % 5 == 0:
                self.link.on_navdata(self.packet(), self.now_s)
            self.poll()

    def poll(self):
        if self.now_s >= self.link.due_s:
            self.link.poll(self.now_s)

    def order(self, order, *arguments):
        order(*arguments, self.now_s)
        self.poll()

    def names(self, *wanted):
        return [command for _, command in self.commands if command.name in wanted]

    @property
    def ref(self):
        return self.names("REF")[-1].arguments[0]

    @property
    def sticks(self):
        return Sticks(*self.names("PCMD_MAG")[-1].arguments[:5])

    def texts(self, level):
        return [text for reported, text in self.reports if reported == level]


@pytest.fixture
def bench():
    """A vehicle that is connected and configured."""
    bench = Bench()
    bench.run(0.5)
    assert bench.link.phase is Phase.READY
    return bench


# --- connection ------------------------------------------------------------------------------------------------------
def test_wakes_the_vehicle_up_until_it_answers():
    bench = Bench()
    bench.speaks = False
    bench.run(1.2)
    assert len(bench.wake_ups) == 5  # at once, then every 0.25 s
    assert not bench.datagrams  # an absent vehicle is not piloted
    assert bench.link.phase is Phase.SEARCHING


def test_settles_before_it_configures():
    bench = Bench(settle_s=2.0)
    bench.run(1.9)
    assert bench.link.phase is Phase.SETTLING
    assert not bench.names("CONFIG")
    assert len(bench.names("REF")) > 60  # the command channel is kept alive meanwhile
    bench.run(0.6)
    assert bench.link.phase is Phase.READY


def test_every_write_goes_through_ids_ack_and_clear(bench):
    assert bench.written == WRITES
    steps = [(c.name, c.arguments) for c in bench.names("CONFIG_IDS", "CONFIG", "CTRL")]
    ids = ("CONFIG_IDS", ("0badcafe", "cea48d22", "e182b69b"))
    expected = []
    for write in WRITES:
        expected += [ids, ("CONFIG", write), ("CTRL", (5, 0))]
    assert steps == expected
    assert not bench.bits & State.BOOTSTRAP
    assert not bench.bits & State.COMMAND_ACK


def test_sequence_numbers_start_at_one_and_grow(bench):
    bench.run(1.0)
    assert [command.sequence for _, command in bench.commands] == list(range(1, len(bench.commands) + 1))


def test_a_lost_write_is_repeated():
    bench = Bench()
    bench.deaf_to = 1
    bench.run(1.0)
    assert bench.written == WRITES
    assert bench.link.phase is Phase.READY
    times = [time_s for time_s, command in bench.commands if command.name == "CONFIG"]
    assert times[1] - times[0] == pytest.approx(link_module.ACK_TIMEOUT_S, abs=0.002)


def test_an_unanswered_first_write_restarts_the_sequence():
    # A vehicle that still expects an earlier client's numbers ignores smaller ones, but always obeys number 1
    bench = Bench()
    bench.deaf_to = 1
    bench.run(1.0)
    restarts = [c.name for c in bench.names("CONFIG_IDS", "PCMD_MAG") if c.sequence == 1]
    assert restarts == ["PCMD_MAG", "CONFIG_IDS"] or restarts == ["CONFIG_IDS", "CONFIG_IDS"]


def test_a_write_that_is_never_acknowledged_does_not_block():
    bench = Bench()
    bench.run(0.004)
    bench.bits &= ~State.BOOTSTRAP
    bench.deaf_to = link_module.MAX_WRITE_TRIES
    bench.run(4.0)
    assert bench.link.phase is Phase.READY
    assert bench.link.unanswered_writes == 1
    assert bench.written == WRITES[1:]
    assert "general:navdata_demo" in bench.texts("error")[0]


def test_a_stuck_acknowledge_bit_does_not_block():
    bench = Bench()
    bench.ack_stuck = True
    bench.run(5.0)
    assert bench.link.phase is Phase.READY
    assert bench.written == WRITES


def test_an_old_acknowledge_bit_is_cleared_first():
    bench = Bench()
    bench.bits |= State.COMMAND_ACK
    bench.run(0.5)
    assert bench.names("CTRL", "CONFIG")[0].name == "CTRL"
    assert bench.written == WRITES


def test_a_write_while_flying(bench):
    bench.order(bench.link.write, "video:video_channel", "1")
    bench.run(0.1)
    assert bench.written[-1] == ("video:video_channel", "1")
    assert not bench.bits & State.COMMAND_ACK


# --- navdata -----------------------------------------------------------------------------------------------------
def test_old_packets_and_strangers_are_dropped(bench):
    newest = bench.packet()
    assert bench.link.on_navdata(newest, bench.now_s)
    assert not bench.link.on_navdata(newest, bench.now_s)
    assert not bench.link.on_navdata(bench.packet(sequence=3), bench.now_s)
    assert not bench.link.on_navdata(b"\x01" * 40, bench.now_s)
    assert not bench.link.on_navdata(b"", bench.now_s)
    assert (bench.link.stale, bench.link.refused) == (2, 2)


@pytest.mark.parametrize("bit", [State.EMERGENCY, State.BOOTSTRAP])
def test_a_damaged_packet_starts_no_emergency_and_no_reboot(bench, bit):
    bench.order(bench.link.take_off)
    bench.run(0.1)
    bench.reports.clear()
    bench.written.clear()
    bits = bench.link.state_bits
    damaged = bytearray(bench.packet())
    damaged[4:8] = (bits | bit).to_bytes(4, "little")
    assert not bench.link.on_navdata(bytes(damaged), bench.now_s)
    assert (bench.link.refused, bench.link.state_bits, bench.link.phase) == (1, bits, Phase.READY)
    bench.run(0.1)
    assert bench.ref & at.Ref.START
    assert not bench.reports
    assert not bench.written


def test_a_damaged_packet_does_not_end_an_emergency(bench):
    bench.bits |= State.EMERGENCY
    bench.run(0.1)
    damaged = bytearray(bench.packet())
    damaged[7] ^= 0x80
    assert not bench.link.on_navdata(bytes(damaged), bench.now_s)
    assert bench.link.emergency


def test_newer_firmware_magic_is_accepted(bench):
    packet = bytearray(bench.packet())
    packet[0] = 0x89
    assert bench.link.on_navdata(bytes(packet), bench.now_s)


def test_watchdog_bit_is_answered_and_lets_the_sequence_restart(bench):
    bench.bits |= State.COM_WATCHDOG
    bench.sequence = 0
    bench.run(0.1)
    assert len(bench.names("COMWDG")) == 1
    assert not bench.bits & State.COM_WATCHDOG
    assert bench.link.stale == 0


def test_watchdog_bit_is_not_answered_in_bootstrap():
    bench = Bench(settle_s=10.0)
    bench.bits |= State.COM_WATCHDOG
    bench.run(1.0)
    assert not bench.names("COMWDG")


# --- ticks -------------------------------------------------------------------------------------------------------
def test_one_pcmd_and_one_ref_every_25_ms(bench):
    bench.commands.clear()
    bench.datagrams.clear()
    bench.run(1.0)
    assert len(bench.datagrams) == pytest.approx(40, abs=2)
    assert [c.name for _, c in bench.commands] == ["PCMD_MAG", "REF"] * len(bench.datagrams)
    assert bench.sticks == HOVER
    assert bench.ref == 290717696


def test_a_new_command_is_sent_at_once_and_moves_the_tick(bench):
    bench.run(0.0125)
    while bench.now_s - bench.datagrams[-1] < 0.010:
        bench.run(0.001)
    bench.order(bench.link.steer, FORWARD)
    sent_s = bench.datagrams[-1]
    assert sent_s == bench.now_s
    assert bench.sticks == FORWARD
    bench.run(0.024)
    assert bench.datagrams[-1] == sent_s
    bench.run(0.002)
    assert bench.datagrams[-1] == pytest.approx(sent_s + 0.025, abs=0.0011)


def test_a_burst_of_commands_is_spaced_and_the_newest_wins(bench):
    bench.datagrams.clear()
    for i in range(100):  # 1 kHz for 0.1 s
        bench.order(bench.link.steer, Sticks(1, 0.0, 0.0, i / 100.0, 0.0))
        bench.run(0.001)
    bench.run(0.005)
    gaps = [b - a for a, b in zip(bench.datagrams, bench.datagrams[1:])]
    assert min(gaps) >= link_module.MIN_SPACING_S - 1e-9
    assert len(bench.datagrams) <= 0.106 / link_module.MIN_SPACING_S + 2
    assert bench.sticks.gaz == pytest.approx(0.99)


def test_without_a_timeout_the_last_command_holds_for_ever(bench):
    bench.order(bench.link.steer, FORWARD)
    bench.run(5.0)
    assert bench.sticks == FORWARD


def test_command_timeout_hovers_until_the_next_command():
    bench = Bench(command_timeout_s=link_module.COMMAND_TIMEOUT_S)
    bench.run(0.5)
    bench.order(bench.link.steer, FORWARD)
    bench.run(0.49)
    assert bench.sticks == FORWARD
    bench.run(0.04)
    assert bench.sticks == HOVER
    assert len(bench.texts("warn")) == 1
    bench.run(2.0)
    assert len(bench.texts("warn")) == 1
    bench.order(bench.link.steer, LEFT)
    assert bench.sticks == LEFT
    bench.run(1.0)
    assert len(bench.texts("warn")) == 2


# --- take-off, landing, emergency -----------------------------------------------------------------------------------
def test_take_off_stays_set_until_landing(bench):
    bench.order(bench.link.take_off)
    assert bench.ref == 290718208
    bench.run(1.0)
    assert bench.ref == 290718208
    bench.run(0.006)
    bench.order(bench.link.land)
    assert bench.ref == 290717696


def test_one_order_a_tick_reset_then_take_off_then_land_then_velocity(bench):
    bench.run(0.02)
    seen = len(bench.commands)
    # all at once, before the next tick
    for order in (bench.link.land, bench.link.take_off, bench.link.reset):
        order(bench.now_s)
    bench.link.steer(FORWARD, bench.now_s)
    bench.run(0.1)
    commands = [command for _, command in bench.commands[seen:]]
    refs = [command.arguments[0] & 0x300 for command in commands if command.name == "REF"]
    flags = [command.arguments[0] for command in commands if command.name == "PCMD_MAG"]
    assert refs[:4] == [0x100, 0x300, 0x100, 0x100]
    assert flags[:4] == [0, 0, 0, 1]


def test_take_off_is_refused_until_configured():
    bench = Bench(settle_s=1.0)
    bench.run(0.5)
    bench.order(bench.link.take_off)
    bench.run(1.5)
    assert bench.link.phase is Phase.READY
    assert bench.ref == at.Ref.PADDING
    assert "not ready" in bench.texts("warn")[0]


def test_reset_in_flight_stops_the_motors_and_drops_both_bits(bench):
    bench.order(bench.link.take_off)
    bench.run(0.1)
    bench.order(bench.link.reset)
    bench.run(0.006)
    assert bench.ref == at.Ref.PADDING | at.Ref.START | at.Ref.SELECT
    bench.run(0.3)  # a slow radio: the bit stays until the state changes
    assert bench.ref & at.Ref.SELECT
    bench.bits |= State.EMERGENCY
    bench.run(0.05)
    assert bench.ref == at.Ref.PADDING
    assert bench.link.emergency
    bench.order(bench.link.take_off)
    bench.run(0.1)
    assert bench.ref == at.Ref.PADDING  # refused
    bench.order(bench.link.reset)
    bench.run(0.1)
    assert bench.ref == at.Ref.PADDING | at.Ref.SELECT
    bench.bits &= ~State.EMERGENCY
    bench.run(0.05)
    assert bench.ref == at.Ref.PADDING  # and it does not take off by itself


def test_an_emergency_of_the_vehicle_drops_the_start_bit(bench):
    bench.order(bench.link.take_off)
    bench.run(0.1)
    bench.bits |= State.EMERGENCY
    bench.run(0.05)
    assert bench.ref == at.Ref.PADDING
    assert "EMERGENCY" in bench.texts("error")[0]


def test_a_reset_without_effect_is_given_up(bench):
    bench.order(bench.link.reset)
    bench.run(0.9)
    assert bench.ref & at.Ref.SELECT
    bench.run(0.2)
    assert not bench.ref & at.Ref.SELECT
    assert "no effect" in bench.texts("warn")[0]


def test_a_reset_during_silence_is_held_as_long_as_any_other(bench):
    bench.order(bench.link.take_off)
    bench.run(0.1)
    bench.speaks = False
    bench.run(1.8)
    bench.order(bench.link.reset)
    pressed_s = bench.now_s
    bench.run(0.98)
    assert bench.link.phase is Phase.SEARCHING  # the silence has turned into a loss
    refs = [command.arguments[0] for time_s, command in bench.commands if command.name == "REF" and time_s > pressed_s]
    assert all(bits & at.Ref.SELECT for bits in refs[1:])
    assert not bench.ref & at.Ref.START
    bench.run(0.1)
    assert bench.ref == at.Ref.PADDING
    assert "is unknown" in bench.texts("warn")[-1]


def test_a_lost_vehicle_is_sent_a_reset_blind(bench):
    bench.order(bench.link.take_off)
    bench.run(0.1)
    bench.speaks = False
    bench.run(3.0)
    assert bench.link.phase is Phase.SEARCHING
    bench.order(bench.link.reset)
    bench.run(0.006)
    assert bench.ref == at.Ref.PADDING | at.Ref.SELECT
    assert "without telemetry" in bench.texts("warn")[-1]
    bench.run(0.9)
    assert bench.ref == at.Ref.PADDING | at.Ref.SELECT
    bench.run(0.2)
    assert bench.ref == at.Ref.PADDING


def test_a_blind_reset_ends_when_the_vehicle_shows_its_effect(bench):
    bench.speaks = False
    bench.run(3.0)
    bench.order(bench.link.reset)
    bench.run(0.1)
    bench.bits |= State.EMERGENCY
    bench.speaks = True
    bench.run(0.05)
    assert bench.link.emergency
    assert bench.ref == at.Ref.PADDING


def test_a_lost_vehicle_that_was_in_emergency_is_not_toggled_blind(bench):
    bench.bits |= State.EMERGENCY
    bench.run(0.1)
    bench.speaks = False
    bench.run(3.0)
    bench.order(bench.link.reset)
    bench.run(0.1)
    assert bench.ref == at.Ref.PADDING
    assert "was in emergency" in bench.texts("warn")[-1]


def test_a_reset_before_the_first_packet_is_refused():
    bench = Bench()
    bench.speaks = False
    bench.run(0.5)
    bench.order(bench.link.reset)
    bench.speaks = True
    bench.run(1.0)
    assert "no vehicle" in bench.texts("warn")[0]
    assert not any(command.arguments[0] & at.Ref.SELECT for command in bench.names("REF"))


def test_a_reset_outlasts_a_reboot(bench):
    # The bootstrap bit also appears in flight, when the vehicle has not received commands for a while
    bench.order(bench.link.reset)
    bench.run(0.1)
    bench.bits |= State.BOOTSTRAP
    bench.run(0.1)
    assert "rebooted" in bench.texts("warn")[0]
    assert bench.ref & at.Ref.SELECT


# --- loss and return ----------------------------------------------------------------------------------------------
def test_a_short_silence_changes_nothing_but_wakes_the_vehicle_up(bench):
    bench.order(bench.link.take_off)
    bench.order(bench.link.steer, FORWARD)
    bench.run(0.1)
    count = len(bench.wake_ups)
    bench.speaks = False
    bench.run(0.9)
    assert bench.link.phase is Phase.READY
    assert len(bench.wake_ups) - count >= 3
    assert bench.ref & at.Ref.START
    assert bench.sticks == FORWARD
    bench.speaks = True
    bench.run(0.5)
    assert bench.link.connections == 1


def test_a_lost_vehicle_is_told_to_land_and_configured_again(bench):
    bench.order(bench.link.take_off)
    bench.order(bench.link.steer, FORWARD)
    bench.run(0.1)
    bench.speaks = False
    bench.run(2.4)
    assert bench.link.phase is Phase.SEARCHING
    assert (bench.ref, bench.sticks) == (at.Ref.PADDING, HOVER)
    assert len(bench.texts("error")) == 1
    bench.written.clear()
    bench.speaks = True
    bench.run(0.6)
    assert bench.link.phase is Phase.READY
    assert bench.written == WRITES
    assert bench.link.connections == 2
    assert not bench.ref & at.Ref.START


@pytest.mark.parametrize("lost_s", [LOST_S, 3.0])
def test_a_vehicle_is_lost_when_its_own_watchdog_takes_us_for_lost(lost_s):
    bench = Bench(lost_s=lost_s)
    bench.run(0.5)
    bench.speaks = False
    bench.run(lost_s - 0.1)
    assert bench.link.phase is Phase.READY
    bench.run(0.4)
    assert bench.link.phase is Phase.SEARCHING


def test_a_rebooted_vehicle_does_not_take_off_by_itself(bench):
    bench.run(5.0)  # its packets are far beyond number 1 by now
    bench.order(bench.link.take_off)
    bench.run(0.1)
    before = len(bench.commands)
    bench.power_on()
    bench.run(1.0)
    assert bench.link.phase is Phase.READY
    assert bench.written == WRITES
    first_write = [c.name for _, c in bench.commands[before:]].index("CONFIG")
    refs = [c.arguments[0] for _, c in bench.commands[before + first_write :] if c.name == "REF"]
    assert set(refs) == {int(at.Ref.PADDING)}


def test_close_hovers_and_lands_and_obeys_nothing_else(bench):
    bench.order(bench.link.take_off)
    bench.order(bench.link.steer, FORWARD)
    bench.bits |= State.FLYING
    bench.control_state = ControlState.FLYING
    bench.run(0.1)
    assert bench.link.in_flight
    bench.order(bench.link.close)
    bench.order(bench.link.steer, LEFT)
    bench.order(bench.link.take_off)
    bench.run(0.1)
    assert (bench.ref, bench.sticks) == (at.Ref.PADDING, HOVER)
    bench.control_state = ControlState.LANDING
    bench.run(0.01)
    assert not bench.link.in_flight


def test_last_orders_hover_and_land_without_a_poll(bench):
    bench.order(bench.link.take_off)
    bench.order(bench.link.steer, FORWARD)
    bench.run(0.1)
    assert (bench.ref & at.Ref.START, bench.sticks) == (at.Ref.START, FORWARD)
    bench.link.send_last_orders()
    assert (bench.ref, bench.sticks) == (at.Ref.PADDING, HOVER)
    bench.link.reset(bench.now_s)  # ordered, not sent yet
    bench.link.send_last_orders()
    assert bench.ref == at.Ref.PADDING | at.Ref.SELECT


def test_nobody_gets_last_orders_who_never_answered():
    bench = Bench()
    bench.link.send_last_orders()
    assert not bench.datagrams


# --- programs that die or hang ---------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "bits, control_state, kept",
    [
        (State.FLYING, ControlState.FLYING, True),
        (State.FLYING, ControlState.HOVERING, True),
        (State.FLYING | State.BOOTSTRAP, ControlState.DEFAULT, True),  # its connection was lost meanwhile
        (State.FLYING, ControlState.LANDING, False),
        (0, ControlState.LANDED, False),
        (State.FLYING | State.EMERGENCY, ControlState.FLYING, False),
    ],
)
def test_a_driver_that_finds_its_vehicle_in_flight_keeps_it_there(bits, control_state, kept):
    bench = Bench(command_timeout_s=0.5)
    bench.bits, bench.control_state = int(bits), control_state
    bench.run(0.3)
    assert {bool(command.arguments[0] & at.Ref.START) for command in bench.names("REF")} == {kept}
    assert {Sticks(*command.arguments[:5]) for command in bench.names("PCMD_MAG")} == {HOVER}
    assert bool(bench.texts("warn")) == kept
    bench.order(bench.link.land)
    bench.run(0.1)
    assert not bench.ref & at.Ref.START


def test_one_that_comes_back_after_a_loss_is_not_kept_in_the_air(bench):
    bench.order(bench.link.take_off)
    bench.bits |= State.FLYING
    bench.control_state = ControlState.FLYING
    bench.run(0.2)
    bench.speaks = False
    bench.run(2.5)
    bench.speaks = True
    bench.run(0.5)
    assert bench.link.phase is Phase.READY and not bench.ref & at.Ref.START


def test_a_vehicle_whose_commands_have_stopped_hovers_and_then_lands():
    bench = Bench(command_timeout_s=0.2, land_timeout_s=4.0)
    bench.run(0.5)
    bench.order(bench.link.steer, FORWARD)  # before it flies: no reason to land it when it has just taken off
    bench.run(5.0)
    bench.order(bench.link.take_off)
    bench.bits, bench.control_state = bench.bits | State.FLYING, ControlState.TAKING_OFF
    bench.run(5.0)
    bench.control_state = ControlState.HOVERING
    bench.run(3.5)
    assert bench.ref & at.Ref.START
    bench.order(bench.link.steer, FORWARD)
    bench.run(3.9)
    assert bench.ref & at.Ref.START and bench.sticks == HOVER
    bench.run(0.2)
    assert not bench.ref & at.Ref.START and "cmd_vel for 4.0 s" in bench.texts("warn")[-1]


def test_without_that_time_out_nobody_is_landed():
    bench = Bench(command_timeout_s=0.2)
    bench.run(0.5)
    bench.order(bench.link.take_off)
    bench.bits, bench.control_state = bench.bits | State.FLYING, ControlState.HOVERING
    bench.order(bench.link.steer, FORWARD)
    bench.run(20.0)
    assert bench.ref & at.Ref.START


def test_who_was_never_steered_is_not_landed():
    """After a take-off from the command line, without cmd_vel."""
    bench = Bench(land_timeout_s=4.0)
    bench.run(0.5)
    bench.order(bench.link.take_off)
    bench.bits, bench.control_state = bench.bits | State.FLYING, ControlState.HOVERING
    bench.run(20.0)
    assert bench.ref & at.Ref.START


@pytest.mark.parametrize("duration_s, deaf", [(0.4, False), (3.0, True)])
def test_orders_that_came_while_the_driver_stood_still_are_old(bench, duration_s, deaf):
    bench.now_s += duration_s
    bench.link.stood_still(duration_s, bench.now_s)
    bench.order(bench.link.take_off)
    bench.order(bench.link.steer, FORWARD)
    bench.run(0.1)
    assert bool(bench.ref & at.Ref.START) == (not deaf)
    assert bench.sticks == (HOVER if deaf else FORWARD)
    assert any("refused" in text and "3.0 s" in text for text in bench.texts("warn")) == deaf
    bench.run(0.4)
    bench.order(bench.link.take_off)
    bench.order(bench.link.steer, FORWARD)
    bench.run(0.1)
    assert bench.ref & at.Ref.START and bench.sticks == FORWARD
    bench.link.stood_still(3.0, bench.now_s)
    bench.order(bench.link.land)
    bench.run(0.1)
    assert not bench.ref & at.Ref.START
