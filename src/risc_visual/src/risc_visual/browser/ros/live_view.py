"""The browser view as a node: marker topics -> scene, the vehicles' own topics -> panel, buttons -> land services.

Without a viewer it subscribes to nothing and costs nothing. Wiring only; see marker_scene, live_status, page_server.
"""

import time
from dataclasses import dataclass
from functools import partial

import rospy
import tf2_ros
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

from risc_lab.phases import OperatorPhase, phase_words
from risc_lab.ros.diagnostics import make_updater
from risc_lab.ros.paced_subscriber import PacedSubscriber
from risc_lab.ros.params import fleet_vehicles, known_arena, load_params, vehicles
from risc_lab.ros.ticker import Ticker
from risc_lab.settings import Name, Port, Positive, Settings
from risc_lab.strangers import Guests, Strangers
from risc_maap_msgs.msg import (
    ControllerReport,
    EstimatorStatus,
    FaultKinds,
    Faults,
    OperatorState,
    Safety,
    TakeoffRefusals,
    TrajectoryPhases,
    VehicleStatus,
)
from risc_maap_msgs.srv import InjectFault
from risc_msgs.msg import Trajectories
from risc_visual.browser.fault_panel import FaultPanel
from risc_visual.browser.landing import ask_all
from risc_visual.browser.live_status import BrowserPanel, LiveStatus, Vehicle
from risc_visual.browser.marker_scene import FIXED_FRAME, MarkerScene
from risc_visual.browser.page_server import open_server
from risc_visual.drawing.scenery import load_scenery
from risc_visual.ros.conversions import verdict_from_msg

# Topics of the drawing nodes. A message of WHOLE replaces all before it, so those that come too fast are skipped; of
# the others every message counts.
WHOLE = ("Quad_Markers", "Quad_Labels", "Cortex_Markers", "Way_Markers", "Heading_Markers", "Way_Labels")
ARRAYS = ("net", "Grid", "Cameras", "Land_Markers", "Land_Labels", "angle_lines") + (
    "Quad_trajectory",
    "desired_trajectory",
    "Way_trail",
    "transform_tuner/text",
)
SINGLE = ("desired_trajectory_name", "Cov_Quad")  # without Ctrl_Status and Battery_Status: the panel shows the same
_PANEL_HZ = 2.0
_MOST_LOAD = 0.25  # of a core: a busy scene is drawn less often
_ANSWER_S = 3.0  # a vehicle node that has not answered by then is shown as silent
_FRAMES_S = 10.0  # of tf to remember: markers of a picture are older than the newest frames
_NO_NODE = "the vehicle node does not answer, use its joystick"
_OPERATOR = "virtual operator"  # no name of a vehicle has a space
_OPERATOR_LAND = "/operator/land"
_INJECT = "/virtual_lab/inject"
_QUEUE = 100  # messages of a burst, e.g. one a vehicle


@dataclass(frozen=True)
class LiveViewParams(Settings):
    """Settings of live_view, beside ~vehicles: those that have a place in the panel and a land button."""

    host: Name = "127.0.0.1"  # this computer only; 0.0.0.0 = also guests in the network
    port: Port = 8080  # of the page
    guests: tuple[str, ...] = ()  # addresses, or networks A.B.C.0/24, who may see the page, and land the vehicles
    rate_hz: Positive = 15.0  # of the picture, at most; without a viewer nothing is done
    arena_file: str = ""  # net, which sets the size of the floor; "" = that of /fleet


