"""A vehicle that does not hover by itself, with its pilot, on a clock that the test advances."""

import math

import numpy as np
from joystick_desk import TAKEOFF_LAND, TOGGLE, JoystickDesk

from risc_control.joystick import Sticks
from risc_control.separation import ALONE
from risc_control.vehicle_pilot import OwnState, VehicleNodeParams, VehiclePilot
from risc_control.vehicles import Command, Controls, ControlsConverter, FlightState, Status
from risc_control.vehicles.iris import hover_throttle, without_dead_zone
from risc_lab.frames import GRAVITY_M_S2 as G
from risc_lab.lab import load_vehicle_type
from risc_lab.lab.vehicle_types import own_numbers
from risc_lab.radio_sticks import RadioSticks

IRIS = load_vehicle_type("iris")
DEAD = own_numbers(IRIS, RadioSticks).stick_dead_zone
STEP_S, LATENCY_S, REST_M = 0.005, 0.006, 0.1


class Iris:
    """Autopilot and vehicle; cortex frame. more: factor on the thrust for a given throttle, e.g. 0.9.

    quicker: factor on the bandwidth of its attitude loops.  level_rad: roll and pitch that it takes for level.
    trim_rad: roll and pitch that it reads from centred sticks.
    """

    def __init__(self, more=1.0, battery_pct=60.0, delay_s=0.05, quicker=1.0, level_rad=(0.0, 0.0)):
        self.more, self.battery_pct, self._delay_s = more, battery_pct, delay_s
        self.quicker, self.level_rad, self.trim_rad = quicker, level_rad, (0.0, 0.0)
        self.position_m, self.velocity_m_s = [0.3, -0.2, REST_M], [0.0, 0.0, 0.0]
        self.angles_rad, self.rates_rad_s = [0.0, 0.0, 0.4], [0.0, 0.0, 0.0]
        self.armed, self.mode, self.arms = False, "STABILIZE", True
        self.impact_m_s = 0.0
        self._under_way, self.sticks = [], Sticks(0.0, 0.0, -1.0, 0.0)
        self.heard_s = 0.0  # when it last received sticks

    def send(self, sticks, now_s):
        self._under_way.append((now_s + self._delay_s, sticks))

    def take_off(self):
        self.mode = "STABILIZE"
        if self.arms and self.sticks.up <= -0.99:
            self.armed = True

    def disarm(self):
        if self.stands:
            self.armed = False

    @property
    def stands(self):
        return self.position_m[2] <= REST_M + 1e-6

    @property
    def state(self):
        flying = FlightState.FLYING if self.mode == "STABILIZE" else FlightState.OTHER_MODE
        return (FlightState.LANDING if self.mode == "LAND" else flying) if self.armed else FlightState.LANDED

    def own(self):
        return OwnState(tuple(self.position_m), tuple(self.velocity_m_s), *self.angles_rad)

    def step(self, now_s):
        while self._under_way and self._under_way[0][0] <= now_s:
            self.heard_s, self.sticks = self._under_way.pop(0)
        if self.armed and now_s - self.heard_s > 1.0:  # failsafe of the board, then of the autopilot
            self.mode = "LAND"
        roll, pitch, turn = (
            -without_dead_zone(stick, DEAD) for stick in (self.sticks.left, self.sticks.forward, self.sticks.turn_left)
        )
        thrust_m_s2 = G * self.more * (1.0 + self.sticks.up - hover_throttle(IRIS, self.battery_pct))
        if self.mode == "LAND":
            thrust_m_s2 = G + 3.0 * (-0.5 - self.velocity_m_s[2])
            self.armed = self.armed and not self.stands
        thrust_m_s2 = max(0.0, thrust_m_s2) if self.armed else 0.0
        phi, theta, psi = self.angles_rad
        for axis, wanted in enumerate((roll * IRIS.tilt_max_rad, pitch * IRIS.tilt_max_rad)):
            wn, zeta = 15.0 * self.quicker, 0.8
            wanted += self.level_rad[axis] + self.trim_rad[axis]
            bends = wn * wn * (wanted - self.angles_rad[axis]) - 2.0 * zeta * wn * self.rates_rad_s[axis]
            self.rates_rad_s[axis] += STEP_S * bends
            self.angles_rad[axis] += STEP_S * self.rates_rad_s[axis]
        self.rates_rad_s[2] += STEP_S * (turn * IRIS.yaw_rate_max_rad_s - self.rates_rad_s[2]) / 0.1
        self.angles_rad[2] += STEP_S * self.rates_rad_s[2]
        forward, right = -thrust_m_s2 * math.sin(theta), thrust_m_s2 * math.cos(theta) * math.sin(phi)
        north = math.cos(psi) * forward - math.sin(psi) * right
        east = math.sin(psi) * forward + math.cos(psi) * right
        pushes = north, -east, thrust_m_s2 * math.cos(phi) * math.cos(theta) - G
        for axis, push_m_s2 in enumerate(pushes):
            self.velocity_m_s[axis] += STEP_S * (push_m_s2 - 0.2 * self.velocity_m_s[axis])
            self.position_m[axis] += STEP_S * self.velocity_m_s[axis]
        if self.position_m[2] <= REST_M:
            self.impact_m_s = max(self.impact_m_s, -self.velocity_m_s[2])
            self.position_m[2], self.velocity_m_s = REST_M, [0.0, 0.0, max(0.0, self.velocity_m_s[2])]
            self.angles_rad[:2] = self.rates_rad_s[:2] = [0.0, 0.0]


