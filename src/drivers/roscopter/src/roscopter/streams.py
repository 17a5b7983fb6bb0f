"""Telemetry streams: which to request, and which are missing. No ROS, no clock."""

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

# Only streams that become topics: a telemetry radio of 57600 baud does not carry all streams at 10 Hz.
_SIGNS = {  # stream: a message of it that every vehicle sends
    mavlink.MAV_DATA_STREAM_RAW_SENSORS: ("RAW_IMU",),
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: ("SYS_STATUS",),
    mavlink.MAV_DATA_STREAM_RC_CHANNELS: ("RC_CHANNELS", "RC_CHANNELS_RAW"),
    mavlink.MAV_DATA_STREAM_POSITION: ("GLOBAL_POSITION_INT",),
    mavlink.MAV_DATA_STREAM_EXTRA1: ("ATTITUDE",),
    mavlink.MAV_DATA_STREAM_EXTRA2: ("VFR_HUD",),
}
_STREAM_OF = {sign: stream for stream, signs in _SIGNS.items() for sign in signs}
LOWEST_HZ = {mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: 2}  # the battery, even if the option is lower
_FIRST_S, _LONGEST_S = 2.0, 16.0  # until a missing stream is requested again; doubled each time
_ENOUGH = 0.5  # fraction of the rate: autopilots send less over a slow radio, and requesting again would not help


class _Stream:
    def __init__(self, number, rate_hz):
        self.number = number
        self.rate_hz = max(rate_hz, LOWEST_HZ.get(number, rate_hz))
        self.restart(-math.inf)

    def restart(self, now_s):
        self.is_missing = True
        self._count, self._since_s, self._wait_s, self._due_s = 0, now_s, _FIRST_S, now_s

    def note(self):
        self._count += 1

    def wants(self, now_s):
        """Whether to request the stream now."""
        if now_s < self._due_s:
            return False
        elapsed_s = now_s - self._since_s
        self.is_missing = not (elapsed_s > 0.0 and self._count >= max(1.0, _ENOUGH * self.rate_hz * elapsed_s))
        self._count, self._since_s = 0, now_s
        self._wait_s = min(2.0 * self._wait_s, _LONGEST_S) if self.is_missing and elapsed_s > 0.0 else _FIRST_S
        self._due_s = now_s + self._wait_s
        return self.is_missing


class Streams:
    """Says which streams to request: each one until it arrives."""

    def __init__(self, rate_hz):
        self._streams = {number: _Stream(number, rate_hz) for number in _SIGNS}

    def restart(self, now_s):
        """Treat all streams as missing: the autopilot is new, back, or has rebooted."""
        for stream in self._streams.values():
            stream.restart(now_s)

    def note(self, message_type):
        """Count a message of the vehicle."""
        number = _STREAM_OF.get(message_type)
        if number is not None:
            self._streams[number].note()

    def wanted(self, now_s):
        """Return [(stream, rate [Hz])] to request now."""
        return [(stream.number, stream.rate_hz) for stream in self._streams.values() if stream.wants(now_s)]

    def missing(self):
        """Return the names of the missing streams."""
        names = mavlink.enums["MAV_DATA_STREAM"]
        return [
            names[stream.number].name.removeprefix("MAV_DATA_STREAM_")
            for stream in self._streams.values()
            if stream.is_missing
        ]
