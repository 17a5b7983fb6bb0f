#!/usr/bin/env python3
"""Origin and quadrants I, II, III, IV, I, stepped through by the joystick's bumpers."""

from risc_control.ros.controller_node import main
from risc_control.ros.trajectory_node import BumperParams, CourseSelector, TrajectoryNode
from risc_control.trajectories import make_course, quadrant


def make_node():
    node = TrajectoryNode("origin", BumperParams)
    vehicles = len(node.wiring.vehicles)
    yaw = node.wiring.params.yaw
    courses = [make_course("origin", vehicles)] + [quadrant(number, vehicles) for number in (1, 2, 3, 4, 1)]
    CourseSelector(node.wiring, [course.with_yaw(yaw) for course in courses], *node.more)
    return node


if __name__ == "__main__":
    main("Trajectory", make_node)
