"""ROS part of the transform tuner: handles in rviz, sliders, services, a text; the work is in tuner.mount_tuner.

It is `transforms` of risc_control with cameras that can be moved: start it in place of that node.
"""

import textwrap
import threading
import time
import xmlrpc.client

import rospy
from dynamic_reconfigure.server import Server
from interactive_markers.interactive_marker_server import InteractiveMarkerServer
from std_srvs.srv import Trigger, TriggerResponse
from visualization_msgs.msg import InteractiveMarkerFeedback, MarkerArray

from risc_control.ros.vehicle_transforms import VehicleTransforms
from risc_estimation.mount_fit import FitParams
from risc_estimation.mount_samples import WindowParams
from risc_estimation.ros.bearing_conversions import bearings_from_msg, states_from_msg
from risc_estimation.ros.cameras import VehicleCameras
from risc_lab.lab.landmark_catalogue import load_landmark_catalogue
from risc_lab.ros.paced_subscriber import PacedSubscriber
from risc_lab.ros.params import fleet_vehicles, load_params
from risc_lab.ros.ticker import on_ros_time
from risc_lab.ros.until_shutdown import until_shutdown
from risc_lab.vehicle_frames import body_frame
from risc_msgs.msg import Cortex, Landmarks, Observed_angles
from risc_visual.cfg import TransformTunerConfig
from risc_visual.drawing.ros.drawer import MarkerPublisher
from risc_visual.drawing.ros.markers import Pen, header
from risc_visual.ros.node import Health
from risc_visual.tuner.mount_tuner import NUMBERS, MountTuner, TunerParams
from risc_visual.tuner.ros.mount_marker import mount_marker, numbers_from_pose, pose_of

NAMESPACE = "transform_tuner"  # of topics, services and sliders, whatever the node is called
ACTIONS = ("solve", "check", "save", "reset", "record")  # services, and the menu in this order
_FOLLOW_S = 0.25  # delay of the sliders after the handles: updating all clients at every mouse event takes too long
_SEEN_S = 0.5  # a vehicle without a pose for longer is not seen
_COMPLAIN_S = 10.0  # between warnings of sliders that cannot follow
_ANSWER_S = 20.0  # how long the last answer stays in the view
_LANDMARKS_HZ = 2.0
_STATES = 400  # frames that may wait while the node is held up: 2 s at 200 Hz
_BUFFER_BYTES = 2**20
_TEXT_ABOVE_M = 0.6  # its lower edge above the vehicle, and above the vehicle's name
_TEXT_M = 0.08  # height of a line
_LINE = 1.3  # distance of two lines / their height
_TEXT_COLUMNS = 56
_APART_LINES = 5  # each vehicle's text is this much higher than that of the one before: they may fly abreast
_TEXT_RGBA = (1.0, 1.0, 0.6, 1.0)


class HandleServer(InteractiveMarkerServer):
    """The server of the package, but silent when ROS shuts down."""

    keepAlive = until_shutdown(InteractiveMarkerServer.keepAlive)  # noqa: N815 - the name is the package's


class Sliders:
    """The six numbers of one vehicle's camera on dynamic_reconfigure."""

    def __init__(self, namespace, tuner, on_moved):
        """namespace: of the sliders. on_moved: called with {number: value} of what a person has moved."""
        self._tuner = tuner
        self._on_moved = on_moved
        self._shown = None
        self._follower = None  # thread that moves them now, in place of a person
        self._told = True  # whether all clients got their last values
        for key, value in tuner.numbers.items():
            rospy.set_param("%s/%s" % (namespace, key), value)
        self._server = Server(TransformTunerConfig, self._on_config, namespace)

    def follow(self):
        """Show the present mount. Do not call this while holding a lock that `on_moved` takes.

        Raises OSError or xmlrpc.client.Error when the master does not answer: call it again later.
        """
        if self._told and self._tuner.shows(self._shown):
            return
        self._told, self._follower = False, threading.get_ident()
        try:
            self._server.update_configuration(self._tuner.numbers)
            self._told = True
        finally:
            self._follower = None

    def _on_config(self, config, _level):
        wanted = {key: config[key] for key in NUMBERS}
        if self._shown is not None and self._follower != threading.get_ident():
            # only what was moved: the others may be behind the handles
            self._on_moved({key: value for key, value in wanted.items() if value != self._shown[key]})
        self._shown = wanted
        return config


