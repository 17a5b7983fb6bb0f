#!/usr/bin/env python3
"""The driver node against a scripted aircraft: topics, services, tf, emergency, reconnection, shutdown."""

import contextlib
import random
import statistics
import sys
import time
import unittest

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from driver_process import Driver
from geometry_msgs.msg import Twist, Vector3, Vector3Stamped
from nav_msgs.msg import Odometry
from scripted_drone import ScriptedDrone
from sensor_msgs.msg import Imu
from std_msgs.msg import Empty
from std_srvs.srv import Empty as EmptySrv
from tf2_msgs.msg import TFMessage

from ardrone_autonomy.link import DEAF_S
from ardrone_autonomy.msg import Navdata, navdata_demo, navdata_magneto
from ardrone_autonomy.protocol import at
from ardrone_autonomy.protocol.navdata import ControlState, Tag
from ardrone_autonomy.srv import CamSelect, FlightAnim, LedAnim, RecordEnable
from risc_lab.ros.publisher_updates import init_node
from risc_lab.testing import LIMIT_S, wait_for

RECEIPT_JITTER_S = 1.0  # a stall of this computer between publishing and counting


@contextlib.contextmanager
def flying_lab(**params):
    with ScriptedDrone() as drone:
        driver = Driver(drone, params)
        try:
            navdata = driver.subscribe("ardrone/navdata", Navdata)
            wait_for(lambda: navdata, "navdata")
            yield drone, driver
        finally:
            driver.end()


def take_off(drone, driver, prefix=""):
    driver.publish(prefix + "ardrone/takeoff", Empty())
    wait_for(lambda: drone.phase is ControlState.HOVERING, "hovering")


def answer_times_s(drone, driver, prefix, count=20):
    """Times [s] that `count` different commands take to reach the vehicle.

    A command that the driver drops after a stall is published again; its time counts from the first attempt.
    """
    times_s = []

    def publish(k):
        driver.publish(prefix + "cmd_vel", Twist(linear=Vector3(0.01 * k, 0, 0)))
        return time.monotonic()

    def arrives(k):
        nonlocal published_s
        if time.monotonic() - published_s > 2.0 * DEAF_S:
            published_s = publish(k)
        return abs(drone.sticks()[2] + 0.01 * k) < 1e-6

    for k in range(1, count + 1):
        begin_s = time.monotonic()
        published_s = publish(k)
        wait_for(lambda k=k: arrives(k), "command %d" % k)
        times_s.append(time.monotonic() - begin_s)
        time.sleep(0.1)
    return times_s


