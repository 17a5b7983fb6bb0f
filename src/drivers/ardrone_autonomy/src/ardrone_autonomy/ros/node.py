"""The node `ardrone_driver`: wires vehicles (udp.UdpThread, link.DroneLink) to topics, services and tf.

Four kinds of threads: rospy's own, which only hand orders over; and for each vehicle the UDP thread, which pilots; one
that publishes; and one that receives and decodes pictures. A vehicle's trouble stays in its own three.
"""

import functools
import math
import queue
import secrets
import threading
import time

import diagnostic_updater
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
from ardrone_autonomy.attitude import Odometry
from ardrone_autonomy.link import DroneLink, Phase
from ardrone_autonomy.piloting import HOVER, sticks_from_velocity
from ardrone_autonomy.protocol.at import FLIGHT_ANIMATIONS, LedAnimation
from ardrone_autonomy.protocol.navdata import Navdata, NavdataError, State, Tag
from ardrone_autonomy.ros import conversions
from ardrone_autonomy.ros.params import frame_name, parse_params
from ardrone_autonomy.ros.video import Video
from ardrone_autonomy.settings import VIDEO_CODEC_LIVE, VIDEO_CODEC_RECORD, WRITABLE_KEYS, setup_writes
from ardrone_autonomy.udp import UdpThread, resolve
from risc_lab.ros.ticker import Ticker

QUEUE_SIZE = 200  # of the telemetry topics, as in the original
LOOPS_PER_CAMERA_FRAME = 5
RESTART_S = 1.0  # until a driver that failed beside others begins again
REALTIME_BACKLOG = 20  # packets that may wait for the publishing thread with realtime_navdata
REPEAT_WARNING_S = 5.0
PUBLISH_PATIENCE_S = 5.0  # how long every packet may fail to be published before the driver gives up and lands

CAMERA_FRAMES = ("_frontcam", "_bottomcam")  # by channel
# The services count through these numbers.
CHANNELS = 2
LED_ANIMATIONS = (
    *list(LedAnimation)[:11],
    LedAnimation.LEFT_GREEN_RIGHT_RED,
    LedAnimation.LEFT_RED_RIGHT_GREEN,
    LedAnimation.BLINK_STANDARD,
)

STATE_NAMES = (
    "unknown",
    "init",
    "landed",
    "flying",
    "hovering",
    "test",
    "taking off",
    "flying to a fixed point",
    "landing",
    "looping",
)
_LOG = {"info": rospy.loginfo, "warn": rospy.logwarn, "error": rospy.logerr}


