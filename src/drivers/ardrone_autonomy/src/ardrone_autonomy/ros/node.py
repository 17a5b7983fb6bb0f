"""The node `ardrone_driver`: wires vehicles (udp.UdpThread, link.DroneLink) to topics, services and tf.

Four kinds of threads: rospy's own, which only pass orders on; and for each vehicle the UDP thread, which pilots; one
that publishes; and one that receives and decodes pictures. A fault of one vehicle affects only its own three threads.
"""

import functools
import math
import secrets
import threading
import time
from collections import deque

import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist, Vector3Stamped
from nav_msgs.msg import Odometry as OdometryMsg
from sensor_msgs.msg import Imu
from std_msgs.msg import Empty, Header
from std_srvs.srv import Empty as EmptySrv
from std_srvs.srv import EmptyResponse
from tf2_msgs.msg import TFMessage

from ardrone_autonomy import msg, srv
from ardrone_autonomy.aircraft_configuration import VIDEO_CODEC_LIVE, VIDEO_CODEC_RECORD, WRITABLE_KEYS, setup_writes
from ardrone_autonomy.attitude import Odometry
from ardrone_autonomy.keeper import Keeper, take_over
from ardrone_autonomy.link import DroneLink, Phase
from ardrone_autonomy.piloting import HOVER, sticks_from_velocity
from ardrone_autonomy.protocol.at import FLIGHT_ANIMATIONS_MS
from ardrone_autonomy.protocol.navdata import ControlState, Navdata, NavdataError, State, Tag
from ardrone_autonomy.ros import conversions
from ardrone_autonomy.ros.params import parse_params
from ardrone_autonomy.ros.video import Video
from ardrone_autonomy.udp import UdpThread, resolve
from risc_lab.ros.diagnostics import Growth, make_updater
from risc_lab.ros.guard import subscribe
from risc_lab.ros.params import tf_frame
from risc_lab.ros.ticker import Ticker
from risc_lab.ros.until_shutdown import is_closing

QUEUE_SIZE = 200  # of the telemetry topics, as in the original
LOOPS_PER_CAMERA_FRAME = 5
RESTART_S = 1.0  # until a driver that failed beside others is restarted
REALTIME_BACKLOG = 20  # packets that may wait to be published with realtime_navdata
REPEAT_WARNING_S = 5.0
PUBLISH_PATIENCE_S = 5.0  # if no packet could be published for this long, the driver gives up and lands

CAMERA_FRAMES = ("_frontcam", "_bottomcam")  # by channel
# The services take channel and animation numbers modulo these.
CHANNELS = 2
LED_ANIMATIONS = (*range(11), 18, 19, 20)  # ids of AT*LED; the aircraft has more

_LOG = {"info": rospy.loginfo, "warn": rospy.logwarn, "error": rospy.logerr}


def make_drivers(arguments=()):
    """Make the ArdroneDrivers of the node: one in its namespace, or those of ~vehicles, {namespace: own parameters}.

    Parameters beside ~vehicles apply to all of them and override their own. Raises ValueError that names the fault.
    """
    tree = rospy.get_param("~", {})
    tree = tree if isinstance(tree, dict) else {}
    vehicles = tree.pop("vehicles", None)
    if vehicles is None:
        return [ArdroneDriver(tree, arguments=arguments)]
    if not isinstance(vehicles, dict) or not vehicles or not all(isinstance(v, dict) for v in vehicles.values()):
        raise ValueError(
            "parameter ~vehicles must be {namespace: {drone_ip: ADDRESS, ...}, ...}, found %r" % (vehicles,)
        )
    if len(vehicles) > 1 and (arguments or "drone_ip" in tree):
        raise ValueError(
            "-ip and ~drone_ip are for one vehicle: for several vehicles set drone_ip for each one in ~vehicles"
        )
    return [
        ArdroneDriver(dict(own, **tree), "/%s/" % namespace.strip("/"), len(vehicles) == 1, arguments)
        for namespace, own in vehicles.items()
    ]


def run(drivers):
    """Fly until ROS shuts down; then hover, land what flies, and close the sockets."""
    keeper = _make_keeper(drivers)
    for k, driver in enumerate(drivers):
        driver.start(keeper, k)
    try:
        rospy.spin()
    finally:
        for driver in drivers:
            driver.udp.begin_to_stop()  # hover, and land if flying; `stop` waits for it
        for driver in drivers:
            driver.stop()
        if keeper is not None:
            keeper.close()


