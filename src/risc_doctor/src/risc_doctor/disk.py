"""The disk that the bag goes to: room for how many minutes, and is it fast enough?"""

import os
import shutil
import tempfile
import time

from risc_doctor.findings import GREEN, RED, YELLOW, Findings, finding

# What record.launch writes: every topic at 200 Hz, and a vehicle's pictures, 10 a second of 80 kB.
BASE_MB_S = 0.5
VEHICLE_MB_S = 1.0
RED_MINUTES, YELLOW_MINUTES = 10.0, 60.0
_RESERVE = 2.0  # by this factor the disk must be faster than the bag, as its speed varies
_MB = 1e6
_TEST_BYTES = 64 * 1024 * 1024
_PIECE_BYTES = 4 * 1024 * 1024
_LONGEST_S = 2.0


def check(situation):
    """Free space and write speed where the bag goes."""
    found = Findings("disk")
    folder = situation.bag_folder or situation.root / "flights"
    if not os.path.lexists(folder):  # the recorder makes it
        folder = folder.parent
    if not os.path.isdir(folder):  # also False without permission
        return found.say("no_folder", folder=folder)
    need_mb_s = BASE_MB_S + VEHICLE_MB_S * len(situation.fleet.vehicles)
    free_bytes = shutil.disk_usage(folder).free
    found.append(judge_space(folder, free_bytes, need_mb_s))
    size = min(_TEST_BYTES, free_bytes // 2)
    if situation.master is not None:
        size //= 8  # a flight may be recorded at this moment
    try:
        found.append(judge_speed(folder, write_speed_mb_s(folder, size), need_mb_s))
    except OSError as error:
        code = "forbidden" if isinstance(error, PermissionError) else "read_only"
        found.say(code, folder=folder, error=error.strerror or error)
    return found


def judge_space(folder, free_bytes, need_mb_s):
    """Finding about the room for a bag that grows by need_mb_s [MB/s]."""
    minutes = free_bytes / (need_mb_s * _MB) / 60.0
    level = RED if minutes < RED_MINUTES else YELLOW if minutes < YELLOW_MINUTES else GREEN
    duration = "%.0f minutes" % minutes if minutes < 120.0 else "%.0f hours" % (minutes / 60.0)
    values = {"free_bytes": free_bytes, "free_gb": free_bytes / 1e9, "minutes": minutes, "duration": duration}
    return finding("disk", "room", level, folder=folder, **values)


def judge_speed(folder, speed_mb_s, need_mb_s):
    """Finding about the speed of writing."""
    level = RED if speed_mb_s < need_mb_s else YELLOW if speed_mb_s < _RESERVE * need_mb_s else GREEN
    return finding("disk", "speed", level, folder=folder, speed_mb_s=speed_mb_s, need_mb_s=need_mb_s)


def write_speed_mb_s(folder, size):
    """Write speed [MB/s] of a temporary file that is synced to the disk. Raises OSError."""
    piece = os.urandom(_PIECE_BYTES)  # not compressible by a file system
    written, start = 0, time.monotonic()
    with tempfile.TemporaryFile(dir=folder, buffering=0) as stream:
        while written < max(size, _PIECE_BYTES) and time.monotonic() - start < _LONGEST_S:
            written += stream.write(piece)
            os.fdatasync(stream)
        return written / _MB / max(time.monotonic() - start, 1e-6)
