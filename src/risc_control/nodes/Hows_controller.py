#!/usr/bin/env python3
"""Pursues a virtual target (virtual_target.py) by nonlinear guidance once it moves; until then flies to it."""

import numpy as np
import rospy
from std_msgs.msg import Float64

from risc_control.ros.controller_node import ControllerNode, main
from risc_lab.ros.guard import subscribe
from risc_lab.ros.params import vehicles


class GuidanceNode(ControllerNode):
    """A controller that learns from `target_velocity` whether its reference is a moving target; publishes `range`."""

    def __init__(self):
        self._range = rospy.Publisher("/range", Float64, queue_size=1)
        super().__init__("guidance", vehicles(only_one=True))

    def _subscribe(self):
        subscribe("/target_velocity", Float64, self._on_target_velocity, queue_size=1)
        super()._subscribe()

    def _on_target_velocity(self, message):
        with self._lock:
            self._loop.controller.target_speed_m_s = message.data

    def _updated(self):
        range_m = self._loop.controller.range_m[0]
        if np.isfinite(range_m):
            self._range.publish(range_m)


if __name__ == "__main__":
    main("Hows_Controller", GuidanceNode)
