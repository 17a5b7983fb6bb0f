"""The virtual Pixhawk's MAVLink: system and component of one autopilot, for any station that talks to it.

Each address that has sent a valid frame is a client: it is answered in the version that it speaks, and has stream
rates of its own, which it asks for (REQUEST_DATA_STREAM, SET_MESSAGE_INTERVAL); until then it gets heartbeats and
texts, as from ArduCopter. It is forgotten after CLIENT_SILENCE_S without a message. Damaged frames, and messages for
another system or component, have no effect; bytes that are not MAVLink are counted.

There are no missions, fences, rally points, files and logs: their lists are empty, and filling them is refused.

What an autopilot must provide
    vehicle                     world.Vehicle
    armed, mode                 bool; number of ArduCopter's flight mode
    parameters                  parameters.Parameters, in which this module sets what clients set
    sensors                     sensors.IrisSensors
    channels_us                 the channels [us] in effect, of its receiver or overridden; () before the first
    radio_failsafe              bool: it receives no sticks
    texts                       deque of (MAV_SEVERITY, text); this module takes them out
    set_mode(number)            \\
    arm(by_force)                > why it was refused, which is in `texts` already; "" if it was done
    disarm(by_force)            /
    arming_trouble()            why it would not arm now; "" if it would
    override(channels, now_s)   18 numbers [us]: 0 gives the channel back to the receiver, 65535 leaves it as it is
"""

import logging
import math
from collections import Counter

from pymavlink.dialects.v10 import ardupilotmega as mavlink1
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from risc_simulator.notices import Notices
from risc_simulator.socket_host import greediest
from risc_simulator.vehicles.iris.firmware import Mode
from risc_simulator.vehicles.iris.messages import NO_CHANNEL, STREAMS, Messages

_LOG = logging.getLogger(__name__)

COMPONENT_ID = mavlink.MAV_COMP_ID_AUTOPILOT1
CLIENT_SILENCE_S = 30.0
MAKES_ROOM_S = 3.0  # of silence, after which a client gives way to a new one if there are too many
MAX_CLIENTS = 8
HEARTBEAT_S = 1.0
MIN_INTERVAL_S, MAX_INTERVAL_US = 0.02, 2**31 - 1  # the latter is the limit of MESSAGE_INTERVAL
MAX_DATAGRAM_BYTES = 4096  # several frames of 300 bytes; larger datagrams only cost time
MAX_MISSES = 50  # false frames in a datagram, before the rest is discarded
PARAMETERS_PER_TICK = 5
TEXT_LENGTH = 50
FORCE_ARM, FORCE_DISARM = 2989.0, 21196.0  # ArduPilot's param2 of a forced order
OVERRIDE_LEAST_US, OVERRIDE_MOST_US = 800, 2200
INVALID_AXIS = 32767
_RELEASE_UPPER = 65534  # of an override in channels 9 to 18, where 0 means: leave it

_MARKERS = bytes((mavlink.PROTOCOL_MARKER_V1, mavlink.PROTOCOL_MARKER_V2))
_ACCEPTED, _DENIED, _UNSUPPORTED, _FAILED = (
    mavlink.MAV_RESULT_ACCEPTED,
    mavlink.MAV_RESULT_DENIED,
    mavlink.MAV_RESULT_UNSUPPORTED,
    mavlink.MAV_RESULT_FAILED,
)
_MISSION_TYPES = (mavlink.MAV_MISSION_TYPE_MISSION, mavlink.MAV_MISSION_TYPE_FENCE, mavlink.MAV_MISSION_TYPE_RALLY)
_TELLS_STATE = {mavlink.MAVLINK_MSG_ID_HEARTBEAT, *(number for stream in STREAMS.values() for number in stream)}
_STATION = 255  # system id of ground stations
_ENDS_OF_SESSIONS = mavlink.MAV_FTP_OPCODE_TERMINATESESSION, mavlink.MAV_FTP_OPCODE_RESETSESSION


