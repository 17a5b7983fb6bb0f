"""The report of a long bag with pictures and bearings: time and peak memory. The bag is synthetic, and made first."""

import argparse
import json
import math
import pathlib
import struct
import subprocess
import sys
import tempfile
import time

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

RATE_HZ = 200
BEARING_EVERY = 14  # frames: about 15 Hz, at any picture rate
LAP_S = 6  # after which everything repeats but the stamps
START_S = 1_500_000_000
VEHICLES = ("fluffy_II", "albatross", "Raven")
PICTURE_TOPIC = "/risc1/ardrone/image_raw"
SOURCES = pathlib.Path(__file__).resolve().parents[2] / "src"
_STAMP = struct.Struct("<II")
_STAMP_AT = 4  # bytes of a message with a header: after its sequence number


def type_store():
    """rosbags type store that knows the workspace's own messages."""
    store = get_typestore(Stores.ROS1_NOETIC)
    types = {}
    for package in ("risc_msgs", "risc_maap_msgs"):
        for path in (SOURCES / package / "msg").glob("*.msg"):
            types.update(get_types_from_msg(path.read_text(encoding="utf-8"), package + "/msg/" + path.stem))
    store.register(types)
    return store


class LongBag:
    """Writes a bag: states, references, commands and frames at 200 Hz, bearings and pictures beside them."""

    def __init__(self, path):
        self._store = type_store()
        self._writer = Writer(path)
        self._connections = {}

    def write(self, duration_s, picture_hz, picture_px):
        """picture_hz: pictures a second, 0 = none; picture_px: (width, height). Returns how many pictures there are."""
        laps = {
            "/mocap_data": ("risc_msgs/msg/Mocap_data", self._mocap),
            "/cortex_raw": ("risc_msgs/msg/Cortex", self._states),
            "/ground_truth": ("risc_msgs/msg/Cortex", self._states),
            "/trajectory": ("risc_msgs/msg/Trajectories", self._references),
            "/controls": ("risc_msgs/msg/Controls", self._controls),
        }
        tables = {
            topic: [self._raw(kind, make(k / RATE_HZ)) for k in range(LAP_S * RATE_HZ)]
            for topic, (kind, make) in laps.items()
        }
        bearings = bytearray(self._raw("risc_msgs/msg/Observed_angles", self._bearings()))
        picture = bytearray(self._raw("sensor_msgs/msg/Image", self._picture(*picture_px)))
        pictures, phases = 0, "risc_maap_msgs/msg/TrajectoryPhases"
        with self._writer:
            for topic, (kind, _) in laps.items():
                self._connect(topic, kind)
            self._connect("/mocap_time", "risc_maap_msgs/msg/MocapTime")
            self._connect("/trajectory_phase", phases)
            self._connect("/angles", "risc_msgs/msg/Observed_angles")
            self._connect(PICTURE_TOPIC, "sensor_msgs/msg/Image")
            vehicle = self._store.types["risc_maap_msgs/msg/VehiclePhase"]
            on_course = [vehicle(name, vehicle.COURSE) for name in VEHICLES]
            phase = self._new(phases, course="circles3", vehicles=on_course)
            self._put("/trajectory_phase", START_S * 10**9, self._raw(phases, phase))
            for k in range(round(duration_s * RATE_HZ)):
                stamp_ns = START_S * 10**9 + k * (10**9 // RATE_HZ)
                for place, (topic, table) in enumerate(tables.items()):
                    raw = bytearray(table[k % len(table)])
                    _STAMP.pack_into(raw, _STAMP_AT, *divmod(stamp_ns, 10**9))
                    self._put(topic, stamp_ns + 4_000_000 + 100_000 * place, raw)
                self._put("/mocap_time", stamp_ns + 4_000_000, self._time(stamp_ns, k))
                if k % BEARING_EVERY == 0:
                    _STAMP.pack_into(bearings, _STAMP_AT, *divmod(stamp_ns, 10**9))
                    self._put("/angles", stamp_ns + 4_800_000, bearings)
                if k * picture_hz // RATE_HZ > (k - 1) * picture_hz // RATE_HZ:
                    _STAMP.pack_into(picture, _STAMP_AT, *divmod(stamp_ns, 10**9))
                    self._put(PICTURE_TOPIC, stamp_ns + 4_900_000, picture)
                    pictures += 1
        return pictures

    def _connect(self, topic, kind):
        self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self._store)

    def _put(self, topic, time_ns, raw):
        self._writer.write(self._connections[topic], time_ns, bytes(raw))

    def _new(self, kind, **fields):
        """A message; fields that are not given are 0, empty, or an empty header."""
        if "header" in self._store.types[kind].__dataclass_fields__:
            stamp = self._store.types["builtin_interfaces/msg/Time"](0, 0)
            fields["header"] = self._store.types["std_msgs/msg/Header"](seq=0, stamp=stamp, frame_id="cortex")
        return self._store.types[kind](**fields)

    def _raw(self, kind, message):
        return bytes(self._store.serialize_ros1(message, kind))

    def _time(self, stamp_ns, number):
        """MocapTime of one frame: received 3 ms after its exposure."""
        kind = "risc_maap_msgs/msg/MocapTime"
        received = self._store.types["builtin_interfaces/msg/Time"](*divmod(stamp_ns + 3_000_000, 10**9))
        raw = bytearray(self._raw(kind, self._new(kind, receipt=received, frame=number, delay=0.003, filtered=True)))
        _STAMP.pack_into(raw, _STAMP_AT, *divmod(stamp_ns, 10**9))
        return raw

    @staticmethod
    def _place(index, t_s):
        """Circles, one above the other."""
        angle = 2.0 * math.pi * (t_s / LAP_S + index / len(VEHICLES))
        return 1.2 * math.cos(angle), 1.2 * math.sin(angle), 1.0 + 0.5 * index

    def _states(self, t_s):
        names = ("u", "v", "w", "phi", "theta", "psi", "p", "q", "r")
        return self._new("risc_msgs/msg/Cortex", Obj=[
            self._store.types["risc_msgs/msg/States"](
                name, True, *self._place(index, t_s - 0.02), **dict.fromkeys(names, 0.0)
            )
            for index, name in enumerate(VEHICLES)
        ])  # fmt: skip

    def _references(self, t_s):
        names = ("psi", "xdot", "ydot", "zdot", "psidot", "xddot", "yddot", "zddot", "psiddot")
        return self._new("risc_msgs/msg/Trajectories", Obj=[
            self._store.types["risc_msgs/msg/Trajectory"](name, *self._place(index, t_s), **dict.fromkeys(names, 0.0))
            for index, name in enumerate(VEHICLES)
        ])  # fmt: skip

    def _controls(self, _t_s):
        kind = self._store.types["risc_msgs/msg/Control"]
        return self._new("risc_msgs/msg/Controls", Obj=[kind(name, 0.0, 0.0, 0.0, 4.2) for name in VEHICLES])

    def _mocap(self, t_s):
        marker, markers = (self._store.types["risc_msgs/msg/" + name] for name in ("Mocap_marker", "Mocap_markers"))
        bodies = []
        for index, name in enumerate(VEHICLES):
            x, y, z = self._place(index, t_s)
            places = [(x + dx, y + dy, z) for dx, dy in ((0.2, 0.2), (0.2, -0.2), (-0.2, 0.2), (-0.12, -0.2))]
            if index == 0 and x > 1.1:
                places[0] = (math.nan, math.nan, math.nan)
            bodies.append(markers(name, 0.0, [marker(*place) for place in places]))
        return self._new("risc_msgs/msg/Mocap_data", Obj=bodies)

    def _bearings(self):
        """Every vehicle sees every other one, always straight ahead: the values do not affect the memory."""
        angle, angles = (self._store.types["risc_msgs/msg/" + name] for name in ("Angle", "Angles"))
        return self._new("risc_msgs/msg/Observed_angles", Obj=[
            angles(name, [], [angle(other, True, 0.0, 0.0) for other in VEHICLES if other != name])
            for name in VEHICLES
        ])  # fmt: skip

    def _picture(self, width, height):
        data = np.random.default_rng(1).integers(0, 255, width * height * 3, dtype=np.uint8)
        return self._new(
            "sensor_msgs/msg/Image", height=height, width=width, encoding="bgr8", is_bigendian=0, step=3 * width,
            data=data,
        )  # fmt: skip


