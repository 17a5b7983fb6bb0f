"""The driver's side of the link to one AR.Drone 2.0: a state machine without sockets, clock or ROS.

    SEARCHING --first packet--> SETTLING --settle time--> CONFIGURING --all writes acknowledged--> READY
        ^                                                     ^------- the vehicle has rebooted ------|
        |------------------------- nothing received for lost_s seconds -------------------------------|

All inputs carry the time of a monotonic clock: received datagrams (`on_navdata`), orders of the pilot (`steer`,
`take_off`, ...) and the passing of time (`poll`).  The outputs are two functions that send a datagram, to the command
port and to the navdata port.

Commands are sent every TICK_S, one PCMD_MAG and one REF in one datagram.  A new order does not wait for the next tick:
it is sent at once and the tick starts over, so nothing is added to the delay of the radio.

Safety rules beyond the original driver: the start bit is cleared when the vehicle is lost or has rebooted (otherwise it
would take off by itself when it comes back), and set by a driver that finds its vehicle in flight (otherwise the
vehicle would land when its driver is restarted); orders that came while the driver was suspended are ignored, except to
land and to stop; a take-off is refused in emergency, and a reset that has no effect is given up instead of being held.
Silence does not disable the emergency stop: telemetry may be lost while commands still arrive, so a reset is sent even
without telemetry.
"""

import itertools
import struct
from collections import deque
from enum import Enum

from ardrone_autonomy.aircraft_configuration import APPLICATION_ID, DRIVER_DEFAULTS, USER_ID
from ardrone_autonomy.piloting import HOVER
from ardrone_autonomy.protocol import at
from ardrone_autonomy.protocol.at import CtrlMode
from ardrone_autonomy.protocol.navdata import HEADER, WAKE_UP, ControlState, Navdata, NavdataError, State, peek

TICK_S = 0.025  # 40 Hz, as the original; the aircraft raises COM_WATCHDOG after 50 ms of silence
MIN_SPACING_S = 0.004  # between two command datagrams: cmd_vel at 200 Hz passes
WAKE_UP_PERIOD_S = 0.25  # silence after which the wake-up is sent and repeated; reduced telemetry comes every 65 ms
COMMAND_TIMEOUT_S = 0.5  # default: the last tilt of a node that died must not stay in force
STALL_S = 0.5  # a driver that was not called for this long was suspended: flight orders from that time are old,
DEAF_S = 0.3  # and may still arrive for this long
LOST_S = float(DRIVER_DEFAULTS["com_watchdog"])  # default: silence after which the vehicle counts as lost
ACK_TIMEOUT_S = 0.5  # a configuration write without answer is repeated after this time
MAX_WRITE_TRIES = 5
CLEAR_PERIOD_S = 0.05  # repetition of the request to clear the acknowledge bit
MAX_CLEAR_TRIES = 20
RESET_TIMEOUT_S = 1.0  # a reset without effect is given up after this time
BOOTSTRAP_PATIENCE_S = 1.0  # bootstrap packets may still come this long after the write that ends that state

# Plain ints: the operators of IntFlag are too slow for every packet.
_ACK, _BOOTSTRAP, _COM_WATCHDOG, _EMERGENCY, _FLYING = map(
    int, (State.COMMAND_ACK, State.BOOTSTRAP, State.COM_WATCHDOG, State.EMERGENCY, State.FLYING)
)
_MOMENTOUS = _BOOTSTRAP | _EMERGENCY  # if one of these changes, the whole packet is checked, including its checksum

_NEVER_S = float("inf")
_FIRST_OPTION = struct.Struct("<HHI")  # tag, size, first word of the payload; every packet has at least these
_NOT_IN_FLIGHT = (ControlState.LANDED, ControlState.LANDING)
_STEERED = (int(ControlState.FLYING), int(ControlState.HOVERING))  # states in which a vehicle obeys the sticks


class Phase(Enum):
    """State of the connection."""

    SEARCHING = "searching"
    SETTLING = "settling"
    CONFIGURING = "configuring"
    READY = "ready"


_Write = Enum("_Write", "IDLE AWAIT_ACK AWAIT_CLEAR")


