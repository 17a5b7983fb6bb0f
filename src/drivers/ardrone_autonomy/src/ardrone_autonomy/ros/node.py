"""The node `ardrone_driver`: wires one vehicle (udp.UdpThread, link.DroneLink) to topics, services and tf.

Four kinds of threads: rospy's own, which only hand orders over; the UDP thread, which pilots; one that publishes; and
one that receives and decodes pictures.
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

QUEUE_SIZE = 200  # of the telemetry topics, as in the original
LOOPS_PER_CAMERA_FRAME = 5
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


class ArdroneDriver(object):
    """Everything of the node; make it after rospy.init_node, then `run`."""

    def __init__(self, arguments=()):
        """arguments: command line, see parse_params. ValueError naming what is wrong and the cure."""
        tree = rospy.get_param("~", {})
        tree = tree if isinstance(tree, dict) else {}
        # Launch files of the laboratory set it for the group of the camera's nodes, not for the driver
        tree["camera_info_url"] = tree.get("camera_info_url") or rospy.get_param("ardrone/camera_info_url", "")
        self._params = params = parse_params(tree, arguments)
        for text in params.warnings:
            rospy.logwarn(text)
        self._address = resolve(params.address)
        session_id = secrets.token_hex(4)
        self._period_s = 1.0 / params.looprate_hz
        self._realtime = queue.Queue(REALTIME_BACKLOG) if params.realtime_navdata else None
        self._udp = UdpThread(
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
            on_packet=None if self._realtime is None else self._on_packet,
            on_failure=self._on_failure,
        )
        self._link = self._udp.link
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
        )
        self._video_configured = 0  # the configuration of the vehicle that the video knows of
        self._telemetry = None
        self._failing_since_s = None  # publishing has failed without a success since then
        self._health = _Health(self._udp, self._video)
        self._subscribe()

    def run(self):
        """Fly until ROS shuts down; then hover, land if flying, and close the sockets."""
        rospy.loginfo("looking for the vehicle at %s", self._address)
        threading.Thread(target=self._publish_loop, name="ardrone_publish", daemon=True).start()
        self._udp.start()
        self._video.start()
        try:
            rospy.spin()
        finally:
            self._udp.stop()
            self._video.stop()

    # --- orders: handed over, nothing else ------------------------------------------------------------------------
    def _subscribe(self):
        post, link = self._udp.post, self._link
        for topic, order in (("takeoff", link.take_off), ("land", link.land), ("reset", link.reset)):
            rospy.Subscriber(
                "ardrone/" + topic, Empty, functools.partial(_post_empty, post, order), queue_size=1, tcp_nodelay=True
            )
        rospy.Subscriber("cmd_vel", Twist, self._on_cmd_vel, queue_size=1, tcp_nodelay=True)
        for name, service_type, handler in (
            ("togglecam", EmptySrv, self._on_toggle_camera),
            ("setcamchannel", srv.CamSelect, self._on_camera_channel),
            ("setledanimation", srv.LedAnim, self._on_led_animation),
            ("setflightanimation", srv.FlightAnim, self._on_flight_animation),
            ("flattrim", EmptySrv, self._on_flat_trim),
            ("setrecord", srv.RecordEnable, self._on_record),
        ):
            rospy.Service("ardrone/" + name, service_type, handler)

    def _on_cmd_vel(self, twist):
        linear, angular = twist.linear, twist.angular
        try:
            sticks = sticks_from_velocity((linear.x, linear.y, linear.z), (angular.x, angular.y, angular.z))
        except ValueError as error:
            sticks = HOVER
            self._health.refused_commands += 1
            rospy.logerr_throttle(REPEAT_WARNING_S, "%s: refused, hovering until a sound command comes" % error)
        self._udp.post(self._link.steer, sticks)

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
        self._udp.post(self._link.blink, int(animation), abs(request.freq), request.duration)
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
        self._udp.post(self._link.flat_trim)
        return EmptyResponse()

    def _on_record(self, request):
        if not self._ready("setrecord"):
            return False
        self._write("video_codec", "%d" % (VIDEO_CODEC_RECORD if request.enable else VIDEO_CODEC_LIVE))
        stamp = time.strftime("%Y%m%d_%H%M%S", time.localtime(rospy.get_time()))
        self._write("userbox_cmd", "1," + stamp if request.enable else "0")
        return True

    def _write(self, name, text):
        self._udp.post(self._link.write, WRITABLE_KEYS[name].key, text)

    def _ready(self, service):
        if self._link.phase is Phase.READY:
            return True
        rospy.logwarn("%s refused: the vehicle is not ready (%s)", service, self._link.phase.value)
        return False

    def _require_vehicle(self, service):
        if not self._ready(service):  # the answer has no field that could say so
            raise rospy.ServiceException("%s refused: the vehicle is not ready" % service)

    # --- from the UDP thread ----------------------------------------------------------------------------------------
    @staticmethod
    def _report(level, text):
        _LOG[level](text)

    @staticmethod
    def _on_failure(error):
        rospy.logfatal("the driver failed, the node ends: %r", error)
        rospy.signal_shutdown("the driver failed: %r" % error)

    def _on_packet(self, packet):
        if self._telemetry is None:
            return
        try:
            self._realtime.put_nowait(packet)
        except queue.Full:
            self._health.skipped_packets += 1

    # --- publishing -------------------------------------------------------------------------------------------------
    def _publish_loop(self):
        try:
            self._wait_until_ready()
            self._telemetry = _Telemetry(self._params)
            self._publish_until_shutdown()
        except Exception as error:  # whatever it is: a driver without telemetry must not go on in silence
            if not rospy.core.is_shutdown_requested():  # then topics close under our feet
                self._on_failure(error)

    def _wait_until_ready(self):
        while not rospy.is_shutdown() and self._link.phase is not Phase.READY:
            time.sleep(self._period_s)

    def _publish_until_shutdown(self):
        last = None
        loop_s = camera_s = time.monotonic()
        while not rospy.is_shutdown():
            if self._realtime is None:
                loop_s = max(loop_s + self._period_s, time.monotonic())
                time.sleep(max(0.0, loop_s - time.monotonic()))
                packet = self._udp.newest
            else:
                packet = self._next_packet()
            try:
                if packet is not None and packet is not last:
                    last = packet
                    self._publish(packet)
                now_s = time.monotonic()
                if now_s >= camera_s:
                    camera_s = max(camera_s + LOOPS_PER_CAMERA_FRAME * self._period_s, now_s)
                    self._telemetry.publish_camera_frames()
            except Exception as error:  # whatever it is: the values of one packet must not end a flight
                if not self._tolerable(error):
                    raise
            self._tick_video()

    def _tick_video(self):
        is_ready = self._link.phase is Phase.READY
        if is_ready and self._video_configured != self._link.configurations:
            self._video_configured = self._link.configurations
            self._video.on_configured(self._current_channel())
        self._video.tick(is_ready)

    def _next_packet(self):
        try:
            return self._realtime.get(timeout=self._period_s)
        except queue.Empty:
            return None

    def _publish(self, packet):
        try:
            navdata = Navdata(packet.data)
            self._health.on_packet(navdata)
            self._telemetry.publish(navdata, packet.received_s)
            self._failing_since_s = None
        except NavdataError as error:
            self._health.bad_packets += 1
            rospy.logwarn_throttle(REPEAT_WARNING_S, "packet dropped: %s" % error)

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


def _post_empty(post, order, _message):
    post(order)


def _frame(params, suffix):
    """tf name of one of the vehicle's frames."""
    tf_prefix_key = rospy.search_param("tf_prefix")
    return frame_name(rospy.get_param(tf_prefix_key) if tf_prefix_key else "", params.frame_prefix + suffix)