def measure(bag, folder):
    """Make the report in a process of its own. Returns (seconds, peak memory [MB]); its errors are printed."""
    begin_s = time.monotonic()
    command = [sys.executable, "-c", MEASURED, str(bag), "--out", str(folder)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    return time.monotonic() - begin_s, float(done.stdout.split()[-1])


# prints the peak resident memory [MB] last
MEASURED = """
import resource, sys
from data_extraction.report.__main__ import main
code = main(sys.argv[1:])
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
sys.exit(code)
"""


def main():
    """Command line. Returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=pathlib.Path, required=True)
    parser.add_argument("--minutes", type=float, default=60.0, help="of flight (default: 60)")
    parser.add_argument("--picture-hz", type=int, default=15, help="pictures a second (default: 15)")
    parser.add_argument("--width", type=int, default=240, help="[px] of the pictures (default: 240)")
    parser.add_argument("--folder", type=pathlib.Path, help="where the bag is put meanwhile (default: that for such)")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=args.folder and str(args.folder)) as folder:
        bag = pathlib.Path(folder) / "long.bag"
        pictures = LongBag(bag).write(60.0 * args.minutes, args.picture_hz, (args.width, 3 * args.width // 4))
        size_gb = 1e-9 * bag.stat().st_size
        duration_s, peak_mb = measure(bag, pathlib.Path(folder))
    figures = {"bag_gb": size_gb, "minutes": args.minutes, "pictures": pictures, "s": duration_s, "peak_mb": peak_mb}
    print("bag %.2f GB, %g min at %d Hz, %d pictures" % (size_gb, args.minutes, RATE_HZ, pictures))
    print("report: %.0f s, %.0f MB/s, peak memory %.0f MB" % (duration_s, 1e3 * size_gb / duration_s, peak_mb))
    args.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
