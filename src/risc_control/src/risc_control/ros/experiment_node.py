"""Nodes of the original release that combine trajectory and controller of one vehicle."""

import time
from dataclasses import dataclass, fields
from functools import partial

import numpy as np
import rospy

from risc_control.feasibility import fleet_ways
from risc_control.ros.controller_node import ControllerNode
from risc_control.ros.conversions import TrajectoriesMessage
from risc_control.ros.trajectory_node import (
    BumperParams,
    CourseSelector,
    ManagerWiring,
    TrajectoryParams,
    check_courses,
)
from risc_control.trajectories import COURSE_HEIGHT_M, origin
from risc_control.vehicles import adapter_class
from risc_lab.lab import load_vehicle_type
from risc_lab.ros.fleet_messages import TrajectoriesArrays
from risc_lab.ros.guard import subscribe
from risc_lab.ros.params import load_params, vehicles
from risc_lab.settings import Positive, Settings

IRIS = "iris"  # type of vehicle


class ExperimentNode(ControllerNode):
    """A controller whose references come from its own generator, exact at any time."""

    def __init__(self, courses, kind="", known=()):
        """courses: of one vehicle each; the joystick's bumpers step through several.  kind: type of the vehicle.
        known: private parameters that are read elsewhere.
        """
        fleet_vehicles = vehicles(only_one=True, kind=kind)
        kinds = (TrajectoryParams, BumperParams)[: min(len(courses), 2)]
        params, *bumpers = load_params(*kinds, known=None, lenient=True)
        courses = [course.with_yaw(params.yaw) for course in courses]
        check_courses(courses, fleet_vehicles)
        params = fleet_ways(params, fleet_vehicles)
        self._wiring = ManagerWiring(fleet_vehicles, courses[0], params, listens=False)
        if bumpers:
            CourseSelector(self._wiring, courses, *bumpers)
        self._reference_message = TrajectoriesMessage(self._wiring.manager.names)
        self._reference_publisher = rospy.Publisher("/trajectory", TrajectoriesArrays, queue_size=1, tcp_nodelay=True)
        known = [*known, *(item.name for kind in kinds for item in fields(kind))]
        super().__init__("differential_flatness", fleet_vehicles, known)
        self._wiring.manager.ask(self._loop.controller.ORDER)

    def _subscribe(self):
        self._subscribe_to_states()

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


class _HearsAutopilot:
    """As in the original, the battery is also read from /apm/status, for when no vehicle node publishes the status."""

    def _subscribe(self):
        adapter_class(load_vehicle_type(IRIS)).listen("/", self._on_autopilot, partial(subscribe, queue_size=1))
        super()._subscribe()

    def _on_autopilot(self, status, _driver):
        if status.battery_pct is not None:
            self._loop.tell_battery(0, status.battery_pct, time.monotonic())


class IrisController(_HearsAutopilot, ControllerNode):
    """Flies the IRIS+ of the fleet along /trajectory."""

    def __init__(self):
        super().__init__("differential_flatness", vehicles(only_one=True, kind=IRIS))


class IrisExperiment(_HearsAutopilot, ExperimentNode):
    """An ExperimentNode of the fleet's IRIS+."""

    def __init__(self, courses, known=()):
        super().__init__(courses, IRIS, known)


@dataclass(frozen=True)
class HoldParams(Settings):
    """Parameters of an IrisHold."""

    height_m: Positive = COURSE_HEIGHT_M


class IrisHold(IrisExperiment):
    """Holds the fleet's IRIS+ above the origin."""

    def __init__(self):
        (params,) = load_params(HoldParams, known=None, lenient=True)
        super().__init__([origin(1, params.height_m)], [item.name for item in fields(HoldParams)])