def make_drivers(arguments=()):
    """The ArdroneDrivers of the node: one in its namespace, or those of ~vehicles, {namespace: its own parameters}.

    Parameters beside ~vehicles are for all of them, and count first. Raises ValueError that names what is wrong.
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
        raise ValueError("-ip and ~drone_ip are for one vehicle: give each of several its drone_ip in ~vehicles")
    return [
        ArdroneDriver(dict(own, **tree), "/%s/" % namespace.strip("/"), len(vehicles) == 1, arguments)
        for namespace, own in vehicles.items()
    ]


def run(drivers):
    """Fly until ROS shuts down; then hover, land what flies, and close the sockets."""
    for driver in drivers:
        driver.start()
    try:
        rospy.spin()
    finally:
        for driver in drivers:
            driver.begin_to_stop()
        for driver in drivers:
            driver.stop()


class ArdroneDriver:
    """Everything of one vehicle; make it after rospy.init_node, then `start` it."""

    def __init__(self, tree, prefix="", is_alone=True, arguments=()):
        """tree: parameters.  prefix: of topics and services.  is_alone: its failure ends the node.

        arguments: command line, see parse_params. ValueError naming what is wrong and the cure.
        """
        # Launch files of the laboratory set it for the group of the camera's nodes, not for the driver
        url = tree.get("camera_info_url") or rospy.get_param(prefix + "ardrone/camera_info_url", "")
        self._params = params = parse_params(dict(tree, camera_info_url=url), arguments)
        self._prefix, self._is_alone = prefix, is_alone
        for text in params.warnings:
            rospy.logwarn("%s%s", self._who, text)
        self._address = resolve(params.address)
        self._period_s = 1.0 / params.looprate_hz
        self._realtime = queue.Queue(REALTIME_BACKLOG) if params.realtime_navdata else None
        self._arrived = threading.Event()  # a packet that was not published yet
        self._replacing = threading.Lock()
        self._udp = self._make_udp()
        self._channel = params.video_channel
        self._channel_set_in = 0  # which configuration of the vehicle the channel was chosen in
        self._video = Video(
            self._address,
            tuple(_frame(params, suffix) for suffix in CAMERA_FRAMES),
            params.video_channel,
            params.camera_info_urls,
            params.video_latency_s,
            params.realtime_video,
            self._report,
            prefix,
        )
        self._video_configured = 0  # the configuration of the vehicle that the video knows of
        self._telemetry = None
        self._failing_since_s = None  # publishing has failed without a success since then
        self._health = _Health(self, self._video)
        self._subscribe()

    @property
    def udp(self):
        """The UdpThread in service: another one after a failure."""
        return self._udp

    def label(self, what):
        """Name of a status on /diagnostics."""
        return what if self._is_alone else "%s %s" % (what, self._prefix.strip("/"))

    @property
    def _link(self):
        return self._udp.link

    @property
    def _who(self):
        return "" if self._is_alone else self._prefix.strip("/") + ": "

    def _make_udp(self):
        params, session_id = self._params, secrets.token_hex(4)
        return UdpThread(
            self._address,
            functools.partial(
                DroneLink,
                setup_writes=setup_writes(params.setting_texts, session_id),
                session_id=session_id,
                settle_s=params.settle_time_s,
                command_timeout_s=params.command_timeout_s,
                report=self._report,
            ),
            self._report,
            on_packet=self._on_packet,
            on_failure=self._on_failure,
        )

    def start(self):
        """Look for the vehicle."""
        rospy.loginfo("%slooking for the vehicle at %s", self._who, self._address)
        threading.Thread(target=self._publish_loop, name="ardrone_publish", daemon=True).start()
        self._udp.start()
        self._video.start()

    def begin_to_stop(self):
        """Hover, and land if flying; `stop` waits for it."""
        self._udp.begin_to_stop()

    def stop(self):
        """End what `start` has begun."""
        self._udp.stop()
        self._video.stop()

    # --- orders: handed over, nothing else ------------------------------------------------------------------------
    def _subscribe(self):
        prefix = self._prefix
        for topic, order in (("takeoff", DroneLink.take_off), ("land", DroneLink.land), ("reset", DroneLink.reset)):
            rospy.Subscriber(
                prefix + "ardrone/" + topic,
                Empty,
                lambda _message, order=order: self._post(order),
                queue_size=1,
                tcp_nodelay=True,
            )
        rospy.Subscriber(prefix + "cmd_vel", Twist, self._on_cmd_vel, queue_size=1, tcp_nodelay=True)
        for name, service_type, handler in (
            ("togglecam", EmptySrv, self._on_toggle_camera),
            ("setcamchannel", srv.CamSelect, self._on_camera_channel),
            ("setledanimation", srv.LedAnim, self._on_led_animation),
            ("setflightanimation", srv.FlightAnim, self._on_flight_animation),
            ("flattrim", EmptySrv, self._on_flat_trim),
            ("setrecord", srv.RecordEnable, self._on_record),
        ):
            rospy.Service(prefix + "ardrone/" + name, service_type, handler)

    def _post(self, order, *arguments):
        """Hand an order (a method of DroneLink) to the UDP thread in service."""
        udp = self._udp
        udp.post(order, udp.link, *arguments)

    def _on_cmd_vel(self, twist):
        linear, angular = twist.linear, twist.angular
        try:
            sticks = sticks_from_velocity((linear.x, linear.y, linear.z), (angular.x, angular.y, angular.z))
        except ValueError as error:
            sticks = HOVER
            self._health.refused_commands += 1
            rospy.logerr_throttle(REPEAT_WARNING_S, "%s: refused, hovering until a sound command comes" % error)
        self._post(DroneLink.steer, sticks)

    def _on_toggle_camera(self, _request):
        self._require_vehicle("togglecam")
        self._select_channel(self._current_channel() + 1)
        return EmptyResponse()

    def _on_camera_channel(self, request):
        if self._ready("setcamchannel"):
            self._select_channel(request.channel)
            return True
        return False

    def _current_channel(self):
        is_chosen = self._channel_set_in == self._link.configurations
        return self._channel if is_chosen else self._params.video_channel

    def _select_channel(self, channel):
        self._channel = channel % CHANNELS
        self._channel_set_in = self._link.configurations
        self._video.on_order(self._channel)
        self._write("video_channel", "%d" % self._channel)

    def _on_led_animation(self, request):
        if not self._ready("setledanimation"):
            return False
        if not math.isfinite(request.freq):
            rospy.logwarn("setledanimation refused: the frequency %r is not a finite number", request.freq)
            return False
        animation = LED_ANIMATIONS[request.type % len(LED_ANIMATIONS)]
        self._post(DroneLink.blink, int(animation), abs(request.freq), request.duration)
        return True

    def _on_flight_animation(self, request):
        if not self._ready("setflightanimation"):
            return False
        animation = request.type % len(FLIGHT_ANIMATIONS)
        duration_ms = request.duration or FLIGHT_ANIMATIONS[animation][1]
        self._write("flight_anim", "%d,%d" % (animation, duration_ms))
        return True

    def _on_flat_trim(self, _request):
        self._require_vehicle("flattrim")
        if self._link.state_bits & State.FLYING:
            raise rospy.ServiceException("flattrim refused: the vehicle flies")
        self._post(DroneLink.flat_trim)
        return EmptyResponse()

    def _on_record(self, request):
        if not self._ready("setrecord"):
            return False
        self._write("video_codec", "%d" % (VIDEO_CODEC_RECORD if request.enable else VIDEO_CODEC_LIVE))
        stamp = time.strftime("%Y%m%d_%H%M%S", time.localtime(rospy.get_time()))
        self._write("userbox_cmd", "1," + stamp if request.enable else "0")
        return True

    def _write(self, name, text):
        self._post(DroneLink.write, WRITABLE_KEYS[name].key, text)

    def _ready(self, service):
        if self._link.phase is Phase.READY:
            return True
        rospy.logwarn("%s refused: the vehicle is not ready (%s)", service, self._link.phase.value)
        return False

    def _require_vehicle(self, service):
        if not self._ready(service):  # the answer has no field that could say so
            raise rospy.ServiceException("%s refused: the vehicle is not ready" % service)

    # --- from the UDP thread ----------------------------------------------------------------------------------------
    def _report(self, level, text):
        _LOG[level]("%s", self._who + text)

    def _on_failure(self, error):
        if not self._ends_node(error):
            threading.Thread(target=self._begin_again, args=(self._udp,), name="ardrone_restart", daemon=True).start()

    def _ends_node(self, error):
        """Report a failure. Alone the node ends, and is started again; beside others only this vehicle's part is."""
        if self._is_alone:
            rospy.logfatal("the driver failed, the node ends: %r", error)
            rospy.signal_shutdown("the driver failed: %r" % error)
        else:
            rospy.logfatal("%sthe driver failed and begins again: %r", self._who, error)
        return self._is_alone

    def _begin_again(self, failed):
        """Hover, land if flying, and replace the UdpThread that was in service when something failed."""
        failed.stop()
        time.sleep(RESTART_S)
        with self._replacing:  # the UDP thread and the one that publishes may have failed together
            if not rospy.is_shutdown() and self._udp is failed:
                self._udp = self._make_udp()
                self._udp.start()

    def _on_packet(self, packet):
        if self._telemetry is None:
            return
        if self._realtime is not None:
            try:
                self._realtime.put_nowait(packet)
            except queue.Full:
                self._health.skipped_packets += 1
        self._arrived.set()

    # --- publishing -------------------------------------------------------------------------------------------------
    def _publish_loop(self):
        while not rospy.is_shutdown():
            try:
                self._wait_until_ready()
                self._telemetry = self._telemetry or _Telemetry(self._params, self._prefix)
                self._publish_until_shutdown()
            except Exception as error:  # noqa: PERF203  whatever it is: without telemetry nobody must fly on in silence
                # while ROS shuts down topics close under our feet
                if rospy.core.is_shutdown_requested() or self._ends_node(error):
                    return
                self._failing_since_s = None
                self._begin_again(self._udp)

    def _wait_until_ready(self):
        while not rospy.is_shutdown() and self._link.phase is not Phase.READY:
            time.sleep(LOOPS_PER_CAMERA_FRAME * self._period_s)

    def _publish_until_shutdown(self):
        last = None
        loop_s = camera_s = time.monotonic()
        # pictures that are not published at once wait for the loop
        patience_s = self._period_s * (LOOPS_PER_CAMERA_FRAME if self._params.realtime_video else 1)
        while not rospy.is_shutdown():
            if self._arrived.wait(patience_s) and self._realtime is None:
                time.sleep(max(0.0, loop_s - time.monotonic()))  # the newest packet of a loop
                loop_s = time.monotonic() + self._period_s
            self._arrived.clear()
            for packet in self._waiting_packets():
                if packet is last or packet is None:
                    continue
                last = packet
                self._tolerate(self._publish, packet)
            now_s = time.monotonic()
            if now_s >= camera_s:
                camera_s = max(camera_s + LOOPS_PER_CAMERA_FRAME * self._period_s, now_s)
                self._tolerate(self._telemetry.publish_camera_frames)
                self._tick_video()
            elif not self._params.realtime_video:
                self._tick_video()

    def _waiting_packets(self):
        if self._realtime is None:
            return [self._udp.newest]
        packets = []
        while not self._realtime.empty():
            packets.append(self._realtime.get_nowait())
        return packets

    def _tick_video(self):
        is_ready = self._link.phase is Phase.READY
        if is_ready and self._video_configured != self._link.configurations:
            self._video_configured = self._link.configurations
            self._video.on_configured(self._current_channel())
        self._video.tick(is_ready)

    def _publish(self, packet):
        try:
            navdata = Navdata(packet.data)
            self._health.on_packet(navdata)
            self._telemetry.publish(navdata, packet.received_s)
            self._failing_since_s = None
        except NavdataError as error:
            self._health.bad_packets += 1
            rospy.logwarn_throttle(REPEAT_WARNING_S, "packet dropped: %s" % error)

    def _tolerate(self, work, *arguments):
        """Do it; what one packet brings must not end a flight, unless nothing but failures has come for a while."""
        try:
            work(*arguments)
        except Exception as error:  # whatever it is
            if not self._tolerable(error):
                raise

    def _tolerable(self, error):
        """Count a failure to publish; False when nothing else has happened for PUBLISH_PATIENCE_S."""
        now_s = time.monotonic()
        if self._failing_since_s is None:
            self._failing_since_s = now_s
        if rospy.core.is_shutdown_requested() or now_s - self._failing_since_s > PUBLISH_PATIENCE_S:
            return False
        self._health.unpublished += 1
        rospy.logerr_throttle(REPEAT_WARNING_S, "telemetry could not be published: %r" % error)
        return True