class DroneLink:
    """Connection, configuration and piloting of one vehicle.

    send_command, send_wake_up: functions of one bytes argument; they must not raise.
    setup_writes: list of ("section:name", wire text) written after each connection, of aircraft_configuration.
    session_id: 8 hexadecimal digits.
    settle_s: pause between the first packet and the configuration.
    command_timeout_s: hover when the last velocity command is older; 0 = it stays in force, as in the original.
    land_timeout_s: land when it is older, once the vehicle has been steered; 0 = never, as in the original.
    lost_s: silence after which the vehicle counts as lost and is told to land: its own limit, general:com_watchdog.
    report: function (level, text), level "info", "warn" or "error".
    """

    def __init__(
        self,
        send_command,
        send_wake_up,
        setup_writes,
        session_id,
        settle_s=5.0,
        command_timeout_s=COMMAND_TIMEOUT_S,
        land_timeout_s=0.0,
        lost_s=LOST_S,
        report=lambda level, text: None,
    ):
        self._send_command = send_command
        self._send_wake_up = send_wake_up
        self._setup_writes = list(setup_writes)
        self._session_id = session_id
        self._settle_s = settle_s
        self._command_timeout_s = command_timeout_s
        self._land_timeout_s = land_timeout_s
        self.lost_s = lost_s
        self._report = report

        self.phase = Phase.SEARCHING
        self.due_s = float("-inf")  # when poll must be called
        self.accepted = 0  # packets
        self.configurations = 0  # times that the vehicle was configured: earlier writes no longer hold
        self.stale = 0  # packets older than one seen before
        self.refused = 0  # datagrams that are not navdata, or damaged
        self.connections = 0
        self.unanswered_writes = 0

        self.state_bits = 0  # of the newest packet, see navdata.State
        self._numbers = itertools.count(1)  # of commands
        self._navdata_sequence = -1
        self._heard_s = float("-inf")
        self._next_wake_up_s = float("-inf")
        self._settled_s = _NEVER_S
        self._configured_before = False
        self._setup_started_s = float("-inf")
        self._watchdog_reset = False
        self._control_state = ControlState.DEFAULT
        self._steered_since_s = _NEVER_S  # since when the vehicle reports that it flies or hovers
        self._stood_still_s, self._deaf_until_s = 0.0, float("-inf")

        self._writes = deque()
        self._write_state = _Write.IDLE
        self._write_tries = 0
        self._write_retry_s = 0.0

        self._wanted = HOVER  # newest velocity command
        self._wanted_s = float("-inf")
        self._timed_out = False
        self._sticks = HOVER  # sticks that are sent
        self._start = False  # REF bit 9
        self._select = False  # REF bit 8
        self._select_until_s = 0.0
        self._emergency_at_select = 0
        self._reset_ordered = False
        self._take_off_ordered = False
        self._land_ordered = False
        self._closing = False
        self._next_tick_s = _NEVER_S  # no commands before the first packet
        self._last_tick_s = float("-inf")

    # --- what is known -------------------------------------------------------------------------------------------
    @property
    def connected(self):
        """Packets are arriving."""
        return self.phase is not Phase.SEARCHING

    @property
    def emergency(self):
        """The vehicle has reported its emergency state."""
        return bool(self.state_bits & _EMERGENCY)

    @property
    def keeps_flying(self):
        """The vehicle is commanded to stay in the air (if it flies)."""
        return self._start

    @property
    def in_flight(self):
        """A connected vehicle reports that it flies and is not landing yet."""
        return self.connected and self._says_it_flies

    @property
    def _says_it_flies(self):
        if self.emergency or self._control_state in _NOT_IN_FLIGHT:
            return False
        return bool(self.state_bits & _FLYING) or self._control_state == ControlState.TAKING_OFF

    # --- orders of the pilot ------------------------------------------------------------------------------------------
    def stood_still(self, duration_s, now_s):
        """Note how long this link was not called: the process hung, or the computer slept."""
        if duration_s >= STALL_S:
            self._stood_still_s, self._deaf_until_s = duration_s, now_s + DEAF_S
            self._report("warn", "the driver was suspended for %.1f s" % duration_s)

    def steer(self, sticks, now_s):
        """Fly with these sticks (piloting.Sticks) from now on."""
        if self._closing or now_s < self._deaf_until_s:
            return
        self._wanted = sticks
        self._wanted_s = now_s
        self._timed_out = False
        self._hurry(now_s)

    def take_off(self, now_s):
        """Take off; refused while the vehicle is not configured or in emergency."""
        if self._closing:
            return
        if self.phase is not Phase.READY:
            self._report("warn", "take-off refused: the vehicle is not ready (%s)" % self.phase.value)
        elif self.emergency:
            self._report("warn", "take-off refused: the vehicle is in emergency, reset it first")
        elif now_s < self._deaf_until_s:
            text = "take-off refused: the driver was suspended for %.1f s, and the order may be as old. Send it again"
            self._report("warn", text % self._stood_still_s)
        else:
            self._take_off_ordered = True
            self._hurry(now_s)

    def land(self, now_s):
        """Land."""
        self._land_ordered = True
        self._hurry(now_s)

    def reset(self, now_s):
        """Toggle the emergency state: stops the motors in the air (!), clears an emergency on the ground.

        Also sent to a vehicle that has fallen silent, because it may still receive; but not if it was in emergency
        before, because then it is unknown whether the toggle would stop or restart it.
        """
        if not self.connections:
            self._report("warn", "reset refused: no vehicle has answered yet")
            return
        if not self.connected:
            if self.emergency:
                self._report("warn", "reset refused: the silent vehicle was in emergency, its motors had stopped")
                return
            self._report("warn", "the reset is sent without telemetry: whether it arrives cannot be seen")
        self._reset_ordered = True
        self._hurry(now_s)

    def flat_trim(self, now_s):
        """Tell the vehicle that it is level now; refused in flight."""
        if self.state_bits & _FLYING:
            self._report("warn", "flat trim refused: the vehicle is flying")
            return
        self._send("FTRIM")

    def blink(self, animation, frequency_hz, duration_s, now_s):
        """Start an LED animation."""
        self._send("LED", animation, frequency_hz, duration_s)

    def write(self, key, text, now_s):
        """Write one configuration value as soon as those before it are acknowledged."""
        self._writes.append((key, text))
        self.due_s = now_s

    def close(self, now_s):
        """Give the last orders, hover and land; ignore all orders from now on."""
        self._wanted = HOVER
        self._closing = True
        self._take_off_ordered = False
        self.land(now_s)

    def send_last_orders(self):
        """Send hover and land at once, without `poll`: for use when the thread that calls `poll` has failed.

        An emergency stop in progress is kept.
        """
        if self.connections:
            self._pilot(HOVER, select=self._select or self._reset_ordered)

    def _pilot(self, sticks, start=False, select=False):
        self._send_command(at.pcmd_mag(next(self._numbers), *sticks) + at.ref(next(self._numbers), start, select))

    def _send(self, name, *arguments):
        self._send_command(at.encode(name, next(self._numbers), *arguments))

    # --- navdata --------------------------------------------------------------------------------------------------
    def on_navdata(self, data, now_s):
        """Handle a datagram from the navdata port of the vehicle. Returns True when it is the newest packet so far.

        Looks at the header only, and verifies the checksum only when the vehicle enters or leaves emergency or
        bootstrap; the caller decodes the options of the packets that it needs.
        """
        try:
            header = peek(data)
            bits = header.state
            changed = bits ^ self.state_bits
            if changed & _MOMENTOUS:
                Navdata(data)
        except NavdataError:
            self.refused += 1
            return False
        if bits & _COM_WATCHDOG and not bits & _BOOTSTRAP:
            self._watchdog_reset = True
            self._navdata_sequence = -1  # the vehicle may restart its count
        if header.sequence <= self._navdata_sequence:
            self.stale += 1
            return False
        self._navdata_sequence = header.sequence
        self._heard_s = now_s
        self.accepted += 1
        self.state_bits = bits
        tag, _, word = _FIRST_OPTION.unpack_from(data, HEADER.size)
        if tag == 0:  # Tag.DEMO
            self._control_state = word >> 16
            if self._control_state not in _STEERED:
                self._steered_since_s = _NEVER_S
            elif self._steered_since_s == _NEVER_S:
                self._steered_since_s = now_s
        if changed & _EMERGENCY:
            self._on_emergency_changed()
        if self.phase is not Phase.READY or self._writes or self._write_state is not _Write.IDLE or bits & _BOOTSTRAP:
            self._on_connection_step(now_s)
        return True

    def _on_emergency_changed(self):
        if self._select and self.state_bits & _EMERGENCY != self._emergency_at_select:
            self._select = False
        if self.emergency:
            self._start = False  # so that it does not take off again when the emergency is cleared
            self._take_off_ordered = False
            self._report("error", "EMERGENCY: the vehicle has stopped its motors (state 0x%08x)" % self.state_bits)
        else:
            self._report("info", "the emergency is cleared")

    def _on_connection_step(self, now_s):
        self.due_s = now_s
        if self.phase is Phase.SEARCHING:
            self.connections += 1
            self._next_tick_s = now_s
            if self._configured_before:
                self._report("info", "the vehicle is back, configuring it again")
                self._start_configuration(now_s)
            else:
                self._report("info", "the vehicle answers; configuration follows in %.1f s" % self._settle_s)
                if self.connections == 1 and self._says_it_flies:
                    self._report("warn", "the vehicle is in flight: it is kept hovering")
                    self._start, self._wanted_s = True, now_s
                self.phase = Phase.SETTLING
                self._settled_s = now_s + self._settle_s
        elif self.state_bits & _BOOTSTRAP and (
            self.phase is Phase.READY
            or self.phase is Phase.CONFIGURING
            and len(self._writes) < len(self._setup_writes)
            and now_s > self._setup_started_s + BOOTSTRAP_PATIENCE_S
        ):
            self._report("warn", "the vehicle has rebooted, configuring it again")
            self._ground()
            self._start_configuration(now_s)

    def _ground(self):
        """Cancel all orders that keep or bring the vehicle into the air; an ordered emergency stop is kept."""
        self._start = self._take_off_ordered = self._land_ordered = False
        self._wanted = self._sticks = HOVER

    def _start_configuration(self, now_s):
        self.phase = Phase.CONFIGURING
        self.configurations += 1
        self._setup_started_s = now_s
        self._writes.clear()
        self._writes.extend(self._setup_writes)
        self._write_state = _Write.IDLE

    # --- time -----------------------------------------------------------------------------------------------------
    def poll(self, now_s):
        """Do what is due; set due_s, the time of the next call (orders and packets may make it earlier)."""
        if now_s >= self._next_wake_up_s:
            if now_s - self._heard_s >= WAKE_UP_PERIOD_S:
                self._send_wake_up(WAKE_UP)
                self._navdata_sequence = -1
                self._next_wake_up_s = now_s + WAKE_UP_PERIOD_S
                if self.connected and now_s - self._heard_s >= self.lost_s:
                    self._on_lost()
            else:
                self._next_wake_up_s = self._heard_s + WAKE_UP_PERIOD_S
        if self.phase is Phase.SETTLING and now_s >= self._settled_s:
            self._start_configuration(now_s)
        next_step_s = _NEVER_S
        if self.phase is Phase.SETTLING:
            next_step_s = self._settled_s
        elif self.connected:
            self._advance_writes(now_s)
            if self._write_state is not _Write.IDLE:
                next_step_s = self._write_retry_s
        if now_s >= self._next_tick_s:
            self._tick(now_s)
        self.due_s = min(self._next_wake_up_s, next_step_s, self._next_tick_s)

    def _on_lost(self):
        self._report("error", "nothing received for %.1f s: landing is ordered, looking for the vehicle" % self.lost_s)
        self.phase = Phase.SEARCHING
        self._writes.clear()
        self._write_state = _Write.IDLE
        self._ground()

    def _hurry(self, now_s):
        """Bring the next tick forward to now, but no earlier than MIN_SPACING_S after the last datagram."""
        if self._next_tick_s != _NEVER_S:
            self._next_tick_s = min(self._next_tick_s, max(now_s, self._last_tick_s + MIN_SPACING_S))
            self.due_s = min(self.due_s, self._next_tick_s)

    def _tick(self, now_s):
        if self._reset_ordered:
            self._reset_ordered = False
            self._select = True
            self._select_until_s = now_s + RESET_TIMEOUT_S
            self._emergency_at_select = self.state_bits & _EMERGENCY
        elif self._take_off_ordered:
            self._take_off_ordered = False
            self._start = True
        elif self._land_ordered:
            self._land_ordered = False
            self._start = False
        else:
            self._sticks = self._fresh_sticks(now_s)
            self._land_if_forgotten(now_s)
        if self._select and now_s >= self._select_until_s:
            self._select = False
            text = "the reset had no effect: the cause of the emergency persists, or the link is bad"
            if not self.connected:
                text = "the reset was sent for %.1f s without telemetry, its effect is unknown" % RESET_TIMEOUT_S
            self._report("warn", text)
        self._pilot(self._sticks, self._start, self._select)
        if self._watchdog_reset:
            self._watchdog_reset = False
            self._send("COMWDG")
        self._last_tick_s = now_s
        # One order a tick: the next one follows at once
        waiting = self._take_off_ordered or self._land_ordered
        self._next_tick_s = now_s + (MIN_SPACING_S if waiting else TICK_S)

    def _fresh_sticks(self, now_s):
        if self._command_timeout_s > 0.0 and now_s - self._wanted_s > self._command_timeout_s:
            if not self._timed_out and self._wanted != HOVER:
                self._timed_out = True
                self._report("warn", "no cmd_vel for %.2f s: hovering" % (now_s - self._wanted_s))
            return HOVER
        return self._wanted

    def _land_if_forgotten(self, now_s):
        """Land when the node that steered the vehicle has ended or hangs, because nothing else would land it."""
        silent_s = now_s - max(self._wanted_s, self._steered_since_s)
        was_steered = self._wanted_s > float("-inf")
        if self._start and was_steered and 0.0 < self._land_timeout_s < silent_s:
            self._start = False
            self._report("warn", "no cmd_vel for %.1f s: landing" % silent_s)

    # --- configuration ----------------------------------------------------------------------------------------------
    def _advance_writes(self, now_s):
        """Do one step of: acknowledge bit clear -> write -> bit set -> ask to clear it -> bit clear -> next write."""
        acknowledged = bool(self.state_bits & _ACK)
        is_due = now_s >= self._write_retry_s
        if self._write_state is _Write.AWAIT_ACK:
            if acknowledged:
                self._writes.popleft()
                self._await(_Write.AWAIT_CLEAR)
            elif is_due and self._write_tries >= MAX_WRITE_TRIES:
                self.unanswered_writes += 1
                self._report("error", "the vehicle did not acknowledge %s = %s" % self._writes.popleft())
                self._await(_Write.IDLE)
        elif self._write_state is _Write.AWAIT_CLEAR:
            if is_due and self._write_tries >= MAX_CLEAR_TRIES:
                acknowledged = False  # the bit is stuck: go on without it
            if not acknowledged:
                self._await(_Write.IDLE)
        if self._write_state is _Write.IDLE:
            if self._writes:
                self._await(_Write.AWAIT_CLEAR if acknowledged else _Write.AWAIT_ACK)
            elif self.phase is Phase.CONFIGURING:
                self.phase = Phase.READY
                self._configured_before = True
                self._report("info", "the vehicle is configured")
        if self._write_state is not _Write.IDLE and (is_due or not self._write_tries):
            self._try_write(now_s)

    def _await(self, write_state):
        self._write_state, self._write_tries = write_state, 0

    def _try_write(self, now_s):
        self._write_tries += 1
        if self._write_state is _Write.AWAIT_CLEAR:
            self._send("CTRL", CtrlMode.CLEAR_ACK, 0)
            self._write_retry_s = now_s + CLEAR_PERIOD_S
            return
        if self._write_tries > 1 and self.phase is Phase.CONFIGURING:
            # A vehicle that still counts on from a previous client ignores our numbers except 1, which was lost
            self._numbers = itertools.count(1)
        self._send_command(
            at.encode("CONFIG_IDS", next(self._numbers), self._session_id, USER_ID, APPLICATION_ID)
            + at.encode("CONFIG", next(self._numbers), *self._writes[0])
        )
        self._write_retry_s = now_s + ACK_TIMEOUT_S