class LiveView:
    """Shows what is drawn for rviz on a web page."""

    def __init__(self):
        params = self._params = load_params(LiveViewParams, known=("vehicles",))[0]
        colours = {vehicle.template: index for index, vehicle in enumerate(fleet_vehicles() or vehicles())}
        self._vehicles = [Vehicle(v.namespace, v.template, colours[v.template]) for v in vehicles()]
        net = load_scenery(params.arena_file).net if params.arena_file else known_arena()
        self._tf = self._tf_listener = None
        self._status = LiveStatus(self._vehicles)
        self._subscribers = []
        self._turns = {"due_s": 0.0, "panel_due_s": 0.0, "changes": 0, "took_max_s": 0.0}
        self._not_shown = set()
        self._strangers = Strangers(lambda _level, text: rospy.logwarn("%s", text), "the page's port %d" % params.port)
        self._server = open_server(params.host, params.port, Guests(params.guests), self._strangers)
        self._scene = MarkerScene(self._server, net.half_x_m, net.half_y_m)
        names = [vehicle.namespace for vehicle in self._vehicles]
        self._panel = BrowserPanel(self._server, names, self.land_all, lambda name: self._land([name], {}))
        self._faults = FaultPanel(self._server, names, self._inject)
        self._updater = make_updater("none")
        self._updater.add("live view", self._diagnose)
        Ticker(1.0 / params.rate_hz, self._turn, "the browser view")
        rospy.on_shutdown(self._server.stop)  # hooks run in order: no turn begins after the Ticker's
        shown_host = "localhost" if params.host == "0.0.0.0" else params.host
        rospy.loginfo("the flight in a browser: http://%s:%d", shown_host, params.port)
        if params.host in ("127.0.0.1", "localhost"):
            rospy.loginfo("for this computer only; host:=0.0.0.0 guests:=[ADDRESS] opens it, and its land buttons")
        elif params.guests:
            rospy.logwarn("anyone who sees this page can land the vehicles: %s", ", ".join(params.guests))
        else:
            rospy.logwarn("no other computer can open the page: list those that may in ~guests")

    def land_all(self):
        """Land every vehicle, and tell the virtual operator, if there is one, not to start them again."""
        self._land([vehicle.namespace for vehicle in self._vehicles], {_OPERATOR: _call_operator})

    def _land(self, names, others):
        """Ask the nodes of these vehicles to land them, and others too; the panel shows what each answers."""
        rospy.logwarn("landing of %s requested from the browser", ", ".join(names))
        self._status.note_asked(names, _time_of_day())
        vehicles_first = {name: partial(_call, "/%s/land" % name, _NO_NODE) for name in names}
        ask_all({**vehicles_first, **others}, _ANSWER_S, self._on_answer)

    def _on_answer(self, name, done, text):
        if name == _OPERATOR and done and not text:
            return  # there is none
        self._status.note_answer(name, done, text)
        (rospy.loginfo if done else rospy.logerr)("%s: %s", name, text)

    def _inject(self, fault="", **fields):
        """Ask the virtual lab for a fault, or for the end of all."""
        what = "fault " + " ".join([fault, *map(str, fields.values())]) if fault else "the end of all faults"
        rospy.logwarn("requested from the browser: %s", what)
        call = partial(_call_lab, fault=fault, **fields)
        ask_all({"": call}, _ANSWER_S, lambda _name, *answer: self._faults.note_answer(*answer))

    def _turn(self):
        self._updater.update()
        looked_at = bool(self._server.get_clients())
        if looked_at != bool(self._subscribers):
            (self._begin if looked_at else self._rest)()
        start_s = time.monotonic()
        if not looked_at or start_s < self._turns["due_s"]:
            return
        if start_s >= self._turns["panel_due_s"]:  # before the scene, which may fail
            self._turns["panel_due_s"] = start_s + 1.0 / _PANEL_HZ
            self._panel.status.content = self._status.html(start_s, _time_of_day())
        try:
            self._turns["changes"] += self._scene.draw(start_s, self._lookup)
        finally:
            took_s = time.monotonic() - start_s
            self._turns["due_s"] = start_s + took_s / _MOST_LOAD
            self._turns["took_max_s"] = max(self._turns["took_max_s"], took_s)

    def _lookup(self, frame, stamp):
        """geometry_msgs/Transform from tf2, which is subscribed to only when a marker needs it; None if unknown."""
        if self._tf is None:
            self._tf = tf2_ros.Buffer(rospy.Duration(_FRAMES_S), debug=False)
            self._tf_listener = tf2_ros.TransformListener(self._tf)
        try:
            return self._tf.lookup_transform(FIXED_FRAME, frame, stamp).transform
        except tf2_ros.TransformException:
            return None

    def _begin(self):
        """Subscribe: a page was opened."""
        self._turns.update(due_s=0.0, panel_due_s=0.0)
        note = self._note

        def every(topic, kind, callback):
            self._subscribers.append(rospy.Subscriber(topic, kind, callback, queue_size=_QUEUE, tcp_nodelay=True))

        def newest(topic, kind, callback, rate_hz=_PANEL_HZ):
            self._subscribers.append(PacedSubscriber(topic, kind, callback, rate_hz))

        for topic in WHOLE:
            newest(topic, MarkerArray, partial(self._on_markers, topic), self._params.rate_hz)
        for topic, kind in [(topic, MarkerArray) for topic in ARRAYS] + [(topic, Marker) for topic in SINGLE]:
            every(topic, kind, partial(self._on_markers, topic))
        for name, _, _ in self._vehicles:
            newest("/%s/controller_status" % name, Bool, lambda msg, name=name: note("mode", name, msg.data))
            newest("/%s/vehicle_status" % name, VehicleStatus, partial(note, "vehicle", name))
            every("/%s/safety" % name, Safety, lambda msg, name=name: note("safety", name, verdict_from_msg(msg)))
            every("/%s/takeoff_refusals" % name, TakeoffRefusals, partial(note, "refusals", name))
        newest("/trajectory", Trajectories, partial(note, "references", ""))
        every("/trajectory_phase", TrajectoryPhases, self._on_phases)
        every("/operator/phase", OperatorState, lambda msg: note("operator", "", _operator_text(msg)))
        every("/controller_report", ControllerReport, self._on_controller)
        every("/estimator_status", EstimatorStatus, partial(note, "mocap", ""))
        every("/virtual_lab/fault_kinds", FaultKinds, lambda msg: self._faults.offer(msg.kinds))
        every("/virtual_lab/faults", Faults, lambda msg: self._faults.note(msg.faults))

    def _rest(self):
        """Unsubscribe: the last page was closed."""
        for subscriber in self._subscribers:
            subscriber.unregister()
        self._subscribers = []
        if self._tf_listener is not None:
            self._tf_listener.unregister()
        self._tf = self._tf_listener = None
        self._status.forget()
        self._faults.close()
        self._scene.clear()
        self._panel.status.content = ""  # the next viewer must not see old values

    def _on_markers(self, topic, message):
        self._not_shown |= self._scene.note(topic, getattr(message, "markers", [message]), time.monotonic())

    def _note(self, what, whose, value):
        self._status.note(what, whose, value, time.monotonic())

    def _on_phases(self, message):
        for template, phase in phase_words(message.vehicles).items():
            self._note("course", template, phase)

    def _on_controller(self, message):
        for vehicle in message.vehicles:
            self._note("error_m", vehicle.name, vehicle.position_error_m)

    def _diagnose(self, status):
        turns = self._turns
        status.summary(0, "%d watching" % len(self._server.get_clients()))
        status.add("strangers refused", str(self._strangers))
        status.add("changes since the last report", str(turns["changes"]))
        status.add("longest turn (ms)", "%.1f" % (1e3 * turns["took_max_s"]))
        status.add("types of markers that are not shown", ", ".join(map(str, sorted(self._not_shown))) or "none")
        turns["changes"], turns["took_max_s"] = 0, 0.0
        return status


def _operator_text(message):
    return ": ".join(filter(None, (OperatorPhase(message.phase).name.lower(), message.text)))


def _call(service, silent):
    """Call a land service. silent: what no answer means. Returns (done, text)."""
    try:
        answer = rospy.ServiceProxy(service, Trigger)()
    except rospy.ServiceException as error:
        return False, "%s (%s)" % (silent, error)
    return answer.success, answer.message


def _call_operator():
    """Tell the virtual operator to land all and to start none. Returns (done, text); text "": there is no operator."""
    if rospy.get_master().lookupService(_OPERATOR_LAND)[0] != 1:
        return True, ""
    return _call(_OPERATOR_LAND, "does not answer and may start vehicles again")


def _call_lab(**fields):
    """Call the virtual lab's service. fields: of InjectFault. Returns (done, text)."""
    try:
        answer = rospy.ServiceProxy(_INJECT, InjectFault)(**fields)
    except rospy.ServiceException as error:
        return False, "the virtual lab does not answer (%s)" % error
    return answer.success, answer.message


def _time_of_day():
    return time.strftime("%H:%M:%S")
