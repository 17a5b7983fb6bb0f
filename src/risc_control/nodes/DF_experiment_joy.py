#!/usr/bin/env python3
"""The figures of chapter 6 with one vehicle: trajectory and controller in one node, figures chosen by the bumpers."""

from dataclasses import fields

import numpy as np
import rospy

from risc_control.ros.controller_node import ControllerNode, main
from risc_control.ros.conversions import TrajectoriesMessage
from risc_control.ros.trajectory_node import BumperParams, CourseSelector, ManagerWiring, TrajectoryParams
from risc_control.trajectories import make_course
from risc_lab.ros.fleet_messages import CortexArrays, TrajectoriesArrays
from risc_lab.ros.params import load_params, vehicles

FIGURES = ("origin", "slanted8", "origin", "flat8", "origin", "circle")


class ExperimentNode(ControllerNode):
    """A controller whose references come from its own generator, exact at any time."""

    def __init__(self):
        fleet_vehicles = vehicles(only_one=True)
        kinds = TrajectoryParams, BumperParams
        params, bumpers = load_params(*kinds, known=None, lenient=True)
        courses = [make_course(name, 1).with_yaw(params.yaw) for name in FIGURES]
        self._wiring = ManagerWiring(fleet_vehicles, courses[0], params, listens=False)
        self._selector = CourseSelector(self._wiring, courses, bumpers)
        self._reference_message = TrajectoriesMessage(self._wiring.manager.names)
        self._reference_publisher = rospy.Publisher("/trajectory", TrajectoriesArrays, queue_size=1, tcp_nodelay=True)
        known = [item.name for kind in kinds for item in fields(kind)]
        super().__init__("differential_flatness", fleet_vehicles, known)
        self._wiring.manager.ask(self._loop.controller.ORDER)

    def _subscribe(self):
        rospy.Subscriber("/cortex_raw", CortexArrays.Raw, self._on_states, queue_size=1, tcp_nodelay=True)

    def _on_states(self, message):
        if self._wiring.manager.watching:
            self._wiring.look(message)
        super()._on_states(message)

    def _references(self, times_s, now_s):
        with self._wiring.lock:
            values = [self._wiring.sample(times_s[0]).derivatives]
            values += [self._wiring.manager.sample(time_s).derivatives for time_s in times_s[1:]]
        stamp = rospy.Time.from_sec(times_s[0])
        self._reference_publisher.publish(self._reference_message.fill(stamp, values[0]))
        return np.array(values), np.ones(len(self.names), dtype=bool)


if __name__ == "__main__":
    main("LQR_controller", ExperimentNode)
