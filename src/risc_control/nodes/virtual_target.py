#!/usr/bin/env python3
"""References for Hows_controller.py: a place to wait at, and, after a button press, a target moving on a circle."""

from dataclasses import dataclass

import rospy
from std_msgs.msg import Float64

from risc_control.feasibility import fleet_ways
from risc_control.pursuit_reference import TargetParams, VirtualTarget
from risc_control.ros.controller_node import main
from risc_control.ros.joystick_buttons import ButtonParams, ButtonSubscriber
from risc_control.ros.trajectory_node import ManagerWiring, ReferenceNode, TrajectoryParams, check_courses
from risc_lab.ros.params import VEHICLE_KEYS, load_params, vehicles
from risc_lab.settings import Count


@dataclass(frozen=True)
class ChaseParams(ButtonParams):
    """The button that releases the target."""

    chase_button: Count = 1


class VirtualTargetNode(ReferenceNode):
    """Also publishes the speed of the target on `target_velocity`, 0 while it rests."""

    def __init__(self):
        kinds = TrajectoryParams, TargetParams, ChaseParams
        params, target, chase = load_params(*kinds, known=VEHICLE_KEYS, lenient=True)
        pursuers = vehicles(only_one=True)
        check_courses([target.waiting_place(), target.target_course()], pursuers)
        params = fleet_ways(params, pursuers)
        wiring = ManagerWiring(pursuers, target.waiting_place(), params, VirtualTarget)
        self._target = wiring.manager
        self._target.target = target.target_course()
        self._pursuing = False
        self._speed_publisher = rospy.Publisher("target_velocity", Float64, queue_size=1, tcp_nodelay=True)
        super().__init__(wiring)
        ButtonSubscriber(chase, self._on_press)

    def _sampled(self, time_s):
        self._speed_publisher.publish(self._target.target_speed_m_s(time_s))
        if self._pursuing != self._target.pursuing:
            self._pursuing = self._target.pursuing
            self.wiring.announce(self._target.target if self._pursuing else self._target.course)

    def _on_press(self, _buttons):
        with self.wiring.lock:
            will = self._target.let_go(self.wiring.clock.now_s())
        rospy.loginfo(
            "the target starts as soon as the vehicle waits for it"
            if will
            else "the target does not start: it moves already, or the vehicle is not on its way to its waiting position"
        )


if __name__ == "__main__":
    main("virtual_target", VirtualTargetNode)