class Sensors:
    """What the autopilot reports of tilt and height, at 10 Hz, with the errors of the virtual IRIS+.

    late_s: delay of the reports.  stuck: the last report is repeated.
    """

    def __init__(self, seed, late_s=0.08):
        self.late_s, self.stuck = late_s, False
        self._rng, self._on_the_way = np.random.default_rng(seed), []
        self._barometer, self._drift, self._climb = 0.06, 0.3, 0.03  # errors, one standard deviation at first

    def heard(self, iris, now_s):
        """Status of each report that arrives now."""
        noise = self._rng.standard_normal
        self._barometer, self._drift, self._climb = (
            math.exp(-0.1 / tau_s) * error + std * math.sqrt(-math.expm1(-0.2 / tau_s)) * noise()
            for error, std, tau_s in ((self._barometer, 0.06, 0.3), (self._drift, 0.3, 60.0), (self._climb, 0.03, 10.0))
        )
        tilt_rad = tuple(a - b + 0.0009 * noise() for a, b in zip(iris.angles_rad, iris.level_rad))
        height_m = iris.position_m[2] + self._drift + self._barometer
        climb_m_s = iris.velocity_m_s[2] + self._climb + 0.03 * noise()
        report = Status(FlightState.UNKNOWN, None, tilt_rad=tilt_rad, height_m=height_m, climb_m_s=climb_m_s)
        if self.stuck and self._on_the_way:
            report = self._on_the_way[-1][1]
        self._on_the_way.append((now_s + self.late_s + 0.02 * self._rng.random(), report))
        arrived = [report for due_s, report in self._on_the_way if due_s <= now_s]
        self._on_the_way = [item for item in self._on_the_way if item[0] > now_s]
        return arrived


