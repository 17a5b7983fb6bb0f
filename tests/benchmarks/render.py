"""How long a picture takes: `./maap bench render`, CPU time on one core."""

import argparse
import json
import sys
import time

import cv2
import numpy as np
from labelled_pictures import CALIBRATIONS, SIZE_PX
from picture_truth import LabelledRenderer

from risc_lab.camera import Camera
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.calibration import CameraCalibration
from risc_simulator.video.scene import Board, CameraPose, Scene, VehiclePose, load_style

REPEATS = 200
STAGES = {"room": "_draw_room", "things": "_draw_things", "sensor": "_expose"}
AIM_MS = {"hover": 4.0, "turning": 8.0}
REQUIRED_MS = {"hover": 6.0, "turning": 12.0}  # medians: three cameras at 30 Hz must leave half a core for the encoders
TURN_RAD_S = 0.7  # 5 px in an exposure of 12 ms

_LANDMARKS = (
    ("Green_pink", (2.3, 0.8, 1.0), (-1.0, 0.0, 0.0)),
    ("Pink_blue", (2.3, -0.8, 1.0), (-1.0, 0.0, 0.0)),
    ("Orange_blue", (-2.3, 0.8, 1.0), (1.0, 0.0, 0.0)),
    ("Blue_green", (-2.3, -0.8, 1.0), (1.0, 0.0, 0.0)),
)


def cases():
    """{name: (CameraPose, VehiclePoses, Boards)}: what a camera of three vehicles in the arena sees."""
    vehicles = [
        VehiclePose("risc2", np.array((0.9, 0.5, 1.2)), rotation_body_to_cortex(0.05, 0.03, 1.0), 1),
        VehiclePose("risc3", np.array((1.1, -0.6, 0.8)), rotation_body_to_cortex(0.0, -0.05, -2.0), 2),
    ]
    board_axes = np.array([(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])  # faces the camera
    level = rotation_body_to_cortex(0.0, 0.0, 0.0)
    board = Board(8, 6, 0.025, (0.0, 0.0, 1.0), level @ board_axes)
    at = (-0.6, 0.0, 1.0)
    return {
        "hover": (_pose(at), vehicles, ()),
        "alone": (_pose(at), (), ()),
        "turning": (_pose(at, rate=(0.0, 0.0, TURN_RAD_S)), vehicles, ()),
        "board": (_pose(at), (), (board,)),
        "down": (_pose(at, pitch=-0.5 * np.pi), (), ()),
    }


def make_renderer():
    """Renderer of the scene that is measured."""
    style = load_style()
    scene = Scene(style, tuple(style.disc(*landmark) for landmark in _LANDMARKS))
    camera = Camera(CameraCalibration.from_intrinsics("bench", SIZE_PX, *CALIBRATIONS["albatross"]))
    return LabelledRenderer(camera, scene)


def measure(name, repeats=REPEATS):
    """{"case", "median_ms", "p90_ms", and the median of each stage in ms}."""
    renderer = make_renderer()
    took_s = {stage: [] for stage in STAGES}
    for stage, method in STAGES.items():
        setattr(renderer, method, _timed(getattr(renderer, method), took_s[stage]))
    pose, vehicles, boards = cases()[name]
    whole_s = []
    for _ in range(repeats):
        start_s = time.thread_time()
        renderer.render(pose, vehicles, boards)
        whole_s.append(time.thread_time() - start_s)
    row = {
        "case": name,
        "median_ms": 1e3 * float(np.median(whole_s)),
        "p90_ms": 1e3 * float(np.percentile(whole_s, 90)),
        "least_ms": 1e3 * min(whole_s),
    }
    row.update({stage + "_ms": 1e3 * float(np.median(values)) for stage, values in took_s.items()})
    return row


def _pose(position_m, pitch=0.0, rate=(0.0, 0.0, 0.0)):
    return CameraPose(
        np.array(position_m), rotation_body_to_cortex(0.02, pitch - 0.03, 0.04), np.zeros(3), np.array(rate)
    )


def _timed(function, took_s):
    def timed(*arguments):
        start_s = time.thread_time()
        result = function(*arguments)
        took_s.append(time.thread_time() - start_s)
        return result

    return timed


def main(arguments=None):
    """Command line. Returns 1 when a required time is missed."""
    parser = argparse.ArgumentParser(prog="render.py", description="Time for one picture of 640 x 360 on one core.")
    parser.add_argument("--json", metavar="FILE", help="write the table there too")
    options = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    rows = [measure(name, REPEATS) for name in cases()]
    print("pictures of 640 x 360, CPU time on one core, %d each [ms]:" % REPEATS)
    print("  case       median    p90  least  |   room  things  sensor  | aim, required")
    for row in rows:
        limits = AIM_MS.get(row["case"]), REQUIRED_MS.get(row["case"])
        print(
            "  %-9s %7.2f %6.2f %6.2f  | %6.2f  %6.2f  %6.2f  | %s"
            % (
                row["case"],
                row["median_ms"],
                row["p90_ms"],
                row["least_ms"],
                row["room_ms"],
                row["things_ms"],
                row["sensor_ms"],
                "%g, %g" % limits if all(limits) else "-",
            )
        )
    if options.json:
        with open(options.json, "w", encoding="utf-8") as stream:
            json.dump({"pictures": rows}, stream, indent=2)
            stream.write("\n")
    return 0 if all(row["median_ms"] <= REQUIRED_MS.get(row["case"], np.inf) for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
