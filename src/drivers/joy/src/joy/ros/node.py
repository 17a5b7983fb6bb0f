"""The node `joy_node`: wires a joystick device to topics and diagnostics. What is decided is decided in joy.events."""

import os
import select
import time

import diagnostic_updater
import rospy
from sensor_msgs.msg import Joy, JoyFeedback, JoyFeedbackArray

from joy.device import Rumble, device_name, find_by_name, open_device
from joy.events import JoySettings, JoyState, PublishClock, RecordReader

RETRY_S = 1.0
READ_BYTES = 64 * 8


def bool_param(name):
    """A truth value; launch files of old set the texts "true" and "False" too. Raises ValueError."""
    value = rospy.get_param(name, False)
    if isinstance(value, str) and value.strip().lower() in ("true", "false", "1", "0"):
        return value.strip().lower() in ("true", "1")
    if not isinstance(value, (bool, int)):
        raise ValueError("joy: parameter %s must be true or false, found %r" % (name, value))
    return bool(value)


def number_param(name, default):
    """A number. Raises ValueError."""
    value = rospy.get_param(name, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError("joy: parameter %s must be a number, found %r" % (name, value))
    return float(value)


class JoyNode:
    """Waits in select() for records of the device; everything that is decided is decided in joy.events."""

    def __init__(self):
        self._settings, notes = JoySettings(
            deadzone=number_param("~deadzone", 0.05),
            autorepeat_rate=number_param("~autorepeat_rate", 0.0),
            coalesce_interval=number_param("~coalesce_interval", 0.001),
            default_trig_val=bool_param("~default_trig_val"),
            sticky_buttons=bool_param("~sticky_buttons"),
        ).checked()
        for note in notes:
            rospy.logwarn("joy: %s", note)
        self._path = str(rospy.get_param("~dev", "/dev/input/js0"))
        self._name = str(rospy.get_param("~dev_name", ""))
        self._is_open = False
        self._counts = {"event": 0, "publication": 0}
        self._reported = {"event": 0, "publication": 0}
        self._reported_s = time.monotonic()
        self._wake_read, self._wake_write = os.pipe()
        rospy.on_shutdown(self._wake)
        # Not 1, as the original has it: a press and its release that are read together must both arrive.
        self._pub = rospy.Publisher("joy", Joy, queue_size=10, tcp_nodelay=True)
        self._diagnostics = diagnostic_updater.Updater()
        self._diagnostics.setHardwareID("none")
        self._diagnostics.add("Joystick Driver Status", self._diagnose)
        self._rumble = self._open_rumble(str(rospy.get_param("~dev_ff", "/dev/input/event0")))
        rospy.Subscriber("joy/set_feedback", JoyFeedbackArray, self._on_feedback, queue_size=10, tcp_nodelay=True)

    def run(self):
        """Read the joystick until shutdown; a lost or missing one is tried again every second."""
        complained = False
        while not rospy.is_shutdown():
            path = self._choose_device()
            try:
                fd = open_device(path)
            except OSError as error:
                if not complained:
                    rospy.logerr(
                        "joy: cannot open joystick %s (%s): plug it in, or set ~dev; trying again every second",
                        path,
                        error.strerror,
                    )
                    complained = True
                self._diagnostics.update()
                select.select([self._wake_read], [], [], RETRY_S)
                continue
            rospy.loginfo(
                "joy: opened joystick %s (%s), dead zone %g",
                path,
                device_name(fd) or "no name",
                self._settings.deadzone,
            )
            self._is_open = True
            self._diagnostics.force_update()
            try:
                self._read(fd, path)
            finally:
                os.close(fd)
                self._is_open = False
            if rospy.is_shutdown():
                break
            rospy.logerr("joy: connection to joystick %s lost; trying again every second", path)
            self._diagnostics.force_update()
            complained = True
            select.select([self._wake_read], [], [], RETRY_S)

    def _choose_device(self):
        if not self._name:
            return self._path
        found = find_by_name(self._name)
        if found is None:
            rospy.logwarn_once("joy: no joystick is called '%s': trying %s" % (self._name, self._path))
        return found or self._path

    def _read(self, fd, path):
        """Publish what comes from an open device; returns when it is gone or at shutdown."""
        reader = RecordReader()
        state = JoyState(self._settings)
        clock = PublishClock(self._settings)
        while not rospy.is_shutdown():
            if clock.due(time.monotonic()):
                self._publish(state, clock, path)
            wait_s = clock.wait_s(time.monotonic(), RETRY_S)
            ready, _, _ = select.select([fd, self._wake_read], [], [], wait_s)
            if fd in ready:
                try:
                    data = os.read(fd, READ_BYTES)
                except BlockingIOError:
                    continue
                except OSError:  # unplugged
                    return
                if not data:  # the other end of a FIFO has gone
                    return
                for event in reader.feed(data):
                    self._counts["event"] += 1
                    if not event.is_button and not event.is_axis:
                        rospy.logwarn_throttle(
                            10.0,
                            "joy: %s sends records of type %d, which is no button and no "
                            "axis: is ~dev a joystick?" % (path, event.type),
                        )
                    if clock.event(state.apply(event), time.monotonic()):
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
        now_s = time.monotonic()
        elapsed_s = max(now_s - self._reported_s, 1e-3)
        if self._is_open:
            status.summary(0, "OK")
        else:
            status.summary(2, "Joystick not open.")
        status.add("topic", self._pub.resolved_name)
        status.add("device", self._path)
        status.add("device name", self._name)
        status.add("dead zone", self._settings.deadzone)
        status.add("autorepeat rate (Hz)", self._settings.autorepeat_rate)
        status.add("coalesce interval (s)", self._settings.coalesce_interval)
        for what, label in (("event", "joystick event"), ("publication", "publication")):
            status.add("recent %s rate (Hz)" % label, (self._counts[what] - self._reported[what]) / elapsed_s)
        status.add("subscribers", self._pub.get_num_connections())
        status.add("default trig val", self._settings.default_trig_val)
        status.add("sticky buttons", self._settings.sticky_buttons)
        self._reported, self._reported_s = dict(self._counts), now_s
        return status

    def _wake(self):
        os.write(self._wake_write, b"x")