def frames(datagram):
    """Yield the bytes that look like frames, MAVLink 1 or 2. Bytes between them, and truncated frames, are left out.

    The caller says by send() whether a frame is valid; if not, the search goes on after its first byte.
    """
    at = 0
    while at < len(datagram):
        if datagram[at] not in _MARKERS:
            at += 1
            continue
        length = _frame_length(datagram, at)
        whole = length and at + length <= len(datagram)
        at += length if whole and (yield datagram[at : at + length]) else 1


def repeated(told, datagram):
    """A datagram of an autopilot in which each state message has the content of the first one of its kind, which
    `told` (a dict) keeps. Sequence numbers stay, checksums are valid. Other data is returned unchanged.
    """
    if datagram[:1] not in (_MARKERS[:1], _MARKERS[1:]):
        return datagram
    found, candidates, frame = b"", frames(datagram), None
    while True:
        try:
            frame = candidates.send(None if frame is None else True)
        except StopIteration:
            return found or datagram
        is_v1 = frame[0] == mavlink.PROTOCOL_MARKER_V1
        at = 2 if is_v1 else 4  # sequence, system, component, message
        system, component = frame[at + 1 : at + 3]
        number = frame[at + 3] if is_v1 else int.from_bytes(frame[at + 3 : at + 6], "little")
        if component == COMPONENT_ID and system != _STATION and number in _TELLS_STATE:
            body = bytearray(told.setdefault(("mavlink", frame[0], number), frame)[:-2])
            body[at] = frame[at]
            extra = bytes((mavlink.mavlink_map[number].crc_extra,))
            found += body + mavlink.x25crc(body[1:] + extra).crc.to_bytes(2, "little")
        else:
            found += frame


def _frame_length(data, at):
    """Length of the frame that begins there, by its header; 0 if the header is truncated or unusable."""
    if data[at] == mavlink.PROTOCOL_MARKER_V1:
        return data[at + 1] + 8 if at + 1 < len(data) else 0
    if at + 2 >= len(data) or data[at + 2] & ~mavlink.MAVLINK_IFLAG_SIGNED:
        return 0
    return data[at + 1] + 12 + (mavlink.MAVLINK_SIGNATURE_BLOCK_LEN if data[at + 2] else 0)


class Client:
    """One address that talks to the autopilot."""

    def __init__(self, address, system_id):
        self.address = address
        self.version = 1  # of MAVLink, that of its newest frame
        self.heard_s = -math.inf
        self.parameters_sent = None  # of the list that is being sent; None: none is
        self._codec = mavlink.MAVLink(None, system_id, COMPONENT_ID)
        self.defaults_s = {}  # message id: interval that it asked for with whole streams; None: not streamed
        self._intervals_s = {}  # message id: interval in force, of streamed messages
        self._due_s = {}
        self.next_s = math.inf  # when the next message is due

    def decode(self, datagram):
        """Messages in a datagram, and the number of its bytes that are not part of one."""
        found, used, misses = [], 0, 0
        candidates = frames(datagram)
        valid = None
        while misses <= MAX_MISSES:
            try:
                frame = candidates.send(valid)
            except StopIteration:
                break
            try:
                message = self._codec.decode(bytearray(frame))
                valid = not isinstance(message, mavlink.MAVLink_unknown)  # whose checksum cannot be verified
            except mavlink.MAVError:
                valid = False
            if not valid:
                misses += 1
            else:
                self.version = 1 if frame[0] == mavlink.PROTOCOL_MARKER_V1 else 2
                found.append(message)
                used += len(frame)
        return found, len(datagram) - used

    def encode(self, message):
        """Bytes of a message for this client."""
        codec = self._codec
        if self.version == 2:
            data = message.pack(codec)
        else:  # without the fields that MAVLink 2 has added
            size = 6 + mavlink1.mavlink_map[message.get_msgId()].unpacker.size
            data = bytearray(message.pack(codec, force_mavlink1=True)[:size])
            data[1] = size - 6
            data += mavlink.x25crc(data[1:] + bytes((message.crc_extra,))).crc.to_bytes(2, "little")
        codec.seq = (codec.seq + 1) % 256
        return bytes(data)

    def stream(self, message_id, interval_s, now_s):
        """Send a message at this interval from now on; None ends it."""
        if interval_s is None:
            self._intervals_s.pop(message_id, None)
            self._due_s.pop(message_id, None)
        elif self._intervals_s.get(message_id) != interval_s:
            self._intervals_s[message_id], self._due_s[message_id] = interval_s, now_s
        self.next_s = min(self._due_s.values(), default=math.inf)

    def interval_s(self, message_id):
        """Interval between two messages; None: not streamed."""
        return self._intervals_s.get(message_id)

    def due(self, now_s):
        """Ids of the messages to be sent now."""
        if now_s < self.next_s:
            return []
        due = [message_id for message_id, due_s in self._due_s.items() if due_s <= now_s]
        for message_id in due:  # messages that a late cycle has missed are skipped
            self._due_s[message_id] = max(self._due_s[message_id] + self._intervals_s[message_id], now_s)
        self.next_s = min(self._due_s.values())
        return due


