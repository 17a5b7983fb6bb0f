"""IRIS+ vehicles for tests, and a pilot's hands on their sticks."""

import dataclasses
import functools
import math

from addresses import free_port, own_net

from risc_lab.lab import fleet_from_dict, load_templates, load_vehicle_type
from risc_simulator.vehicles.iris.firmware import RcFrame
from risc_simulator.world import World

TYPE = load_vehicle_type("iris")
NAMES = ["fluffy_II", "albatross", "Raven", "Condor"]
FRAME_S = 0.02
LOWEST_US, CENTRE_US, HIGHEST_US = 1000, 1500, 2000


def make_fleet(n=1, kind="iris", **extra):
    net = own_net()
    vehicles = [
        {
            "namespace": "iris%d" % (i + 1),
            "template": NAMES[i],
            "type": kind,
            "address": "%s.2.%d" % (net, i + 1),
            "start": {"position_m": [1.2 * (i % 2), 1.2 * (i // 2), 0.0], "yaw_deg": 0},
        }
        for i in range(n)
    ]
    content = {"name": "test", "mocap": {"host": net + ".0.2", "stream_port": free_port()}, "vehicles": vehicles}
    return fleet_from_dict({**content, **extra})


def make_world(n=1, changes=None, fleet=None, **options):
    """Make a World. changes: {field of the vehicle type: value}."""
    options.setdefault("perturbed", False)
    fleet = fleet or make_fleet(n)
    return World(fleet, {"iris": dataclasses.replace(TYPE, **changes or {})}, load_templates(fleet=fleet), **options)


class Hands:
    """Sends frames of channels to an IRIS+, as its receiver does, and steps the world meanwhile."""

    def __init__(self, world, namespace="iris1"):
        self.world, self.vehicle = world, world.vehicles[namespace]
        self.autopilot = self.vehicle.firmware

    def send(self, duration_s, roll=CENTRE_US, pitch=CENTRE_US, throttle=LOWEST_US, yaw=CENTRE_US, until=None):
        """Repeat a frame for duration_s or until `until()`. Returns whether that became true; True without `until`."""
        end_s = self.world.time_s + duration_s
        while self.world.time_s < end_s - 1e-9:
            throttle_us = throttle() if callable(throttle) else throttle
            self.vehicle.schedule(self.world.time_s, RcFrame((roll, pitch, throttle_us, yaw)))
            self.world.step_to(self.world.time_s + FRAME_S)
            if until is not None and until():
                return True
        return until is None

    def wait(self, duration_s):
        """Let time pass without frames from the receiver."""
        self.world.step_to(self.world.time_s + duration_s)

    def arm(self):
        self.send(0.1)
        assert self.autopilot.arm() == ""
        self.send(0.04)
        assert self.autopilot.armed

    def throttle_for(self, up_m_s2=0.0):
        """Throttle [us] that gives this vehicle an upward acceleration while it is level."""
        plant = self.vehicle.plant
        thrust = plant.mass_kg * up_m_s2 / (plant.nominal_mass_kg * plant.thrust_scale * 9.80665)
        return round(CENTRE_US + 500.0 * (self.autopilot.hover_throttle(self.vehicle.battery_pct) + thrust))

    def keep(self, height_m):
        """Throttle [us] that flies to a height and holds it."""
        error_m, climb_m_s = height_m - self.vehicle.height_m, self.vehicle.state.velocity_m_s[2]
        return self.throttle_for(min(2.0, max(-2.0, 4.0 * error_m - 3.5 * climb_m_s)))

    def stay(self, position_m):
        """Roll and pitch sticks [us] that fly a vehicle facing along x to a position."""
        state, kind = self.vehicle.state, self.vehicle.type
        away_m, speed_m_s = state.position_m - position_m, state.velocity_m_s
        angles = [-(2.0 * d + 2.0 * v) / 9.80665 for d, v in zip(away_m[:2], speed_m_s[:2])]
        pitch, roll = (-min(0.15, max(-0.15, angle)) / kind.tilt_max_rad for angle in angles)
        return [round(CENTRE_US + math.copysign(20, stick) + 480 * stick) for stick in (roll, pitch)]

    def fly_to(self, height_m, duration_s=4.0):
        self.send(duration_s, throttle=functools.partial(self.keep, height_m))

    def take_off(self, height_m=1.0):
        self.arm()
        self.fly_to(height_m)
        assert abs(self.vehicle.height_m - height_m) < 0.05

    def texts(self):
        """What the autopilot has said since the last call."""
        said = [text for _, text in self.autopilot.texts]
        self.autopilot.texts.clear()
        return said
