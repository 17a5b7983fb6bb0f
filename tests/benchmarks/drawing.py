"""How long the drawing nodes take for one drawing for rviz: fleets of several sizes, 200 Hz, drawn at 25 Hz.

Simulated: vehicles on circles, messages as they come from the wire, serialised again as they go out; no rviz. Messages
between two drawings are not even deserialised (risc_lab.ros.paced_subscriber), so nodes do not work on them here.
Times are processor times: other programs hardly affect them.
"""

import argparse
import io
import json
import math
import pathlib
import sys
import time

import genpy
import numpy as np
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from risc_estimation.bearings import Bearing
from risc_estimation.ros.bearing_conversions import bearings_from_msg, observed_angles, states_from_msg
from risc_lab.lab.fleet import FleetVehicle, Start
from risc_lab.lab.templates import load_templates
from risc_msgs.msg import Cortex, Mocap_data, Mocap_marker, Mocap_markers, Observed_angles, States
from risc_visual.drawing.cast import Index
from risc_visual.drawing.params import CortexParams, RayParams, TrajectoryParams
from risc_visual.drawing.rays import RayStyles
from risc_visual.drawing.ros import markers
from risc_visual.drawing.ros.cortex_drawing import CortexDrawing
from risc_visual.drawing.ros.paths import PathDrawing
from risc_visual.vision.landmark_config import load_landmarks

MOCAP_HZ = 200.0
START_S = 1.0e9
HULL_M = ((0.2, 0.2, 0.0), (0.2, -0.2, 0.0), (-0.2, 0.2, 0.0), (-0.12, -0.2, 0.08))  # markers of a vehicle


class Flight:
    """Messages of a fleet that flies circles, as bytes."""

    def __init__(self, names):
        self.names = names

    def cortex(self, stamp_s):
        """Cortex at a time [s]."""
        states = [
            States(name, True, x, y, z, *[0.0] * 3, 3.0, -2.0, yaw_deg, *[0.0] * 3)
            for name, (x, y, z), yaw_deg in self._poses(stamp_s)
        ]
        return _bytes(Cortex(_header(stamp_s), states))

    def mocap(self, stamp_s):
        """Mocap_data at a time [s]: four markers a vehicle."""
        bodies = [
            Mocap_markers(name, 0.0, [Mocap_marker(x + a, y + b, z + c) for a, b, c in HULL_M])
            for name, (x, y, z), _ in self._poses(stamp_s)
        ]
        return _bytes(Mocap_data(_header(stamp_s), bodies))

    def angles(self, stamp_s, seen):
        """Observed_angles at a time [s]: every vehicle sees these landmarks."""
        bearings = [Bearing(name, True, 0.2 * math.sin(stamp_s + k), 0.1) for k, name in enumerate(seen)]
        return _bytes(observed_angles(_header(stamp_s), [(name, bearings, []) for name in self.names]))

    def _poses(self, stamp_s):
        """(name, position [m], yaw [deg]) of every vehicle."""
        for k, name in enumerate(self.names):
            angle = 0.8 * stamp_s + k
            yield name, (1.8 * math.cos(angle), 1.5 * math.sin(angle), 0.5 + 0.04 * k), math.degrees(angle) % 360.0