def _make_keeper(drivers):
    """Start the Keeper of the drivers' vehicles; None if it is not wanted or does not start."""
    if not all(driver.wants_keeper for driver in drivers):
        return None
    try:
        return Keeper([driver.address for driver in drivers])
    except OSError as error:
        text = (
            "the keeper did not start: if this driver dies or hangs, vehicles fly on with their last tilt for a second"
        )
        rospy.logerr("%s (%s)", text, error)
        return None


class ArdroneDriver:
    """The driver of one vehicle; make it after rospy.init_node, then `start` it."""

    def __init__(self, tree, prefix="", is_alone=True, arguments=()):
        """tree: parameters.  prefix: of topics and services.  is_alone: its failure ends the node.

        arguments: command line, see parse_params. ValueError that says what is wrong and how to fix it.
        """
        # Launch files of the laboratory set this for the group of the camera's nodes, not for the driver
        url = tree.get("camera_info_url") or rospy.get_param(prefix + "ardrone/camera_info_url", "")
        self._configuration = configuration = parse_params(dict(tree, camera_info_url=url), arguments)
        self._params = params = configuration.params
        self._prefix, self._is_alone = prefix, is_alone
        for text in configuration.warnings:
            rospy.logwarn("%s%s", self._who, text)
        self.address = resolve(params.drone_ip)
        self.wants_keeper, self._keeper, self._place = params.keeper, None, 0
        self._period_s = 1.0 / params.looprate
        self._waiting = deque(maxlen=REALTIME_BACKLOG if params.realtime_navdata else 1)  # newest packets to publish
        self._arrived = threading.Event()
        self._replacing = threading.Lock()
        self._has_taken_over = False  # the vehicle was taken over from the keeper of a driver that died
        self.udp = self._make_udp()  # the current UdpThread: replaced after a failure
        self._channel = configuration.video_channel
        self._channel_set_in = 0  # number of the vehicle's configuration in which the channel was chosen
        self._video = Video(
            self.address,
            [tf_frame(params.drone_frame_id + suffix) for suffix in CAMERA_FRAMES],
            configuration.video_channel,
            (params.camera_info_url, params.bottom_camera_info_url),
            params.video_latency,
            params.realtime_video,
            self._report,
            prefix,
        )
        self._video_configured = 0  # number of the vehicle's configuration that the video was told of
        self._telemetry = None
        self._failing_since_s = None  # publishing has failed without a success since then
        # counters of /diagnostics: cmd_vel that is not finite; realtime_navdata faster than it can be published;
        # packets with a valid header but invalid content; failures to convert or publish
        self._counts = dict.fromkeys(("refused cmd_vel", "skipped packets", "bad packets", "packets not published"), 0)
        self._battery_pct = self._flight_state = self._link_quality = "unknown"
        self._growth = Growth()
        updater = make_updater("AR.Drone %s" % self.address)
        updater.add(self.label("vehicle"), self._diagnose)
        updater.add(self.label("video"), self._video.fill)
        Ticker(1.0, updater.force_update, "the diagnostics")
        self._subscribe()

    def label(self, what):
        """Name of a status on /diagnostics."""
        return what if self._is_alone else "%s %s" % (what, self._prefix.strip("/"))

    @property
    def _link(self):
        return self.udp.link

    @property
    def _who(self):
        return "" if self._is_alone else self._prefix.strip("/") + ": "

    def _make_udp(self):
        params, session_id = self._params, secrets.token_hex(4)
        return UdpThread(
            self.address,
            self._report,
            self._on_packet,
            self._on_failure,
            setup_writes=setup_writes(self._configuration.texts, session_id),
            session_id=session_id,
            settle_s=params.settle_time,
            command_timeout_s=params.cmd_timeout,
            land_timeout_s=params.cmd_land_timeout,
            lost_s=self._configuration.lost_s,
            note=self._note_state,
        )

    def start(self, keeper=None, place=0):
        """Start looking for the vehicle. keeper: Keeper.   place: index of the vehicle in the keeper's list."""
        self._keeper, self._place = keeper, place
        rospy.loginfo("%slooking for the vehicle at %s", self._who, self.address)
        threading.Thread(target=self._publish_loop, name="ardrone_publish", daemon=True).start()
        self.udp.start()
        self._video.stream.start()

    def stop(self):
        """Stop what `start` has started."""
        self.udp.stop()
        self._video.stream.stop()

    # --- orders: handed over, nothing else ------------------------------------------------------------------------
    def _subscribe(self):
        prefix = self._prefix
        for topic, order in (("takeoff", DroneLink.take_off), ("land", DroneLink.land), ("reset", DroneLink.reset)):
            give = functools.partial(self._on_order, order)
            subscribe(prefix + "ardrone/" + topic, Empty, give, queue_size=1)
        subscribe(prefix + "cmd_vel", Twist, self._on_cmd_vel, queue_size=1)
        for name, service_type, handler in (
            ("togglecam", EmptySrv, self._on_toggle_camera),
            ("setcamchannel", srv.CamSelect, self._on_camera_channel),
            ("setledanimation", srv.LedAnim, self._on_led_animation),
            ("setflightanimation", srv.FlightAnim, self._on_flight_animation),
            ("flattrim", EmptySrv, self._on_flat_trim),
            ("setrecord", srv.RecordEnable, self._on_record),
        ):
            answer = functools.partial(self._answer, name, service_type is EmptySrv, handler)
            rospy.Service(prefix + "ardrone/" + name, service_type, answer)

    def _answer(self, name, is_empty, handler, request):
        """Return the response of a service. handler: gives the order, or returns the reason why it refuses."""
        phase = self._link.phase
        why = handler(request) if phase is Phase.READY else "the vehicle is not ready (%s)" % phase.value
        if why:
            rospy.logwarn("%s refused: %s", name, why)
            if is_empty:  # the response has no field for the result
                raise rospy.ServiceException("%s refused: %s" % (name, why))
        return EmptyResponse() if is_empty else not why

    def _post(self, order, *arguments):
        """Hand an order (a method of DroneLink) to the current UDP thread."""
        udp = self.udp
        udp.post(order, udp.link, *arguments)

    def _on_order(self, order, _message):
        self._post(order)

    def _on_cmd_vel(self, twist):
        linear, angular = twist.linear, twist.angular
        try:
            sticks = sticks_from_velocity((linear.x, linear.y, linear.z), (angular.x, angular.y, angular.z))
        except ValueError as error:
            sticks = HOVER
            self._counts["refused cmd_vel"] += 1
            rospy.logerr_throttle(REPEAT_WARNING_S, "%s: refused, hovering until a valid command arrives" % error)
        self._post(DroneLink.steer, sticks)

    def _on_toggle_camera(self, _request):
        self._select_channel(self._current_channel() + 1)

    def _on_camera_channel(self, request):
        self._select_channel(request.channel)

    def _current_channel(self):
        is_chosen = self._channel_set_in == self._link.configurations
        return self._channel if is_chosen else self._configuration.video_channel

    def _select_channel(self, channel):
        self._channel = channel % CHANNELS
        self._channel_set_in = self._link.configurations
        self._video.tracker.order(self._channel, time.monotonic())
        self._write("video_channel", "%d" % self._channel)

    def _on_led_animation(self, request):
        if not math.isfinite(request.freq):
            return "the frequency %r is not a finite number" % request.freq
        animation = LED_ANIMATIONS[request.type % len(LED_ANIMATIONS)]
        self._post(DroneLink.blink, animation, abs(request.freq), request.duration)
        return ""

    def _on_flight_animation(self, request):
        animation = request.type % len(FLIGHT_ANIMATIONS_MS)
        self._write("flight_anim", "%d,%d" % (animation, request.duration or FLIGHT_ANIMATIONS_MS[animation]))

    def _on_flat_trim(self, _request):
        if self._link.state_bits & State.FLYING:
            return "the vehicle is flying"
        self._post(DroneLink.flat_trim)
        return ""

    def _on_record(self, request):
        self._write("video_codec", "%d" % (VIDEO_CODEC_RECORD if request.enable else VIDEO_CODEC_LIVE))
        stamp = time.strftime("%Y%m%d_%H%M%S", time.localtime(rospy.get_time()))
        self._write("userbox_cmd", "1," + stamp if request.enable else "0")

    def _write(self, name, text):
        self._post(DroneLink.write, WRITABLE_KEYS[name].key, text)

    # --- from the UDP thread ----------------------------------------------------------------------------------------
    def _report(self, level, text):
        _LOG[level]("%s", self._who + text)

    def _on_failure(self, error):
        if not self._ends_node(error):
            threading.Thread(target=self._begin_again, args=(self.udp,), name="ardrone_restart", daemon=True).start()

    def _ends_node(self, error):
        """Report a failure; return whether the node ends: with one vehicle yes, with several this driver restarts."""
        if self._is_alone:
            rospy.logfatal("the driver failed, the node ends: %r", error)
            rospy.signal_shutdown("the driver failed: %r" % error)
        else:
            rospy.logfatal("%sthe driver failed and is restarting: %r", self._who, error)
        return self._is_alone

    def _begin_again(self, failed):
        """Hover, land if flying, and replace `failed`, the UdpThread that was current when something failed."""
        failed.stop()
        time.sleep(RESTART_S)
        with self._replacing:  # the UDP thread and the publishing thread may have failed together
            if not rospy.is_shutdown() and self.udp is failed:
                self.udp = self._make_udp()
                self.udp.start()

    def _note_state(self, now_s, link):
        if link.connections == 1 and not self._has_taken_over:
            self._has_taken_over = True
            take_over(self.address)
        if self._keeper is not None:
            self._keeper.note(self._place, now_s, link.connections > 0, link.keeps_flying)

    def _on_packet(self, packet):
        if self._telemetry is None:
            return
        if self._params.realtime_navdata and len(self._waiting) == REALTIME_BACKLOG:
            self._counts["skipped packets"] += 1
        self._waiting.append(packet)
        self._arrived.set()

    # --- publishing -------------------------------------------------------------------------------------------------
    def _publish_loop(self):
        while not rospy.is_shutdown():
            try:
                while self._link.phase is not Phase.READY:
                    if rospy.is_shutdown():
                        return
                    time.sleep(LOOPS_PER_CAMERA_FRAME * self._period_s)
                self._telemetry = self._telemetry or _Telemetry(self._configuration, self._prefix)
                self._publish_until_shutdown()
            except Exception as error:  # noqa: PERF203  any failure: it must not fly on without telemetry
                # on shutdown rospy closes the topics before us
                if is_closing() or self._ends_node(error):
                    return
                self._failing_since_s = None
                self._begin_again(self.udp)

    def _publish_until_shutdown(self):
        loop_s = camera_s = time.monotonic()
        # pictures that are not published at once wait for this loop
        patience_s = self._period_s * (LOOPS_PER_CAMERA_FRAME if self._params.realtime_video else 1)
        while not rospy.is_shutdown():
            if self._arrived.wait(patience_s) and not self._params.realtime_navdata:
                time.sleep(max(0.0, loop_s - time.monotonic()))  # publish only the newest packet of a period
                loop_s = time.monotonic() + self._period_s
            self._arrived.clear()
            for _ in range(len(self._waiting)):  # packets that arrive meanwhile are for the next loop
                self._tolerate(self._publish, self._waiting.popleft())
            now_s = time.monotonic()
            if now_s >= camera_s:
                camera_s = max(camera_s + LOOPS_PER_CAMERA_FRAME * self._period_s, now_s)
                self._tolerate(self._telemetry.publish_camera_frames)
                self._tick_video()
            elif not self._params.realtime_video:
                self._tick_video()

    def _tick_video(self):
        is_ready = self._link.phase is Phase.READY
        if is_ready and self._video_configured != self._link.configurations:
            self._video_configured = self._link.configurations
            self._video.tracker.reset(self._current_channel())
        self._video.tick(is_ready)

    def _publish(self, packet):
        try:
            navdata = Navdata(packet.data)
            self._note(navdata)
            self._telemetry.publish(navdata, packet.received_s)
            self._failing_since_s = None
        except NavdataError as error:
            self._counts["bad packets"] += 1
            rospy.logwarn_throttle(REPEAT_WARNING_S, "packet dropped: %s" % error)

    def _tolerate(self, work, *arguments):
        """Call `work` and log its failure: one bad packet must not end a flight. Raise after PUBLISH_PATIENCE_S of
        failures only.
        """
        try:
            work(*arguments)
        except Exception as error:  # any failure
            now_s = time.monotonic()
            self._failing_since_s = self._failing_since_s or now_s
            if is_closing() or now_s - self._failing_since_s > PUBLISH_PATIENCE_S:
                raise
            self._counts["packets not published"] += 1
            rospy.logerr_throttle(REPEAT_WARNING_S, "telemetry could not be published: %r" % error)

    # --- diagnostics ------------------------------------------------------------------------------------------------
    def _note(self, packet):
        """Store the vehicle's status from a packet, for the diagnostics."""
        demo, wifi = packet.option(Tag.DEMO), packet.option(Tag.WIFI)
        if demo is not None:
            self._battery_pct = demo.vbat_flying_percentage
            state = demo.ctrl_state >> 16
            self._flight_state = ControlState(state).name.lower() if state < len(ControlState) else state
        if wifi is not None:
            self._link_quality = wifi.link_quality

    def _diagnose(self, status):
        udp, link, counts = self.udp, self._link, self._counts
        _, rates_hz = self._growth({"navdata": link.accepted})
        if not link.connected:
            status.summary(DiagnosticStatus.ERROR, "no vehicle at %s" % udp.address)
        elif link.emergency:
            status.summary(DiagnosticStatus.ERROR, "emergency: motors stopped")
        elif link.state_bits & State.BATTERY_LOW:
            status.summary(DiagnosticStatus.WARN, "battery low")
        elif link.phase is not Phase.READY:
            status.summary(DiagnosticStatus.WARN, link.phase.value)
        else:
            status.summary(DiagnosticStatus.OK, "connected")
        for item in (
            ("connected", link.connected),
            ("phase", link.phase.value),
            ("navdata rate [Hz]", "%.1f" % rates_hz["navdata"]),
            ("battery [%]", self._battery_pct),
            ("state", self._flight_state),
            ("state bits", "0x%08x" % link.state_bits),
            ("emergency", link.emergency),
            ("link quality", self._link_quality),
            ("reconnects", max(0, link.connections - 1)),
            ("late packets", link.stale),
            ("foreign or bad packets", udp.foreign + link.refused + counts["bad packets"]),
            ("foreign packets of", udp.strangers),
            ("skipped packets", counts["skipped packets"]),
            ("packets not published", counts["packets not published"]),
            ("send errors", udp.send_errors),
            ("unanswered configuration writes", link.unanswered_writes),
            ("refused cmd_vel", counts["refused cmd_vel"]),
            ("keeper", "runs" if self._keeper is not None and self._keeper.runs else "none"),
        ):
            status.add(*item)
        return status


