"""The node of driver.py and roscopter_node.py: wires a Link to topics, services and diagnostics.

Callbacks of ROS pass orders on; a service waits for the outcome of its order, in its own thread. The thread of the link
publishes.
"""

import threading
import time

import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import NavSatFix
from std_msgs.msg import Bool, Empty
from std_srvs.srv import Empty as EmptySrv
from std_srvs.srv import EmptyResponse

from risc_lab.ros import low_latency
from risc_lab.ros.diagnostics import Growth, add_all, age_text, summarise, ticking_updater
from risc_lab.ros.guard import subscribe
from risc_lab.ros.until_shutdown import is_closing
from roscopter import msg, orders, srv
from roscopter.link import Link
from roscopter.modes import mode_number
from roscopter.ros import conversions
from roscopter.ros.missions import mission_items

QUEUE_SIZE = 10  # of the telemetry topics
REPEAT_WARNING_S = 5.0
MARGIN_S = 2.0  # a service waits this much longer than the longest time of its order
_LOG = {
    "debug": rospy.logdebug,
    "info": rospy.loginfo,
    "warn": rospy.logwarn,
    "error": rospy.logerr,
    "fatal": rospy.logfatal,
}


def main(parse, argv):
    """Run a node until shutdown; return its exit code. parse: driver_options or node_options.  argv: command line."""
    options, ignored = parse(rospy.myargv(argv)[1:])
    low_latency.start("roscopter")
    if ignored:
        rospy.logwarn("ignored on the command line: %s", " ".join(ignored))
    bridge = Bridge(options)
    rospy.on_shutdown(bridge.link.stop)
    bridge.link.start()
    low_latency.spin()
    return 1 if bridge.has_failed else 0


