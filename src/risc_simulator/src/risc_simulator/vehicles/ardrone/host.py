"""An AR.Drone 2.0 on the wire: the sockets, state machine and telemetry of one aircraft of the virtual lab.

UDP 5556 takes AT commands, UDP 5554 answers wake-up datagrams with navdata, TCP 5559 gives the configuration text,
TCP 5555 is for video, which video.server serves (`attach_video`).  TCP 5551 is FTP, with the firmware's version.
Each aircraft has its own loopback address, so all use the standard ports.  Any real client can connect.

Piloting (PCMD, REF) passes the simulated radio: one set of sticks per 1/30 s slot, the vehicle's command delay later.
Navdata may be lost there too, but is not delayed; configuration is neither lost nor delayed.  One thread, non-blocking
sockets; bad input is counted, never raised.

Where the public documents leave a choice, this aircraft behaves as follows:
- State bit 30 stays set until COMWDG arrives, even when commands flow again.
- The watchdog of general:com_watchdog (2 s unless a client writes another time, 1 s at least) counts accepted commands
  only, so a client that restarts with low sequence numbers is accepted once it has expired.  The aircraft then hovers
  for 2 s and lands; it takes off again only after REF bit 9 was seen 0.
- From 50 ms of silence until the watchdog expires the last command stays in force.
- Flight and LED animations, CALIB and the user box are acknowledged and noted (see `notes`), not performed.
- Wake-up value 2 (multicast) is answered by unicast.
"""

import logging
import math
import socket
from collections import deque, namedtuple
from dataclasses import replace
from zlib import crc32

import numpy as np

from ardrone_autonomy import protocol
from ardrone_autonomy.protocol import at, navdata
from ardrone_autonomy.protocol.navdata import ControlState, State
from risc_simulator.models.flight import FlightAction, FlightPhase, Setpoint
from risc_simulator.models.radio_link import RadioLink
from risc_simulator.notices import Notices
from risc_simulator.socket_host import TcpClients, Told, VehicleHost, open_socket
from risc_simulator.vehicles.ardrone.firmware import LOST_HOVER_S, LOW_BATTERY_PCT
from risc_simulator.vehicles.ardrone.navdata import Frame, NavdataWriter
from risc_simulator.vehicles.ardrone.profiles import NO_LIMIT_MM, ConfigurationStore
from risc_simulator.vehicles.ardrone.sensors import ArdroneSensors
from risc_simulator.vehicles.ardrone.wire import SequenceGate, parse_datagram

_LOG = logging.getLogger(__name__)

WATCHDOG_S = 0.050  # silence that sets state bit 30
BOOTSTRAP_PERIOD_S = 1.0 / 15.0
FULL_PERIOD_S = 1.0 / navdata.FULL_RATE_HZ
DEMO_PERIOD_S = navdata.DEMO_PERIOD * FULL_PERIOD_S
LOOK_AHEAD_S = 0.010  # decisions are taken this long before they take effect: two cycles of the lab
ORDER_REST_S = 0.1  # after an order, until the vehicle's phase is evaluated again
ALTITUDE_GAIN_1_S = 0.8  # climb rate allowed per metre below altitude_max; below 1/(4 * 0.3 s): no overshoot
CLIMB_STEP_M_S = 0.005  # smaller changes by the altitude limit are not worth a command
FOREVER_S = 1e9  # upper limit of the client's own time-out

MAX_CONTROL_CLIENTS = 16
MAX_TCP_BACKLOG_BYTES = 256 * 1024

_BASE_STATE = sum(
    (
        State.ALTITUDE_CONTROL,
        State.PIC_VERSION_OK,
        State.AT_THREAD,
        State.NAVDATA_THREAD,
        State.VIDEO_THREAD,
        State.ACQUISITION_THREAD,
    )
)
_SELECT, _START = int(at.Ref.SELECT), int(at.Ref.START)
_PROGRESSIVE, _ABSOLUTE = int(at.PcmdFlag.PROGRESSIVE), int(at.PcmdFlag.ABSOLUTE)

