#!/usr/bin/env python3
"""References for Hows_controller.py: a place to wait at, and, after a button, a target that runs on a circle."""

import sys

import rospy
from std_msgs.msg import Float64

from risc_control.pursuit_reference import TargetParams, VirtualTarget
from risc_control.ros.controller_node import main
from risc_control.ros.joystick_buttons import ButtonSubscriber
from risc_control.ros.trajectory_node import ManagerWiring, ReferenceNode
from risc_lab.ros.params import dataclass_from_params, number, vehicles


class VirtualTargetNode(ReferenceNode):
    """Publishes the speed of the target, too, on `target_velocity`, 0 while it rests."""

    def __init__(self):
        params = dataclass_from_params(TargetParams)
        wiring = ManagerWiring(vehicles(only_one=True), params.waiting_place(), VirtualTarget)
        self._target = wiring.manager
        self._target.target = params.target_course()
        button = number("~chase_button", 1)
        if button < 0 or button != int(button):
            raise ValueError("parameter ~chase_button must be a button, counted from 0, got %r" % button)
        self._pursuing = False
        self._speed_publisher = rospy.Publisher("target_velocity", Float64, queue_size=1, tcp_nodelay=True)
        super().__init__(wiring)
        ButtonSubscriber({"chase_button": int(button)}, self._on_press)

    def _sampled(self, time_s):
        self._speed_publisher.publish(self._target.target_speed_m_s(time_s))
        if self._pursuing != self._target.pursuing:
            self._pursuing = self._target.pursuing
            self.wiring.announce(self._target.target if self._pursuing else self._target.course)

    def _on_press(self, _buttons):
        with self.wiring.lock:
            will = self._target.let_go(self.wiring.clock.now_s())
        rospy.loginfo(
            "the target is let go as soon as the vehicle waits for it"
            if will
            else "the target is not let go: it runs already, or the vehicle is not on its way to where it waits"
        )


if __name__ == "__main__":
    sys.exit(main("virtual_target", VirtualTargetNode))
