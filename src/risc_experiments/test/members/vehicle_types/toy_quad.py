"""A type that differs from the AR.Drone wherever an adapter may: radians on /controls, and a stick for thrust.

`up` is the thrust, from none at -1 to `lift` weights at 1: it holds no height by itself.
"""

from dataclasses import dataclass

import numpy as np

from risc_control import vehicles
from risc_control.joystick import Sticks, limited
from risc_control.vehicles import Status
from risc_lab.frames import GRAVITY_M_S2
from risc_lab.lab.vehicle_types import own_numbers
from risc_lab.ros.sender import sender
from risc_lab.settings import Settings, between

CLIMB_GAIN_1_S = 3.0  # of the climb rate loop, used when no thrust is commanded


@dataclass(frozen=True)
class Params(Settings):
    """The numbers under `own` in its YAML file; adapter and virtual vehicle read them."""

    lift: between(1.5, 10.0)  # [weights] of the full stick

    def weights(self, up):
        """Thrust [weights] of a stick position."""
        return 0.5 * self.lift * (1.0 + up)


class Adapter(vehicles.Adapter):
    """See the module."""

    PARAMS = Params
    NODES = {"driver": "toy_commands"}

    @staticmethod
    def climb_loop(vehicle_type):
        """The loop takes an acceleration; 1 is that of gravity."""
        return GRAVITY_M_S2, 0.0, min(1.0, own_numbers(vehicle_type, Params).lift - 1.0)

    def answer(self, controls, own, own_s, now_s, sent):
        """Radians and newtons -> fractions."""
        return self._sticks(-controls.theta, -controls.phi, controls.thrust_n, -controls.psi)

    def move(self, forward_rad, left_rad, climb_m_s, own):
        """Holds the climb rate by the thrust."""
        up_m_s2 = CLIMB_GAIN_1_S * (climb_m_s - (own.velocity_m_s[2] if own else 0.0))
        return self._sticks(forward_rad, left_rad, self.type.mass_kg * (GRAVITY_M_S2 + up_m_s2), 0.0)

    def by_hand(self, sticks, own):
        """The operator's `up` is a climb rate."""
        up = self.move(0.0, 0.0, sticks.up * self.type.climb_max_m_s, own).up
        return sticks._replace(up=up)

    def settles_at(self, sticks, own):
        """Its climb loop takes an acceleration."""
        roll_rad, pitch_rad = (-tilt * self.type.tilt_max_rad for tilt in (sticks.left, sticks.forward))
        yaw_rate_rad_s = -sticks.turn_left * self.type.yaw_rate_max_rad_s
        return np.array((roll_rad, pitch_rad, self.numbers.weights(sticks.up) - 1.0, yaw_rate_rad_s))

    def _sticks(self, forward_rad, left_rad, thrust_n, left_rad_s):
        tilt_rad, weight_n = self.type.tilt_max_rad, self.type.mass_kg * GRAVITY_M_S2
        sticks = forward_rad / tilt_rad, left_rad / tilt_rad, 2.0 * thrust_n / (self.numbers.lift * weight_n) - 1.0
        return Sticks(*map(limited, sticks), limited(left_rad_s / self.type.yaw_rate_max_rad_s))

    @staticmethod
    def listen(prefix, on_status, subscribe):
        from std_msgs.msg import Float32MultiArray

        def on_message(message):
            state, battery_pct = message.data
            on_status(Status(int(state), battery_pct), sender(message))

        subscribe(prefix + "toy/status", Float32MultiArray, on_message)

    @staticmethod
    def connect(prefix, name, on_refusal):
        return Link(prefix)


class Link:
    """Publisher to the command node; the status node's topic is toy/status."""

    def __init__(self, prefix):
        import rospy
        from std_msgs.msg import String

        commands = rospy.Publisher(prefix + "toy/command", String, queue_size=10)
        self.topic = commands.resolved_name
        self._command = commands.publish

    def take_off(self):
        self._command("take_off")

    def land(self):
        self._command("land")

    def reset(self):
        self._command("cut_motors")

    def send(self, sticks, level_only=False):
        self._command("sticks %g %g %g %g" % sticks)

    def driver_overrides(self, driver):
        return {}
