"""The world of the virtual lab: N vehicles in the net, stepped together, bit for bit reproducible from the seed.

Time is world time in seconds from 0, on a fixed grid. Actions are applied at the first grid time that is not before
theirs. Everything outside (positions, velocities) is in the cortex frame; inside it is the state of
models/quadrotor.py.
"""

import heapq
import math
from collections import deque

import numpy as np

from risc_control.frames import GRAVITY_M_S2, rotation_body_to_cortex, wrap_angle
from risc_control.lab.arena import NET_HALF_X_M, NET_HALF_Y_M, NET_HEIGHT_M
from risc_simulator.models.ardrone_firmware import ArdroneFirmware
from risc_simulator.models.flight import Crash, FlightAction, FlightPhase, Setpoint, VehicleState
from risc_simulator.models.plant import draw_plant, stack_plants
from risc_simulator.models.quadrotor import Quadrotors, U, X

__all__ = ["Crash", "FlightAction", "FlightPhase", "Setpoint", "Vehicle", "VehicleState", "World"]

NET_REBOUND_M_S = 0.5
REST_HEIGHT_M = 0.08  # of a vehicle's centre above the floor when it stands
COLLISION_DISTANCE_M = 0.5  # between centres, in any direction: indoor hulls are 0.52 m across and give way a little

GUST_STD_M_S = (0.4, 0.4, 0.2)  # north, east, up: people, doors, the other vehicles' downwash
GUST_TIME_CONSTANT_S = 1.5  # first-order (Dryden-like) correlation
_GUST_BLOCK = 1024  # steps drawn at once

_FIRMWARE = {"ardrone": ArdroneFirmware}  # on-board logic by the name of the vehicle type

# What each random stream of a vehicle is for; the numbers are part of what a seed means.
_PLANT_STREAM, _FIRMWARE_STREAM, _GUST_STREAM = range(3)


class Vehicle(object):
    """One vehicle of the world, as hosts and studies see it."""

    def __init__(self, world, index, fleet_vehicle, vehicle_type, markers_m, plant, firmware):
        self.namespace = fleet_vehicle.namespace
        self.name = self.template = fleet_vehicle.template  # its name in motion capture and on every topic
        self.markers_m = markers_m  # (n, 3) markers it carries, body axes (forward, right, down)
        self.type = vehicle_type  # VehicleType: the nominal vehicle
        self.plant = plant  # PlantParams: the true one
        self.firmware = firmware
        self._world, self._index = world, index

    def schedule(self, time_s, action):
        """Let a Setpoint or FlightAction reach the vehicle's logic when world time passes time_s (a past time: now)."""
        self._world._schedule(time_s, self._index, action)

    @property
    def phase(self):
        """FlightPhase at world time."""
        return self.firmware.phase

    @property
    def state(self):
        """VehicleState at world time."""
        return self._world._state(self._index)

    def set_battery_pct(self, pct):
        """Change the battery's charge now."""
        self.firmware.set_battery_pct(pct, self._world.time_s)

    def fly_at(self, position_m, yaw_rad=0.0):
        """Put the vehicle into the air at this place (cortex frame), hovering: a start for offline studies."""
        self._world._place_in_flight(self._index, position_m, yaw_rad)