class Bridge:
    """The node; make it after rospy.init_node, then start its `link`."""

    def __init__(self, options):
        self._options = options
        self._who = options.vehicle_name + ": " if options.vehicle_name else ""
        self.has_failed = False
        self._unpublished = 0  # messages
        self._navigation = None  # newest NAV_CONTROLLER_OUTPUT
        self._battery_pct = None
        self._growth = Growth()
        self.link = Link(options, self._report, self._publish, self._on_failure)
        self._topics = self._advertise()
        ticking_updater(options.device).add("autopilot", self._diagnose)
        self._subscribe()

    def _report(self, level, text):
        _LOG[level]("%s%s", self._who, text)

    # --- telemetry, in the thread of the link -------------------------------------------------------------------------
    def _advertise(self):
        """Return {type of MAVLink message: (publisher, function (message, stamp) that makes the ROS message)}."""

        def topic(name, kind, convert):
            return rospy.Publisher(name, kind, queue_size=QUEUE_SIZE, tcp_nodelay=True), convert

        def same(name, kind):
            return topic(name, kind, conversions.same_fields(kind))

        vehicle_type = self._options.type
        rc = topic("rc", msg.RC, conversions.rc)
        mission_item = topic("mission_item", msg.MissionItem, conversions.mission_item)
        return {
            "GPS_RAW_INT": topic("gps", NavSatFix, conversions.gps),
            "RC_CHANNELS": rc,
            "RC_CHANNELS_RAW": rc,
            "HEARTBEAT": topic("state", msg.State, lambda message, _: conversions.state(message, vehicle_type)),
            "VFR_HUD": same("vfr_hud", msg.VFR_HUD),
            "ATTITUDE": same("attitude", msg.Attitude),
            "RAW_IMU": topic("raw_imu", msg.Mavlink_RAW_IMU, conversions.raw_imu),
            "SYS_STATUS": topic("status", msg.Status, conversions.status),
            "GLOBAL_POSITION_INT": topic("filtered_pos", msg.FilteredPosition, conversions.filtered_position),
            "NAV_CONTROLLER_OUTPUT": topic("controller_output", msg.ControllerOutput, conversions.controller_output),
            "MISSION_CURRENT": topic(
                "current_mission",
                msg.CurrentMission,
                lambda message, stamp: conversions.current_mission(message, self._navigation, stamp),
            ),
            "MISSION_ITEM": mission_item,
            "MISSION_ITEM_INT": mission_item,
        }

    def _publish(self, message):
        kind = message.get_type()
        if kind == "NAV_CONTROLLER_OUTPUT":
            self._navigation = message
        elif kind == "SYS_STATUS":
            self._battery_pct = message.battery_remaining
        publisher, convert = self._topics.get(kind, (None, None))
        if publisher is None or not publisher.get_num_connections():
            return
        try:
            publisher.publish(convert(message, rospy.Time.now()))
        except Exception as error:  # of any kind: no message may end the link
            if is_closing():
                return  # on shutdown rospy closes the topics before us
            self._unpublished += 1
            rospy.logerr_throttle(REPEAT_WARNING_S, "a %s could not be published: %r" % (kind, error))

    def _on_failure(self, error):
        self.has_failed = True
        rospy.logfatal("%sthe link failed, the node ends: %r", self._who, error)
        rospy.signal_shutdown("the link failed: %r" % error)

    # --- orders: handed over ------------------------------------------------------------------------------------------
    def _subscribe(self):
        link, autopilot = self.link, self.link.autopilot
        for name, service_type, handler in (
            ("command", srv.APMCommand, self._on_command),
            ("waypoint", srv.SendWaypoint, lambda request: self._on_waypoints([request.waypoint])),
            ("waypoint_list", srv.SendWaypointList, lambda request: self._on_waypoints(request.waypoints)),
            ("arm", EmptySrv, lambda _request: self._answer_empty(srv.APMCommandRequest.CMD_ARM)),
            ("disarm", EmptySrv, lambda _request: self._answer_empty(srv.APMCommandRequest.CMD_DISARM)),
        ):
            rospy.Service(name, service_type, handler)
        subscribe(
            "send_rc",
            msg.RC,
            lambda message: link.post(autopilot.override, message.channel, time.monotonic()),
            queue_size=1,
        )
        if self._options.enable_watchdog:
            subscribe("watchdog", Bool, lambda message: link.post(autopilot.feed_watchdog, message.data), queue_size=1)
        subscribe("emergency_stop", Empty, lambda _: link.post(autopilot.emergency_stop), queue_size=1)

    def _on_command(self, request):
        return self._command(request.command).is_done

    def _answer_empty(self, number):
        outcome = self._command(number)
        if not outcome.is_done:  # the response has no field for it
            raise rospy.ServiceException(outcome.why)
        return EmptyResponse()

    def _command(self, number):
        """Carry out a command of APMCommand; return its Outcome."""
        if number == srv.APMCommandRequest.RETURN_RC_CONTROL:
            self.link.post(self.link.autopilot.release)
            return orders.Outcome(True)
        try:
            order = self._order(number)
        except ValueError as error:
            self._report("error", "command %d refused: %s" % (number, error))
            return orders.Outcome(False, str(error))
        return self._wait(order.longest_s, self.link.autopilot.begin, order)

    def _order(self, number):
        """Return the Order for a command number. Raises ValueError."""
        options, command = self._options, srv.APMCommandRequest
        mode_s, arm_s, launch_s = (
            milliseconds / 1000.0
            for milliseconds in (options.mode_timeout, options.arm_timeout, options.launch_timeout)
        )

        def set_mode(name):
            return orders.SetMode(name, mode_number(options.type, name), mode_s)

        if number in _MODE_OF:
            return set_mode(_MODE_OF[number])
        if number in (command.CMD_ARM, command.CMD_DISARM):
            return orders.Arm(number == command.CMD_ARM, arm_s)
        if number == command.CMD_LAND:
            return orders.land(mode_s)
        if number == command.CMD_LAUNCH:
            altitude_m = options.launch_altitude / 1000.0
            steps = [set_mode("GUIDED"), orders.Arm(True, arm_s), orders.take_off(altitude_m, launch_s)]
            return orders.Sequence("launch", steps)
        raise ValueError("it is not a constant of roscopter/APMCommand")

    def _on_waypoints(self, waypoints):
        try:
            if not self._options.enable_waypoint_control:
                raise ValueError("--enable-waypoint-control false is among the driver's options")
            items = mission_items(waypoints, self._options)
        except ValueError as error:
            self._report("error", "mission refused: %s" % error)
            return False
        longest_s = orders.longest_mission_s(len(items), self._options.waypoint_timeout / 1000.0)
        return self._wait(longest_s, self.link.autopilot.send_mission, items).is_done

    def _wait(self, longest_s, order, *arguments):
        """Post an order, and wait for its Outcome."""
        ended, outcomes = threading.Event(), []

        def on_end(outcome):
            outcomes.append(outcome)
            ended.set()

        self.link.post(order, *arguments, on_end)
        deadline_s = time.monotonic() + longest_s + MARGIN_S
        while not ended.wait(0.2):
            if rospy.is_shutdown() or time.monotonic() > deadline_s:
                return orders.Outcome(False, "the driver has not carried it out")
        return outcomes[0]

    # --- diagnostics --------------------------------------------------------------------------------------------------
    def _diagnose(self, status):
        link, autopilot, counts = self.link, self.link.autopilot, self.link.autopilot.counts
        grown, rates_hz = self._growth({**counts, **link.counts, "skipped bytes": autopilot.reader.skipped_bytes})
        missing = autopilot.missing_streams()
        summarise(
            status,
            (not autopilot.is_open, DiagnosticStatus.ERROR, "cannot open %s" % self._options.device),
            (autopilot.target is None, DiagnosticStatus.ERROR, "no autopilot heard yet"),
            (not autopilot.is_connected, DiagnosticStatus.ERROR, "the autopilot is silent"),
            (
                bool(missing),
                DiagnosticStatus.WARN,
                "telemetry that is missing, or slower than asked: %s" % ", ".join(missing),
            ),
            (grown["skipped bytes"] > 0, DiagnosticStatus.WARN, "damaged bytes on the link"),
            (True, DiagnosticStatus.OK, "connected"),
        )
        add_all(
            status,
            {
                "device": self._options.device,
                "system": autopilot.target[0] if autopilot.target else "none yet",
                "MAVLink version": autopilot.version,
                "armed": autopilot.is_armed,
                "mode": autopilot.mode,
                "battery [%]": "unknown" if self._battery_pct is None else self._battery_pct,
                "age of the heartbeat [s]": age_text(autopilot.heartbeat_s),
                "messages [Hz]": "%.1f" % rates_hz["messages"],
                "received [byte/s]": "%.0f" % rates_hz["received bytes"],
                "channels overridden": autopilot.is_overriding,
                "skipped bytes": autopilot.reader.skipped_bytes,
                **counts,
                "packets not sent": link.counts["not sent"],
                "times opened": link.counts["times opened"],
                "strangers refused": link.strangers,
                "messages not published": self._unpublished,
            },
        )
        return status


_MODE_OF = {
    srv.APMCommandRequest.CMD_SET_MANUAL: "MANUAL",
    srv.APMCommandRequest.CMD_SET_HOLD: "HOLD",
    srv.APMCommandRequest.CMD_SET_STABILIZE: "STABILIZE",
    srv.APMCommandRequest.CMD_SET_ALT_HOLD: "ALT_HOLD",
    srv.APMCommandRequest.CMD_SET_AUTO: "AUTO",
    srv.APMCommandRequest.CMD_SET_LOITER: "LOITER",
    srv.APMCommandRequest.CMD_SET_LAND: "LAND",
}