class _Telemetry:
    """The topics and tf frames made from navdata. Messages without subscribers are not computed."""

    def __init__(self, configuration, prefix):
        def publisher(topic, message):
            return rospy.Publisher(prefix + "ardrone/" + topic, message, queue_size=QUEUE_SIZE)

        params = configuration.params
        self._covariances = configuration.covariances
        self._base_frame = base = tf_frame(params.drone_frame_id + "_link")
        self._odometry = Odometry()
        self._legacy = ()  # publishers of navdata, imu, mag
        if params.enable_legacy_navdata:
            types = (("navdata", msg.Navdata), ("imu", Imu), ("mag", Vector3Stamped))
            self._legacy = tuple(publisher(*item) for item in types)
        self._odometry_topic = publisher("odometry", OdometryMsg)
        self._tf = rospy.Publisher("/tf", TFMessage, queue_size=QUEUE_SIZE)
        converters = [conversions.OptionConverter(name) for name in configuration.options]
        self._selective = [(each, publisher("navdata_" + each.name, each.message_type)) for each in converters]
        frames = [tf_frame(params.drone_frame_id + suffix) for suffix in CAMERA_FRAMES]
        cameras = (conversions.FRONT_CAMERA, conversions.BOTTOM_CAMERA)
        self._camera_frames = TFMessage(
            [conversions.camera_transform(base, *camera) for camera in zip(frames, cameras)]
        )

    def publish(self, packet, received_s):
        """Publish one packet (protocol.navdata.Navdata). received_s: time of reception, monotonic clock."""
        stamp = rospy.Time.now() - rospy.Duration.from_sec(time.monotonic() - received_s)
        header = Header(stamp=stamp, frame_id=self._base_frame)
        self._publish_legacy(packet, header)
        self._publish_odometry(packet, stamp, received_s)
        for converter, publisher in self._selective:
            if publisher.get_num_connections():
                message = converter.convert(packet, header)
                if message is not None:
                    publisher.publish(message)

    def _publish_legacy(self, packet, header):
        listeners = [publisher.get_num_connections() for publisher in self._legacy]
        if not any(listeners):
            return
        navdata = conversions.navdata_message(packet, header)
        self._legacy[0].publish(navdata)
        if listeners[1]:
            self._legacy[1].publish(conversions.imu_message(packet, navdata, self._covariances))
        mag = conversions.mag_message(navdata) if listeners[2] else None
        if mag is not None:
            self._legacy[2].publish(mag)

    def _publish_odometry(self, packet, stamp, received_s):
        demo = packet.option(Tag.DEMO)
        if demo is None:
            return
        state = self._odometry.update(demo, received_s)
        if self._odometry_topic.get_num_connections():
            self._odometry_topic.publish(conversions.odometry_message(state, stamp, self._base_frame))
        if self._tf.get_num_connections():
            pose = state.position_m, state.quaternion_xyzw
            self._tf.publish(TFMessage([conversions.transform_message("odom", self._base_frame, *pose, stamp)]))

    def publish_camera_frames(self):
        """Publish the fixed transforms to both cameras, stamped now."""
        if self._tf.get_num_connections():
            for transform in self._camera_frames.transforms:
                transform.header.stamp = rospy.Time.now()
            self._tf.publish(self._camera_frames)
