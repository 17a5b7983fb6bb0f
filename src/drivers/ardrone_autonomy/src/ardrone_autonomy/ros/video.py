"""The camera topics of the driver: wires a video_stream.VideoStream to images, camera_info and set_camera_info."""

import time
from collections import deque, namedtuple

import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from ardrone_autonomy.video_channel import CameraTracker
from ardrone_autonomy.video_stream import VideoStream
from camera_info_manager import CameraInfoManager
from risc_lab.ros.diagnostics import Growth, age_text
from risc_lab.ros.until_shutdown import is_closing

CAMERA_NAMES = ("front", "bottom")  # by channel
QUEUE_SIZE = 10  # as in the original
REPEAT_WARNING_S = 5.0
STALE_S = 1.0  # /diagnostics warns when the last picture is older
_CHANNELS_PER_PIXEL = 3

_Topics = namedtuple("_Topics", "image info")


def _advertise(name):
    types = (("/image_raw", Image), ("/camera_info", CameraInfo))
    return _Topics(*[rospy.Publisher(name + topic, kind, queue_size=QUEUE_SIZE) for topic, kind in types])


class Video:
    """Topics of both cameras and of the selected one; the video is received only while one of them has a subscriber.

    address: IPv4 address of the vehicle.
    frames: frame ids of front and bottom camera.
    channel: channel that the vehicle sends after its configuration, 0 front, 1 bottom.
    camera_info_urls: of front and bottom camera, "" = the default of camera_info_manager.
    latency_s: from exposure to reception, subtracted from the stamps.
    realtime: publish every picture at once; otherwise `tick` publishes the newest one.
    report: function (level, text).
    prefix: prefix of the topics and services.
    """

    def __init__(self, address, frames, channel, camera_info_urls, latency_s, realtime, report, prefix=""):
        self._frames = frames
        self._realtime = realtime
        self._waiting = deque(maxlen=1)  # (Picture, channel) that is not published yet
        self.tracker = CameraTracker(channel)  # must be told every camera order to the vehicle
        self._selected = _advertise(prefix + "ardrone")
        self._cameras = tuple(_advertise(prefix + "ardrone/" + name) for name in CAMERA_NAMES)
        self._managers = tuple(
            CameraInfoManager("ardrone_" + name, url, prefix + "ardrone/" + name)
            for name, url in zip(CAMERA_NAMES, camera_info_urls)
        )
        for manager in self._managers:
            manager.loadCameraInfo()
        self._sizes_warned = set()
        self._channel = channel
        self._published = 0
        self._unpublished = 0  # failures to publish
        self._superseded = 0  # a newer picture came before the loop did
        self._of_unknown_camera = 0
        self._growth = Growth()
        self.stream = VideoStream(address, self._on_picture, report, latency_s)  # the caller starts and stops it

    def tick(self, is_ready):
        """Call once per loop: opens or closes the stream as subscribers come and go, publishes the newest picture.

        is_ready: the vehicle is configured; before that it is unknown which camera it sends.
        """
        self.stream.want(
            is_ready
            and any(topic.get_num_connections() for topics in (self._selected, *self._cameras) for topic in topics)
        )
        if self._waiting:
            self._publish(*self._waiting.popleft())

    # --- pictures -------------------------------------------------------------------------------------------------
    def _on_picture(self, picture):
        """Handle a picture; called in the thread of the stream."""
        channel = self.tracker.camera(picture.header, picture.is_key, picture.connection, picture.received_s)
        if channel is None:
            self._of_unknown_camera += 1
        elif self._realtime:
            self._publish(picture, channel)
        else:
            self._superseded += len(self._waiting)
            self._waiting.append((picture, channel))

    def _publish(self, picture, channel):
        try:
            self._send(picture, channel)
        except Exception as error:  # any failure: pictures are not worth a landing
            if not is_closing():  # on shutdown rospy closes the topics before us
                self._unpublished += 1
                rospy.logerr_throttle(REPEAT_WARNING_S, "a picture could not be published: %r" % error)

    def _send(self, picture, channel):
        height, width, _ = picture.rgb.shape
        stamp = rospy.Time.now() - rospy.Duration.from_sec(time.monotonic() - picture.exposure_s)
        header = Header(stamp=stamp, frame_id=self._frames[channel])
        outputs = (self._cameras[channel], self._selected)
        self._channel = channel
        self._published += 1
        if any(topics.image.get_num_connections() for topics in outputs):
            image = Image(header, height, width, "rgb8", 0, _CHANNELS_PER_PIXEL * width, picture.rgb.tobytes())
            for topics in outputs:
                topics.image.publish(image)
        if any(topics.info.get_num_connections() for topics in outputs):
            info = self._camera_info(channel, width, height)
            info.header = header
            for topics in outputs:
                topics.info.publish(info)

    def _camera_info(self, channel, width, height):
        info = self._managers[channel].getCameraInfo()
        size = info.width, info.height
        if size not in ((0, 0), (width, height)) and (channel, size) not in self._sizes_warned:
            self._sizes_warned.add((channel, size))
            rospy.logwarn(
                "the calibration of the %s camera is for %d x %d px, the vehicle sends %d x %d px: calibrate again",
                CAMERA_NAMES[channel],
                *size,
                width,
                height,
            )
        info.width, info.height = width, height
        return info

    # --- diagnostics ------------------------------------------------------------------------------------------------
    def fill(self, status):
        """Fill a status; a task of diagnostic_updater."""
        stream, decoder = self.stream, self.stream.decoder
        _, rates_hz = self._growth({"pictures": self._published})
        if not stream.wanted:
            status.summary(DiagnosticStatus.OK, "not received: no subscriber, or the vehicle is not ready")
        elif not stream.connected:
            status.summary(DiagnosticStatus.WARN, "no connection to the video of the vehicle")
        elif stream.last_s is None or time.monotonic() - stream.last_s > STALE_S:
            status.summary(DiagnosticStatus.WARN, "no pictures")
        else:
            status.summary(DiagnosticStatus.OK, "pictures")
        status.add("camera", CAMERA_NAMES[self._channel])
        for name, manager in zip(CAMERA_NAMES, self._managers):
            status.add(name + " calibrated", manager.isCalibrated())
        status.add("rate [Hz]", "%.1f" % rates_hz["pictures"])
        status.add("age [s]", age_text(stream.last_s))
        status.add("decode errors", decoder.errors)
        status.add("pictures of another codec", decoder.foreign)
        status.add("pictures missing in the stream", decoder.missing + stream.assembler.incomplete)
        status.add("undecodable until the next IDR", decoder.unusable)
        status.add("skipped", stream.skipped + self._superseded)
        status.add("of an unknown camera", self._of_unknown_camera)
        status.add("not published", self._unpublished)
        status.add("damaged headers", stream.parser.bad_headers + stream.parser.broken_payloads)
        status.add("bytes skipped", stream.parser.skipped_bytes)
        status.add("connections", stream.connections)
        status.add("restarts of the video clock", stream.clock.restarts)
        return status
