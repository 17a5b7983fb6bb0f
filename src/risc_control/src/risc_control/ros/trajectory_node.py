"""Wiring of the trajectory nodes: references of all vehicles at 200 Hz. The work is in `trajectory_manager`."""

import math
import threading
import time
import traceback
from dataclasses import dataclass
from typing import Literal

import numpy as np
import rospy
from std_msgs.msg import Bool, UInt8
from std_srvs.srv import Trigger, TriggerResponse

from risc_control.feasibility import check_course, fleet_course, fleet_ways
from risc_control.reference_buffer import Order
from risc_control.ros import controller_node
from risc_control.ros.conversions import StatesReader, TrajectoriesMessage, derivatives_message
from risc_control.ros.joystick_buttons import ButtonParams, ButtonSubscriber
from risc_control.trajectories import (
    SAFE_SEPARATION_M,
    YawProgram,
    course_separation,
    course_settings,
    find_course,
)
from risc_control.trajectory_manager import TrajectoryManager, make_manager
from risc_control.transitions import WayLimits, plan_ways
from risc_control.waypoints import Waypoints
from risc_lab.lab.fleet import widest_pair_m
from risc_lab.ros.clock import SteadyClock
from risc_lab.ros.fleet_messages import CortexArrays, TrajectoriesArrays
from risc_lab.ros.guard import subscribe
from risc_lab.ros.paced_subscriber import PacedSubscriber
from risc_lab.ros.params import VEHICLE_KEYS, known_arena, load_params, vehicles
from risc_lab.ros.ticker import Ticker
from risc_lab.settings import Count, Settings, between, settings_from
from risc_maap_msgs.msg import TrajectoryDerivatives, TrajectoryPhases, VehiclePhase

_WATCH_HZ = 50.0  # how often the positions of vehicles flown by others are read

# Ways begin this long after the order: planning takes 10 ms for three vehicles, some 300 ms for fifty, and the
# references go on meanwhile.
_LEAD_S = 0.1
_LEAD_PER_VEHICLE_S = 0.01
_REST_S = 1.0  # after planning has failed


@dataclass(frozen=True)
class TrajectoryParams(WayLimits):
    """Parameters of all nodes that publish references."""

    rate: between(1.0, 1000.0) = 200.0  # [Hz]
    home_height: float = 1.0  # [m]
    wait_for_autonomous: bool = True  # False: on the course from the first moment on, in every mode
    wait_for_all: bool = True  # no vehicle starts while one hovers that is not autonomous
    psi_deg: float | Literal[""] = ""  # constant heading; "": that of the course
    yaw_along_path: bool = False  # the nose points along the path

    @property
    def yaw(self):
        """YawProgram; None = the course's own."""
        if self.psi_deg == "":
            return YawProgram(along_path=True) if self.yaw_along_path else None
        return YawProgram(math.radians(self.psi_deg), along_path=self.yaw_along_path)


@dataclass(frozen=True)
class CourseParams(Settings):
    """Parameters of nodes whose course is chosen by a parameter."""

    course_speed: float | str = ""  # largest speed [m/s], or e.g. 2x for twice the course's own; "": the course's own


