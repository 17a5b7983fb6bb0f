"""What motions.npz holds: courses over time and blends between motions, to snap. See README.md."""

import math
import pathlib
import sys

import numpy as np

from risc_control.motions import blend, coasting, standing
from risc_control.trajectories import COURSES, YawProgram, make_course, on_course

PATH = pathlib.Path(__file__).with_suffix(".npz")
YAWS = {"own": None, "along": YawProgram(0.3, 0.1, along_path=True)}


def sampled():
    """{name: (rows, 18) path to snap and yaw to its acceleration}."""
    result = {}
    for name in sorted(COURSES):
        for kind, yaw in YAWS.items():
            course = make_course(name, 3).with_yaw(yaw)
            times = np.array([-1.7, 0.0, 3.3, 7.001, 100.0])
            result["%s %s" % (name, kind)] = np.concatenate([_rows(course.at(time_s)) for time_s in times])
    eight = on_course(make_course("flat8", 3).with_yaw(YAWS["along"]), 1, 4.0)
    tour = on_course(make_course("quadrants", 3), 2, 4.5)
    circle = on_course(make_course("circles3", 3), 0, 6.0)
    drifting = coasting([1.5, -1.0, 0.8], [0.2, 0.1, -0.1], 3.0, 4.0)
    onto = blend(drifting, eight, 5.0, 3.0)
    blends = {
        "onto a course": onto,
        "from course to course": blend(eight, tour, 5.0, 4.2),
        "of a blend": blend(onto, circle, 6.5, 5.0),
        "of a blend of a blend": blend(blend(onto, circle, 6.5, 5.0), standing([0.9, 0.0, 1.0], -2.5), 7.5, 6.1),
    }
    for name, way in blends.items():
        # after its end a blend was turned by whole revolutions: angles are compared as such
        result[name] = _rows(way.at(np.linspace(4.0, 16.0, 25)))
    return result


def _rows(derivatives):
    """(n, 18); the yaw within a revolution."""
    yaw = derivatives[:3, :, 3].T.copy()
    yaw[:, 0] = np.mod(yaw[:, 0], 2.0 * math.pi)
    return np.concatenate([derivatives[..., :3].transpose(1, 0, 2).reshape(-1, 15), yaw], axis=1)


if __name__ == "__main__":
    np.savez_compressed(PATH, **sampled())
    sys.stdout.write("%s\n" % PATH)
