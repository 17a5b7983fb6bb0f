"""Surroundings of vehicle nodes, for their rostests: their inputs, and a record of what they publish."""

import random
import threading
import time

import rospy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Empty

from ardrone_autonomy.msg import Navdata
from risc_control.vehicles import adapter_class
from risc_lab.lab.vehicle_types import load_vehicle_type
from risc_lab.ros.testing import publishers_heard
from risc_lab.testing import wait_for
from risc_maap_msgs.msg import CommandsSent, Safety, VehicleStatus
from risc_msgs.msg import Control, Controls, Cortex, States, Trajectories, Trajectory

JOY_TO_WAY, EMERGENCY, SHUT_DOWN, TAKEOFF_LAND = 0, 2, 7, 6
LANDED, FLYING = 2, 3
HOVER_N = 0.45 * 9.80665
MOST_HZ = 31.0  # commands: 30 Hz is command_rate_hz
TIMEOUT_S = 60.0
NOISE_M = 1e-4  # of positions: exactly constant ones would look like frozen motion capture
ARDRONE = load_vehicle_type("ardrone")
STRAY_M_S = 0.5  # of a reference that leaves its vehicle, up to 1 m
PUBLISHED = {
    "cmd_vel": Twist,
    "ardrone/takeoff": Empty,
    "ardrone/land": Empty,
    "ardrone/reset": Empty,
    "controller_status": Bool,
    "safety": Safety,
    "vehicle_status": VehicleStatus,
}


def within(condition, seconds):
    """Whether the condition came true in that time."""
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.005)
    return True