def _frame(params, suffix):
    """tf name of one of the vehicle's frames."""
    tf_prefix_key = rospy.search_param("tf_prefix")
    return frame_name(rospy.get_param(tf_prefix_key) if tf_prefix_key else "", params.frame_prefix + suffix)


class _Telemetry:
    """The topics and tf frames that come from navdata. What nobody listens to is not computed."""

    def __init__(self, params, prefix):
        self._params = params
        base = _frame(params, "_link")
        self._base_frame = base
        self._odometry = Odometry()
        self._navdata = self._imu = self._mag = None
        if params.legacy_navdata:
            self._navdata = rospy.Publisher(prefix + "ardrone/navdata", msg.Navdata, queue_size=QUEUE_SIZE)
            self._imu = rospy.Publisher(prefix + "ardrone/imu", Imu, queue_size=QUEUE_SIZE)
            self._mag = rospy.Publisher(prefix + "ardrone/mag", Vector3Stamped, queue_size=QUEUE_SIZE)
        self._odometry_topic = rospy.Publisher(prefix + "ardrone/odometry", OdometryMsg, queue_size=QUEUE_SIZE)
        self._tf = rospy.Publisher("/tf", TFMessage, queue_size=QUEUE_SIZE)
        self._selective = []
        for name in params.options:
            converter = conversions.OptionConverter(name)
            self._selective.append(
                (
                    converter,
                    rospy.Publisher(prefix + "ardrone/navdata_" + name, converter.message_type, queue_size=QUEUE_SIZE),
                )
            )
        self._camera_frames = TFMessage(
            [
                conversions.camera_transform(base, _frame(params, suffix), camera)
                for suffix, camera in zip(CAMERA_FRAMES, (conversions.FRONT_CAMERA, conversions.BOTTOM_CAMERA))
            ]
        )

    def publish(self, packet, received_s):
        """One packet (protocol.navdata.Navdata), received at this time of the monotonic clock."""
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
        if self._navdata is None or not (
            self._navdata.get_num_connections() or self._imu.get_num_connections() or self._mag.get_num_connections()
        ):
            return
        navdata = conversions.navdata_message(packet, header)
        self._navdata.publish(navdata)
        if self._imu.get_num_connections():
            params = self._params
            self._imu.publish(
                conversions.imu_message(packet, navdata, (params.cov_imu_la, params.cov_imu_av, params.cov_imu_or))
            )
        if self._mag.get_num_connections():
            mag = conversions.mag_message(navdata)
            if mag is not None:
                self._mag.publish(mag)

    def _publish_odometry(self, packet, stamp, received_s):
        demo = packet.option(Tag.DEMO)
        if demo is None:
            return
        state = self._odometry.update(demo, received_s)
        if self._odometry_topic.get_num_connections():
            self._odometry_topic.publish(conversions.odometry_message(state, stamp, self._base_frame))
        if self._tf.get_num_connections():
            self._tf.publish(
                TFMessage(
                    [
                        conversions.transform_message(
                            "odom", self._base_frame, state.position_m, state.quaternion_xyzw, stamp
                        )
                    ]
                )
            )

    def publish_camera_frames(self):
        """The fixed transforms to both cameras, stamped now."""
        if self._tf.get_num_connections():
            for transform in self._camera_frames.transforms:
                transform.header.stamp = rospy.Time.now()
            self._tf.publish(self._camera_frames)


