"""An autopilot written with pymavlink: only the behaviour that the bridge can see, no flight dynamics.

`Autopilot` is bytes in, bytes out, with the time passed in. `Running` puts one on a socket or a pseudo terminal.
"""

import contextlib
import os
import select
import socket
import threading
import time

from pymavlink.dialects.v10 import ardupilotmega as version_1
from pymavlink.dialects.v20 import ardupilotmega as mavlink

GCS = 255  # system id whose orders are obeyed
ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
OVERRIDE_S = 3.0  # how long an override is in force
RADIO_US = (1500, 1500, 1000, 1500, 1000, 1000, 1500, 1500)  # what the pilot's own radio sends
STREAMS = {  # messages of each stream
    mavlink.MAV_DATA_STREAM_RAW_SENSORS: ("raw_imu",),
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: (
        *("sys_status", "mission_current", "gps_raw_int", "nav_controller_output"),
    ),
    mavlink.MAV_DATA_STREAM_RC_CHANNELS: ("rc_channels", "rc_channels_raw"),
    mavlink.MAV_DATA_STREAM_POSITION: ("global_position_int",),
    mavlink.MAV_DATA_STREAM_EXTRA1: ("attitude",),
    mavlink.MAV_DATA_STREAM_EXTRA2: ("vfr_hud",),
}
TIMES = {  # fields that are the time since the start [ms]
    **dict.fromkeys(("rc_channels", "rc_channels_raw", "global_position_int", "attitude"), ("time_boot_ms",)),
}
TELEMETRY = {  # the other fields, except the first eight channels
    "raw_imu": {
        "time_usec": 123456789,
        "xacc": 1,
        "yacc": -2,
        "zacc": -1000,
        "xgyro": 4,
        "ygyro": -5,
        "zgyro": 6,
        "xmag": 7,
        "ymag": -8,
        "zmag": 9,
    },
    "sys_status": {
        **{"onboard_control_sensors_%s" % name: 0x80000001 for name in ("present", "enabled", "health")},
        "load": 100,
        "voltage_battery": 11800,
        "current_battery": 1234,
        "battery_remaining": 87,
        **dict.fromkeys(("drop_rate_comm", "errors_comm", *("errors_count%d" % k for k in range(1, 5))), 0),
    },
    "mission_current": {"seq": 3},
    "gps_raw_int": {
        "time_usec": 1,
        "fix_type": 3,
        "lat": 417500000,
        "lon": -1118100000,
        "alt": 1400250,
        "eph": 120,
        "epv": 200,
        "vel": 0,
        "cog": 0,
        "satellites_visible": 9,
    },
    "nav_controller_output": {
        "nav_roll": 1.5,
        "nav_pitch": -2.5,
        "nav_bearing": -30,
        "target_bearing": 45,
        "wp_dist": 12,
        "alt_error": 0.5,
        "aspd_error": -0.25,
        "xtrack_error": 2.0,
    },
    "rc_channels": {"chancount": 8, "rssi": 200, **{"chan%d_raw" % k: 65535 for k in range(9, 19)}},
    "rc_channels_raw": {"port": 0, "rssi": 200},
    "global_position_int": {
        "lat": 417500001,
        "lon": -1118100002,
        "alt": 1400300,
        "relative_alt": 1500,
        "vx": 10,
        "vy": -20,
        "vz": 30,
        "hdg": 27000,
    },
    "attitude": {"roll": 0.1, "pitch": -0.2, "yaw": 3.0, "rollspeed": 0.4, "pitchspeed": -0.5, "yawspeed": 0.6},
    "vfr_hud": {"airspeed": 1.0, "groundspeed": 2.0, "heading": 270, "throttle": 42, "alt": 1400.0, "climb": -0.5},
}