class Mavlink:
    """Answers datagrams of clients, and streams to them."""

    def __init__(self, autopilot, system_id, send):
        """autopilot: see the module.  send: function (data, address)."""
        self._autopilot, self._parameters = autopilot, autopilot.parameters
        self.system_id = system_id
        self._parameters.set("SYSID_THISMAV", system_id)
        self._send_datagram = send
        self._messages = Messages(autopilot, system_id)
        self.clients = {}  # address: Client
        self._heartbeat_s = 0.0
        self._station_s = None  # when the station that may override was last heard; None: never
        self._station_lost = False
        self.counts = Counter()
        self.notices = Notices(_LOG, autopilot.vehicle.namespace)
        self._now_s = 0.0

    # ------------------------------------------------------------------ datagrams

    def on_datagram(self, data, sender, now_s):
        """Handle a datagram of a client. Bad input never raises."""
        self._now_s = now_s
        client = self.clients.get(sender) or Client(sender, self.system_id)
        messages, foreign = client.decode(data) if len(data) <= MAX_DATAGRAM_BYTES else ([], len(data))
        if foreign:
            self.counts["foreign_bytes"] += foreign
            self.notices.complaint("sends bytes that are not MAVLink", sender, "%d bytes" % foreign)
        if not messages:
            return
        if sender not in self.clients and not self._welcome(client):
            return
        client.heard_s = now_s
        for message in messages:
            handler = self._HANDLERS.get(message.get_msgId())  # not .id, which is a field of some messages
            if handler is not None and self._is_for_us(message):
                self.counts["messages"] += 1
                handler(self, message, client)

    def _welcome(self, client):
        if len(self.clients) >= MAX_CLIENTS:
            longest = min(self.clients.values(), key=lambda other: other.heard_s)
            if self._now_s - longest.heard_s < MAKES_ROOM_S:
                greedy = greediest([address for address, _ in self.clients], client.address[0])
                if greedy is None:
                    self.notices.complaint("is turned away: too many clients", client.address)
                    return False
                longest = min(
                    (other for other in self.clients.values() if other.address[0] == greedy),
                    key=lambda other: other.heard_s,
                )
            self._forget(longest)
        self.clients[client.address] = client
        self.notices.event("talks to the autopilot", client.address, "MAVLink %d" % client.version)
        self._send(client, self._make(mavlink.MAVLINK_MSG_ID_HEARTBEAT))
        return True

    def _is_for_us(self, message):
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        return system in (0, self.system_id) and component in (0, COMPONENT_ID)

    def _make(self, message_id):
        return self._messages.make(message_id, self._now_s)

    def _send(self, client, message):
        self._send_datagram(client.encode(message), client.address)

    def _send_all(self, message):
        for client in self.clients.values():
            self._send(client, message)

    # ------------------------------------------------------------------ time

    def tick(self, now_s):
        """Send what is due at lab time now_s."""
        self._now_s = now_s
        texts = self._autopilot.texts
        while texts:
            severity, text = texts.popleft()
            self._send_all(mavlink.MAVLink_statustext_message(severity, text.encode()[:TEXT_LENGTH]))
        self._watch_station()
        if now_s - self._heartbeat_s >= HEARTBEAT_S:
            self._heartbeat_s = max(self._heartbeat_s + HEARTBEAT_S, now_s - HEARTBEAT_S)
            self._forget_silent_clients()
            self._send_all(self._make(mavlink.MAVLINK_MSG_ID_HEARTBEAT))
        for client in self.clients.values():
            for message_id in client.due(now_s):
                self._send(client, self._make(message_id))
            if client.parameters_sent is not None:
                self._go_on_with_parameters(client)

    def power_cycle(self):
        """Start over, and forget all stations."""
        self.clients.clear()
        self._station_s, self._station_lost = None, False

    def _forget_silent_clients(self):
        for client in list(self.clients.values()):
            if self._now_s - client.heard_s > CLIENT_SILENCE_S:
                self._forget(client)

    def _forget(self, client):
        self.notices.event("is forgotten: silent, or it has most places", client.address)
        del self.clients[client.address]

    def _watch_station(self):
        """Run the failsafe for the loss of the ground station, if it is enabled and there was one."""
        if self._station_s is None or self._station_lost or not self._parameters["FS_GCS_ENABLE"]:
            return
        if self._now_s - self._station_s > self._parameters["FS_GCS_TIMEOUT"]:
            self._station_lost = True
            if self._autopilot.armed and self._autopilot.mode != Mode.LAND:
                self._autopilot.texts.append((mavlink.MAV_SEVERITY_CRITICAL, "GCS Failsafe: landing"))
                self._autopilot.set_mode(Mode.LAND)

    def _hear_station(self):
        self._station_s, self._station_lost = self._now_s, False

    def _is_from_station(self, message):
        return message.get_srcSystem() == self._parameters["SYSID_MYGCS"]

    # ------------------------------------------------------------------ small services

    def _on_heartbeat(self, message, _client):
        if self._is_from_station(message):
            self._hear_station()

    def _on_ping(self, message, client):
        if message.target_system == 0:
            reply = message.time_usec, message.seq, message.get_srcSystem(), message.get_srcComponent()
            self._send(client, mavlink.MAVLink_ping_message(*reply))

    def _on_timesync(self, message, client):
        if message.tc1 == 0:
            self._send(client, mavlink.MAVLink_timesync_message(int(1e9 * self._now_s), message.ts1))

    def _on_file_transfer(self, message, client):
        asked = message.payload  # sequence (2 bytes), session, opcode, size, opcode that is answered, ...
        sequence, opcode = (asked[0] | asked[1] << 8) + 1 & 0xFFFF, asked[3]
        if opcode in _ENDS_OF_SESSIONS:  # there are no sessions
            answer, content = mavlink.MAV_FTP_OPCODE_ACK, []
        else:
            is_of_names = opcode in (mavlink.MAV_FTP_OPCODE_LISTDIRECTORY, mavlink.MAV_FTP_OPCODE_OPENFILERO)
            error = mavlink.MAV_FTP_ERR_FILENOTFOUND if is_of_names else mavlink.MAV_FTP_ERR_UNKNOWNCOMMAND
            answer, content = mavlink.MAV_FTP_OPCODE_NAK, [error]
        payload = [sequence & 255, sequence >> 8, asked[2], answer, len(content), opcode, 0, 0, 0, 0, 0, 0, *content]
        payload += [0] * (251 - len(payload))
        sender = message.get_srcSystem(), message.get_srcComponent()
        self._send(client, mavlink.MAVLink_file_transfer_protocol_message(0, *sender, payload))

    def _on_log_request_list(self, _message, client):
        self._send(client, mavlink.MAVLink_log_entry_message(0, 0, 0, 0, 0))

    # ------------------------------------------------------------------ streams

    def _on_request_data_stream(self, message, client):
        streams = [message.req_stream_id] if message.req_stream_id else STREAMS
        rate_hz = message.req_message_rate if message.start_stop else 0
        interval_s = max(MIN_INTERVAL_S, 1.0 / rate_hz) if rate_hz else None
        for message_id in (message_id for stream in streams for message_id in STREAMS.get(stream, ())):
            is_old = message_id == mavlink.MAVLINK_MSG_ID_RC_CHANNELS_RAW  # RC_CHANNELS has taken its place
            client.defaults_s[message_id] = None if is_old and client.version == 2 else interval_s
            client.stream(message_id, client.defaults_s[message_id], self._now_s)

    def _set_interval(self, params, client):
        message_id, interval_us = int(params[0]), params[1]
        if message_id not in self._messages:
            return _UNSUPPORTED
        if message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            return _DENIED  # always once a second
        if interval_us == 0:  # the default: that of its stream
            interval_s = client.defaults_s.get(message_id)
        else:
            interval_s = max(MIN_INTERVAL_S, 1e-6 * min(interval_us, MAX_INTERVAL_US)) if interval_us > 0 else None
        client.stream(message_id, interval_s, self._now_s)
        return _ACCEPTED

    def _get_interval(self, params, client):
        message_id = int(params[0])
        if message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            interval_s = HEARTBEAT_S
        elif message_id in self._messages:
            interval_s = client.interval_s(message_id)
        else:
            interval_s = 0.0  # unknown
        interval_us = -1 if interval_s is None else round(1e6 * interval_s)
        self._send(client, mavlink.MAVLink_message_interval_message(message_id & 0xFFFF, interval_us))
        return _ACCEPTED if message_id in self._messages else _UNSUPPORTED

    # ------------------------------------------------------------------ parameters

    def _parameter(self, name, index=None):
        known = self._parameters.about[name]
        value = float(self._parameters[name])
        index = known.index if index is None else index
        return mavlink.MAVLink_param_value_message(name.encode(), value, known.kind, len(self._parameters), index)

    def _on_param_request_list(self, _message, client):
        client.parameters_sent = 0

    def _go_on_with_parameters(self, client):
        names = self._parameters.names
        first = client.parameters_sent
        for name in names[first : first + PARAMETERS_PER_TICK]:
            self._send(client, self._parameter(name))
        client.parameters_sent = first + PARAMETERS_PER_TICK
        if client.parameters_sent >= len(names):
            client.parameters_sent = None

    def _on_param_request_read(self, message, client):
        names, index = self._parameters.names, message.param_index
        if index < 0:
            if message.param_id in self._parameters.about:
                self._send(client, self._parameter(message.param_id))
                return
        elif index < len(names):
            self._send(client, self._parameter(names[index]))
            return
        self.counts["unknown_parameters"] += 1
        self._refuse_parameter(client, message, mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST, index)

    def _on_param_set(self, message, client):
        name = message.param_id
        if name not in self._parameters.about:
            self.counts["unknown_parameters"] += 1
            self._refuse_parameter(client, message, mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST, -1)
        elif self._parameters.set(name, message.param_value):
            self._send_all(self._parameter(name, NO_CHANNEL))  # 65535: not part of a list
        else:
            self._refuse_parameter(client, message, mavlink.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE, -1)
            self._send(client, self._parameter(name, NO_CHANNEL))  # the value that it keeps

    def _refuse_parameter(self, client, message, error, index):
        if client.version == 2:
            sender, name = (message.get_srcSystem(), message.get_srcComponent()), message.param_id.encode()[:16]
            self._send(client, mavlink.MAVLink_param_error_message(*sender, name, index, error))

    # ------------------------------------------------------------------ missions, fences, rally points

    def _on_mission_request_list(self, message, client):
        kind = message.mission_type
        sender = message.get_srcSystem(), message.get_srcComponent()
        if kind in _MISSION_TYPES:
            self._send(client, mavlink.MAVLink_mission_count_message(*sender, 0, kind))
        else:
            self._acknowledge_mission(message, client, mavlink.MAV_MISSION_UNSUPPORTED)

    def _on_mission_count(self, message, client):
        self._acknowledge_mission(
            message, client, mavlink.MAV_MISSION_UNSUPPORTED if message.count else mavlink.MAV_MISSION_ACCEPTED
        )

    def _on_mission_clear_all(self, message, client):
        self._acknowledge_mission(message, client, mavlink.MAV_MISSION_ACCEPTED)

    def _on_mission_refused(self, message, client):
        self._acknowledge_mission(message, client, mavlink.MAV_MISSION_UNSUPPORTED)

    def _on_mission_request(self, message, client):
        self._acknowledge_mission(message, client, mavlink.MAV_MISSION_INVALID_SEQUENCE)

    def _acknowledge_mission(self, message, client, result):
        kind = getattr(message, "mission_type", 0)
        sender = message.get_srcSystem(), message.get_srcComponent()
        self._send(client, mavlink.MAVLink_mission_ack_message(*sender, result, kind))

    # ------------------------------------------------------------------ sticks

    def _on_override(self, message, _client):
        if not self._is_from_station(message):
            self.counts["overrides_refused"] += 1
            return
        self._hear_station()
        channels = [getattr(message, "chan%d_raw" % number) for number in range(1, 19)]
        for i in range(8, 18):  # ArduPilot's rule for those that MAVLink 2 has added
            channels[i] = {0: NO_CHANNEL, _RELEASE_UPPER: 0}.get(channels[i], channels[i])
        self._override(channels)

    def _on_manual_control(self, message, _client):
        if message.target != self.system_id:
            return
        if not self._is_from_station(message):
            self.counts["overrides_refused"] += 1
            return
        self._hear_station()
        channels = [NO_CHANNEL] * 18
        pitch = -message.x if message.x != INVALID_AXIS else INVALID_AXIS  # nose down is forward
        axes = (message.y, -1000), (pitch, -1000), (message.z, 0), (message.r, -1000)
        for i, (axis, lowest) in enumerate(axes):
            if axis != INVALID_AXIS:
                least_us, most_us = (self._parameters["RC%d_%s" % (i + 1, end)] for end in ("MIN", "MAX"))
                share = min(1.0, max(0.0, (axis - lowest) / (1000 - lowest)))
                channels[i] = round(least_us + share * (most_us - least_us))
        self._override(channels)

    def _override(self, channels):
        self._autopilot.override(
            tuple(
                value if value in (0, NO_CHANNEL) else min(OVERRIDE_MOST_US, max(OVERRIDE_LEAST_US, value))
                for value in channels
            ),
            self._now_s,
        )

    # ------------------------------------------------------------------ commands

    def _on_set_mode(self, message, client):
        is_custom = message.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        self._acknowledge(message, client, mavlink.MAVLINK_MSG_ID_SET_MODE, self._go_to(is_custom, message.custom_mode))

    def _go_to(self, is_custom, mode):
        if not is_custom:
            return _DENIED
        return _FAILED if self._autopilot.set_mode(mode) else _ACCEPTED

    def _on_command_long(self, message, client):
        self._obey(message, client, [getattr(message, "param%d" % number) for number in range(1, 8)])

    def _on_command_int(self, message, client):
        params = [getattr(message, "param%d" % number) for number in range(1, 5)]
        self._obey(message, client, [*params, message.x, message.y, message.z])

    def _obey(self, message, client, params):
        command = self._COMMANDS.get(message.command)
        params = [value if math.isfinite(value) else 0.0 for value in params]  # NaN: not given
        result = _UNSUPPORTED if command is None else command(self, params, client)
        self._acknowledge(message, client, message.command, result)

    def _acknowledge(self, message, client, command, result):
        sender = message.get_srcSystem(), message.get_srcComponent()
        self._send(client, mavlink.MAVLink_command_ack_message(command, result, 0, 0, *sender))

    def _arm_or_disarm(self, params, _client):
        if params[0] not in (0.0, 1.0):
            return _DENIED
        order, force = (self._autopilot.arm, FORCE_ARM) if params[0] else (self._autopilot.disarm, FORCE_DISARM)
        return _FAILED if order(params[1] == force) else _ACCEPTED

    def _terminate_flight(self, params, _client):
        if params[0] < 0.5:
            return _DENIED
        return _FAILED if self._autopilot.disarm(True) else _ACCEPTED

    def _set_mode(self, params, _client):
        return self._go_to(int(params[0]) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, int(params[1]))

    def _land(self, _params, _client):
        return self._go_to(True, Mode.LAND)

    def _tell(self, message_id, client):
        if message_id not in self._messages:
            return _UNSUPPORTED
        self._send(client, self._make(message_id))
        return _ACCEPTED

    def _tell_what_is_asked(self, params, client):
        return self._tell(int(params[0]), client)

    def _tell_version(self, _params, client):
        return self._tell(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, client)

    def _tell_home(self, _params, client):
        return self._tell(mavlink.MAVLINK_MSG_ID_HOME_POSITION, client)

    def _refuse_take_off(self, _params, _client):
        return _FAILED  # these flight modes take off by the throttle alone

    _COMMANDS = {
        mavlink.MAV_CMD_NAV_LAND: _land,
        mavlink.MAV_CMD_NAV_TAKEOFF: _refuse_take_off,
        mavlink.MAV_CMD_DO_SET_MODE: _set_mode,
        mavlink.MAV_CMD_DO_FLIGHTTERMINATION: _terminate_flight,
        mavlink.MAV_CMD_COMPONENT_ARM_DISARM: _arm_or_disarm,
        mavlink.MAV_CMD_GET_HOME_POSITION: _tell_home,
        mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: _get_interval,
        mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: _set_interval,
        mavlink.MAV_CMD_REQUEST_MESSAGE: _tell_what_is_asked,
        mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: _tell_version,
    }
    _HANDLERS = {
        kind.id: handler
        for kind, handler in (
            (mavlink.MAVLink_heartbeat_message, _on_heartbeat),
            (mavlink.MAVLink_ping_message, _on_ping),
            (mavlink.MAVLink_timesync_message, _on_timesync),
            (mavlink.MAVLink_file_transfer_protocol_message, _on_file_transfer),
            (mavlink.MAVLink_log_request_list_message, _on_log_request_list),
            (mavlink.MAVLink_request_data_stream_message, _on_request_data_stream),
            (mavlink.MAVLink_param_request_list_message, _on_param_request_list),
            (mavlink.MAVLink_param_request_read_message, _on_param_request_read),
            (mavlink.MAVLink_param_set_message, _on_param_set),
            (mavlink.MAVLink_mission_request_list_message, _on_mission_request_list),
            (mavlink.MAVLink_mission_count_message, _on_mission_count),
            (mavlink.MAVLink_mission_clear_all_message, _on_mission_clear_all),
            (mavlink.MAVLink_mission_write_partial_list_message, _on_mission_refused),
            (mavlink.MAVLink_mission_item_message, _on_mission_refused),
            (mavlink.MAVLink_mission_item_int_message, _on_mission_refused),
            (mavlink.MAVLink_mission_request_message, _on_mission_request),
            (mavlink.MAVLink_mission_request_int_message, _on_mission_request),
            (mavlink.MAVLink_mission_set_current_message, _on_mission_request),
            (mavlink.MAVLink_rc_channels_override_message, _on_override),
            (mavlink.MAVLink_manual_control_message, _on_manual_control),
            (mavlink.MAVLink_set_mode_message, _on_set_mode),
            (mavlink.MAVLink_command_long_message, _on_command_long),
            (mavlink.MAVLink_command_int_message, _on_command_int),
        )
    }