class World(object):
    """All vehicles and landmarks. One thread at a time."""

    def __init__(
        self, fleet, vehicle_types, templates, seed=0, honest=True, gusts=False, step_s=0.005, collisions=True
    ):
        """fleet: Fleet. vehicle_types: VehicleType by the name used in the fleet. templates: Template by name.

        honest: true plants are drawn around the nominal ones. gusts: moving air. step_s: grid (see test_quadrotor.py
        for what it costs in accuracy). collisions: vehicles in the air cannot pass through each other, and
        least_separation_m is measured. Raises ValueError when fleet, types and templates do not fit each other.
        """
        if not 0.0 < step_s <= 0.02:
            raise ValueError("step_s must be in (0, 0.02], got %r" % (step_s,))
        self.step_s = step_s
        self.gusts = gusts
        self.crashes = deque(maxlen=1000)  # Crash, newest last
        self._collisions = collisions
        self._pairs = None  # (indices, indices) of the vehicles in the air, two by two; None when there are no two
        self._least_squared_m2 = math.inf
        self._steps = 0
        self._agenda, self._agenda_count = [], 0

        n = len(fleet.vehicles)
        self._x = np.zeros((len(X), n))
        self._u = np.zeros((len(U), n))
        vehicles = []
        for i, fleet_vehicle in enumerate(fleet.vehicles):
            vehicle_type = _look_up(vehicle_types, fleet_vehicle.type, "vehicle type")
            firmware_class = _look_up(_FIRMWARE, vehicle_type.name, "on-board logic for vehicle type")
            markers_m = _look_up(templates, fleet_vehicle.template, "mocap template").markers_m
            plant = draw_plant(vehicle_type, _rng(seed, i, _PLANT_STREAM), honest)
            firmware = firmware_class(vehicle_type, _rng(seed, i, _FIRMWARE_STREAM), honest, REST_HEIGHT_M)
            vehicles.append(Vehicle(self, i, fleet_vehicle, vehicle_type, markers_m, plant, firmware))
            x, y, _ = fleet_vehicle.start_position_m  # height is the floor's: it stands
            if abs(x) > NET_HALF_X_M or abs(y) > NET_HALF_Y_M:
                raise ValueError(
                    "%s starts outside the net (|x| <= %.2f m, |y| <= %.2f m): change its start in the "
                    "fleet file" % (fleet_vehicle.namespace, NET_HALF_X_M, NET_HALF_Y_M)
                )
            self._x[: X.H + 1, i] = x, -y, REST_HEIGHT_M
            self._x[X.PSI, i] = fleet_vehicle.start_yaw_rad
        self.vehicles = {vehicle.namespace: vehicle for vehicle in vehicles}
        self._vehicles = vehicles
        self._landmark_bodies = [
            (
                mark.name,
                _look_up(templates, mark.name, "mocap template").markers_m @ _turned(mark.facing_rad).T
                + np.array(mark.position_m),
            )
            for mark in fleet.landmarks
        ]

        self._quadrotors = Quadrotors(stack_plants([vehicle.plant for vehicle in vehicles]))
        self._inputs_changed = True
        self._needing_step = []
        self._standing = np.ones((len(X), n), dtype=bool)
        self._any_standing = True
        self._rest = self._x.copy()
        self._trim_step = np.zeros(n)  # [1/s] integral gain times step; 0 while not lifted
        self._trim_gain = np.array([vehicle.firmware.climb_integral_1_s2 for vehicle in vehicles]) * step_s
        self._trim_limit = np.array([vehicle.firmware.climb_trim_limit_m_s2 for vehicle in vehicles])
        self._trim_low = -self._trim_limit
        self._trim_error = np.empty(n)
        self._low = np.repeat([[-NET_HALF_X_M], [-NET_HALF_Y_M], [REST_HEIGHT_M]], n, axis=1)
        self._high = np.repeat([[NET_HALF_X_M], [NET_HALF_Y_M], [NET_HEIGHT_M]], n, axis=1)
        self._middle = 0.5 * (self._low + self._high)
        self._reach_squared = (0.5 * (self._high - self._low)) ** 2
        self._excess = np.empty((3, n))
        self._place = self._x[: X.H + 1]
        self._steps_per_second = max(1, int(round(1.0 / step_s)))
        self._derivative_at, self._derivative = -1, None

        self._gust_rngs = [_rng(seed, i, _GUST_STREAM) for i in range(n)]
        self._gust_keep = math.exp(-step_s / GUST_TIME_CONSTANT_S)
        self._gust_scale = np.array(GUST_STD_M_S) * math.sqrt(1.0 - self._gust_keep**2)
        self._gust_block = None

    # ------------------------------------------------------------------ time

    @property
    def time_s(self):
        """World time: that of the last step."""
        return self._steps * self.step_s

    @property
    def least_separation_m(self):
        """Least distance between the centres of two vehicles in the air so far; None when no two have been."""
        return None if self._least_squared_m2 == math.inf else math.sqrt(self._least_squared_m2)

    def step_to(self, time_s):
        """Advance to the last grid time that is not after time_s. Never goes back."""
        target = int(math.floor(time_s / self.step_s + 1e-6))
        while self._steps < target:
            self._step()

    def _step(self):
        time_s = self._steps * self.step_s
        if self._agenda and self._agenda[0][0] <= time_s:
            self._run_agenda(time_s)
        if self._steps % self._steps_per_second == 0:
            self._check_batteries(time_s)
        for i in self._needing_step:
            self._step_firmware(i, time_s)
        if self.gusts:
            self._blow()
        if self._inputs_changed:
            self._quadrotors.load_inputs(self._u)
            self._inputs_changed = False
        x = self._x
        self._quadrotors.advance(x, self.step_s)
        self._trim_climb()
        if self._any_standing:
            np.copyto(x, self._rest, where=self._standing)
        self._steps += 1
        excess = self._excess  # of the squared distance from the middle of the net
        np.subtract(self._place, self._middle, out=excess)
        np.multiply(excess, excess, out=excess)
        np.subtract(excess, self._reach_squared, out=excess)
        if np.maximum.reduce(excess, axis=None) > 1e-12:
            for i in np.flatnonzero((excess > 1e-12).any(axis=0)).tolist():
                self._meet_wall_or_floor(i)
        if self._pairs is not None:
            self._meet_each_other()

    # ------------------------------------------------------------------ what vehicles are told

    def _schedule(self, time_s, index, action):
        if not math.isfinite(time_s):
            raise ValueError("an action needs a finite time, got %r" % (time_s,))
        self._agenda_count += 1  # equal times keep the order of scheduling
        heapq.heappush(self._agenda, (time_s, self._agenda_count, index, action))

    def _run_agenda(self, time_s):
        while self._agenda and self._agenda[0][0] <= time_s:
            _, _, i, action = heapq.heappop(self._agenda)
            height_m, climb_m_s, _, _ = self._level_motion(i)
            self._vehicles[i].firmware.apply(action, time_s, height_m, climb_m_s)
            self._take_over(i)

    def _check_batteries(self, time_s):
        for i, vehicle in enumerate(self._vehicles):
            phase = vehicle.firmware.phase
            vehicle.firmware.check_battery(time_s)
            if vehicle.firmware.phase is not phase:
                self._take_over(i)

    def _step_firmware(self, i, time_s):
        firmware = self._vehicles[i].firmware
        phase, lifted = firmware.phase, firmware.lifted
        firmware.step(time_s, *self._level_motion(i))
        if firmware.phase is phase and firmware.lifted is lifted:
            self._u[: U.CLIMB + 1, i] = firmware.command
            self._inputs_changed = True
        else:
            self._take_over(i)

    def _take_over(self, i):
        """Bring what the firmware decided into the arrays."""
        firmware = self._vehicles[i].firmware
        self._u[: U.CLIMB + 1, i] = firmware.command
        self._u[U.MOTORS, i] = 1.0 if firmware.motors_on and firmware.lifted else 0.0
        if not firmware.motors_on:
            self._u[U.CLIMB_TRIM, i] = 0.0
        self._trim_step[i] = self._trim_gain[i] if self._u[U.MOTORS, i] else 0.0
        if self._standing[0, i] == firmware.lifted:
            self._standing[:, i] = not firmware.lifted
            self._any_standing = bool(self._standing.any())
            self._pair_up()
        if not firmware.lifted:
            self._rest[:, i] = self._x[:, i]
        self._needing_step = [j for j, vehicle in enumerate(self._vehicles) if vehicle.firmware.needs_step]
        self._inputs_changed = True

    def _level_motion(self, i):
        """Height [m], climb rate [m/s], and velocity [m/s] forward and to the right along the heading, level."""
        _, _, h, u, v, w, phi, theta, _, _, _, _ = self._x[:, i].tolist()
        sin_theta, cos_theta = math.sin(theta), math.cos(theta)
        right = math.cos(phi) * v - math.sin(phi) * w
        down2 = math.sin(phi) * v + math.cos(phi) * w
        return h, sin_theta * u - cos_theta * down2, cos_theta * u + sin_theta * down2, right

    def _trim_climb(self):
        """The slow on-board integral on the climb error, with the climb rate at the start of the step."""
        trim, error = self._u[U.CLIMB_TRIM], self._trim_error
        np.subtract(self._u[U.CLIMB], self._quadrotors.climb_rate_m_s, out=error)
        error *= self._trim_step
        trim += error
        np.minimum(trim, self._trim_limit, out=trim)
        np.maximum(trim, self._trim_low, out=trim)
        self._quadrotors.load_climb_trim(trim)

    def _blow(self):
        k = self._steps % _GUST_BLOCK
        if k == 0 or self._gust_block is None:
            self._gust_block = np.stack(
                [rng.standard_normal((_GUST_BLOCK, 3)) * self._gust_scale for rng in self._gust_rngs], axis=-1
            )
        wind = self._u[U.WIND_N : U.WIND_UP + 1]
        wind *= self._gust_keep
        wind += self._gust_block[k]
        self._inputs_changed = True

    # ------------------------------------------------------------------ floor, net and each other

    def _meet_wall_or_floor(self, i):
        firmware = self._vehicles[i].firmware
        north, east, height = self._place[:, i].tolist()
        _, climb_m_s, _, _ = self._level_motion(i)
        if height < REST_HEIGHT_M:
            reason = firmware.touch_down(self.time_s, -climb_m_s)
            # it stands: level, at rest, heading kept; what still pushes lifts it off again in the next step
            self._x[X.U : X.PSI, i] = 0.0
            self._x[X.P : X.R + 1, i] = 0.0
            self._x[X.H, i] = REST_HEIGHT_M
        else:
            reason = ""
        if abs(north) > NET_HALF_X_M or abs(east) > NET_HALF_Y_M or height > NET_HEIGHT_M:
            if firmware.phase is not FlightPhase.EMERGENCY:
                reason = "flew into the net"
                firmware.crash(self.time_s)
            # the net holds it and throws it back a little: it comes down clear of the net
            np.clip(self._place[:, i], self._low[:, i], self._high[:, i], out=self._place[:, i])
            back_north = math.copysign(NET_REBOUND_M_S, -north) if abs(north) > NET_HALF_X_M else 0.0
            back_east = math.copysign(NET_REBOUND_M_S, -east) if abs(east) > NET_HALF_Y_M else 0.0
            if firmware.lifted:
                self._set_velocity_neu(i, back_north, back_east, min(0.0, climb_m_s))
        if reason:
            self._report_crash(i, (north, -east, height), reason)
        self._take_over(i)

    def _pair_up(self):
        in_air = np.flatnonzero(~self._standing[0])
        if self._collisions and len(in_air) > 1:
            first, second = np.triu_indices(len(in_air), 1)
            self._pairs = in_air[first], in_air[second]
        else:
            self._pairs = None

    def _meet_each_other(self):
        first, second = self._pairs
        apart_m = self._place[:, first] - self._place[:, second]
        squared_m2 = np.einsum("ij,ij->j", apart_m, apart_m)
        least_m2 = float(np.minimum.reduce(squared_m2))
        self._least_squared_m2 = min(self._least_squared_m2, least_m2)
        if least_m2 < COLLISION_DISTANCE_M**2:
            for k in np.flatnonzero(squared_m2 < COLLISION_DISTANCE_M**2).tolist():
                self._collide(int(first[k]), int(second[k]))

    def _collide(self, i, j):
        for this, other in ((i, j), (j, i)):
            firmware = self._vehicles[this].firmware
            if firmware.phase is FlightPhase.EMERGENCY:
                continue  # it falls already, for this reason or another
            firmware.crash(self.time_s)
            north, east, height = self._place[:, this].tolist()
            self._report_crash(this, (north, -east, height), "collided with %s" % self._vehicles[other].namespace)
            self._take_over(this)

    def _report_crash(self, i, position_m, reason):
        self.crashes.append(Crash(self.time_s, self._vehicles[i].namespace, np.array(position_m), reason))

    def _set_velocity_neu(self, i, north_m_s, east_m_s, up_m_s):
        phi, theta, psi = self._x[X.PHI : X.PSI + 1, i]
        velocity_cortex = np.array([north_m_s, -east_m_s, up_m_s])
        self._x[X.U : X.W + 1, i] = rotation_body_to_cortex(phi, theta, psi).T @ velocity_cortex

    def _place_in_flight(self, i, position_m, yaw_rad):
        x, y, z = (float(value) for value in position_m)
        if not (abs(x) < NET_HALF_X_M and abs(y) < NET_HALF_Y_M and REST_HEIGHT_M < z < NET_HEIGHT_M):
            raise ValueError("cannot fly at %r: outside the net" % (tuple(position_m),))
        self._x[:, i] = 0.0
        self._x[: X.H + 1, i] = x, -y, z
        self._x[X.PSI, i] = yaw_rad
        self._vehicles[i].firmware.fly_at(self.time_s, z)
        self._take_over(i)
        self._derivative_at = -1

    # ------------------------------------------------------------------ what is seen

    def bodies(self):
        """List of (name, markers_m (n, 3) exact, cortex frame): vehicles in fleet order, then landmarks."""
        x = self._x
        rotations = rotation_body_to_cortex(x[X.PHI], x[X.THETA], x[X.PSI])
        places = x[: X.H + 1].T * (1.0, -1.0, 1.0)
        return [
            (vehicle.template, vehicle.markers_m @ rotation.T + place)
            for vehicle, rotation, place in zip(self._vehicles, rotations, places)
        ] + self._landmark_bodies

    def truth(self):
        """(n, 12) what perfect motion capture would say of the vehicles, in fleet order.

        Columns: position [m] and velocity [m/s] in cortex axes; roll, pitch, yaw [rad], yaw not wrapped; their rates
        of change [rad/s].
        """
        self._differentiate()
        x, slope = self._x, self._derivative
        rows = np.concatenate((x[: X.H + 1], slope[: X.H + 1], x[X.PHI : X.PSI + 1], slope[X.PHI : X.PSI + 1]))
        rows[[1, 4]] *= -1.0  # east is right, cortex' y points left
        if self._any_standing:
            standing = self._standing[0]
            rows[3:6, standing] = rows[9:12, standing] = 0.0
        return rows.T

    def _differentiate(self):
        """Slopes and thrust at world time, once."""
        if self._derivative_at != self._steps:
            if self._inputs_changed:
                self._quadrotors.load_inputs(self._u)
                self._inputs_changed = False
            self._derivative, self._thrust = self._quadrotors.derivative(self._x), self._quadrotors.demanded_thrust_n
            self._derivative_at = self._steps

    def _state(self, i):
        x = self._x[:, i]
        self._differentiate()
        p_n, p_e, h, u, v, w, phi, theta, psi, p, q, r = x.tolist()
        slope = self._derivative[:, i].tolist()
        firmware, plant = self._vehicles[i].firmware, self._vehicles[i].plant
        sin_phi, cos_phi, sin_theta, cos_theta = math.sin(phi), math.cos(phi), math.sin(theta), math.cos(theta)
        felt_g = GRAVITY_M_S2 * np.array([-sin_theta, cos_theta * sin_phi, cos_theta * cos_phi])
        if firmware.lifted:
            force = (
                np.array([slope[X.U] - (r * v - q * w), slope[X.V] - (p * w - r * u), slope[X.W] - (q * u - p * v)])
                - felt_g
            )
            velocity = np.array([slope[X.P_N], -slope[X.P_E], slope[X.H]])
        else:
            force, velocity = -felt_g, np.zeros(3)
        return VehicleState(
            position_m=np.array([p_n, -p_e, h]),
            velocity_m_s=velocity,
            phi=phi,
            theta=theta,
            psi=float(wrap_angle(psi)),
            p=p,
            q=q,
            r=r,
            specific_force_m_s2=force,
            motor_pwm=_motor_pwm(firmware, self._thrust[i] / plant.thrust_max_n),
            battery_pct=firmware.battery_pct(self.time_s),
        )


def _motor_pwm(firmware, thrust_fraction):
    """The four motor commands 0..255: thrust grows with the square of the speed; 40 is idling."""
    if not firmware.motors_on:
        return (0, 0, 0, 0)
    pwm = int(255.0 * math.sqrt(thrust_fraction)) if firmware.lifted else 40
    return (pwm, pwm, pwm, pwm)


def _turned(yaw_rad):
    """Rotation matrix of an upright object, cortex axes, from facing along x to facing there (+ clockwise)."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def _rng(seed, vehicle_index, stream):
    """A Generator that belongs to one vehicle and purpose, whatever the size of the fleet."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(vehicle_index, stream)))


def _look_up(mapping, name, what):
    if name not in mapping:
        raise ValueError("no %s '%s'; known are: %s" % (what, name, ", ".join(sorted(mapping))))
    return mapping[name]