class Autopilot:
    """version: of MAVLink.  Tests set the attributes in __init__."""

    def __init__(self, version=2, system=1, heartbeat_s=1.0):
        self.version, self.system, self.heartbeat_s = version, system, heartbeat_s
        self.is_silent = False  # sends nothing
        self.is_deaf = False  # hears nothing
        self.ignores = 0  # number of next orders that are lost
        self.answers = {}  # {command number: result}; 11 stands for SET_MODE
        self.no_answers = False  # COMMAND_ACK is lost
        self.explanation = ()  # (severity, text) of messages that follow an answer
        self.obeys_disarm = True
        self.mode, self.is_armed = 0, False
        self.radio_us = list(RADIO_US)
        self.fields = {}  # {message name: fields to change}
        self.slow = ()  # names of messages that are never sent
        self.heard = []  # messages addressed to it, newest last
        self.beats = []  # times of ground stations' heartbeats
        self.mission = None  # list of items, once one was received
        self.missions_cleared = 0
        self.forgets = 0  # number of next mission items and counts that are lost
        self.asks_int = True
        self._expected, self._items = 0, None
        self.override = {}  # {channel from 0: (us, until)}
        self._out = bytearray()
        self._dialect = version_1 if version == 1 else mavlink
        self._encoder = self._dialect.MAVLink(self, system, 1)
        self._decoder = mavlink.MAVLink(None)
        self._decoder.robust_parsing = True
        self._boot_s, self._now_s = None, 0.0
        self._beat_s = -1e9
        self._rates = {}  # {stream: (period, next)}

    # --- wire
    def write(self, data):
        self._out += data

    def send(self, name, **fields):
        """Send any message."""
        fields.update(self.fields.get(name, {}))
        self._encoder.send(getattr(self._dialect, "MAVLink_%s_message" % name)(**fields))

    def take(self):
        data, self._out = bytes(self._out), bytearray()
        return b"" if self.is_silent else data

    def receive(self, data, now_s):
        self._now_s = now_s
        for message in self._decoder.parse_buffer(data) or ():
            if message.get_type() == "BAD_DATA" or self.is_deaf:
                continue
            version = 1 if message.get_msgbuf()[0] == 0xFE else 2
            target = getattr(message, "target_system", self.system)
            if target in (0, self.system) and version <= self.version:
                self.heard.append(message)
                self._obey(message)

    def named(self, name):
        """Received messages of a type."""
        return [message for message in self.heard if message.get_type() == name]

    # --- time
    def reboot(self):
        self._boot_s, self.is_armed, self.mode, self._rates, self.override = self._now_s, False, 0, {}, {}

    def advance(self, now_s):
        self._now_s = now_s
        if self._boot_s is None:
            self._boot_s = now_s - 100.0  # it was switched on 100 s ago
        if now_s >= self._beat_s + self.heartbeat_s:
            self._beat_s = now_s
            self.beat()
        for stream, (period_s, next_s) in self._rates.items():
            if now_s >= next_s:
                self._rates[stream] = (period_s, max(next_s + period_s, now_s))
                for name in STREAMS[stream]:
                    if name not in self.slow and (name != "rc_channels_raw" or self.version == 1):
                        self.tell(name)

    def beat(self):
        self.send(
            "heartbeat",
            type=mavlink.MAV_TYPE_QUADROTOR,
            autopilot=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
            base_mode=81 | (ARMED if self.is_armed else 0),
            custom_mode=self.mode,
            system_status=4 if self.is_armed else 3,
            mavlink_version=3,
        )

    def channels_us(self):
        """Channels in force [us]: an override until it expires, otherwise the pilot's radio."""
        values = list(self.radio_us)
        for channel, (value, until_s) in self.override.items():
            if self._now_s < until_s:
                values[channel] = value
        return values

    def tell(self, name):
        """Send telemetry with values that tests know."""
        boot_ms = int((self._now_s - self._boot_s) * 1000)
        channels = {"chan%d_raw" % (k + 1): value for k, value in enumerate(self.channels_us())}
        values = {
            **TELEMETRY[name],
            **dict.fromkeys(TIMES.get(name, ()), boot_ms),
            **(channels if name.startswith("rc_channels") else {}),
        }
        self.send(name, **values)

    # --- orders
    def _obey(self, message):
        kind = message.get_type()
        if kind == "HEARTBEAT":
            self.beats.append(self._now_s)
        elif message.get_srcSystem() != GCS:
            return
        elif kind == "REQUEST_DATA_STREAM":
            self._rates[message.req_stream_id] = (1.0 / message.req_message_rate, self._now_s)
        elif kind in ("COMMAND_LONG", "SET_MODE") and self.ignores:
            self.ignores -= 1
        elif kind == "COMMAND_LONG":
            self._command(message)
        elif kind == "SET_MODE":
            if self._answer(11):
                self.mode = message.custom_mode
        elif kind == "RC_CHANNELS_OVERRIDE":
            self._override([getattr(message, "chan%d_raw" % k) for k in range(1, 9)])
        elif kind.startswith("MISSION_"):
            self._mission(message)

    def _command(self, message):
        if not self._answer(message.command) or message.command != mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            return
        if message.param1 == 1.0:
            self.is_armed = True
        elif self.obeys_disarm:
            self.is_armed = False

    def _answer(self, command):
        """Answer a command. Returns whether it is accepted."""
        result = self.answers.get(command, mavlink.MAV_RESULT_ACCEPTED)
        if not self.no_answers:
            self.send("command_ack", command=command, result=result)
        for severity, text in self.explanation:
            self.send("statustext", severity=severity, text=text)
        return result == mavlink.MAV_RESULT_ACCEPTED

    def _override(self, values):
        for channel, value in enumerate(values):
            if value == 0:
                self.override.pop(channel, None)
            elif value != 65535:
                self.override[channel] = (value, self._now_s + OVERRIDE_S)

    def _mission(self, message):
        kind = message.get_type()
        if kind == "MISSION_CLEAR_ALL":
            self.missions_cleared += 1
            self.mission = []
            self.acknowledge_mission(mavlink.MAV_MISSION_ACCEPTED)
        elif self.forgets:
            self.forgets -= 1
        elif kind == "MISSION_COUNT":
            self._items = []
            self._expected = message.count
            self._ask()
        elif kind in ("MISSION_ITEM", "MISSION_ITEM_INT") and self._items is not None:
            if message.seq != len(self._items):
                self.acknowledge_mission(mavlink.MAV_MISSION_INVALID_SEQUENCE)
                return
            self._items.append(message)
            if len(self._items) < self._expected:
                self._ask()
            else:
                self.mission, self._items = self._items, None
                result = self.answers.get("mission", mavlink.MAV_MISSION_ACCEPTED)
                self.acknowledge_mission(result)

    def _ask(self):
        kind = "mission_request_int" if self.asks_int else "mission_request"
        self.send(kind, target_system=GCS, target_component=0, seq=len(self._items))

    def acknowledge_mission(self, result):
        self.send("mission_ack", target_system=GCS, target_component=0, type=result)