_CAN_LAND = (FlightPhase.TAKING_OFF, FlightPhase.HOVERING, FlightPhase.FLYING)
_IN_FLIGHT = _CAN_LAND + (FlightPhase.LANDING,)
_MAJOR = {
    FlightPhase.LANDED: ControlState.LANDED,
    FlightPhase.TAKING_OFF: ControlState.TAKING_OFF,
    FlightPhase.HOVERING: ControlState.HOVERING,
    FlightPhase.FLYING: ControlState.FLYING,
    FlightPhase.LANDING: ControlState.LANDING,
}
_HOVERING_LOST_COM = 8  # minor state

Ports = namedtuple("Ports", "navdata video at control ftp", defaults=(0,))
STANDARD_PORTS = Ports(
    protocol.NAVDATA_PORT, protocol.VIDEO_PORT, protocol.AT_PORT, protocol.CONTROL_PORT, protocol.FTP_PORT
)

# One set of piloting values as received: flags of PCMD, the four sticks in [-1, 1], the pilot's heading (fractions of
# 180 degrees) and its accuracy, the sequence number and the time of reception.
Sticks = namedtuple("Sticks", "flags roll pitch gaz yaw psi psi_accuracy sequence time_s")
NO_STICKS = Sticks(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0.0)


class ArdroneHost(VehicleHost):
    """One aircraft.

    vehicle: world.Vehicle.
    address: IPv4 address of this machine to listen on, e.g. 127.0.1.1.
    ports: Ports; a 0 takes a free one, see `ports`.
    seed: of sensor noise and radio, combined with the namespace.   sensor_noise: factor, 0 = exact sensors.
    radio_loss: probability that a radio slot, or a datagram of navdata, is lost.
    wires: wires.Wires, of which it uses commands, wake_ups, navdata, and the streams control and ftp; None = wires of
        its own.

    All now_s are lab time in seconds, the clock of vehicle.schedule.  Raises OSError naming the cause and the cure
    if an address or port cannot be used; input that arrives later never raises.
    """

    def __init__(self, vehicle, address, ports=STANDARD_PORTS, seed=0, sensor_noise=1.0, radio_loss=0.0, wires=None):
        super().__init__(vehicle, wires)
        self._navdata = self.wire("navdata")
        control, ftp = map(self.stream, ("control", "ftp"))
        self.address = address
        rng = np.random.default_rng([seed, crc32(vehicle.namespace.encode("utf-8"))])
        rate_hz = vehicle.type.command_rate_hz
        self._radio = RadioLink(
            vehicle.plant.command_delay_s, rate_hz, radio_loss, rng, phase_s=rng.uniform(0.0, 1.0 / rate_hz)
        )
        self._rest_height_m = vehicle.height_m if vehicle.phase is FlightPhase.LANDED else 0.0
        self.sensors = ArdroneSensors(rng, sensor_noise, self._rest_height_m, lambda: vehicle.firmware.flow)
        serial = "PS721%09d" % (crc32(address.encode("ascii")) % 10**9)
        self.configuration = ConfigurationStore(serial, vehicle.namespace)
        self.notes = {}  # last LED, animation, ... that was acknowledged but not performed
        self._notices = Notices(_LOG, vehicle.namespace)

        # link
        self._gate = SequenceGate()
        self._last_at_s = None  # of the last accepted command; None before the first and after a loss
        self._com_watchdog = True  # state bit 30
        self._com_lost_s = None  # since when state bit 13 is set

        # piloting
        self._arriving = deque()  # (time, item) from the radio that is not yet due
        self._last_phase = vehicle.phase
        self._told_flags = NO_STICKS.flags
        self._forget_pilot()
        self._ref_sequence = 0
        self._ref_time_s = None
        self._ref_gap_ms = 0.0
        self._config_ids = None  # of the CONFIG_IDS directly before

        # navdata
        self._client = None  # address of the last wake-up
        self._last_wake_up_s = -math.inf
        self._radio_loss = radio_loss
        self._losses = np.random.default_rng([seed, crc32(vehicle.namespace.encode("utf-8")), 1])  # of navdata
        self._bootstrap = True
        self._ack = False  # state bit 6
        self._sequence = 0
        self._cycles = 0
        self._next_packet_s = -math.inf
        self._writer = None

        self._readers = None  # TcpClients of the configuration
        self._video = None  # video.server.Station
        self._sockets = {}  # name -> socket
        self._ftp = None
        try:
            for name in Ports._fields:
                kind = socket.SOCK_DGRAM if name in ("navdata", "at") else socket.SOCK_STREAM
                self._sockets[name] = open_socket(kind, address, getattr(ports, name), vehicle.namespace)
            asks, most = "reads the configuration", MAX_CONTROL_CLIENTS
            self._readers = TcpClients(self._sockets["control"], control, self._notices, asks, most, self._write)
            # imported here: pyftpdlib is slow to import, and offline flights do not need it
            from risc_simulator.vehicles.ardrone.ftp import FtpServer

            self._ftp = FtpServer(self._sockets["ftp"], self._notices, ftp)
        except OSError:
            self.close()
            raise
        self.hear(self._sockets["at"], self.wire("commands"), self._on_at_datagram)
        self.hear(self._sockets["navdata"], self.wire("wake_ups"), self._on_wake_up)
        self._waiting.add(self._readers)
        self._waiting.add(self._ftp)
        self.ports = Ports(*[self._sockets[name].getsockname()[1] for name in Ports._fields])
        self._obey_configuration()

    # --- the host interface of the virtual lab ------------------------------------------------------------------

    @property
    def video_listener(self):
        """The socket that video clients connect to."""
        return self._sockets["video"]

    def attach_video(self, video):
        self._video = video
        self._obey_configuration()

    def tick(self, now_s):
        """To be called once per cycle of the lab, after the world has moved."""
        self._now_s = now_s
        if now_s >= self.wires.due_s:
            self.wires.release(now_s)
        phase = self._vehicle.phase
        self._watch_phase(phase)
        self._watch_link(now_s, phase)
        self._pilot(now_s, phase)
        self._readers.flush()
        if self._client is not None and now_s >= self._next_packet_s - 0.1 * FULL_PERIOD_S:
            self._send_navdata(now_s, phase)

    def power_cycle(self, now_s):
        """The configuration stays. Take-off needs a fresh command, lest the rotors hit the person who put it back."""
        self._radio.clear()
        self._arriving.clear()
        self._forget_pilot()
        self._armed = False
        self._begin_anew()
        self._com_lost_s, self._com_watchdog = None, True

    def close(self):
        """Close all sockets. May be called twice."""
        for server in (self._readers, self._ftp, *self._sockets.values()):
            if server is not None:
                server.close()
        self._waiting.close()
        self._ftp, self._sockets = None, {}

    def describe(self):
        """One line for people: what listens where."""
        return (
            "%s (%s) AR.Drone 2.0 at %s: navdata udp %d, video tcp %d, AT commands udp %d, configuration tcp %d, "
            "version by FTP tcp %d" % (self._vehicle.namespace, self._vehicle.name, self.address, *self.ports)
        )

    def get(self, key):
        """Typed value of a configuration key in force."""
        return self.configuration.get(key)

    def statistics(self):
        """Counts since the start (0 for a missing key)."""
        result = self._counts.copy()
        result["radio_slots_lost"] = self._radio.slots_lost
        result["sticks_superseded"] = self._radio.items_superseded
        result["tcp_clients_refused"] = self._readers.refused
        result["notices"] = self._notices.statistics()
        return result

    # --- sockets --------------------------------------------------------------------------------------------------

    def _forget_pilot(self):
        self._submitted_ref = None
        self._select = False  # last level of REF bit 8
        self._start = None  # last level of REF bit 9; None: no REF yet
        self._armed = True  # False: bit 9 must be seen 0 before the next take-off
        self._refused = False  # this take-off was counted as refused already
        self._landing_ordered = False
        self._rest_until_s = -math.inf  # until then an order is under way
        self._user_emergency = False
        self._sticks = NO_STICKS
        self._wanted = Setpoint(hover=True)  # before the altitude limit
        self._scheduled = self._wanted

    def _write(self, text, sock):
        """Text for a client that reads the configuration."""
        backlog = self._readers.backlogs[sock]
        if len(backlog) + len(text) > MAX_TCP_BACKLOG_BYTES:
            self._readers.hang_up(sock)  # it requests and never reads
        else:
            backlog += text

    # --- commands ---------------------------------------------------------------------------------------------------

    def _on_at_datagram(self, data, sender, now_s):
        self._counts["at_datagrams"] += 1
        commands, malformed = parse_datagram(data)
        if malformed:
            self._counts["at_malformed"] += malformed
            self._notices.complaint("sends malformed commands", sender, repr(data[:60]))
        else:
            self._notices.event("sends commands", sender)
        for command in commands:
            if not self._gate.accept(command.sequence):
                self._counts["at_stale"] += 1
                self._notices.complaint("is not obeyed: numbers below the last", sender, "%d" % command.sequence)
                continue
            self._counts["at_commands"] += 1
            # silence is checked here as well: a late tick must not miss a gap that this command has just ended
            if self._last_at_s is not None and now_s - self._last_at_s > WATCHDOG_S:
                self._bark()
            self._last_at_s = now_s
            self._com_lost_s = None
            handler = self._HANDLERS.get(command.name)
            if handler is not None:
                handler(self, command, now_s)
            elif command.name not in at.IGNORED:
                self._counts["at_unknown"] += 1
            if command.name != "CONFIG_IDS":
                self._config_ids = None

    def _on_ref(self, command, now_s):
        bits = command.arguments[0]
        if self._ref_time_s is not None:
            self._ref_gap_ms += 0.1 * (1e3 * max(0.0, now_s - self._ref_time_s) - self._ref_gap_ms)
        self._ref_time_s, self._ref_sequence = now_s, command.sequence
        if bits != self._submitted_ref:
            self._submitted_ref = bits
            self._radio.submit(now_s, bits, must_arrive=True)
        self._note_told(now_s)

    def _on_pcmd(self, command, now_s):
        flags, *sticks = command.arguments
        sticks = [min(1.0, max(-1.0, value)) for value in sticks]
        sticks += [0.0] * (6 - len(sticks))
        self._told_flags = flags
        self.note_inputs((flags, *sticks), now_s)
        self._radio.submit(now_s, Sticks(flags, *sticks, command.sequence, now_s))

    def _note_told(self, now_s):
        """Called with REF, which clients send after their PCMD."""
        if not self._submitted_ref & _START:
            self.note_told(Told.LAND, now_s)
        else:
            self.note_told(Told.FLY if self._told_flags & _PROGRESSIVE else Told.HOVER, now_s)

    def _on_config_ids(self, command, _):
        self._config_ids = command.arguments

    def _on_config(self, command, _):
        key, value = command.arguments
        self._ack = True
        if not self.configuration.write(key, value, self._config_ids):
            self._counts["config_ignored"] += 1
            return
        self._counts["config_writes"] += 1
        key = key.strip().lower()
        if key == "general:navdata_demo":
            self._bootstrap = False
            self._next_packet_s = min(self._next_packet_s, self._now_s + FULL_PERIOD_S)
        if key in ("control:flight_anim", "leds:leds_anim", "userbox:userbox_cmd"):
            self.notes[key] = value
        self._obey_configuration()  # whatever the key: another session's or user's profile brings its own values

    def _obey_configuration(self):
        get = self.configuration.get
        self._patience_s = min(max(1, get("general:com_watchdog")), FOREVER_S)
        self._packet_period_s = DEMO_PERIOD_S if get("general:navdata_demo") else FULL_PERIOD_S
        self._tilt_max_rad, self._yaw_rate_max_rad_s = get("control:euler_angle_max"), get("control:control_yaw")
        self._climb_max_m_s = 1e-3 * get("control:control_vz_max")
        self._lowest_m, highest_mm = 1e-3 * get("control:altitude_min"), get("control:altitude_max")
        self._highest_m = 1e-3 * highest_mm if highest_mm < NO_LIMIT_MM else math.inf
        self._rebuild_writer()
        if self._video is not None:
            self._video.configure(
                channel=get("video:video_channel"),
                rate_hz=get("video:codec_fps"),
                bitrate_kbit_s=get("video:max_bitrate"),
                enabled=get("general:video_enable"),
            )

    def _on_ctrl(self, command, now_s):
        mode = command.arguments[0]
        if mode == at.CtrlMode.CLEAR_ACK:
            self._ack = False
        elif mode in (at.CtrlMode.SEND_CONFIG, at.CtrlMode.SEND_CUSTOM_IDS) and self._readers.backlogs:
            # without a reader nothing is acknowledged, so that the client asks again
            self._ack = True
            self._counts["config_readbacks"] += 1
            whole = mode == at.CtrlMode.SEND_CONFIG
            self._readers.write(self.configuration.text() if whole else self.configuration.custom_ids_text(), now_s)

    def _on_comwdg(self, _command, _now_s):
        self._com_watchdog = False

    def _on_ftrim(self, _command, _now_s):
        if self._vehicle.phase is FlightPhase.LANDED:
            self.sensors.flat_trim()
            self.notes["FTRIM"] = ()

    def _on_note(self, command, _):
        self.notes[command.name] = command.arguments

    _HANDLERS = {
        "REF": _on_ref,
        "PCMD": _on_pcmd,
        "PCMD_MAG": _on_pcmd,
        "CONFIG": _on_config,
        "CONFIG_IDS": _on_config_ids,
        "CTRL": _on_ctrl,
        "COMWDG": _on_comwdg,
        "FTRIM": _on_ftrim,
        **dict.fromkeys(("LED", "ANIM", "CALIB", "PMODE", "MISC"), _on_note),
    }

    # --- watchdogs --------------------------------------------------------------------------------------------------

    def _bark(self):
        if not self._com_watchdog:
            self._com_watchdog = True
            self._counts["com_watchdogs"] += 1

    def _watch_link(self, now_s, phase):
        if self._com_lost_s is not None:
            if now_s - self._com_lost_s > LOST_HOVER_S and now_s >= self._rest_until_s and phase in _CAN_LAND:
                self._armed, self._start = False, None  # take-off needs a fresh command
                self._order(now_s, FlightAction.LAND)
            return
        if self._last_at_s is None:
            return
        silence_s = now_s - self._last_at_s
        if silence_s > WATCHDOG_S:
            self._bark()
        if silence_s > self._patience_s:
            self._lose_client(now_s)

    def _lose_client(self, now_s):
        """Handle the loss of the link: hover; the client has to start over, as with an aircraft just switched on."""
        _LOG.warning("%s: no command for %.1f s, link lost", self._vehicle.namespace, now_s - self._last_at_s)
        self._counts["com_losses"] += 1
        self._com_lost_s, self._submitted_ref = now_s, None
        self._begin_anew()
        self._wanted = Setpoint(hover=True)
        self._schedule(now_s, self._wanted)

    def _begin_anew(self):
        """Forget the client."""
        self._last_at_s = None
        self._gate.reset()
        self._ack = False
        self._bootstrap, self._client = True, None
        self._rebuild_writer()

    # --- piloting ---------------------------------------------------------------------------------------------------

    def _pilot(self, now_s, phase):
        self._arriving.extend(self._radio.collect(now_s))
        while self._arriving and self._arriving[0][0] <= now_s + LOOK_AHEAD_S:
            time_s, item = self._arriving.popleft()
            if isinstance(item, Sticks):
                self._obey_sticks(time_s, item)
            else:
                self._obey_ref(time_s, item, phase)
        self._obey_start_level(now_s, phase)
        if phase is FlightPhase.FLYING:
            self._limit_altitude(now_s)

    def _obey_ref(self, time_s, bits, phase):
        select = bool(bits & _SELECT)
        if select and not self._select:
            self._armed = False  # bit 9 must be seen 0 first, whatever it was during the emergency
            if phase is FlightPhase.EMERGENCY:
                self._order(time_s, FlightAction.CLEAR_EMERGENCY)
            else:
                self._user_emergency = True
                self._order(time_s, FlightAction.CUT_MOTORS)
        self._select = select
        start = bool(bits & _START)
        if not start:
            self._armed, self._refused = True, False
        self._start = start

    def _obey_start_level(self, now_s, phase):
        """REF bit 9 is a level: it is compared with the vehicle's phase on every cycle."""
        if now_s < self._rest_until_s or self._start is None:
            return
        if self._start:
            if phase is FlightPhase.LANDED and self._armed:
                if self._vehicle.battery_pct > LOW_BATTERY_PCT:
                    self._order(now_s, FlightAction.TAKE_OFF)
                elif not self._refused:
                    self._refused = True
                    self._counts["take_offs_refused"] += 1
        elif phase in _CAN_LAND:
            self._order(now_s, FlightAction.LAND)

    def _order(self, time_s, action):
        self._vehicle.schedule(time_s, action)
        self._rest_until_s = time_s + ORDER_REST_S
        self._landing_ordered = action is FlightAction.LAND
        if action is FlightAction.TAKE_OFF:
            self._wanted = self._scheduled = Setpoint(hover=True)
            self._counts["take_offs"] += 1
        elif action is FlightAction.LAND:
            self._counts["landings"] += 1

    def _watch_phase(self, phase):
        if phase is self._last_phase:
            return
        if phase is FlightPhase.EMERGENCY:
            self._counts["emergencies"] += 1
        elif phase is FlightPhase.LANDED:
            self._user_emergency = False
        elif phase is FlightPhase.LANDING and not self._landing_ordered:
            self._armed = False  # it lands by itself, with an empty battery: do not take off again
        self._last_phase = phase

    def _obey_sticks(self, time_s, sticks):
        self._sticks = sticks
        if sticks.flags & _PROGRESSIVE:
            roll, pitch = sticks.roll, sticks.pitch
            if sticks.flags & _ABSOLUTE:
                roll, pitch = self._from_pilots_heading(roll, pitch, math.pi * sticks.psi)
            self._wanted = Setpoint(
                roll_rad=self._tilt_max_rad * roll,
                pitch_rad=self._tilt_max_rad * pitch,
                climb_m_s=self._climb_max_m_s * sticks.gaz,
                yaw_rate_rad_s=self._yaw_rate_max_rad_s * sticks.yaw,
            )
        else:
            self._wanted = Setpoint(hover=True)
        self._schedule(time_s, self._within_altitude_limits(self._wanted))

    def _from_pilots_heading(self, roll, pitch, pilot_psi_rad):
        """Turn roll and pitch sticks from the pilot's heading to that of the aircraft."""
        turn = self._vehicle.state.psi - pilot_psi_rad
        forward, right = -pitch, roll
        c, s = math.cos(turn), math.sin(turn)
        return -s * forward + c * right, -(c * forward + s * right)

    def _within_altitude_limits(self, setpoint):
        if setpoint.hover or self._vehicle.phase is not FlightPhase.FLYING:
            return setpoint
        altitude_m = self._vehicle.height_m - self._rest_height_m
        climb = max(setpoint.climb_m_s, ALTITUDE_GAIN_1_S * (self._lowest_m - altitude_m))
        climb = min(climb, ALTITUDE_GAIN_1_S * (self._highest_m - altitude_m))
        return setpoint if climb == setpoint.climb_m_s else replace(setpoint, climb_m_s=climb)

    def _limit_altitude(self, now_s):
        limited = self._within_altitude_limits(self._wanted)
        if abs(limited.climb_m_s - self._scheduled.climb_m_s) > CLIMB_STEP_M_S:
            self._schedule(now_s, limited)

    def _schedule(self, time_s, setpoint):
        self._scheduled = setpoint
        self._vehicle.schedule(time_s, setpoint)

    # --- navdata ----------------------------------------------------------------------------------------------------

    def _on_wake_up(self, data, sender, now_s):
        if not navdata.is_wake_up(data):
            self._counts["not_wake_ups"] += 1
            self._notices.complaint("asks for navdata wrongly", sender, repr(data[:20]))
            return
        self._counts["wake_ups"] += 1
        if sender != self._client or self._bootstrap:
            self._next_packet_s = now_s  # answer in the next cycle
        if sender != self._client:
            self._notices.event("gets the navdata", sender)
        if self._client is None and self._bootstrap:
            self._sequence = 0  # a new conversation counts from 1
        self._client, self._last_wake_up_s = sender, now_s

    def _rebuild_writer(self):
        if self._bootstrap:
            tags = ()
        elif self.get("general:navdata_demo"):
            mask = self.get("general:navdata_options") | navdata.DEFAULT_OPTIONS_MASK
            tags = [tag for tag in navdata.ALL_TAGS if mask >> tag & 1]
        else:
            tags = navdata.ALL_TAGS
        self._writer = NavdataWriter(tags, self)

    def _send_navdata(self, now_s, phase):
        last_s = self._last_wake_up_s if self._last_at_s is None else max(self._last_at_s, self._last_wake_up_s)
        if now_s - last_s > self._patience_s:
            self._client = None  # until the next wake-up
            return
        period_s = BOOTSTRAP_PERIOD_S if self._bootstrap else self._packet_period_s
        self._next_packet_s += period_s
        if self._next_packet_s < now_s:  # a late cycle: missed packets are skipped
            self._next_packet_s = now_s + 0.5 * period_s
        self._cycles += 1
        self._sequence += 1
        frame = self._frame(now_s, phase) if self._writer.has_options else None
        packet = self._writer.packet(frame, self._state_bits(phase), self._sequence)
        if self._radio_loss > 0.0 and self._losses.random() < self._radio_loss:
            self._counts["datagrams_lost_out"] += 1
            return
        self._navdata.carry(packet, self._client, now_s, self._send)

    def _send(self, packet, client, _now_s):
        try:
            self._sockets["navdata"].sendto(packet, client)
            self._counts["navdata_sent"] += 1
        except OSError:
            self._counts["send_errors"] += 1

    def _frame(self, now_s, phase):
        state = self._vehicle.state
        airborne = phase in _IN_FLIGHT
        if phase is FlightPhase.EMERGENCY:
            airborne = float(state.position_m[2]) - self._rest_height_m > 0.05
            major = ControlState.DEFAULT if airborne else ControlState.LANDED
        else:
            major = _MAJOR[phase]
        minor = _HOVERING_LOST_COM if phase is FlightPhase.HOVERING and self._com_lost_s is not None else 0
        s = self._scheduled
        return Frame(
            reading=self.sensors.read(state, airborne, now_s),
            time_s=max(0.0, now_s),
            ctrl_state=major << 16 | minor,
            sticks=self._sticks,
            command=(s.roll_rad, s.pitch_rad, s.climb_m_s, s.yaw_rate_rad_s),
            ref_sequence=self._ref_sequence,
            ref_gap_ms=self._ref_gap_ms,
            cycles=self._cycles,
            picture=(0, 0) if self._video is None else self._video.newest_picture,
            trim_deg=self.sensors.trim_deg,
        )

    def _state_bits(self, phase):
        in_emergency = phase is FlightPhase.EMERGENCY
        bits = (
            (State.FLYING, phase in _IN_FLIGHT),
            (State.VIDEO_ENABLED, self._video is not None and self._video.backlogs),
            (State.USER_START, self._start),
            (State.COMMAND_ACK, self._ack),
            (State.BOOTSTRAP, self._bootstrap),
            (State.CAMERA_READY, not self._bootstrap),
            (State.NAVDATA_DEMO, self._bootstrap or self.get("general:navdata_demo")),
            (State.COM_LOST, self._com_lost_s is not None),
            (State.BATTERY_LOW, self._vehicle.battery_pct <= LOW_BATTERY_PCT),
            (State.COM_WATCHDOG, self._com_watchdog),
            (State.EMERGENCY, in_emergency),
            (State.USER_EMERGENCY_LANDING, in_emergency and self._user_emergency),
            (State.CUTOUT, in_emergency and not self._user_emergency),
        )
        return _BASE_STATE + sum(bit for bit, is_set in bits if is_set)
