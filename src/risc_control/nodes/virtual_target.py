#!/usr/bin/env python3
"""References for Hows_controller.py: a place to wait at, and, after a button, a target that runs on a circle."""

import sys

import rospy
from sensor_msgs.msg import Joy
from std_msgs.msg import Float64

from risc_control.ros.controller_node import main
from risc_control.ros.conversions import TrajectoriesMessage
from risc_control.ros.params import dataclass_from_params, number, vehicles
from risc_control.ros.trajectory_node import ManagerWiring
from risc_control.ros.until_shutdown import until_shutdown
from risc_control.virtual_target import TargetParams, VirtualTarget
from risc_msgs.msg import Trajectories


class VirtualTargetNode:
    """Publishes `trajectory` and the speed of the target on `target_velocity`, 0 while it rests."""

    def __init__(self):
        params = dataclass_from_params(TargetParams)
        self._wiring = ManagerWiring(vehicles(only_one=True), params.waiting_place(), VirtualTarget)
        self._target = self._wiring.manager
        self._target.target = params.target_course()
        self._button = int(number("~chase_button", 1))
        self._held = True  # held at the start is no press
        self._chasing = False
        self._message = TrajectoriesMessage(self._target.names)
        options = {"queue_size": 1, "tcp_nodelay": True}
        self._speed_publisher = rospy.Publisher("target_velocity", Float64, **options)
        self._publisher = rospy.Publisher("trajectory", Trajectories, **options)
        self._timer = rospy.Timer(rospy.Duration(1.0 / number("~rate", 200.0)), self._on_tick, reset=True)
        rospy.on_shutdown(self._timer.shutdown)
        rospy.Subscriber("joy", Joy, self._on_joy, queue_size=10)

    @until_shutdown
    def _on_tick(self, _event):
        with self._wiring.lock:
            now = rospy.Time.now()
            reference = self._wiring.sample(now.to_sec())
            speed_m_s = self._target.target_speed_m_s
        self._speed_publisher.publish(speed_m_s)  # first: what it says is true of the reference that follows
        self._publisher.publish(self._message.fill(now, reference.derivatives))
        if self._chasing != (speed_m_s > 0.0):
            self._chasing = not self._chasing
            self._wiring.announce(self._target.target if self._chasing else self._target.course)

    def _on_joy(self, message):
        pressed = self._button < len(message.buttons) and bool(message.buttons[self._button])
        if pressed and not self._held:
            rospy.loginfo("the target is let go as soon as the vehicle waits for it")
            with self._wiring.lock:
                self._target.let_go()
        self._held = pressed


if __name__ == "__main__":
    sys.exit(main("virtual_target", VirtualTargetNode))