class OneDriverTest(unittest.TestCase):
    """Tests that share one driver, one after the other."""

    @classmethod
    def setUpClass(cls):
        cls.drone, cls.driver = cls.enterClassContext(flying_lab())
        cls.driver.subscribe("/diagnostics", DiagnosticArray)
        cls.driver.subscribe("ardrone/odometry", Odometry)

    def tearDown(self):
        # Order between topics is not guaranteed: an unneeded land order could arrive after the next test's take-off.
        if self.drone.phase is not ControlState.LANDED:
            self.driver.publish("ardrone/land", Empty())
            wait_for(lambda: self.drone.phase is ControlState.LANDED, "landed")

    def said(self, fits):
        """Whether `fits` holds for any status of the driver on /diagnostics so far."""
        messages, name = list(self.driver.received["/diagnostics"]), self.driver.namespace[1:]
        return any(fits(status) for m in messages for status in m.status if name in status.name)

    def test_1_configuration(self):
        """Runs first: later tests reboot the vehicle."""
        drone = self.drone
        keys = [key for key, _, _ in drone.writes]
        self.assertEqual(keys[0], "general:navdata_demo")
        self.assertIn(("control:outdoor", "FALSE"), [write[:2] for write in drone.writes])
        self.assertNotIn("control:altitude_max", keys)  # no parameter
        self.assertAlmostEqual(drone.configuration.get("control:euler_angle_max"), 0.349066)
        self.assertEqual(drone.configuration.get("detect:enemy_colors"), 3)
        self.assertEqual(drone.configuration.get("general:navdata_options"), 2**28 - 1)
        self.assertEqual(drone.configuration.get("video:max_bitrate"), 4000)
        self.assertIs(drone.configuration.get("general:navdata_demo"), False)

    def test_emergency_and_reset(self):
        drone, driver = self.drone, self.driver
        take_off(drone, driver)
        driver.publish("ardrone/reset", Empty())
        wait_for(lambda: drone.emergency, "emergency")
        wait_for(lambda: drone.named("REF")[-1][1].arguments[0] == at.Ref.PADDING, "both bits to drop")
        wait_for(lambda: self.said(lambda status: "emergency" in status.message), "the emergency on /diagnostics")
        driver.publish("ardrone/takeoff", Empty())  # refused
        time.sleep(0.5)  # order between topics is not guaranteed
        driver.publish("ardrone/reset", Empty())
        wait_for(lambda: not drone.emergency, "the emergency to be cleared")
        time.sleep(0.3)
        self.assertIs(drone.phase, ControlState.LANDED)
        take_off(drone, driver)

    def test_comes_back_after_silence_and_reboot(self):
        drone, driver = self.drone, self.driver
        take_off(drone, driver)
        drone.silent = True
        time.sleep(4.0)  # twice what the driver takes for a loss
        count = len(driver.received["ardrone/navdata"])
        drone.reboot()
        drone.silent = False
        wait_for(lambda: len(driver.received["ardrone/navdata"]) > count + 20, "navdata after the reboot")
        self.assertAlmostEqual(drone.configuration.get("control:euler_angle_max"), 0.349066)
        self.assertIs(drone.phase, ControlState.LANDED)  # it must not take off by itself
        self.assertFalse([c for _, c in drone.named("REF") if c.arguments[0] & at.Ref.START])
        wait_for(lambda: driver.call("setcamchannel", CamSelect, 1).result, "the driver to be ready again")
        take_off(drone, driver)

    def test_fast_reboot(self):
        drone, driver = self.drone, self.driver
        drone.reboot()
        wait_for(
            lambda: not drone.bootstrap and drone.configuration.get("detect:enemy_colors") == 3,
            "configuration after the reboot",
        )
        wait_for(lambda: driver.call("setcamchannel", CamSelect, 1).result, "the driver to be ready again")
        take_off(drone, driver)

    def test_flight(self):
        drone, driver = self.drone, self.driver
        take_off(drone, driver)
        wait_for(lambda: driver.newest("ardrone/navdata").state == 4, "state 4 in navdata")
        driver.publish("cmd_vel", Twist(linear=Vector3(0.1, 0.2, 0.3), angular=Vector3(0, 0, 0.4)))
        wait_for(lambda: drone.phase is ControlState.FLYING, "flying")
        flags, roll, pitch, gaz, yaw = drone.sticks()
        self.assertEqual(flags, 1)
        for value, expected in ((roll, -0.2), (pitch, -0.1), (gaz, 0.3), (yaw, -0.4)):
            self.assertAlmostEqual(value, expected, places=6)
        driver.publish("cmd_vel", Twist(linear=Vector3(float("nan"), 0, 0)))
        wait_for(lambda: drone.sticks()[0] == 0, "hover after a command that is not finite")
        driver.publish("ardrone/land", Empty())
        wait_for(lambda: drone.phase is ControlState.LANDED, "landed")
        wait_for(lambda: driver.newest("ardrone/navdata").state == 2, "state 2 in navdata")

    def test_one_packet_that_cannot_be_published_does_not_end_the_flight(self):
        drone, driver = self.drone, self.driver
        odometry = driver.received["ardrone/odometry"]
        take_off(drone, driver)
        drone.options = {Tag.DEMO: {"phi": float("inf")}}  # has no sine
        wait_for(
            lambda: self.said(
                lambda status: any(v.key == "packets not published" and int(v.value) > 10 for v in status.values)
            ),
            "failures on /diagnostics",
        )
        drone.options = {Tag.DEMO: {"phi": 0.0}}
        count = len(odometry)
        wait_for(lambda: len(odometry) > count + 20, "odometry to go on")
        driver.publish("cmd_vel", Twist(linear=Vector3(0.1, 0, 0)))
        wait_for(lambda: drone.phase is ControlState.FLYING, "flying")
        driver.publish("cmd_vel", Twist())  # or the next test takes off with this one
        wait_for(lambda: drone.phase is ControlState.HOVERING, "hovering")

    def test_services(self):
        drone, driver = self.drone, self.driver
        self.assertTrue(driver.call("setcamchannel", CamSelect, 3).result)
        wait_for(lambda: drone.configuration.get("video:video_channel") == 1, "the bottom camera")
        driver.call("togglecam", EmptySrv)
        wait_for(lambda: drone.configuration.get("video:video_channel") == 0, "the front camera")
        self.assertTrue(driver.call("setledanimation", LedAnim, 12, -2.0, 3).result)
        wait_for(lambda: drone.named("LED"), "LED")
        self.assertEqual(drone.named("LED")[-1][1].arguments, (19, 2.0, 3))
        self.assertFalse(driver.call("setledanimation", LedAnim, 0, float("nan"), 3).result)
        self.assertTrue(driver.call("setflightanimation", FlightAnim, 6, 0).result)
        wait_for(lambda: ("control:flight_anim", "6,5000") in [w[:2] for w in drone.writes], "flight_anim")
        self.assertTrue(driver.call("setrecord", RecordEnable, True).result)
        wait_for(lambda: drone.configuration.get("userbox:userbox_cmd").startswith("1,20"), "recording")
        self.assertEqual(drone.configuration.get("video:video_codec"), 130)
        driver.call("flattrim", EmptySrv)
        wait_for(lambda: drone.named("FTRIM"), "FTRIM")
        take_off(drone, driver)
        wait_for(lambda: driver.newest("ardrone/navdata").state == 4, "state 4 in navdata")
        with self.assertRaises(rospy.ServiceException):
            driver.call("flattrim", EmptySrv)
        self.assertEqual(len(drone.named("FTRIM")), 1)

    def test_telemetry(self):
        drone, driver = self.drone, self.driver
        drone.options = {
            Tag.DEMO: {
                "theta": 2000.0,
                "phi": 1000.0,
                "psi": 3000.0,
                "altitude": 700,
                "vx": 100.0,
                "vy": 200.0,
                "vz": 300.0,
            },
            Tag.PHYS_MEASURES: {"phys_accs": (10.0, 20.0, -1000.0), "phys_gyros": (1.0, 2.0, 3.0)},
            Tag.MAGNETO: {"mx": 0, "my": 3, "mz": 4, "magneto_raw": (1.0, 2.0, 3.0)},
            Tag.TIME: {"time": 5 << 21 | 250000},
        }
        driver.subscribe("ardrone/imu", Imu)
        driver.subscribe("ardrone/mag", Vector3Stamped)
        driver.subscribe("ardrone/navdata_demo", navdata_demo)
        driver.subscribe("ardrone/navdata_magneto", navdata_magneto)
        frames = driver.subscribe("/tf", TFMessage)
        topics = set(driver.received) - {"/diagnostics"}
        for topic in topics:
            wait_for(lambda topic=topic: len(driver.received[topic]) > 5, topic)
        wait_for(lambda: driver.newest("ardrone/navdata").altd == 700, "the new values")
        counts = {topic: len(driver.received[topic]) for topic in topics}
        for topic, count in counts.items():  # messages in transit on other topics may be older
            wait_for(lambda t=topic, n=count: len(driver.received[t]) > n + 25, "later messages on " + topic)
        navdata, imu, mag, odometry, demo, magneto = (
            driver.newest("ardrone/" + name)
            for name in ("navdata", "imu", "mag", "odometry", "navdata_demo", "navdata_magneto")
        )
        for value, expected in (
            (navdata.rotX, 1.0),
            (navdata.rotY, -2.0),
            (navdata.rotZ, -3.0),
            (navdata.vy, -200.0),
            (navdata.az, 1.0),
            (navdata.batteryPercent, 87.0),
            (imu.linear_acceleration.z, 9.8),
            (imu.angular_velocity.y, -0.0349066),
            (mag.vector.y, 0.6),
            (mag.vector.z, 0.8),
            (odometry.twist.twist.linear.y, -0.2),
            (odometry.pose.pose.position.z, 0.7),
            (demo.theta, 2000.0),
            (demo.vy, 200.0),
            (demo.drone_time, 5.25),
            (magneto.magneto_raw.z, 3.0),
        ):
            self.assertAlmostEqual(value, expected, places=5)
        self.assertEqual(imu.linear_acceleration_covariance, (1, 0, 0, 0, 2, 0, 0, 0, 3))
        self.assertEqual((demo.tag, demo.size), (0, 148))
        base = "lab/ardrone_base_link"
        self.assertEqual(
            (navdata.header.frame_id, odometry.header.frame_id, odometry.child_frame_id), (base, "odom", base)
        )
        self.assertLess(abs((rospy.Time.now() - navdata.header.stamp).to_sec()), LIMIT_S)
        wait_for(
            lambda: {("odom", base), (base, "lab/ardrone_base_frontcam"), (base, "lab/ardrone_base_bottomcam")}
            <= {(t.header.frame_id, t.child_frame_id) for m in list(frames) for t in m.transforms},
            "all frames",
        )


