"""From the bytes of a serial line to the channels of a receiver: an Arduino Due with its firmware, and its PPM signal.

The firmware is the real one (firmware/dueppm), built for this computer. It runs on lab time.
"""

import ctypes
from collections import Counter

from risc_simulator.vehicles.iris.sensors import sensor_errors

TICKS_PER_US = 42
LINE_S = 0.015  # time of a message on the line to the board, at 57600 baud

LIBRARY = "libdueppm_host.so"
_EDGES_PER_CALL = 64
_BYTES_PER_CALL = 1024


def radio_delay_s(plant):
    """From the beginning of a frame to its effect [s]: the command delay of the vehicle without the serial line."""
    return max(0.0, plant.command_delay_s - LINE_S)


def telemetry_delay_s(autopilot, rng):
    """Delay of the next telemetry datagram of an IrisFirmware [s]; its radio sends in turns."""
    return autopilot.telemetry_delay_s + sensor_errors().jitter_s * rng.random()


class _Edge(ctypes.Structure):
    _fields_ = (("time_ticks", ctypes.c_uint64), ("level", ctypes.c_int))


def _load():
    try:
        library = ctypes.CDLL(LIBRARY)
    except OSError as error:
        raise OSError(
            error.errno,
            "the firmware of the IRIS+'s Arduino is not built for this computer (%s): run ./maap build, and source "
            "devel/setup.bash" % error,
        ) from error
    board, size = ctypes.c_void_p, ctypes.c_size_t
    for name, result, *arguments in (
        ("new", board),
        ("free", None, board),
        ("reset", None, board),
        ("receive", None, board, ctypes.c_char_p, size),
        ("send", size, board, ctypes.c_char_p, size),
        ("advance", None, board, ctypes.c_uint64),
        ("accepted", ctypes.c_uint64, board),
        ("edges", size, board, ctypes.POINTER(_Edge), size),
    ):
        function = getattr(library, "dueppm_" + name)
        function.restype, function.argtypes = result, arguments
    return library


class Board:
    """One Arduino Due with its firmware. Raises OSError when that has not been built."""

    def __init__(self):
        self._library = _load()
        self._board = self._library.dueppm_new()
        self._edges = (_Edge * _EDGES_PER_CALL)()
        self._bytes = ctypes.create_string_buffer(_BYTES_PER_CALL)

    def reset(self):
        """Reset the board, as its button does."""
        self._library.dueppm_reset(self._board)

    def receive(self, data):
        """Feed bytes from the serial line."""
        self._library.dueppm_receive(self._board, data, len(data))

    def advance(self, time_s):
        """Run the firmware up to this time; a time in the past has no effect."""
        self._library.dueppm_advance(self._board, int(1e6 * time_s))

    def sent(self):
        """Bytes that it has sent since the last call."""
        count = self._library.dueppm_send(self._board, self._bytes, _BYTES_PER_CALL)
        return self._bytes.raw[:count] if count else b""

    def accepted_s(self):
        """When the newest message that it accepted was complete [s]; 0: none yet."""
        return self._library.dueppm_accepted(self._board) / (1e6 * TICKS_PER_US)

    def edges(self):
        """[(time [ticks], level)] of its output since the last call."""
        found, count = [], _EDGES_PER_CALL
        while count == _EDGES_PER_CALL:
            count = self._library.dueppm_edges(self._board, self._edges, _EDGES_PER_CALL)
            found += [(edge.time_ticks, edge.level) for edge in self._edges[:count]]
        return found

    def close(self):
        """May be called twice."""
        if self._board is not None:
            self._library.dueppm_free(self._board)
            self._board = None


class PpmReceiver:
    """The radio's end of the trainer cord: turns edges into the channels of complete frames, and refuses the rest.

    A channel lasts from one pulse's leading edge to the next one's. Refused frames are counted by reason.
    """

    FEWEST, MOST = 4, 8  # channels
    SHORTEST_US, LONGEST_US = 800, 2200  # of a channel
    PULSE_US = 100, 500
    SYNC_US = 2500  # shortest time between two frames
    AGREE = 3  # frames in a row with another number of channels, before that number is accepted
    LOST_S = 0.5

    def __init__(self, pulse_level=0):
        """pulse_level: of the line while a pulse lasts."""
        self._pulse_level = pulse_level
        self.counts = Counter()  # "frames", and reasons for refusing one
        self.channels_us = ()  # of the newest good frame
        self._good_ticks = None  # when that frame began
        self._leading = []  # times of the leading edges of the frame being received; []: none is
        self._trouble = "no gap before"  # of that frame
        self._last_ticks, self._level = None, 1 - pulse_level
        self._other_count = 0, 0  # an unusual number of channels; how many frames had it

    def feed(self, edges, now_ticks):
        """Edges (time [ticks], level), oldest first, up to now. Returns the good frames in them, [(begin, channels)].

        begin: [ticks].  channels: whole microseconds.
        """
        frames = []
        for time_ticks, level in edges:
            if self._last_ticks is not None and time_ticks < self._last_ticks:
                self._trouble = self._trouble or "time goes back"
            self._last_ticks = time_ticks
            if level == self._level:
                self._trouble = self._trouble or "an edge is missing"
            before, self._level = self._level, level
            if level != self._pulse_level:
                self._end_pulse(time_ticks)
                continue
            if self._leading and time_ticks - self._leading[-1] >= self.SYNC_US * TICKS_PER_US:
                self._end_frame(frames, before)
            self._leading.append(time_ticks)
        if self._leading and now_ticks - self._leading[-1] >= self.SYNC_US * TICKS_PER_US:
            self._end_frame(frames, self._level)
        return frames

    def is_lost(self, now_ticks):
        """Whether no good frame has begun for LOST_S."""
        return self._good_ticks is None or now_ticks - self._good_ticks > 1e6 * self.LOST_S * TICKS_PER_US

    def _end_pulse(self, time_ticks):
        if self._leading:
            shortest, longest = self.PULSE_US
            if not shortest <= (time_ticks - self._leading[-1]) / TICKS_PER_US <= longest:
                self._trouble = self._trouble or "a pulse of another length"

    def _end_frame(self, frames, level):
        """level: of the line in the gap after the frame."""
        leading, trouble = self._leading, self._trouble
        self._leading, self._trouble = [], ""
        channels = tuple(round((end - begin) / TICKS_PER_US) for begin, end in zip(leading, leading[1:]))
        if not trouble and level == self._pulse_level:
            trouble = "a pulse without an end"
        if not trouble and not self.FEWEST <= len(channels) <= self.MOST:
            trouble = "too few channels" if len(channels) < self.FEWEST else "too many channels"
        if not trouble and not all(self.SHORTEST_US <= us <= self.LONGEST_US for us in channels):
            trouble = "a channel out of range"
        if not trouble and self.channels_us and len(channels) != len(self.channels_us):
            count, times = self._other_count
            self._other_count = len(channels), times + 1 if count == len(channels) else 1
            trouble = "" if self._other_count[1] >= self.AGREE else "another number of channels"
        if trouble:
            self.counts[trouble] += 1
            return
        self.counts["frames"] += 1
        self.channels_us, self._good_ticks, self._other_count = channels, leading[0], (0, 0)
        frames.append((leading[0], channels))