class _Health:
    """What /diagnostics says, once a second."""

    def __init__(self, driver, video):
        """driver: the ArdroneDriver."""
        self.refused_commands = 0  # cmd_vel that is not finite
        self.skipped_packets = 0  # realtime_navdata faster than it can be published
        self.bad_packets = 0  # header sound, content not
        self.unpublished = 0  # failures to convert or publish
        self._driver = driver
        self._battery_pct = None
        self._state = None
        self._link_quality = None
        self._accepted = 0
        self._counted_s = time.monotonic()
        self._updater = diagnostic_updater.Updater()
        self._updater.setHardwareID("AR.Drone %s" % driver.udp.address)
        self._updater.add(driver.label("vehicle"), self._fill)
        self._updater.add(driver.label("video"), video.fill)
        Ticker(1.0, self._updater.force_update, "the diagnostics")

    def on_packet(self, packet):
        """Remember what a packet says about the vehicle's health."""
        demo = packet.option(Tag.DEMO)
        if demo is not None:
            self._battery_pct = demo.vbat_flying_percentage
            self._state = demo.ctrl_state >> 16
        wifi = packet.option(Tag.WIFI)
        if wifi is not None:
            self._link_quality = wifi.link_quality

    def _fill(self, status):
        udp = self._driver.udp
        link = udp.link
        now_s = time.monotonic()
        accepted = link.accepted
        rate_hz = (accepted - self._accepted) / max(1e-3, now_s - self._counted_s)
        self._accepted, self._counted_s = accepted, now_s
        bits = link.state_bits
        if not link.connected:
            status.summary(DiagnosticStatus.ERROR, "no vehicle at %s" % udp.address)
        elif link.emergency:
            status.summary(DiagnosticStatus.ERROR, "emergency: motors stopped")
        elif bits & State.BATTERY_LOW:
            status.summary(DiagnosticStatus.WARN, "battery low")
        elif link.phase is not Phase.READY:
            status.summary(DiagnosticStatus.WARN, link.phase.value)
        else:
            status.summary(DiagnosticStatus.OK, "connected")
        state = self._state
        status.add("connected", link.connected)
        status.add("phase", link.phase.value)
        status.add("navdata rate [Hz]", "%.1f" % rate_hz)
        status.add("battery [%]", "unknown" if self._battery_pct is None else self._battery_pct)
        status.add(
            "state", "unknown" if state is None else STATE_NAMES[state] if state < len(STATE_NAMES) else "%d" % state
        )
        status.add("state bits", "0x%08x" % bits)
        status.add("emergency", link.emergency)
        status.add("link quality", "unknown" if self._link_quality is None else self._link_quality)
        status.add("reconnects", max(0, link.connections - 1))
        status.add("late packets", link.stale)
        status.add("foreign or bad packets", udp.foreign + link.refused + self.bad_packets)
        status.add("skipped packets", self.skipped_packets)
        status.add("packets not published", self.unpublished)
        status.add("send errors", udp.send_errors)
        status.add("unanswered configuration writes", link.unanswered_writes)
        status.add("refused cmd_vel", self.refused_commands)
        return status
