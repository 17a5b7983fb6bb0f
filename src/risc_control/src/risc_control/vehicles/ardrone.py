"""Parrot AR.Drone (thesis 5.1): angles become fractions of full scales, thrust a climb rate; ardrone_autonomy topics.

Signs of /controls and cmd_vel, as in the original release: + phi moves left, + theta moves forward, + psi turns left.
All three are opposite to the angles phi, theta, psi of the states (+ right, + nose up, + clockwise).

A fraction of 1 commands the full scale of the vehicle (`euler_angle_max`, `control_yaw`). Its attitude loops settle at
`gain` times the command (1.17 in roll, 1.11 in pitch), so the wanted angle is divided by the gain here, where an angle
becomes a fraction, and nowhere else.
"""

import math

import numpy as np

from risc_control import vehicles
from risc_control.joystick import Sticks, limited
from risc_control.vehicles import Command, EventTopic, FlightState, Status, climb_command, climb_loops, greatest_command
from risc_lab.command_history import ROWS, Channel, CommandHistory, last_by
from risc_lab.compiled import compiled
from risc_lab.frames import GRAVITY_M_S2
from risc_lab.ros.sender import sender


class Adapter(vehicles.Adapter):
    """See `vehicles.Adapter`."""

    HOLDS_POSITION = True  # by its bottom camera and its height sensor
    REPORTS, LINK, COMMANDS = "navdata", "Wi-Fi", "cmd_vel"
    NODES = {"driver": "ardrone_driver"}
    EVENT_TOPICS = {
        "ardrone/takeoff": EventTopic("Empty", lambda _: "take-off ordered", each=True),
        "ardrone/land": EventTopic("Empty", lambda _: "landing ordered", each=True),
        "ardrone/reset": EventTopic("Empty", lambda _: "reset ordered (emergency)", each=True),
    }

    def __init__(self, vehicle_type, command_rate_hz):
        super().__init__(vehicle_type, command_rate_hz)
        self._loop = climb_loops([vehicle_type])[0]
        self._delay_s = vehicle_type.command_delay_s + 0.5 / command_rate_hz  # it waits for the vehicle's next slot
        self._unit = self.units(vehicle_type)
        climb_command(self._climb_ahead(0.0, 0.0, 0.0, CommandHistory(1).vehicles[0]), 0.0, self._loop)

    @staticmethod
    def units(vehicle_type):
        most = greatest_command(vehicle_type)
        return Command(-most.roll_rad, -most.pitch_rad, -most.yaw_rate_rad_s, 1.0)

    @staticmethod
    def climb_loop(vehicle_type):
        per_s = 1.0 / vehicle_type.climb_time_constant_s
        return per_s, per_s, vehicle_type.climb_max_m_s

    def answer(self, controls, own, own_s, now_s, sent):
        """Eqs 5.3-5.4 for the climb rate, at the moment the command takes effect; the rest are fractions already."""
        climb_m_s = self._climb_ahead(own.velocity_m_s[2], own_s, now_s, sent)
        up_m_s2 = controls.thrust_n * math.cos(own.phi_rad) * math.cos(own.theta_rad) / self.type.mass_kg - GRAVITY_M_S2
        up = climb_command(up_m_s2, climb_m_s, self._loop) / self.type.climb_max_m_s
        return Sticks(limited(controls.theta), limited(controls.phi), limited(up), limited(controls.psi))

    def move(self, forward_rad, left_rad, climb_m_s, own):
        tilts = (limited(tilt_rad / self.type.tilt_max_rad) for tilt_rad in (forward_rad, left_rad))
        return Sticks(*tilts, limited(climb_m_s / self.type.climb_max_m_s), 0.0)

    def settles_at(self, sticks, own):
        unit, climb_m_s = self._unit, sticks.up * self.type.climb_max_m_s
        roll_rad, pitch_rad = sticks.left * unit.roll_rad, sticks.forward * unit.pitch_rad
        return np.array((roll_rad, pitch_rad, climb_m_s, sticks.turn_left * unit.yaw_rate_rad_s))

    def _climb_ahead(self, climb_m_s, measured_s, now_s, sent):
        tau_s = self.type.climb_time_constant_s
        return climb_ahead(climb_m_s, measured_s, now_s + self._delay_s, sent, self._delay_s, tau_s)

    @staticmethod
    def listen(prefix, on_status, subscribe):
        from ardrone_autonomy.msg import Navdata  # the rest needs no ROS, but for Link

        def on_navdata(message):
            on_status(status(message), sender(message))

        subscribe(prefix + "ardrone/navdata", Navdata, on_navdata)

    @staticmethod
    def connect(prefix, name, on_refusal):
        return Link(prefix)


@compiled
def climb_ahead(climb_m_s, measured_s, until_s, sent, delay_s, tau_s):
    """Climb rate [m/s, + up] at until_s, by the nominal climb loop zdot' = (command - zdot) / tau.

    measured_s: when the vehicle climbed at climb_m_s.  sent: its HISTORY; commands take effect delay_s later.
    """
    k = last_by(sent, measured_s - delay_s, sent.newest)
    while measured_s < until_s:
        end_s = until_s
        if k < sent.newest:
            end_s = min(until_s, sent.times_s[(k + 1) % ROWS] + delay_s)
        command = sent.commands[k % ROWS, Channel.CLIMB]
        climb_m_s = command + (climb_m_s - command) * math.exp((measured_s - end_s) / tau_s)
        measured_s, k = end_s, k + 1
    return climb_m_s


def status(navdata):
    """Status of a Navdata; a packet without the vehicle's main block is published as state 0 with battery 0."""
    battery_pct = navdata.batteryPercent if navdata.state != FlightState.UNKNOWN else None
    level_m_s = (1e-3 * navdata.vx, -1e-3 * navdata.vy) if navdata.vx or navdata.vy else None  # 0, 0: not measured
    return Status(navdata.state, battery_pct, level_m_s)


class Link:
    """The topics of ardrone_autonomy, for one vehicle; with ROS only."""

    def __init__(self, prefix):
        import rospy  # the rest of the file needs none
        from geometry_msgs.msg import Twist
        from std_msgs.msg import Empty

        def publisher(topic, message):
            return rospy.Publisher(prefix + topic, message, queue_size=10, tcp_nodelay=True)

        self._twist = Twist()  # filled again and again
        self._cmd_vel = publisher("cmd_vel", Twist)
        # called directly
        self.take_off = publisher("ardrone/takeoff", Empty).publish
        self.land = publisher("ardrone/land", Empty).publish
        self.reset = publisher("ardrone/reset", Empty).publish  # motors off in the air
        self.topic = self._cmd_vel.resolved_name  # of the commands

    def send(self, sticks, level_only=False):
        """cmd_vel. level_only: the driver must not start the vehicle's own position hold."""
        twist = self._twist
        twist.linear.x, twist.linear.y, twist.linear.z, twist.angular.z = sticks
        twist.angular.x = 1.0 if level_only else 0.0  # any value but 0 keeps the driver from auto-hovering
        self._cmd_vel.publish(twist)

    def driver_overrides(self, driver):
        """{field of VehicleType: value} that the driver's node has set on the vehicle, by its parameters."""
        import rospy

        from risc_lab.lab.vehicle_types import legacy_overrides

        values = rospy.get_param(driver, {})
        namespace = self.topic.split("/")[-2]  # also of a node inside its vehicle's group, which has no prefix
        own = values.get("vehicles", {}).get(namespace, {})
        return legacy_overrides({**own, **values})  # as the driver does
