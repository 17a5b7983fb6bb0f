#!/usr/bin/env python3
"""driver.py and roscopter_node.py against a scripted autopilot: topics, services, sticks, loss, end."""

import contextlib
import itertools
import os
import pathlib
import random
import sys
import tempfile
import threading
import unittest

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from rosgraph_msgs.msg import Log
from scripted_autopilot import RADIO_US, Running
from sensor_msgs.msg import NavSatFix
from std_msgs.msg import Bool, Empty
from std_srvs.srv import Empty as EmptySrv

from risc_lab.ros.publisher_updates import init_node
from risc_lab.ros.testing import LIMIT_S, NodeProcess, wait_for
from roscopter import msg
from roscopter.srv import APMCommand, APMCommandRequest, SendWaypoint, SendWaypointList

STICKS = [1400, 1600, 1200, 1500, 1000, 1800, 1500, 1500]
TOPICS = {
    "gps": NavSatFix,
    "rc": msg.RC,
    "state": msg.State,
    "vfr_hud": msg.VFR_HUD,
    "attitude": msg.Attitude,
    "raw_imu": msg.Mavlink_RAW_IMU,
    "status": msg.Status,
    "filtered_pos": msg.FilteredPosition,
    "controller_output": msg.ControllerOutput,
    "current_mission": msg.CurrentMission,
}


class Driver(NodeProcess):
    """A driver in its own process."""

    def __init__(self, *options, program="driver.py"):
        super().__init__(group="/apm")
        self.start("roscopter", program, *options, "__name:=roscopter", "__log:=" + os.devnull)

    def command(self, number):
        return self.call("command", APMCommand, number).result


@contextlib.contextmanager
def lab(*options, is_serial=False, version=2, program="driver.py"):
    """(scripted autopilot, driver that is connected to it)."""
    with tempfile.TemporaryDirectory() as folder:
        where = pathlib.Path(folder, "ttyUSB0") if is_serial else ("127.0.0.1", 0)
        with Running(where, version=version) as vehicle:
            driver = Driver("--device=" + vehicle.device, *options, program=program)
            try:
                states = driver.subscribe("state", msg.State)
                wait_for(lambda: states, "the first state")
                yield vehicle, driver
            finally:
                driver.end()


