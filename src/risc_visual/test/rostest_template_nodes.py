#!/usr/bin/env python3
"""The template nodes on the wire: a moving photograph goes in, and each node's result comes out."""

import pathlib
import shutil
import threading
import time
import unittest

import cv2
import numpy as np
import rospy
import rostest
from cv_bridge import CvBridge
from diagnostic_msgs.msg import DiagnosticArray
from dynamic_reconfigure.client import Client
from geometry_msgs.msg import Vector3Stamped
from matplotlib import cbook
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import CompressedImage, Image, RegionOfInterest

from ardrone_autonomy.msg import Navdata
from risc_lab.images import picture_from_msg
from risc_lab.ros.publisher_updates import init_node
from risc_msgs.msg import Observed_rois, Risc_roi, Risc_rois

PACKAGE = "risc_visual"
NAME = "template_nodes"
PATIENCE_S = 60.0
RATE_HZ = 10.0
STEP_PX = 2  # to the right, from picture to picture
STEPS = 20
CIRCLE = (420, 250, 35)  # x, y, radius [px] of a green disc on the photograph
BRIDGE = CvBridge()


class Results:
    """Context manager: listens to a topic."""

    def __init__(self, topic, kind=Image):
        self._messages = []
        self._condition = threading.Condition()
        self._subscriber = rospy.Subscriber(topic, kind, self._keep, queue_size=10, buff_size=2**24)
        self._topic = topic

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._subscriber.unregister()

    def _keep(self, message):
        with self._condition:
            self._messages.append(message)
            self._condition.notify_all()

    def wait_for(self, fits=lambda _: True, what="anything"):
        """Wait for the first message from now on that fits; return it."""
        begin, found = len(self._messages), []

        def there():
            found[:] = [message for message in self._messages[begin:] if fits(message)][:1]
            return found

        with self._condition:
            if not self._condition.wait_for(there, PATIENCE_S):
                raise AssertionError(
                    "%s did not come on %s within %g s (%d others did)"
                    % (what, self._topic, PATIENCE_S, len(self._messages) - begin)
                )
        return found[0]

    def count(self):
        with self._condition:
            return len(self._messages)


def picture_of(message):
    return BRIDGE.imgmsg_to_cv2(message, "passthrough")


def regions_of(message, observer="camera"):
    """[(name, x, y), ...] of the only observer."""
    assert [entry.name for entry in message.Obj] == [observer], message
    return [(roi.name, roi.x, roi.y) for roi in message.Obj[0].landmarks if roi.visible]


class TemplateNodesTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        photograph = cv2.imread(str(cbook.get_sample_data("grace_hopper.jpg", asfileobj=False)))
        cv2.circle(photograph, CIRCLE[:2], CIRCLE[2], (20, 190, 60), -1, cv2.LINE_AA)
        cls.photograph = photograph
        cls.files = pathlib.Path(rospy.get_param("/files"))
        cls.files.mkdir()
        square = np.zeros((240, 320, 3), np.uint8)
        square[80:161, 100:201] = 255
        cv2.imwrite(str(cls.files / "square.png"), square)
        cls.publishers = [
            rospy.Publisher(topic, Image, queue_size=1)
            for topic in ("/ardrone/image_raw", "/risc1/ardrone/image_rect_color")
        ]
        cls.navdata = rospy.Publisher("/ardrone/navdata", Navdata, queue_size=1)
        cls.log = Results("/rosout", Log)
        cls.encoding = "bgr8"
        cls.last_x = 0  # how far to the right the newest picture is shifted
        cls.tick, cls.every = 0, 1  # ticks of the timer; a picture is sent at one of this many
        cls.timer = rospy.Timer(rospy.Duration(1.0 / RATE_HZ), cls.send)
        cls.step = 0

    @classmethod
    def tearDownClass(cls):
        cls.timer.shutdown()
        shutil.rmtree(str(cls.files))

    @classmethod
    def send(cls, _event):
        cls.tick += 1
        if cls.tick % cls.every:
            return
        cls.step = (cls.step + 1) % STEPS
        shifted = np.roll(cls.photograph, STEP_PX * cls.step, axis=1)
        message = BRIDGE.cv2_to_imgmsg(shifted, "bgr8")
        message.header.stamp = rospy.Time.now()
        message.header.frame_id = "eye"
        message.encoding = cls.encoding
        navdata = Navdata(rotX=10.0)
        navdata.header.stamp = message.header.stamp
        cls.navdata.publish(navdata)
        for publisher in cls.publishers:
            publisher.publish(message)

    def wait_until(self, condition, what):
        deadline_s = time.monotonic() + PATIENCE_S
        while not condition():
            self.assertLess(time.monotonic(), deadline_s, "never came: " + what)
            time.sleep(0.05)

    def check_header(self, message):
        self.assertEqual(message.header.frame_id, "eye")
        self.assertLess(abs((rospy.Time.now() - message.header.stamp).to_sec()), PATIENCE_S)

    def test_1_pictures_are_taken_only_while_somebody_listens(self):
        drone = self.publishers[0]
        # the navdata reader proves that the nodes are up
        self.wait_until(lambda: self.navdata.get_num_connections() > 0, "vert_drone")
        time.sleep(1.0)
        self.assertEqual(drone.get_num_connections(), 0, "no result has a subscriber")
        with Results("/diagnostics", DiagnosticArray) as diagnostics:

            def says(text):
                return lambda m: any("edge_drone" in s.name and text in s.message for s in m.status)

            diagnostics.wait_for(says("no result has a subscriber"), "an idle edge_drone")
            with Results("/camera/image_edge") as edges:
                edges.wait_for(lambda m: m.header.frame_id == "eye", "edges")  # not those of the USB camera
                self.assertEqual(drone.get_num_connections(), 1)
                diagnostics.wait_for(says("working"), "a working edge_drone")
            self.wait_until(lambda: drone.get_num_connections() == 0, "the end of the subscription")

    def test_2_edges_and_their_sliders(self):
        with Results("/camera/image_edge") as edges:
            message = edges.wait_for(lambda m: m.header.frame_id == "eye", "edges")
            self.check_header(message)
            self.assertEqual((message.width, message.height, message.encoding), (512, 600, "mono8"))
            many = np.count_nonzero(picture_of(message))
            self.assertGreater(many, 2000)
            client = Client("/edge_drone", timeout=PATIENCE_S)
            client.update_configuration({"threshold": 9000})
            edges.wait_for(
                lambda m: m.header.frame_id == "eye" and np.count_nonzero(picture_of(m)) < many / 2, "fewer edges"
            )
            client.update_configuration({"aperture": 4})
            self.assertEqual(client.get_configuration(PATIENCE_S).aperture, 7, "an impossible one changes nothing")

    def test_3_edges_of_a_usb_camera(self):
        with Results("/camera/image_edge") as edges:
            message = edges.wait_for(lambda m: m.width == 320, "edges of the folder of pictures")
            columns = np.nonzero(picture_of(message).any(axis=0))[0]
            self.assertAlmostEqual(columns.min(), 100, delta=2)
            self.assertAlmostEqual(columns.max(), 200, delta=2)

    def test_4_optical_flow(self):
        type(self).every = 4  # slow enough that no node skips a picture, which would increase the motion
        self.addCleanup(setattr, type(self), "every", 1)
        with Results("/camera/flow") as flows, Results("/camera/dense") as dense:
            Client("/dense_flow", timeout=PATIENCE_S).update_configuration({"on_edges": False, "levels": 3})

            def measured(message):
                flow = picture_of(message)
                return np.hypot(*(np.median(flow[130:330, 200:340], axis=(0, 1)) - (STEP_PX, 0.0))) < 0.3

            message = flows.wait_for(measured, "the flow of the face")
            self.check_header(message)
            self.assertEqual(message.encoding, "32FC2")
            self.assertEqual(dense.wait_for().encoding, "bgr8")
        with Results("/camera/motion", Vector3Stamped) as motions, Results("/camera/sparse") as sparse:
            motions.wait_for(
                lambda m: abs(m.vector.x - STEP_PX) < 0.1 and abs(m.vector.y) < 0.1 and m.vector.z > 100, "the motion"
            )
            self.check_header(sparse.wait_for())

    def test_5_the_vertical(self):
        with Results("/camera/vert_line") as levelled:
            message = levelled.wait_for()
            self.check_header(message)
            self.assertEqual((message.width, message.height), (600, 600))
            # rotX 10 deg and 4 deg of mounting, turned clockwise: the right edge of the picture leans to the right
            lit = picture_of(message).any(axis=2)
            top, bottom = (np.nonzero(lit[row])[0].max() for row in (150, 450))
            self.assertAlmostEqual((top - bottom) / 300.0, np.tan(np.radians(14.0)), delta=0.03)

    def test_6_segmentation(self):
        with Results("/camera/mask") as masks, Results("/camera/segmented") as segmented:
            colours = np.unique(picture_of(segmented.wait_for()).reshape(-1, 3), axis=0)
            self.assertLessEqual(len(colours), 26)
            client = Client("/hsv_segmentation", timeout=PATIENCE_S)
            client.update_configuration({"saturation_low": 60, "value_low": 60, "first_bin": 14, "last_bin": 19})
            # blue: the sky right of the head, wherever the picture is shifted to; the face is not
            masks.wait_for(
                lambda m: picture_of(m)[30:200, 460:490].mean() > 250 and picture_of(m)[230:300, 240:300].mean() < 20,
                "the mask of the sky",
            )

    def test_7_overlay(self):
        rois = rospy.Publisher("/land_rois", Observed_rois, queue_size=1, latch=True)
        seen = Risc_roi("green", True, 256, 300, 100.0, 60.0, 0.0)
        rois.publish(Observed_rois(Obj=[Risc_rois("camera", [seen], []), Risc_rois("risc7", [seen], [])]))
        with Results("/camera/overlay") as overlay:

            def drawn(message):
                picture = picture_of(message)
                return (picture[300, 206] == (0, 255, 255)).all() and (picture[300, 256] == (0, 0, 255)).all()

            self.check_header(overlay.wait_for(drawn, "the region and the dot of the cross hair"))

    def test_8_faces(self):
        with Results("/face_rois", Observed_rois) as rois, Results("/camera/faces") as drawn:
            message = rois.wait_for(lambda m: regions_of(m), "a face")
            self.check_header(message)
            ((name, x, y),) = regions_of(message)
            self.assertEqual(name, "face")
            self.assertTrue(250 <= x <= 290 + STEP_PX * STEPS and 210 <= y <= 245, (x, y))
            self.check_header(drawn.wait_for())

    def test_9_camshift(self):
        target = rospy.Publisher("/target", RegionOfInterest, queue_size=1, latch=True)
        with Results("/target_rois", Observed_rois) as rois, Results("/camera/tracked") as drawn:
            self.assertEqual(regions_of(rois.wait_for()), [], "nothing is followed yet")
            x, y, radius = CIRCLE
            target.publish(RegionOfInterest(x + STEPS - 8, y - 8, 16, 16, False))
            for _ in range(2 * STEPS):
                message = rois.wait_for(lambda m: regions_of(m), "the disc")
                ((name, found_x, found_y),) = regions_of(message)
                self.assertEqual(name, "target")
                self.assertTrue(
                    x - 5 <= found_x <= x + STEP_PX * STEPS + 5 and abs(found_y - y) < 5, (found_x, found_y)
                )
            self.check_header(drawn.wait_for())

    def test_a_shapes_in_a_group_and_on_another_topic(self):
        with Results("/risc1/shape_rois", Observed_rois) as rois, Results("/risc1/camera/shapes") as drawn:

            def disc(message):
                return [r for r in regions_of(message, "risc1") if r[0] == "circle" and abs(r[2] - CIRCLE[1]) < 4]

            message = rois.wait_for(disc, "the disc")
            self.assertTrue(CIRCLE[0] <= disc(message)[0][1] <= CIRCLE[0] + STEP_PX * STEPS)
            self.check_header(drawn.wait_for())

    def test_b_a_picture_that_cannot_be_read_is_refused_with_one_error(self):
        with Results("/camera/image_edge") as edges, Results("/diagnostics", DiagnosticArray) as diagnostics:
            edges.wait_for(lambda m: m.header.frame_id == "eye", "edges")
            type(self).encoding = "nonsense"
            try:
                entry = self.log.wait_for(lambda m: "was rejected" in m.msg and "edge_drone" in m.name, "the refusal")
                self.assertIn("nonsense", entry.msg)
                self.assertIn("/ardrone/image_raw", entry.msg)
                diagnostics.wait_for(
                    lambda m: any("edge_drone" in s.name and s.level == 2 for s in m.status), "an error status"
                )
            finally:
                type(self).encoding = "bgr8"
            edges.wait_for(lambda m: m.header.frame_id == "eye", "edges again")

    def test_c_compressed_pictures_for_bags(self):
        topic = "/risc1/ardrone/image_rect_color/compressed"
        with Results(topic, CompressedImage) as pictures, Results("/diagnostics", DiagnosticArray) as diagnostics:
            messages = [pictures.wait_for() for _ in range(11)]
            self.check_header(messages[0])
            gaps_s = np.diff([message.header.stamp.to_sec() for message in messages])
            # The mean: a single gap is two or three of 0.1 s, and less when a picture was sent late.
            self.assertGreater(np.mean(gaps_s), 0.19, "10 a second come, 4 are wanted")
            picture = picture_from_msg(messages[0]).astype(int)
            errors = [np.abs(np.roll(picture, -STEP_PX * step, axis=1) - self.photograph) for step in range(STEPS)]
            self.assertLess(min(error.mean() for error in errors), 3.0)  # of 255: JPEG

            def says(text):
                return lambda m: any("compress_images" in s.name and text in s.message for s in m.status)

            diagnostics.wait_for(says("working"), "a working compress_images")
            type(self).encoding = "nonsense"
            try:
                diagnostics.wait_for(says("rejected"), "the refusal")
            finally:
                type(self).encoding = "bgr8"
            pictures.wait_for(what="a picture again")


if __name__ == "__main__":
    init_node(NAME)
    rostest.rosrun(PACKAGE, NAME, TemplateNodesTest)