class _Telemetry(object):
    """The topics and tf frames that come from navdata. What nobody listens to is not computed."""

    def __init__(self, params):
        self._params = params
        base = _frame(params, "_link")
        self._base_frame = base
        self._odometry = Odometry()
        self._navdata = self._imu = self._mag = None
        if params.legacy_navdata:
            self._navdata = rospy.Publisher("ardrone/navdata", msg.Navdata, queue_size=QUEUE_SIZE)
            self._imu = rospy.Publisher("ardrone/imu", Imu, queue_size=QUEUE_SIZE)
            self._mag = rospy.Publisher("ardrone/mag", Vector3Stamped, queue_size=QUEUE_SIZE)
        self._odometry_topic = rospy.Publisher("ardrone/odometry", OdometryMsg, queue_size=QUEUE_SIZE)
        self._tf = rospy.Publisher("/tf", TFMessage, queue_size=QUEUE_SIZE)
        self._selective = []
        for name in params.options:
            converter = conversions.OptionConverter(name)
            self._selective.append(
                (converter, rospy.Publisher("ardrone/navdata_" + name, converter.message_type, queue_size=QUEUE_SIZE))
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


class _Health(object):
    """What /diagnostics says, once a second."""

    def __init__(self, udp, video):
        self.refused_commands = 0  # cmd_vel that is not finite
        self.skipped_packets = 0  # realtime_navdata faster than it can be published
        self.bad_packets = 0  # header sound, content not
        self.unpublished = 0  # failures to convert or publish
        self._udp = udp
        self._battery_pct = None
        self._state = None
        self._link_quality = None
        self._accepted = 0
        self._counted_s = time.monotonic()
        self._updater = diagnostic_updater.Updater()
        self._updater.setHardwareID("AR.Drone %s" % udp.address)
        self._updater.add("vehicle", self._fill)
        self._updater.add("video", video.fill)
        self._timer = rospy.Timer(rospy.Duration(1.0), lambda _event: self._updater.force_update(), reset=True)
        rospy.on_shutdown(self._timer.shutdown)

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
        link = self._udp.link
        now_s = time.monotonic()
        accepted = link.accepted
        rate_hz = (accepted - self._accepted) / max(1e-3, now_s - self._counted_s)
        self._accepted, self._counted_s = accepted, now_s
        bits = link.state_bits
        if not link.connected:
            status.summary(DiagnosticStatus.ERROR, "no vehicle at %s" % self._udp.address)
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
        status.add("foreign or bad packets", self._udp.foreign + link.refused + self.bad_packets)
        status.add("skipped packets", self.skipped_packets)
        status.add("packets not published", self.unpublished)
        status.add("send errors", self._udp.send_errors)
        status.add("unanswered configuration writes", link.unanswered_writes)
        status.add("refused cmd_vel", self.refused_commands)
        return status
