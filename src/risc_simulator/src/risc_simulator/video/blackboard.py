"""What the lab and its camera process tell each other: one block of shared memory, each field with one writer.

The lab writes where the vehicles are and what their configuration says; the camera process writes who watches.  The
memory has no name: the file descriptor is inherited, so nothing is left behind whatever dies first.
"""

import mmap
import os
from collections import namedtuple

import numpy as np

RATES_HZ = (1.0, 30.0)  # of video:codec_fps
BITRATES_KBIT_S = (250.0, 8000.0)
COUNTS = ("sent", "delivered", "later", "cut")  # of faults on the wire, see faults.Wires.statistics
BAD_FILES = 3  # exit code of the camera process: a file that the fleet names cannot be used

STATE_WIDTH = 12  # columns of World.truth(): position, velocity, roll pitch yaw, their rates
_SLOTS = 64  # poses kept: a third of a second at 200 Hz

# One pose of all vehicles. time_s: monotonic clock of the exposure; lab_s: the same on the lab's clock;
# rows: (n, 12) as World.truth().
Snapshot = namedtuple("Snapshot", "time_s lab_s rows")


class Blackboard:
    """Shared memory for a fleet of n vehicles. Made by the lab, attached to by the camera process."""

    def __init__(self, vehicle_count, fd=None):
        """fd: of an existing board of the same size; None makes a new one (see `fd`)."""
        n = vehicle_count
        fields = (
            ("newest", np.int64, ()),  # number of the newest snapshot, 0 = none yet
            ("slots", np.float64, (_SLOTS, 2 + n * STATE_WIDTH)),
            ("light", np.float64, ()),  # brightness of the room, 1 = normal
            ("zero_s", np.float64, ()),  # monotonic time at which the lab's clock is 0
            ("channel", np.int32, (n,)),  # place among the cameras of its type
            ("rate_hz", np.float64, (n,)),  # within RATES_HZ
            ("bitrate_kbit_s", np.float64, (n,)),  # of video:max_bitrate, within BITRATES_KBIT_S
            ("enabled", np.int32, (n,)),  # general:video_enable
            ("link_up", np.int32, (n,)),  # 0: nothing passes
            ("board_since_s", np.float64, (n,)),  # monotonic time since when a checkerboard is waved,
            ("board_until_s", np.float64, (n,)),  # and until when
            ("ready", np.int32, ()),  # 1: a client is served at once; written by the camera process, cleared by the lab
            ("watchers", np.int32, (n,)),  # written by the camera process
            ("newest_picture", np.uint64, (n,)),  # number << 32 | bytes, written by the camera process
            ("pictures", np.int64, (n,)),  # sent, written by the camera process
            ("late_s", np.float64, (n,)),  # see Station.late_s, written by the camera process
            ("skipped", np.int64, (n,)),  # pictures that the computer was too slow for, written by the camera process
            ("faults", np.int64, (n, len(COUNTS))),  # what they did to the video, written by the camera process
        )
        kind = np.dtype(list(fields), align=True)
        is_new = fd is None
        self.fd = os.memfd_create("risc_simulator_video") if is_new else fd
        if is_new:
            os.ftruncate(self.fd, kind.itemsize)
        self._memory = mmap.mmap(self.fd, kind.itemsize)
        (record,) = np.split(np.frombuffer(self._memory, kind), 1)
        for name, _, shape in fields:
            setattr(self, name, record[name].reshape(shape))
        if is_new:
            self.light[...] = 1.0
            self.link_up[:] = self.enabled[:] = 1
            self.rate_hz[:] = 30.0
            self.bitrate_kbit_s[:] = 4000.0

    def publish(self, time_s, lab_s, rows):
        """The lab's: where the vehicles are now."""
        number = int(self.newest) + 1
        slot = self.slots[number % _SLOTS]
        slot[0], slot[1] = time_s, lab_s
        slot[2:] = rows.ravel()
        self.zero_s[...] = time_s - lab_s
        self.newest[...] = number  # only now: a reader never sees half a snapshot

    def snapshot(self):
        """The camera process': newest Snapshot, None before the first."""
        while True:
            number = int(self.newest)
            if number == 0:
                return None
            slot = self.slots[number % _SLOTS].copy()
            if int(self.newest) - number < _SLOTS - 1:  # else it was overwritten while it was copied
                return Snapshot(slot[0], slot[1], slot[2:].reshape(-1, STATE_WIDTH))

    def close(self):
        """Close the descriptor; the memory goes when nobody maps it any more."""
        if self.fd is not None:
            os.close(self.fd)
            self.fd = None