class ManagerWiring:
    """A TrajectoryManager with the topics and services around it, for nodes that publish what it samples.

    Ways are planned in a thread of their own.
    """

    def __init__(self, fleet_vehicles, course, params, kind=TrajectoryManager, listens=True):
        """course: one that the vehicles can fly.  params: TrajectoryParams.  kind: TrajectoryManager or a subclass.
        listens: whether it subscribes to the states; if not, the node calls `look`.
        """
        self.vehicles, self.params = fleet_vehicles, params
        self.clock = SteadyClock()  # time of the courses: setting the computer's clock moves no reference
        smooth = params.wait_for_autonomous
        self.manager = make_manager(
            fleet_vehicles,
            course,
            params.home_height,
            params,
            kind,
            smooth=smooth,
            wait_for_all=params.wait_for_all,
            lead_s=_LEAD_S + _LEAD_PER_VEHICLE_S * len(fleet_vehicles),
        )
        self.lock = threading.Lock()
        self._to_plan = threading.Event()
        threading.Thread(target=self._plan, name="planner", daemon=True).start()
        self._reader = StatesReader(self.manager.names)
        self._unseen = set(self.manager.names) if smooth else set()  # vehicles whose position is not known yet
        self._publisher = rospy.Publisher("trajectory_phase", TrajectoryPhases, queue_size=10, latch=True)
        self.announce(course)
        self._watcher = None
        self._watch_lock = threading.Lock()  # separate: held while the master is asked; references must not wait
        self._serve("~go_home", self.manager.go_home, "going home", "no vehicle is flying a course")
        self._serve("~start", self.manager.start, "starting", "no vehicle hovers at home in autonomous mode")
        for vehicle in fleet_vehicles:
            topic = "/%s/controller_status" % vehicle.namespace
            # every message: a node that hung must not miss that a vehicle was flown by hand meanwhile
            subscribe(topic, Bool, self._on_status, vehicle.template, queue_size=None)
        subscribe("reference_order", UInt8, self._on_reference_order, queue_size=10)
        self._listens = smooth and listens
        self._watch()

    def sample(self, time_s):
        """Reference at a time; the caller holds the lock. Publishes phases and course when they have changed."""
        reference = self.manager.sample(time_s)
        if self.manager.task is not None:
            self._to_plan.set()
        waiting_for = self.manager.waiting_for(time_s)
        if waiting_for:
            text = "no vehicle starts: %s hovers there in manual mode. Make it autonomous, or land it (~wait_for_all)"
            rospy.logwarn_throttle(5.0, text, ", ".join(waiting_for))
        if reference.phases != self._phases:
            self._phases = reference.phases
            message = TrajectoryPhases(course=self._course)
            message.header.stamp = rospy.Time.now()
            message.vehicles = [VehiclePhase(*item) for item in zip(self.manager.names, self._phases)]
            self._publisher.publish(message)
        return reference

    def set_course(self, course):
        """Fly another course from now on, smoothly."""
        warn_of_near_vehicles(course, self.vehicles)
        with self.lock:
            self.manager.set_course(course, self.clock.now_s())
            self.announce(course)

    def announce(self, course):
        """Set the course that is flown, to be published with the next sample. The caller holds the lock."""
        self._course, self._phases = course.name, None

    def _watch(self):
        """Subscribe to the states only while positions are needed: they come 200 times a second."""
        if not self._listens:
            return
        with self._watch_lock:
            if self.manager.watching and self._watcher is None:
                self._watcher = PacedSubscriber("/cortex_raw", CortexArrays.Raw, self.look, _WATCH_HZ)
            elif not self.manager.watching and self._watcher is not None:
                self._watcher.unregister()
                self._watcher = None

    def look(self, message):
        """Take the positions of the vehicles. message: of /cortex_raw, its bytes."""
        with self.lock:
            _, states = self._reader.read(message.buff)
            for i in np.flatnonzero(states.visible):
                self._unseen.discard(self.manager.names[i])
                self.manager.see(
                    self.manager.names[i], states.position_m[i], states.velocity_m_s[i], states.angles_rad[i, 2]
                )

    def _on_status(self, message, name):
        if message.data and name in self._unseen:
            return  # it would be held where it is not; the status comes again and again
        with self.lock:
            changed = self.manager.set_autonomous(name, message.data, self.clock.now_s())
        if changed:
            self._watch()
            rospy.loginfo("%s: autonomous mode %s", name, "on" if message.data else "off")

    def _on_reference_order(self, message):
        with self.lock:
            self.manager.ask(message.data)

    def _serve(self, name, order, done, refused):
        """Service ~name that gives an order (a method of the manager) and answers with the vehicles that obey."""

        def answer(_request):
            with self.lock:
                names = order(self.clock.now_s())
            return TriggerResponse(bool(names), "%s: %s" % (done, ", ".join(names)) if names else refused)

        rospy.Service(name, Trigger, answer)

    def _plan(self):
        while True:
            self._to_plan.wait()
            self._to_plan.clear()
            try:
                self._plan_tasks()
            except Exception:  # after any error the next task must be planned; meanwhile all vehicles fly on
                rospy.logerr("ways cannot be planned, please report it\n%s", traceback.format_exc())
                time.sleep(_REST_S)

    def _plan_tasks(self):
        """Plan tasks until none is left."""
        task = self.manager.task
        while task is not None:
            plan = plan_ways(task)
            with self.lock:
                accepted = self.manager.accept(task, plan, self.clock.now_s())
                task = self.manager.task
            if accepted and plan.closest_m < self.manager.safe_m:
                rospy.logwarn("on the way, vehicles come within %.2f m of each other", plan.closest_m)