class DriverTest(unittest.TestCase):
    def check_telemetry(self, **options):
        with lab(**options) as (_, driver):
            for name, kind in TOPICS.items():
                driver.subscribe(name, kind)
            diagnostics = driver.subscribe("/diagnostics", DiagnosticArray)
            wait_for(lambda: all(driver.received.values()), "all topics")
            newest = {name: messages[-1] for name, messages in driver.received.items()}
            self.assertAlmostEqual(newest["gps"].latitude, 41.75)
            self.assertEqual(newest["rc"].channel, RADIO_US)
            self.assertEqual((newest["state"].mode, newest["state"].armed), ("STABILIZE", False))
            self.assertEqual((newest["vfr_hud"].throttle, newest["vfr_hud"].heading), (42, 270))
            self.assertAlmostEqual(newest["attitude"].pitch, -0.2, 6)
            self.assertEqual((newest["raw_imu"].zacc, newest["raw_imu"].zmag), (-1000, 9))
            status = newest["status"]
            self.assertEqual((status.battery_voltage, status.battery_remaining), (11800, 87))
            self.assertLess(abs((rospy.Time.now() - status.header.stamp).to_sec()), LIMIT_S)
            self.assertEqual(newest["filtered_pos"].relative_altitude, 1500)
            self.assertAlmostEqual(newest["controller_output"].air_spd_error, -0.25)
            self.assertEqual((newest["current_mission"].mission_num, newest["current_mission"].wp_dist), (3, 12))
            wait_for(lambda: "connected" in self.summaries(diagnostics, driver), "a good diagnosis")
            self.check_rate(driver, "status", least_hz=2.0)

    def check_rate(self, driver, topic, least_hz):
        """Check the rate by the stamps of received messages: a busy computer delays them but loses none."""
        messages = driver.received[topic]
        wait_for(lambda: len(messages) > 30, "30 messages on " + topic)
        span_s = (messages[-1].header.stamp - messages[0].header.stamp).to_sec()
        self.assertGreater((len(messages) - 1) / span_s, least_hz)

    @staticmethod
    def summaries(diagnostics, driver):
        name = driver.namespace.lstrip("/") + "/roscopter: autopilot"
        return [status.message for array in diagnostics for status in array.status if status.name == name]

    def test_telemetry_of_a_serial_line_and_mavlink_1(self):
        self.check_telemetry(is_serial=True, version=1)

    def test_telemetry_of_udp_and_mavlink_2(self):
        self.check_telemetry(version=2)

    def test_commands_and_the_reasons_of_refusals(self):
        with lab() as (vehicle, driver):
            log = driver.subscribe("/rosout", Log)
            self.assertTrue(driver.command(APMCommandRequest.CMD_ARM))
            self.assertTrue(vehicle.is_armed)
            self.assertTrue(driver.command(APMCommandRequest.CMD_SET_ALT_HOLD))
            self.assertEqual(vehicle.mode, 2)
            self.assertTrue(driver.command(APMCommandRequest.CMD_SET_LAND))
            self.assertTrue(driver.command(APMCommandRequest.CMD_SET_STABILIZE))
            self.assertTrue(driver.command(APMCommandRequest.CMD_LAND))
            self.assertTrue(driver.command(APMCommandRequest.CMD_DISARM))
            self.assertFalse(vehicle.is_armed)
            self.assertTrue(driver.command(APMCommandRequest.CMD_LAUNCH))
            self.assertEqual((vehicle.mode, vehicle.is_armed), (4, True))
            self.assertFalse(driver.command(APMCommandRequest.CMD_SET_MANUAL))  # a copter has no such mode
            self.assertFalse(driver.command(99))
            vehicle.answers[mavlink.MAV_CMD_COMPONENT_ARM_DISARM] = mavlink.MAV_RESULT_FAILED
            vehicle.explanation = [(4, b"PreArm: Check Board Voltage")]
            self.assertFalse(driver.command(APMCommandRequest.CMD_ARM))
            wait_for(lambda: self.has(log, driver, Log.WARN, "PreArm: Check Board Voltage"), "the autopilot's words")
            wait_for(lambda: self.has(log, driver, Log.ERROR, "PreArm: Check Board Voltage"), "the reason")

    @staticmethod
    def has(log, driver, level, text):
        return any(m.level == level and text in m.msg and driver.namespace in m.name for m in list(log))

    def test_a_command_that_waits_holds_nothing_up(self):
        with lab() as (vehicle, driver):
            attitudes = driver.subscribe("attitude", msg.Attitude)
            wait_for(lambda: attitudes, "telemetry")
            vehicle.ignores = 1000
            results = []
            caller = threading.Thread(target=lambda: results.append(driver.command(APMCommandRequest.CMD_ARM)))
            caller.start()
            wait_for(lambda: vehicle.ignores < 998, "the command, and its repetition")
            before = len(attitudes)
            wait_for(lambda: len(attitudes) > before + 5, "telemetry meanwhile")
            self.assertEqual(results, [])
            driver.publish("emergency_stop", Empty())
            vehicle.ignores = 0
            caller.join(LIMIT_S)
            self.assertEqual(results, [False])

    def test_emergency_stop(self):
        with lab() as (vehicle, driver):
            self.assertTrue(driver.command(APMCommandRequest.CMD_ARM))
            driver.publish("emergency_stop", Empty())
            wait_for(lambda: not vehicle.is_armed, "motors to stop")
            kill = vehicle.named("COMMAND_LONG")[-1]
            self.assertEqual((kill.command, kill.param1, kill.param2), (400, 0.0, 21196.0))

    def test_sticks_are_passed_on_only_when_enabled(self):
        with lab() as (vehicle, driver):
            for _ in range(20):
                driver.publish("send_rc", msg.RC(STICKS))
            self.assertTrue(driver.command(APMCommandRequest.CMD_ARM))  # all that was sent before has arrived
            self.assertTrue(driver.command(APMCommandRequest.RETURN_RC_CONTROL))
            self.assertEqual(vehicle.named("RC_CHANNELS_OVERRIDE"), [])
        with lab("--enable-rc-control=true") as (vehicle, driver):
            driver.publish("send_rc", msg.RC(STICKS))
            wait_for(lambda: vehicle.named("RC_CHANNELS_OVERRIDE"), "the sticks")
            first = vehicle.named("RC_CHANNELS_OVERRIDE")[0]
            self.assertEqual([getattr(first, "chan%d_raw" % k) for k in range(1, 9)], STICKS)
            wait_for(lambda: vehicle.channels_us() == list(RADIO_US), "the release after silence")
            over, sender = threading.Event(), rospy.Rate(20)

            def send():
                while not over.is_set():
                    driver.publish("send_rc", msg.RC(STICKS))
                    sender.sleep()

            thread = threading.Thread(target=send)
            thread.start()
            try:
                wait_for(lambda: vehicle.channels_us() == STICKS, "the sticks again")
                self.assertEqual(driver.end(), 0)
                self.assertEqual(vehicle.named("RC_CHANNELS_OVERRIDE")[-1].chan1_raw, 0)
            finally:
                over.set()
                thread.join()

    def test_the_watchdog_lands(self):
        with lab("--enable-watchdog=true", "--enable-ros-failsafe=true", "--max-watchdog-time=1") as (vehicle, driver):
            driver.publish("watchdog", Bool(True))
            self.assertTrue(driver.command(APMCommandRequest.CMD_ARM))
            wait_for(lambda: vehicle.mode == 9, "the landing")

    def test_missions(self):
        with lab("--minimum-waypoint-altitude=1000") as (vehicle, driver):
            place = msg.Waypoint(latitude=417500000, longitude=-1118100000, altitude=2000, waypoint_type=1)
            self.assertTrue(driver.call("waypoint_list", SendWaypointList, [place, place]).result)
            self.assertEqual(len(vehicle.mission), 3)
            self.assertTrue(driver.call("waypoint", SendWaypoint, place).result)
            self.assertEqual(len(vehicle.mission), 2)
            place.altitude = 500
            self.assertFalse(driver.call("waypoint", SendWaypoint, place).result)
            self.assertEqual(vehicle.missions_cleared, 0)
            self.assertTrue(driver.call("waypoint_list", SendWaypointList, []).result)
            self.assertEqual((vehicle.missions_cleared, vehicle.mission), (1, []))
            items = driver.subscribe("mission_item", msg.MissionItem)
            fields = {"target_system": 255, "target_component": 0, "seq": 1, "frame": 3, "command": 16, "current": 1}
            fields.update({"autocontinue": 1, "x": 41.75, "y": -111.81, "z": 8.0})
            fields.update({"param%d" % k: float(k) for k in range(1, 5)})

            def item():
                vehicle.send("mission_item", **fields)
                return items

            wait_for(item, "the mission item")
            self.assertEqual((items[0].mission_num, items[0].posAcc, items[0].z_alt), (1, 2.0, 8.0))
        with lab("--enable-waypoint-control=false") as (vehicle, driver):
            self.assertFalse(driver.call("waypoint_list", SendWaypointList, []).result)
            self.assertEqual(vehicle.missions_cleared, 0)

    def test_loss_is_silence_and_it_recovers(self):
        for is_serial in (True, False):
            with lab(is_serial=is_serial) as (vehicle, driver):
                log = driver.subscribe("/rosout", Log)
                status = driver.subscribe("status", msg.Status)
                wait_for(lambda status=status: status, "the battery")
                vehicle.is_silent = True
                wait_for(lambda: self.has(log, driver, Log.ERROR, "no word from the autopilot"), "the loss")  # noqa: B023
                count = len(status)
                self.assertFalse(driver.command(APMCommandRequest.CMD_SET_LAND))
                self.assertEqual(len(status), count)  # no old status is published again
                self.assertEqual(vehicle.mode, 9)  # but the order was sent
                vehicle.is_silent = False
                vehicle.reboot()
                wait_for(lambda status=status, count=count: len(status) > count + 5, "the battery again")

    def test_damaged_bytes_change_no_value(self):
        """One byte in 100 is damaged: received values are correct, and messages keep coming."""
        numbers = random.Random(5)

        def spoil(data):
            return bytes(byte ^ 0x55 if numbers.random() < 0.01 else byte for byte in data)

        with lab(is_serial=True) as (vehicle, driver):
            status = driver.subscribe("status", msg.Status)
            wait_for(lambda: status, "the battery")
            vehicle.spoils = spoil
            status.clear()
            wait_for(lambda: len(status) > 10, "the battery, through the noise")
            self.assertEqual({(m.battery_voltage, m.battery_current, m.battery_remaining) for m in list(status)},
                             {(11800, 1234, 87)})  # fmt: skip

    def test_others_on_the_link_are_not_the_vehicle(self):
        with lab() as (vehicle, driver):
            states, rounds = driver.received["state"], itertools.count()
            gimbal = mavlink.MAVLink(vehicle, 1, 154)
            station = mavlink.MAVLink(vehicle, 254, 190)
            count = len(states)

            def speak():
                station.send(mavlink.MAVLink_heartbeat_message(6, 8, 209, 9, 4, 3))
                gimbal.send(mavlink.MAVLink_heartbeat_message(26, 3, 209, 9, 4, 3))
                return next(rounds) > 20 and len(states) > count + 2

            wait_for(speak, "more states")
            self.assertEqual({(state.mode, state.armed) for state in list(states)}, {("STABILIZE", False)})

    def test_the_other_form(self):
        with lab("--rate=4", program="roscopter_node.py") as (vehicle, driver):
            driver.call("arm", EmptySrv)
            self.assertTrue(vehicle.is_armed)
            driver.call("disarm", EmptySrv)
            self.assertFalse(vehicle.is_armed)
            asked = {message.req_message_rate for message in vehicle.named("REQUEST_DATA_STREAM")}
            self.assertEqual(asked, {4})
            vehicle.answers[mavlink.MAV_CMD_COMPONENT_ARM_DISARM] = mavlink.MAV_RESULT_DENIED
            with self.assertRaisesRegex(rospy.ServiceException, "DENIED"):
                driver.call("arm", EmptySrv)

    def test_no_device_at_the_start(self):
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder, "ttyUSB0")
            driver = Driver("--device=%s" % path)
            try:
                diagnostics = driver.subscribe("/diagnostics", DiagnosticArray)
                states = driver.subscribe("state", msg.State)
                wait_for(lambda: "cannot open %s" % path in self.summaries(diagnostics, driver), "the diagnosis")
                self.assertFalse(driver.command(APMCommandRequest.CMD_ARM))
                with Running(path):
                    wait_for(lambda: states, "the first state")
            finally:
                self.assertEqual(driver.end(), 0)

    def test_a_wrong_option_ends_it(self):
        driver = Driver("--enable-rc-control=perhaps")
        wait_for(lambda: driver.process.poll() is not None, "the end")
        self.assertEqual(driver.end(), 2)


if __name__ == "__main__":
    init_node("driver_rostest")
    rostest.rosrun("roscopter", "driver", DriverTest, sys.argv)