class _Udp:
    def __init__(self, address):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(address)
        self.peer = None

    def fileno(self):
        return self.socket.fileno()

    def read(self):
        data, self.peer = self.socket.recvfrom(4096)
        return data

    def write(self, data):
        if self.peer is not None:
            self.socket.sendto(data, self.peer)

    def close(self):
        self.socket.close()


class _Pty:
    def __init__(self, path):
        """path: of a symbolic link to the terminal, so that the name stays, as with a serial device."""
        self.master, self.slave = os.openpty()  # kept open: the device exists even while no program uses it
        self.path = str(path)
        with contextlib.suppress(FileNotFoundError):
            os.unlink(path)
        os.symlink(os.ttyname(self.slave), path)
        os.set_blocking(self.master, False)

    def fileno(self):
        return self.master

    def read(self):
        try:
            return os.read(self.master, 4096)
        except OSError:
            return b""

    def write(self, data):
        with contextlib.suppress(BlockingIOError):
            os.write(self.master, data)

    def close(self):
        os.unlink(self.path)
        os.close(self.slave)
        os.close(self.master)


class Running(Autopilot):
    """An Autopilot in a thread, on a UDP address or a pseudo terminal's path. `device`: the driver's argument."""

    def __init__(self, where, **options):
        super().__init__(**options)
        self.spoils = None  # function that damages bytes before they are sent
        is_udp = isinstance(where, tuple)
        self._line = _Udp(where) if is_udp else _Pty(where)
        self.device = "udpout:%s:%d" % self._line.socket.getsockname() if is_udp else self._line.path
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self.stop()

    def stop(self):
        self._is_over.set()
        self._thread.join()
        self._line.close()

    def _run(self):
        while not self._is_over.is_set():
            ready, _, _ = select.select([self._line], [], [], 0.01)
            if ready:
                self.receive(self._line.read(), time.monotonic())
            self.advance(time.monotonic())
            data = self.take()
            if data and self.spoils is not None:
                data = self.spoils(data)
            if data:
                self._line.write(data)