def programs(names):
    """{what is drawn: (function of a flight and a time [s] to the message's bytes, function of these to markers)}."""
    fleet = [
        FleetVehicle("risc%d" % k, name, "ardrone", "127.0.0.1", Start((0.0, 0.0, 0.0))) for k, name in enumerate(names)
    ]
    landmarks, paths_of = load_landmarks(), TrajectoryParams()
    scene = CortexDrawing(CortexParams(), fleet, load_templates(), landmarks)
    paths = PathDrawing("quad_line", markers.RED, markers.FLOWN_M, paths_of.actual_s, paths_of, Index(names))
    rays_of, styles = RayParams(), RayStyles(RayParams(), landmarks, [(name,) for name in names])
    index = Index(kind.roi_name for kind in landmarks.landmarks)

    def vehicles(data):
        msg = Cortex().deserialize(data)
        found, labels = scene.vehicles(msg, msg.header.stamp.to_sec())
        return found + labels

    def bodies(data):
        return scene.bodies(Mocap_data().deserialize(data))

    def flown(data):
        msg = Cortex().deserialize(data)
        places_m = {name: at_m for name, (at_m, _) in states_from_msg(msg).items()}
        return paths.draw(markers.header(msg.header.stamp), places_m)

    def rays(data):
        msg = Observed_angles().deserialize(data)
        found = []
        for entry in msg.Obj:
            pen = markers.Pen(rays_of.lifetime_s, markers.header(msg.header.stamp, "%s/camera" % entry.name))
            numbered = [(index[ray.name], ray) for ray in styles.rays(bearings_from_msg(entry.landmarks))]
            found += markers.ray_markers(pen, entry.name, numbered, rays_of.alpha)
        return found

    seen = [kind.roi_name for kind in landmarks.landmarks]
    return {
        "vehicles, labels": (Flight.cortex, vehicles),
        "mocap markers": (Flight.mocap, bodies),
        "paths flown": (Flight.cortex, flown),
        "rays, 4 a vehicle": (lambda flight, stamp_s: flight.angles(stamp_s, seen), rays),
    }


def measure(count, seconds, rate_hz):
    """List of rows of one fleet: what is drawn, ms per drawing (p50, p99, max), markers and bytes in the last one."""
    names = ["vehicle_%d" % k for k in range(count)]
    flight = Flight(names)
    every = round(MOCAP_HZ / rate_hz)
    rows = []
    for what, (message, draw) in programs(names).items():
        taken_s, found, size = [], [], 0
        for frame in range(0, int(seconds * MOCAP_HZ), every):
            data = message(flight, START_S + frame / MOCAP_HZ)
            start_s = time.thread_time()
            found = draw(data)
            size = len(_bytes(MarkerArray(found)))
            taken_s.append(time.thread_time() - start_s)
        ms = 1e3 * np.array(taken_s)
        rows.append(
            {
                "vehicles": count,
                "what": what,
                "ms_p50": float(np.percentile(ms, 50)),
                "ms_p99": float(np.percentile(ms, 99)),
                "ms_max": float(ms.max()),
                "core_percent": float(0.1 * ms.mean() * rate_hz),
                "markers": len(found),
                "kilobytes": size / 1e3,
            }
        )
    return rows


def _header(stamp_s):
    return Header(stamp=genpy.Time.from_sec(stamp_s), frame_id="cortex")


def _bytes(message):
    wire = io.BytesIO()
    message.serialize(wire)
    return wire.getvalue()


def main(arguments=None):
    """Print the table; with --json also write it. Returns 1 when something takes longer than it has time for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vehicles", type=int, nargs="+", default=[3, 10, 50], help="fleet sizes (default 3 10 50)")
    parser.add_argument(
        "--seconds", type=float, default=12.0, help="of flight; paths are ten seconds long (default 12)"
    )
    parser.add_argument("--json", type=pathlib.Path, metavar="FILE", help="also write the figures here")
    options = parser.parse_args(arguments)
    if min(options.vehicles) < 1 or options.seconds <= 0.0:
        parser.error("--vehicles needs numbers from 1 up, --seconds a positive one")
    rate_hz = CortexParams().rate_hz
    print("%8s  %-20s%9s%9s%9s%9s%10s%8s" % ("vehicles", "", "ms p50", "p99", "max", "core", "markers", "kB"))
    rows = []
    for count in options.vehicles:
        for row in measure(count, options.seconds, rate_hz):
            rows.append(row)
            print("%(vehicles)8d  %(what)-20s%(ms_p50)9.2f%(ms_p99)9.2f%(ms_max)9.2f%(core_percent)8.1f%%"
                  "%(markers)10d%(kilobytes)8.1f" % row)  # fmt: skip
    if options.json:
        figures = {"simulated": True, "rate_hz": rate_hz, "mocap_hz": MOCAP_HZ, "rows": rows}
        options.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    late = ["%(vehicles)d vehicles, %(what)s" % row for row in rows if row["core_percent"] >= 100.0]
    if late:
        print("not in real time: %s" % "; ".join(late), file=sys.stderr)
    return 1 if late else 0


if __name__ == "__main__":
    sys.exit(main())