class DriverTest(unittest.TestCase):
    def test_one_vehicles_trouble_never_delays_another(self):
        """One driver for three vehicles: one link is silent, another brings 1000 garbage datagrams per second."""
        random_bytes = random.Random(1).randbytes
        with contextlib.ExitStack() as stack:
            drones = {name: stack.enter_context(ScriptedDrone()) for name in ("good", "gone", "noisy")}
            driver = Driver(drones)
            stack.callback(driver.end)
            telemetry = {name: driver.subscribe(name + "/ardrone/navdata", Navdata) for name in drones}
            for name, drone in drones.items():
                wait_for(lambda name=name: telemetry[name], "navdata of " + name)
                take_off(drone, driver, name + "/")
            good, gone, noisy = drones.values()
            whole, last_write = noisy.packet(), gone.writes[-1]
            garbage = (
                random_bytes(500),
                whole[: len(whole) // 2],
                whole[:-1] + bytes([whole[-1] ^ 1]),  # the checksum is wrong
                b"",
                random_bytes(60000),
            )

            def fly_good(count):
                """(times [s] that commands take, share of the packets that is published meanwhile)."""
                before, sent = len(telemetry["good"]), good.packets
                times_s = answer_times_s(good, driver, "good/", count)
                return times_s, (len(telemetry["good"]) - before) / (good.packets - sent)

            rates, slower_s, slow_s = [], [], []
            for _ in range(3):  # alternating, so that other load on this computer spoils only one round
                quiet_s, published = fly_good(7)
                gone.silent, noisy.garbage = True, garbage
                beside_s, published_beside = fly_good(25)  # takes longer than the detection of a lost link
                rates.append(published_beside / published)
                slower_s.append(statistics.median(beside_s) - 2.0 * statistics.median(quiet_s))
                slow_s.append(statistics.quantiles(beside_s)[2])
                written, counts = len(gone.writes), {name: len(telemetry[name]) for name in ("gone", "noisy")}
                gone.silent, noisy.garbage = False, ()
                wait_for(lambda n=written: last_write in gone.writes[n:], "the configuration of gone")
                for name, count in counts.items():  # both come back
                    wait_for(lambda name=name, n=count: len(telemetry[name]) > n + 20, "navdata of " + name)
            self.assertGreater(statistics.median(rates), 0.5, "navdata of the good vehicle is published as before")
            self.assertLess(statistics.median(slower_s), 0.02)
            self.assertLess(statistics.median(slow_s), 0.2, "no command waits for another vehicle's time-out")
            self.assertTrue(driver.alive())
            wait_for(lambda: len(good.named("PCMD_MAG")) > 100, "commands of the good vehicle")
            self.assertIs(good.phase, ControlState.FLYING)
            self.assertTrue(noisy.named("PCMD_MAG"), "its commands go on as well")

    def test_navdata_rate_is_that_of_the_loop(self):
        with flying_lab(looprate=25) as (_, driver):
            navdata, begin_s = driver.received["ardrone/navdata"], time.monotonic()
            before = len(navdata)
            wait_for(lambda: len(navdata) >= before + 100, "navdata")
            most = 26.0 * (time.monotonic() - begin_s + RECEIPT_JITTER_S)
            self.assertLess(100, most, "the vehicle sends 200 packets a second, the loop has 25 Hz")

    def test_realtime_navdata_publishes_every_packet(self):
        with flying_lab(realtime_navdata=True) as (drone, driver):
            navdata = driver.received["ardrone/navdata"]
            wait_for(lambda: not drone.bootstrap, "telemetry")
            before, sent_before = len(navdata), drone.packets
            wait_for(lambda: drone.packets - sent_before >= 800, "packets of the vehicle")
            # The loop alone would publish a quarter of them; on a busy computer the newest may still be in transit.
            self.assertGreater(len(navdata) - before, 0.5 * (drone.packets - sent_before))

    def test_telemetry_that_can_never_be_published_lands_and_ends(self):
        with flying_lab() as (drone, driver):
            take_off(drone, driver)
            drone.options = {Tag.DEMO: {"phi": float("inf")}}
            wait_for(lambda: not driver.alive(), "the driver to give up")
            wait_for(lambda: drone.phase is ControlState.LANDED, "landed")

    def test_waits_for_a_vehicle_that_is_switched_on_later_and_lands_it_at_shutdown(self):
        with ScriptedDrone() as drone:
            drone.silent = True
            driver = Driver(drone)
            try:
                navdata = driver.subscribe("ardrone/navdata", Navdata)
                self.assertFalse(driver.call("setcamchannel", CamSelect, 1).result)
                self.assertFalse(navdata)
                drone.silent = False
                wait_for(lambda: navdata, "navdata")
                wait_for(lambda: driver.call("setcamchannel", CamSelect, 1).result, "the driver to be ready")
                take_off(drone, driver)
                driver.publish("cmd_vel", Twist(linear=Vector3(0.5, 0, 0)))
                wait_for(lambda: drone.phase is ControlState.FLYING, "flying")
            finally:
                code = driver.end()
            self.assertEqual(code, 0)
            wait_for(lambda: drone.phase is ControlState.LANDED, "landed")
            self.assertEqual(drone.sticks(), (0, 0.0, 0.0, 0.0, 0.0))

    def test_bad_parameter_ends_the_node(self):
        with ScriptedDrone() as drone:
            driver = Driver(drone, {"looprate": 0})
            wait_for(lambda: not driver.alive(), "the driver to give up")
            self.assertEqual(driver.end(), 1)


def all_tests():
    load = unittest.defaultTestLoader.loadTestsFromTestCase
    return unittest.TestSuite(map(load, (OneDriverTest, DriverTest)))


if __name__ == "__main__":
    init_node("driver_test", anonymous=True)
    rostest.rosrun("ardrone_autonomy", "ardrone_driver", "driver_rostest.all_tests", sys.argv)