class TransformTunerNode:
    """/cortex_raw, /states3, /angles -> tf as `transforms`; transform_tuner/...: handles, sliders, text, services."""

    def __init__(self):
        self._params, window_params, fit_params = load_params(TunerParams, WindowParams, FitParams)
        fleet = fleet_vehicles()
        if not fleet:
            raise ValueError("there is no fleet in /fleet: start it beside a flight, or give its fleet file")
        self._tuners = [MountTuner(vehicle, self._params, window_params, fit_params) for vehicle in fleet]
        self._by_name = {name: tuner for tuner in self._tuners for name in (tuner.template, tuner.name)}
        self._template_of_region = load_landmark_catalogue().template_of_region
        self._cameras = VehicleCameras(fleet, self._params.rectified, self._params.camera)
        self._lock = threading.Lock()  # windows and frames: handles, sliders, services and topics have a thread each
        namespace = rospy.resolve_name(NAMESPACE)
        self._text = MarkerPublisher(namespace + "/text", MarkerArray, queue_size=1)
        self._handles = HandleServer(namespace)
        self._health = Health("transform_tuner", ("/cortex_raw", "/states3", "/angles"))
        self._frames = VehicleTransforms({tuner.template: tuner.mount for tuner in self._tuners})
        self._frames_due_s = 0.0
        self._sliders = [self._offer(tuner, "%s/%s" % (namespace, tuner.name)) for tuner in self._tuners]
        self._handles.applyChanges()
        # Every pose counts, also when this node is late: between two poses that are far apart nothing is known.
        rospy.Subscriber(
            "/cortex_raw", Cortex, self._on_states, queue_size=_STATES, buff_size=_BUFFER_BYTES, tcp_nodelay=True
        )
        PacedSubscriber("/states3", Landmarks, self._on_landmarks, _LANDMARKS_HZ)
        rospy.Subscriber("/angles", Observed_angles, self._on_angles, queue_size=100, tcp_nodelay=True)
        for period_s, callback in ((_FOLLOW_S, self._on_follow), (1.0 / self._params.text_hz, self._on_text)):
            on_ros_time(period_s, callback, "the transform tuner")

    def _offer(self, tuner, namespace):
        """Handles and services of one vehicle. Returns its sliders."""
        titles = [action.capitalize() for action in ACTIONS]
        self._handles.insert(mount_marker(tuner.name, tuner.template, tuner.mount, titles), self._on_handle)
        for action in ACTIONS:

            def serve(_request, action=action):
                return TriggerResponse(*self._do(tuner, action))

            rospy.Service("%s/%s" % (namespace, action), Trigger, serve)
        return Sliders(namespace, tuner, lambda numbers: self._change(tuner, numbers))

    @until_shutdown
    def _on_states(self, msg):
        stamp_s, now_s = msg.header.stamp.to_sec(), time.monotonic()
        if now_s >= self._frames_due_s:
            self._frames_due_s = now_s + 1.0 / self._params.rate_hz
            self._frames.send(msg)
        with self._lock:
            for name, (position_m, euler_rad) in states_from_msg(msg).items():
                tuner = self._by_name.get(name)
                if tuner is not None:
                    tuner.seen_s = now_s
                    tuner.window.see_pose(stamp_s, position_m, euler_rad)
        self._health.drawn("/cortex_raw")

    def _on_landmarks(self, msg):
        with self._lock:
            for tuner in self._tuners:
                tuner.window.see_landmarks({entry.name: (entry.x, entry.y, entry.z) for entry in msg.Obj})
        self._health.drawn("/states3")

    def _on_angles(self, msg):
        templates = self._template_of_region
        with self._lock:
            for entry in msg.Obj:
                tuner = self._by_name.get(entry.name)
                if tuner is not None:
                    seen = [bearing for bearing in bearings_from_msg(entry.landmarks) if bearing.visible]
                    bearings = {templates.get(b.name, b.name): (b.azimuth_rad, b.elevation_rad) for b in seen}
                    tuner.window.see_bearings(msg.header.stamp.to_sec(), bearings)
        self._health.drawn("/angles")

    def _on_handle(self, feedback):
        tuner = self._by_name[feedback.marker_name]
        if feedback.event_type == InteractiveMarkerFeedback.MENU_SELECT:
            self._do(tuner, ACTIONS[feedback.menu_entry_id - 1])
        elif feedback.event_type == InteractiveMarkerFeedback.POSE_UPDATE:
            self._change(tuner, numbers_from_pose(feedback.pose))

    def _change(self, tuner, numbers):
        try:
            with self._lock:
                tuner.change(numbers)
                self._show(tuner)
        except ValueError as error:
            rospy.logwarn("%s", error)

    def _do(self, tuner, action):
        """Run one of ACTIONS, after any that is running. Returns (whether it was done, a sentence)."""
        with tuner.acting:
            with self._lock:
                given = dict(zip(("solve", "check"), tuner.window.samples()))
                if action == "record":
                    done, answer = tuner.record()
            if action in given:  # without the lock, so that frames are sent meanwhile
                done, answer = getattr(tuner, action)(given[action], self._cameras[tuner.name])
            elif action != "record":
                done, answer = getattr(tuner, action)()
            with self._lock:
                self._show(tuner)
            tuner.answer, tuner.answered_s = answer, time.monotonic()
        (rospy.loginfo if done else rospy.logwarn)("%s", answer)
        return done, answer

    def _show(self, tuner):
        """Publish where the camera sits now; sliders follow soon."""
        self._frames.move_camera(tuner.template, tuner.mount)
        self._handles.setPose(tuner.name, pose_of(tuner.mount))
        self._handles.applyChanges()

    @until_shutdown
    def _on_follow(self):
        try:
            for sliders in self._sliders:
                sliders.follow()
        except (OSError, xmlrpc.client.Error) as error:
            rospy.logwarn_throttle(_COMPLAIN_S, "the sliders cannot follow, the master does not answer: %s" % error)

    @until_shutdown
    def _on_text(self):
        found = []
        for number, tuner in enumerate(self._tuners):
            with self._lock:
                windows, latest = tuner.window.samples(), tuner.window.latest(self._params.live_s)
            now_s = time.monotonic()
            lines = tuner.lines(latest, *windows, self._cameras[tuner.name], now_s - tuner.seen_s < _SEEN_S)
            if now_s - tuner.answered_s < _ANSWER_S:
                lines += textwrap.wrap(tuner.answer, _TEXT_COLUMNS)
            pen = Pen(3.0 / self._params.text_hz, header(frame_id=body_frame(tuner.template)))  # where it is now
            lines_below = 0.5 * len(lines) + _APART_LINES * number
            at_m = (0.0, 0.0, -_TEXT_ABOVE_M - _LINE * _TEXT_M * lines_below)  # body axes
            found.append(pen.text(tuner.name, 0, "\n".join(lines), at_m, _TEXT_M, _TEXT_RGBA))
        self._text.publish(found)