class Desk(JoystickDesk):
    """A pilot with its vehicle: ticks at 66 Hz, states and controls at 200 Hz, telemetry at 4 Hz, the board at 10 Hz,
    and the joystick at 20 Hz from its first message on.

    alive: what works; without "radio" nothing that is sent arrives, without "state" motion capture runs but does not
    see it, without "frames" no frames come.  fly: function of the desk that gives the controller's `Command`.
    """

    def __init__(self, iris=None, fly=None, **params):
        self.iris, self.now_s = iris or Iris(), 500.0
        self.pilot = VehiclePilot(
            VehicleNodeParams(**{"joystick_timeout": 0.0, "preflight": False, **params}), IRIS, self.now_s
        )
        self.alive = {"state", "frames", "telemetry", "board", "radio", "node"}
        self.look, self.fly, self.sensors, self.seen = ALONE, fly, None, lambda own: own
        self.sent, self.said, self.states = [], [], []  # (time, Sticks); (time, level, text); FlightStates, in turn
        self.counts = dict.fromkeys(("takeoff", "land", "reset", "disarm"), 0)
        self._converter, self._step = ControlsConverter([IRIS]), 0
        self.run(1.0)

    def take(self, orders):
        for what in self.counts:
            self.counts[what] += getattr(orders, what)
        self.said += [(self.now_s, *said) for said in orders.log]
        if orders.command is not None:
            self.sent.append((self.now_s, orders.command.sticks))
            if {"radio", "board"} <= self.alive:
                self.iris.send(orders.command.sticks, self.now_s)
        if "telemetry" in self.alive:
            if orders.takeoff:
                self.iris.take_off()
            if orders.land and self.iris.armed:
                self.iris.mode = "LAND"
            if orders.disarm:
                self.iris.disarm()
            if orders.reset:
                self.iris.armed = False
        return orders

    def run(self, duration_s, until=None):
        """Run for at most duration_s; return whether `until` came true."""
        for _ in range(round(duration_s / STEP_S)):
            self.now_s += STEP_S
            self._step += 1
            self.iris.step(self.now_s)
            if "node" in self.alive:
                self._hear()
            if until is not None and until():
                return True
        return False

    def _hear(self):
        pilot, now_s, own = self.pilot, self.now_s, self.iris.own()
        if self._step % 3 == 0 and {"state", "frames"} <= self.alive:
            pilot.on_state(self.seen(own), LATENCY_S, now_s, self.look)
        elif self._step % 3 == 0 and "frames" in self.alive:
            pilot.on_unseen()
        if self.fly is not None and (command := self.fly(self)) is not None:
            controls, _ = self._converter(
                Command(*(np.array([part]) for part in command)), np.array([True]), np.array([False])
            )
            self.take(pilot.on_controls(Controls(*(part[0] for part in controls)), now_s, LATENCY_S, now_s))
        if self._step % 50 == 0 and "telemetry" in self.alive:
            battery_pct = math.ceil(self.iris.battery_pct)
            self._converter.tell_battery(0, battery_pct, now_s)
            self.take(pilot.on_status(Status(self.iris.state, battery_pct), now_s))
        if self.sensors is not None and self._step % 20 == 0 and "telemetry" in self.alive:
            for status in self.sensors.heard(self.iris, now_s):
                self.take(pilot.on_status(status, now_s))
        if self._step % 20 == 0 and "board" in self.alive:
            pilot.on_wire(now_s)
        if self.message is not None and self._step % 10 == 0:
            self.repeat()
        if self._step % 3 == 0:
            self.take(pilot.tick(now_s))
        if not self.states or self.states[-1] != pilot.flight_state:
            self.states.append(pilot.flight_state)

    def up(self):
        """Take off, and wait until it hovers."""
        self.press(TAKEOFF_LAND)
        assert self.run(8.0, lambda: self.pilot.flight_state == FlightState.HOVERING), self.said
        return self

    def wait_for(self, state, duration_s):
        assert self.run(duration_s, lambda: self.pilot.flight_state == state), (self.pilot.flight_state, self.said)


def level_at(height_m):
    """A controller that holds a height, level, without an integral."""

    def fly(desk):
        own = desk.iris.own()
        up_m_s2 = 8.0 * (height_m - own.position_m[2]) - 4.0 * own.velocity_m_s[2]
        return Command(0.0, 0.0, 0.0, IRIS.mass_kg * (G + up_m_s2))

    return fly


def circling(desk):
    """A controller that flies a circle, up and down."""
    if not hasattr(desk, "integrals"):
        desk.integrals = np.zeros(3)
    own, angle = desk.iris.own(), 0.45 * desk.now_s
    cosine, sine = math.cos(angle), math.sin(angle)
    place, speed = np.array((cosine, sine, 1.0 + 0.3 * sine)), 0.45 * np.array((-sine, cosine, 0.3 * cosine))
    errors = np.clip(place - own.position_m, -0.5, 0.5)
    desk.integrals += STEP_S * errors
    x, y, up_m_s2 = 3.0 * errors + 2.8 * (speed - own.velocity_m_s) + desk.integrals - 0.2 * place * (1.0, 1.0, 0.0)
    psi = own.psi_rad
    forward, right = math.cos(psi) * x - math.sin(psi) * y, -math.sin(psi) * x - math.cos(psi) * y
    roll_rad, pitch_rad = (max(-0.25, min(0.25, math.atan2(part, G))) for part in (right, -forward))
    return Command(roll_rad, pitch_rad, 0.0, IRIS.mass_kg * (G + up_m_s2))


def flown(more=0.9, **params):
    """Desk in autonomous mode, after a hover of a few seconds."""
    desk = Desk(Iris(more=more), **params).up()
    desk.run(4.0)
    desk.fly = level_at(desk.iris.position_m[2])
    desk.run(0.1)
    assert desk.press(TOGGLE).mode is True, desk.said
    return desk


def said(desk):
    return " ".join(text for _, _, text in desk.said)
