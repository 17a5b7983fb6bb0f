"""The node `joy_node`: wires a joystick device to topics and diagnostics. joy.device_records decides."""

import os
import select
import time

import rospy
from sensor_msgs.msg import Joy, JoyFeedback, JoyFeedbackArray

from joy.device import Rumble, device_name, find_by_name, open_device
from joy.device_records import JoySettings, JoyState, PublishClock, RecordReader, Urgency
from risc_lab.ros.diagnostics import Growth, make_updater
from risc_lab.ros.params import load_params

RETRY_S = 1.0
STALL_S = 0.3  # a node that wakes up later than planned by more was suspended: buttons pressed meanwhile are old
READ_BYTES = 64 * 8


class JoyNode:
    """Waits in select() for records of the device; joy.device_records decides what they mean."""

    def __init__(self):
        (given,) = load_params(JoySettings, lenient=True)
        self._settings, notes = given.checked()
        for note in notes:
            rospy.logwarn("joy: %s", note)
        self._is_open = False
        self._counts = {"joystick event": 0, "publication": 0}
        self._growth = Growth()
        self._wake_read, self._wake_write = os.pipe()
        rospy.on_shutdown(self._wake)
        # The original has 1. Here 10: a press and its release that are read together must both arrive.
        self._pub = rospy.Publisher("joy", Joy, queue_size=10, tcp_nodelay=True)
        self._diagnostics = make_updater("none")
        self._diagnostics.add("Joystick Driver Status", self._diagnose)
        self._rumble = self._open_rumble(self._settings.dev_ff)
        rospy.Subscriber("joy/set_feedback", JoyFeedbackArray, self._on_feedback, queue_size=10, tcp_nodelay=True)

    def run(self):
        """Read the joystick until shutdown; retry a lost or missing one every second."""
        complained = False
        while not rospy.is_shutdown():
            path = self._choose_device()
            try:
                fd = open_device(path)
            except OSError as error:
                problem = "cannot open joystick %s (%s): plug it in, or set ~dev" % (path, error.strerror)
            else:
                problem, complained = "connection to joystick %s lost" % path, False
                name = device_name(fd) or "no name"
                rospy.loginfo("joy: opened joystick %s (%s), dead zone %g", path, name, self._settings.deadzone)
                self._is_open = True
                self._diagnostics.force_update()
                try:
                    self._read(fd, path)
                finally:
                    os.close(fd)
                    self._is_open = False
            if not complained and not rospy.is_shutdown():
                rospy.logerr("joy: %s; trying again every second", problem)
            complained = True
            self._diagnostics.force_update()
            select.select([self._wake_read], [], [], RETRY_S)

    def _choose_device(self):
        name, path = self._settings.dev_name, self._settings.dev
        if not name:
            return path
        found = find_by_name(name)
        if found is None:
            rospy.logwarn_once("joy: no joystick is named '%s': trying %s" % (name, path))
        return found or path

    def _read(self, fd, path):
        """Publish events of an open device; return when it is gone or at shutdown."""
        reader = RecordReader()
        state = JoyState(self._settings)
        clock = PublishClock(self._settings)
        while not rospy.is_shutdown():
            if clock.due(time.monotonic()):
                self._publish(state, clock, path)
            wait_s, begin_s = clock.wait_s(time.monotonic(), RETRY_S), time.monotonic()
            ready, _, _ = select.select([fd, self._wake_read], [], [], wait_s)
            stood_still = time.monotonic() - begin_s > wait_s + STALL_S
            if fd in ready:
                try:
                    data = os.read(fd, READ_BYTES)
                except BlockingIOError:
                    continue
                except OSError:  # unplugged
                    return
                if not data:  # the other end of a FIFO was closed
                    return
                for event in reader.feed(data):
                    self._counts["joystick event"] += 1
                    urgency = state.apply(event)
                    if urgency is Urgency.NEVER:
                        text = "joy: %s sends records of type %d, neither button nor axis: is ~dev a joystick?"
                        rospy.logwarn_throttle(10.0, text % (path, event.type))
                    if clock.event(urgency, time.monotonic()) and not stood_still:
                        self._publish(state, clock, path)
                if stood_still:  # publish only the current state
                    rospy.logwarn("joy: the node was suspended; what was pressed and released meanwhile is ignored")
                    self._publish(state, clock, path)
            self._diagnostics.update()

    def _publish(self, state, clock, path):
        message = Joy(axes=list(state.axes), buttons=list(state.buttons))
        message.header.stamp = rospy.Time.now()
        message.header.frame_id = path
        self._pub.publish(message)
        self._counts["publication"] += 1
        clock.published(time.monotonic())

    @staticmethod
    def _open_rumble(path):
        try:
            return Rumble(path)
        except OSError as error:
            rospy.logwarn("joy: no force feedback on %s (%s); set ~dev_ff if the joystick has it", path, error.strerror)
            return None

    def _on_feedback(self, message):
        intensities = {
            item.id: item.intensity
            for item in message.array
            if item.type == JoyFeedback.TYPE_RUMBLE and item.id in (0, 1) and 0.0 <= item.intensity <= 1.0
        }
        if self._rumble is None or not intensities:
            return
        try:
            self._rumble.set(intensities)
        except OSError as error:
            rospy.logwarn_throttle(10.0, "joy: force feedback failed: %s" % error.strerror)

    def _diagnose(self, status):
        settings = self._settings
        _, rates_hz = self._growth(self._counts)
        status.summary(*((0, "OK") if self._is_open else (2, "Joystick not open.")))
        for item in (
            ("topic", self._pub.resolved_name),
            ("device", settings.dev),
            ("device name", settings.dev_name),
            ("dead zone", settings.deadzone),
            ("autorepeat rate (Hz)", settings.autorepeat_rate),
            ("coalesce interval (s)", settings.coalesce_interval),
            *(("recent %s rate (Hz)" % what, rate_hz) for what, rate_hz in rates_hz.items()),
            ("subscribers", self._pub.get_num_connections()),
            ("default trig val", settings.default_trig_val),
            ("sticky buttons", settings.sticky_buttons),
        ):
            status.add(*item)
        return status

    def _wake(self):
        os.write(self._wake_write, b"x")