class ReferenceNode:
    """Publishes what a ManagerWiring samples on `trajectory`, on an absolute schedule."""

    def __init__(self, wiring):
        self.wiring = wiring
        self._message = TrajectoriesMessage(wiring.manager.names)
        self._publisher = rospy.Publisher("trajectory", TrajectoriesArrays, queue_size=1, tcp_nodelay=True)
        self._derivatives = rospy.Publisher(
            "trajectory_derivatives", TrajectoryDerivatives, queue_size=1, tcp_nodelay=True
        )
        Ticker(1.0 / wiring.params.rate, self._on_tick, "the references' clock")

    def _on_tick(self):
        with self.wiring.lock:
            time_s, stamp_s = self.wiring.clock.now()
            reference = self.wiring.sample(time_s)
            self._sampled(time_s)
        stamp = rospy.Time.from_sec(stamp_s)
        self._publisher.publish(self._message.fill(stamp, reference.derivatives))
        if len(reference.derivatives) > Order.SNAP + 1:  # a controller has asked for more than /trajectory carries
            names = self.wiring.manager.names
            self._derivatives.publish(derivatives_message(stamp, names, reference.derivatives))

    def _sampled(self, time_s):
        """For subclasses: called after every sample, with the lock held."""


class TrajectoryNode(ReferenceNode):
    """The references of a fleet on a course."""

    def __init__(self, default_course, *kinds, **default_options):
        """default_course: name in COURSES, unless ~course is set.  kinds: dataclasses of further parameters, which are
        stored in `more`.  default_options: options of make_course.
        """
        name, fleet_vehicles = chosen_course(default_course), vehicles()
        own = default_options if name == default_course else {}
        numbers = course_settings(name)(**own)
        params, speed, numbers, *self.more = load_params(
            TrajectoryParams, CourseParams, numbers, *kinds, known=("course", "waypoints", *VEHICLE_KEYS), lenient=True
        )
        # numbers that are not set may have another default for wide vehicles
        said = {key: number for key, number in vars(numbers).items() if key in own or rospy.has_param("~" + key)}
        course, factor = fleet_course(name, fleet_vehicles, known_arena(), speed.course_speed, params.yaw, **said)
        warn_of_near_vehicles(course, fleet_vehicles)
        super().__init__(ManagerWiring(fleet_vehicles, course, fleet_ways(params, fleet_vehicles, factor)))


def chosen_course(default):
    """Argument for `make_course`, from the parameters ~waypoints (content of a file) or ~course (a name, or a file).

    Raises ValueError.
    """
    content = rospy.get_param("~waypoints", {})
    if content:
        return settings_from(Waypoints, content, "parameter %s" % rospy.resolve_name("~waypoints"))
    return find_course(rospy.get_param("~course", default))


def main(name, course, **options):
    """Run a TrajectoryNode until shutdown."""
    controller_node.main(name, lambda: TrajectoryNode(course, **options))


@dataclass(frozen=True)
class BumperParams(ButtonParams):
    """The buttons of a CourseSelector: by default the original's bumpers."""

    next_button: Count = 5
    previous_button: Count = 4

    def __post_init__(self):
        super().__post_init__()
        if self.next_button == self.previous_button:
            raise ValueError("next_button and previous_button must be two buttons, both are %d" % self.next_button)


class CourseSelector:
    """Steps a ManagerWiring cyclically through courses, by two joystick buttons."""

    def __init__(self, wiring, courses, params):
        """courses: list of Course; the first is flown at the start.  params: BumperParams.

        Raises ValueError when the vehicles cannot fly one of them.
        """
        check_courses(courses, wiring.vehicles)
        self._wiring, self._courses, self._index = wiring, courses, 0
        self._steps = {params.next_button: 1, params.previous_button: -1}
        ButtonSubscriber(params, self._on_press)

    def _on_press(self, pressed):
        before, count = self._index, len(self._courses)
        self._index = (self._index + sum(self._steps.get(button, 0) for button in pressed)) % count
        if self._index != before:
            rospy.loginfo("course %d of %d: %s", self._index + 1, count, self._courses[self._index].name)
            self._wiring.set_course(self._courses[self._index])


def check_courses(courses, fleet_vehicles):
    """Raises ValueError when vehicles cannot fly one of the courses."""
    for course in courses:
        check_course(course, fleet_vehicles, known_arena())


def warn_of_near_vehicles(course, fleet_vehicles):
    """Log that a course brings vehicles near each other."""
    closest_m = course_separation(course, 400)
    if closest_m < SAFE_SEPARATION_M + widest_pair_m(fleet_vehicles):
        rospy.logwarn("on '%s' %d vehicles come within %.2f m of each other", course.name, len(course), closest_m)
