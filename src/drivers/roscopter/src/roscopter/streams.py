"""Telemetry streams: which are asked for, and which do not come. No ROS, no clock."""

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

# Only what becomes a topic: a telemetry radio of 57600 baud does not carry everything at 10 Hz.
_SIGNS = {  # stream: a message of it that each vehicle has
    mavlink.MAV_DATA_STREAM_RAW_SENSORS: ("RAW_IMU",),
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: ("SYS_STATUS",),
    mavlink.MAV_DATA_STREAM_RC_CHANNELS: ("RC_CHANNELS", "RC_CHANNELS_RAW"),
    mavlink.MAV_DATA_STREAM_POSITION: ("GLOBAL_POSITION_INT",),
    mavlink.MAV_DATA_STREAM_EXTRA1: ("ATTITUDE",),
    mavlink.MAV_DATA_STREAM_EXTRA2: ("VFR_HUD",),
}
_STREAM_OF = {sign: stream for stream, signs in _SIGNS.items() for sign in signs}
LOWEST_HZ = {mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: 2}  # the battery, whatever the option says
_FIRST_S, _LONGEST_S = 2.0, 16.0  # until a stream that does not come is asked for again; doubled each time
_ENOUGH = 0.5  # of the rate: a radio that is too slow makes autopilots send less, and asking would not help


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
        """Whether it is to be asked for now."""
        if now_s < self._due_s:
            return False
        elapsed_s = now_s - self._since_s
        self.is_missing = not (elapsed_s > 0.0 and self._count >= max(1.0, _ENOUGH * self.rate_hz * elapsed_s))
        self._count, self._since_s = 0, now_s
        self._wait_s = min(2.0 * self._wait_s, _LONGEST_S) if self.is_missing and elapsed_s > 0.0 else _FIRST_S
        self._due_s = now_s + self._wait_s
        return self.is_missing


class Streams:
    """Asks for each stream until it comes."""

    def __init__(self, rate_hz):
        self._streams = {number: _Stream(number, rate_hz) for number in _SIGNS}

    def restart(self, now_s):
        """The autopilot is new, or back, or restarted: nothing is known."""
        for stream in self._streams.values():
            stream.restart(now_s)

    def note(self, message_type):
        """A message of the vehicle came."""
        number = _STREAM_OF.get(message_type)
        if number is not None:
            self._streams[number].note()

    def wanted(self, now_s):
        """[(stream, rate [Hz])] to ask for now."""
        return [(stream.number, stream.rate_hz) for stream in self._streams.values() if stream.wants(now_s)]

    def missing(self):
        """Names of those that do not come."""
        names = mavlink.enums["MAV_DATA_STREAM"]
        return [
            names[stream.number].name.removeprefix("MAV_DATA_STREAM_")
            for stream in self._streams.values()
            if stream.is_missing
        ]