class World:
    """Everything around the nodes: states and controls at 200 Hz, navdata at 50 Hz; records what the nodes publish.

    templates: {vehicle: its template}.  nodes: number of nodes that subscribe to states and controls.  flown: the
    vehicles in our controls; None: all.
    """

    def __init__(self, templates, nodes, flown=None):
        self.templates = templates
        self._flown = list(flown or templates)
        self.flight_state = dict.fromkeys(templates, LANDED)
        self.controls = dict.fromkeys(self.templates, (0.0, 0.0, 0.0, HOVER_N))
        self.visible = dict.fromkeys(self.templates, True)
        self.psi_deg = dict.fromkeys(self.templates, 0.0)
        self.turn_deg_s = dict.fromkeys(self.templates, 0.0)
        self.y_m = {vehicle: 1.5 * (k - 1) for k, vehicle in enumerate(templates)}  # none is near another one
        self.strays = set()  # vehicles whose references leave them
        self.passers = {}  # {template: y [m]} of vehicles that no node here flies
        self.running = True
        self.sent = set()  # stamps of states and controls
        self.sent_s = 0.0  # [s] monotonic, of the newest ones
        self._ended = False
        self.received = {(v, t): [] for v in self.templates for t in PUBLISHED}  # [(monotonic time, message)]
        self.told = {template: [] for template in self.templates.values()}  # CommandSent, as they came
        self._reports = {}  # template: {key: value} of its node's diagnostics
        self._subscribers = [
            rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics),
            rospy.Subscriber("/commands_sent", CommandsSent, self._on_commands_sent),
        ]
        for vehicle in self.templates:
            for topic, kind in PUBLISHED.items():
                key = (vehicle, topic)
                self._subscribers.append(
                    rospy.Subscriber(
                        "/%s/%s" % key, kind, lambda m, key=key: self.received[key].append((time.monotonic(), m))
                    )
                )
        self._states = rospy.Publisher("/cortex_raw", Cortex, queue_size=1)
        self._controls = rospy.Publisher("/controls", Controls, queue_size=1)
        self._references = rospy.Publisher("/trajectory", Trajectories, queue_size=1)
        self._navdata = {v: rospy.Publisher("/%s/ardrone/navdata" % v, Navdata, queue_size=1) for v in self.templates}
        self._joy = {v: rospy.Publisher("/%s/joy" % v, Joy, queue_size=10) for v in self.templates}
        wait_for(lambda: all(map(publishers_heard, self._subscribers)), "all topics of the nodes")
        wait_for(lambda: all(p.get_num_connections() for p in (*self._navdata.values(), *self._joy.values())), "inputs")
        for publisher in (self._states, self._controls, self._references):
            wait_for(lambda p=publisher: p.get_num_connections() == nodes, "inputs")
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        rate = rospy.Rate(200)
        step, turned_s = 0, time.monotonic()
        while not self._ended:
            before_s, turned_s = turned_s, time.monotonic()
            if self.running:
                self.sent_s = time.monotonic()  # before the stamp: no age is reckoned from an earlier moment
                stamp = rospy.Time.now()
                self.sent.add(stamp)
                states, controls = Cortex(), Controls()
                for name, y_m in self.passers.items():
                    states.Obj.append(States(name=name, visible=True, x=random.gauss(0.0, NOISE_M), y=y_m, z=1.0))
                states.header.stamp = controls.header.stamp = stamp
                references = Trajectories(header=states.header)
                for vehicle, template in reversed(list(self.templates.items())):  # by name, not by index (D-27)
                    y_m = self.y_m[vehicle]
                    seen = States(name=template, visible=self.visible[vehicle], y=y_m, z=1.0)
                    self.psi_deg[vehicle] += self.turn_deg_s[vehicle] * (turned_s - before_s)
                    seen.x, seen.psi = random.gauss(0.0, NOISE_M), (self.psi_deg[vehicle] + 180.0) % 360.0 - 180.0
                    states.Obj.append(seen)
                    reference = Trajectory(name=template, y=y_m, z=1.0)
                    if vehicle in self.strays:  # there and back again
                        reference.ydot = STRAY_M_S if step % 800 < 400 else -STRAY_M_S
                        reference.y += STRAY_M_S * 0.005 * min(step % 800, 800 - step % 800)
                    references.Obj.append(reference)
                    if vehicle in self._flown:
                        controls.Obj.append(Control(template, *self.controls[vehicle]))
                self._states.publish(states)
                self._references.publish(references)
                self._controls.publish(controls)
            if step % 4 == 0:
                for vehicle, publisher in self._navdata.items():
                    publisher.publish(Navdata(state=self.flight_state[vehicle], batteryPercent=80.0))
            step += 1
            rate.sleep()

    def _on_commands_sent(self, message):
        for command in message.commands:
            self.told.setdefault(command.name, []).append(command)

    def _on_diagnostics(self, message):
        for status in message.status:
            values = {item.key: item.value for item in status.values}
            self._reports[values.get("vehicle")] = values

    def end(self):
        self._ended = True
        self._thread.join()

    def press(self, vehicle, button, late_s=0.0):
        """Press a button and let go. late_s: age of the messages when they are sent."""
        self.hold(vehicle, button, late_s)
        self.hold(vehicle, None, late_s)

    def hold(self, vehicle, button, late_s=0.0):
        """Send one joystick message with this button down; None: no button."""
        self.send_joy(vehicle, Joy(axes=[0.0] * 8, buttons=[1 if k == button else 0 for k in range(11)]), late_s)

    def send_joy(self, vehicle, joy, late_s=0.0):
        """Send a joystick message. late_s: its age when it is sent."""
        joy.header.stamp = rospy.Time.now() - rospy.Duration(late_s)
        self._joy[vehicle].publish(joy)

    def messages(self, vehicle, topic):
        return [message for _, message in self.received[vehicle, topic]]

    def forget(self):
        for received in (*self.received.values(), *self.told.values()):
            del received[:]

    def answers(self, vehicle):
        """Commands sent to it that answer /controls; manual commands and those of a hold answer nothing."""
        return [command for command in self.told[self.templates[vehicle]] if not command.answers.is_zero()]

    def wait(self, vehicle, topic, fits=lambda message: True):
        found = within(lambda: any(map(fits, self.messages(vehicle, topic))), TIMEOUT_S)
        assert found, "%s of %s, of\n%s" % (topic, vehicle, self.messages(vehicle, topic)[:20])

    def wait_for_state(self, vehicle, state):
        """Wait until the vehicle's node knows by navdata that the vehicle is in this state."""
        reports, template = self._reports, self.templates[vehicle]
        wait_for(lambda: reports.get(template, {}).get("flight state") == str(state), "state of %s" % vehicle)

    def let_pass(self, vehicle, statuses=15):
        """Wait half a second of the node's own time: it reports its mode 30 times a second at most."""
        self.forget()
        wait_for(lambda: len(self.received[vehicle, "controller_status"]) >= statuses, "status of %s" % vehicle)

    def fly(self):
        """Bring all from the ground into the air and into autonomous mode; keep what comes after the take-off."""
        self.flight_state = dict.fromkeys(self.templates, LANDED)
        self.forget()
        for vehicle in self.templates:  # on the ground the mode becomes manual, and the ladder begins anew
            self.wait(vehicle, "controller_status", lambda m: not m.data)
        self.flight_state = dict.fromkeys(self.templates, FLYING)
        self.forget()
        for vehicle in self.templates:
            # Only flying vehicles are commanded: the node knows that it flies. These commands are level: after ten
            # of them no earlier climb command is under way, with which the prediction of the climb rate would begin.
            wait_for(lambda v=vehicle: len(self.messages(v, "cmd_vel")) >= 10, "manual commands of %s" % vehicle)
            wait_for(lambda v=vehicle: self._switches_to_autonomous(v), "autonomous mode of %s" % vehicle)

    def fly_by_controls(self):
        """`fly`, until every vehicle is commanded as the controls of tests 4 to 9 say."""
        self.controls = dict.fromkeys(self.templates, (0.2, 0.2, 0.2, HOVER_N))
        self.fly()
        for vehicle in self.templates:
            self.wait(vehicle, "cmd_vel", is_flown)

    def _switches_to_autonomous(self, vehicle):
        """Press the button. A node refuses while this computer stalls: its state is too old then."""

        def is_autonomous():
            return [m.data for m in self.messages(vehicle, "controller_status")[-1:]] == [True]

        self.press(vehicle, JOY_TO_WAY)
        return within(is_autonomous, 3.0)


def same(twist, x, y, z, yaw):
    wanted, found = (x, y, z, yaw), (twist.linear.x, twist.linear.y, twist.linear.z, twist.angular.z)
    return all(abs(a - b) < 0.01 for a, b in zip(wanted, found))


def twist_of(command):
    """cmd_vel of a CommandSent."""
    twist, unit = Twist(), adapter_class(ARDRONE).units(ARDRONE)
    twist.linear.x, twist.linear.y = command.pitch_rad / unit.pitch_rad, command.roll_rad / unit.roll_rad
    twist.linear.z = command.climb / ARDRONE.climb_max_m_s
    twist.angular.z = command.yaw_rate_rad_s / unit.yaw_rate_rad_s
    return twist


def equal(one, other):
    """Whether two Twists are the same command."""
    return all(
        abs(a - b) < 1e-9
        for a, b in (
            (one.linear.x, other.linear.x),
            (one.linear.y, other.linear.y),
            (one.linear.z, other.linear.z),
            (one.angular.z, other.angular.z),
        )
    )


def is_zero(twist):
    return same(twist, 0.0, 0.0, 0.0, 0.0)


def is_flown(twist):
    """The command of `World.fly_by_controls`; its climb contains the predicted climb rate."""
    return same(twist, 0.2, 0.2, twist.linear.z, 0.2)
