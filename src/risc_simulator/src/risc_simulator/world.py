"""The world of the virtual lab: N vehicles in the net, stepped together, bit for bit reproducible from the seed.

Time is world time in seconds from 0, on a fixed grid. Actions are applied at the first grid time that is not before
theirs. The interface (positions, velocities) uses the cortex frame; the internal state is that of models/quadrotor.py.

The world is a list of systems: a vehicle with the body attached to it, if any. One compiled call advances all systems
of a kind by a step (models/integrator.py); events between steps (actions, an empty battery, the phases of a take-off,
contact with the floor, the net or another vehicle) are handled here.
"""

import functools
import heapq
import math
from collections import deque
from dataclasses import replace

import numpy as np

from risc_lab.compiled import compiled, record
from risc_lab.frames import GRAVITY_M_S2, rotation_body_to_cortex
from risc_simulator.bodies import load_body
from risc_simulator.models.flight import Crash, FlightPhase, VehicleState
from risc_simulator.models.gusts import Gusts
from risc_simulator.models.integrator import REST_HEIGHT_M, closest, integrator
from risc_simulator.models.perturbed_plant import draw_plant, fill_records
from risc_simulator.models.quadrotor import U, X, level_motion
from risc_simulator.vehicles import virtual_type

NET_REBOUND_M_S = 0.5

# Purposes of the random streams of a vehicle; with other numbers a seed would mean something else.
_PLANT_STREAM, _FIRMWARE_STREAM, _GUST_STREAM = range(3)
_EAST_IS_RIGHT = np.array([1.0, -1.0, 1.0])  # the cortex frame's y points left


class Vehicle:
    """One vehicle of the world: the interface for hosts and offline studies."""

    def __init__(self, world, index, fleet_vehicle, vehicle_type, virtual, markers_m, plant, firmware):
        self.namespace = fleet_vehicle.namespace
        self.name = self.template = fleet_vehicle.template  # its name in motion capture and on every topic
        self.markers_m = markers_m  # (n, 3) markers it carries, body axes (forward, right, down)
        self.type = vehicle_type  # VehicleType: the nominal vehicle
        self.virtual = virtual  # vehicles.VirtualType: its equations and its host
        self.plant = plant  # PlantParams: the true one
        self.firmware = firmware
        self.attached = fleet_vehicle.attached  # AttachedBody or None
        self.battery_was_set = False  # its charge was changed from outside
        self._drawn = plant
        self._world, self._index = world, index

    def schedule(self, time_s, action):
        """Deliver a Setpoint or FlightAction to the on-board logic at world time time_s (a past time: now)."""
        if not math.isfinite(time_s):
            raise ValueError("an action needs a finite time, got %r" % (time_s,))
        world = self._world
        world._agenda_count += 1  # equal times keep the order of scheduling
        heapq.heappush(world._agenda, (time_s, world._agenda_count, self._index, action))

    @property
    def phase(self):
        """FlightPhase at world time."""
        return self.firmware.phase

    @property
    def state(self):
        """VehicleState at world time."""
        return self._world._state(self._index)

    @property
    def body_state(self):
        """State of the attached body (see its module in bodies), at world time; empty if no vehicle carries one."""
        return self._world._x[len(X) :, self._index].copy()

    @property
    def height_m(self):
        """Height of its centre above the floor at world time."""
        return self._world._x.item(X.H, self._index)

    @property
    def battery_pct(self):
        """Charge at world time."""
        return self.firmware.battery_pct(self._world.time_s)

    def set_battery_pct(self, pct):
        """Change the battery's charge now."""
        self.firmware.set_battery_pct(pct, self._world.time_s)
        self.battery_was_set = True

    def weaken_battery(self, pct):
        """Change the charge now, as by a fault of the fitted battery (see Firmware.weaken_battery)."""
        self.firmware.weaken_battery(pct, self._world.time_s)
        self.battery_was_set = True

    def change_wind(self, by_m_s):
        """Add by_m_s (3,), cortex axes, to the mean velocity of the air around it, from now on."""
        self._world._change_wind(self._index, by_m_s)

    def turn(self, rolls_rad_s):
        """Change its roll rate by this, at once: the effect of a moment that its equations do not contain."""
        self._world._x[X.P, self._index] += rolls_rad_s
        self._world._slope_at = -1

    def change_plant(self, **values):
        """Change its true plant from now on, unknown to its on-board logic. values: fields of PlantParams."""
        self._world._change_plant(self._index, values)

    @property
    def out_of_reach(self):
        """Why it cannot be picked up now; "" if it can."""
        if self.firmware.lifted:
            return "%s is in the air (%s)" % (self.namespace, self.phase.value)
        return "the rotors of %s turn" % self.namespace if self.firmware.motors_on else ""

    def put_back(self):
        """Stand it at its start, with its original plant and a full battery, switched off and on.

        Not when it is out of reach, see `World.check_place_for`.
        """
        self._world._put_back(self._index, self._drawn)
        self.battery_was_set = False

    def fly_at(self, position_m, yaw_rad=0.0):
        """Put the vehicle into the air at this place (cortex frame), hovering: a start for offline studies."""
        self._world._place_in_flight(self._index, position_m, yaw_rad)


@functools.cache
def _equations(type_name, body_name):
    """(Integrator, dtype of the records, Body or None) of a kind of system: a vehicle type and the body it carries."""
    virtual = virtual_type(type_name)
    if not body_name:
        return integrator(type_name, **virtual.equations), record(*virtual.fields), None
    body = load_body(body_name)
    compiled_for = integrator("%s_%s" % (type_name, body_name), body.size, **virtual.equations, couple=body.couple)
    return compiled_for, record(*virtual.fields, ("body", body.record)), body


class _Kind:
    """The systems of one kind: their columns in the state, and the records of their vehicles."""

    def __init__(self, type_name, body_name, columns):
        self.columns = np.array(columns, dtype=np.uintp)
        (self.advance, self.differentiate), dtype, self.body = _equations(type_name, body_name)
        self.records = np.zeros(len(columns), dtype=dtype)
        if self.body is not None:
            self.records["body"] = self.body.values


class _Carried:
    """The body that one vehicle carries."""

    def __init__(self, kind, c, template):
        self.column, self.template = int(kind.columns[c]), template
        self._body, self._record = kind.body, kind.records[c]

    def rest(self, x):
        """Set the state that it has while the vehicle stands. x: state of all systems."""
        self._body.rest(x[:, self.column], self._record)

    def markers_m(self, x):
        """(k, 3) markers of the body, cortex frame."""
        position_m, axes = np.zeros(3), np.eye(3)
        self._body.place(x[:, self.column], self._record, position_m, axes)
        return position_m + self.template.markers_m @ axes.T


class World:
    """All vehicles and landmarks. One thread at a time."""

    def __init__(self, fleet, vehicle_types, templates, seed=0, perturbed=True, gusts=False, step_s=0.005):
        """fleet: Fleet. vehicle_types: VehicleType by the name used in the fleet. templates: Template by name.

        perturbed: true plants are drawn around the nominal ones. gusts: moving air, `Gusts`; True: the default ones.
        step_s: grid (see test_quadrotor.py for what it costs in accuracy). Raises ValueError when fleet, types and
        templates do not match, and for impossible gusts.
        """
        if not 0.0 < step_s <= 0.02:
            raise ValueError("step_s must be in (0, 0.02], got %r" % (step_s,))
        self.step_s = step_s
        self.crashes = deque(maxlen=1000)  # Crash, newest last
        self._least_squared_m2 = math.inf
        self._steps = 0
        self._agenda, self._agenda_count = [], 0

        net = self._net = fleet.arena
        self._net_m = net.half_x_m, net.half_y_m, net.height_m
        n = len(fleet.vehicles)
        types = [
            replace(look_up(vehicle_types, vehicle.type, "vehicle type"), **dict(vehicle.overrides))
            for vehicle in fleet.vehicles
        ]
        kinds = {}  # {(name of the type, name of the body or ""): columns}
        for i, (fleet_vehicle, vehicle_type) in enumerate(zip(fleet.vehicles, types)):
            carried = fleet_vehicle.attached.body if fleet_vehicle.attached else ""
            kinds.setdefault((vehicle_type.name, carried), []).append(i)
        self._kinds = [_Kind(name, carried, i) for (name, carried), i in kinds.items()]
        rows = len(X) + max((kind.body.size for kind in self._kinds if kind.body), default=0)
        self._x = np.zeros((rows, n))
        self._u = np.zeros((len(U), n))
        self._radius_m = np.array([vehicle_type.radius_m for vehicle_type in types])
        vehicles, self._starts = [], []  # of each vehicle: north, east, height [m]; heading [rad]
        for i, (fleet_vehicle, vehicle_type) in enumerate(zip(fleet.vehicles, types)):
            virtual = virtual_type(vehicle_type.name)
            markers_m = look_up(templates, fleet_vehicle.template, "mocap template").markers_m
            plant = draw_plant(vehicle_type, _rng(seed, i, _PLANT_STREAM), perturbed)
            firmware = virtual.Firmware(vehicle_type, _rng(seed, i, _FIRMWARE_STREAM), perturbed, REST_HEIGHT_M)
            vehicles.append(Vehicle(self, i, fleet_vehicle, vehicle_type, virtual, markers_m, plant, firmware))
            x, y, _ = fleet_vehicle.start.position_m  # its height is ignored: the vehicle stands on the floor
            if abs(x) > net.half_x_m or abs(y) > net.half_y_m:
                raise ValueError(
                    "%s starts outside the net (|x| <= %.2f m, |y| <= %.2f m): change its start in the "
                    "fleet file" % (fleet_vehicle.namespace, net.half_x_m, net.half_y_m)
                )
            self._starts.append(((x, -y, REST_HEIGHT_M), fleet_vehicle.start.yaw_rad))
            self._stand(i)
        self.vehicles = {vehicle.namespace: vehicle for vehicle in vehicles}
        self._vehicles = vehicles
        for kind in self._kinds:
            fill_records(kind.records, [vehicles[i].plant for i in kind.columns])
            for c, i in enumerate(kind.columns):
                vehicles[i].firmware.configure(kind.records[c : c + 1])
        carried = [
            _Carried(kind, c, look_up(templates, vehicles[i].attached.template, "mocap template"))
            for kind in self._kinds
            if kind.body
            for c, i in enumerate(kind.columns)
        ]
        self._carried = {one.column: one for one in carried}
        bodies = [(vehicle.template, vehicle.markers_m) for vehicle in vehicles]
        for mark in fleet.landmarks:
            markers_m = look_up(templates, mark.name, "mocap template").markers_m
            bodies.append((mark.name, markers_m @ _turned(mark.facing_rad).T + mark.position_m))
        bodies += [(one.template.name, one.template.markers_m) for one in carried]
        #: ((name, number of markers), ...) of all bodies: vehicles in fleet order, landmarks, attached bodies
        self.layout = tuple((name, len(markers_m)) for name, markers_m in bodies)
        firsts = np.cumsum([0] + [count for _, count in self.layout])
        self._first_marker, self._first_carried = firsts[: n + 1], firsts[len(bodies) - len(carried)]
        self._markers_m = np.concatenate([np.empty((0, 3)), *(markers_m for _, markers_m in bodies)])
        self._body_markers_m = self._markers_m[: firsts[n]].copy()
        for one in carried:
            one.rest(self._x)

        self._flags = np.zeros((2, n), dtype=bool)  # lifted; touches floor or net
        self._lifted = self._flags[0]
        self._commands, self._motors = self._u[: U.CLIMB + 1].T, self._u[U.MOTORS]
        self._motions = [functools.partial(self._vertical_motion, i) for i in range(n)]
        self._steps_per_second = max(1, int(round(1.0 / step_s)))
        self._slope, self._thrust_n = np.empty((rows, n)), np.empty(n)
        self._slope_at = -1  # step for which slopes and thrusts were computed

        self._gusts = Gusts() if gusts is True else gusts or None
        self._gust_rngs = [_rng(seed, i, _GUST_STREAM) for i in range(n if self._gusts else 0)]
        self._wind_m_s = None  # (n, 3) north, east, up: mean velocity of the air; None: it has never been set
        self._scale_gusts()
        self._load_compiled()

    # ------------------------------------------------------------------ time

    @property
    def time_s(self):
        """World time: that of the last step."""
        return self._steps * self.step_s

    @property
    def least_separation_m(self):
        """Least distance between the centres of two vehicles in the air so far; None if two never were."""
        return None if self._least_squared_m2 == math.inf else math.sqrt(self._least_squared_m2)

    def step_to(self, time_s):
        """Advance to the last grid time that is not after time_s. Never goes back."""
        target = int(math.floor(time_s / self.step_s + 1e-6))
        while self._steps < target:
            time_s = self.time_s
            while self._agenda and self._agenda[0][0] <= time_s:
                _, _, i, action = heapq.heappop(self._agenda)
                self._vehicles[i].firmware.apply(action, time_s, self._motions[i])
                self._take_over(i)
            is_second = self._steps % self._steps_per_second == 0
            for i, vehicle in enumerate(self._vehicles):
                if is_second:
                    vehicle.firmware.check_battery(time_s)
                    self._take_over(i)
                if vehicle.firmware.wake_s <= time_s:
                    vehicle.firmware.wake(time_s, self._motions[i])
                    self._take_over(i)
            if self._gusts:
                self._blow()
            touching = self._advance()
            self._steps += 1
            if touching:
                for i in np.flatnonzero(self._flags[1]).tolist():
                    self._meet_wall_or_floor(i)
            least_m2, touch = closest(self._x, self._lifted, self._radius_m)
            if least_m2 < self._least_squared_m2:
                self._least_squared_m2 = least_m2
            if touch:
                self._meet_each_other()

    def _blow(self):
        """Advance the random motion of the air, around its mean velocity, by a step."""
        gusts_m_s = self._gust_scale * np.array([rng.standard_normal(3) for rng in self._gust_rngs])
        keep, wind_m_s = self._gusts.keep(self.step_s), self._u[U.WIND_N : U.WIND_UP + 1]
        if self._wind_m_s is not None:
            gusts_m_s += (1.0 - keep) * self._wind_m_s
        wind_m_s[:] = keep * wind_m_s + gusts_m_s.T

    def _scale_gusts(self):
        """Update _gust_scale for the current plants: (n, 3) 1 sigma of what a step adds to the velocity of the air."""
        if self._gusts:
            std_m_s = np.array([self._gusts.std_m_s(vehicle.plant) for vehicle in self._vehicles])
            self._gust_scale = std_m_s * math.sqrt(1.0 - self._gusts.keep(self.step_s) ** 2)

    def _change_wind(self, i, by_m_s):
        if self._wind_m_s is None:
            self._wind_m_s = np.zeros((len(self._vehicles), 3))
        north, west, up = by_m_s
        for wind_m_s in (self._u[U.WIND_N : U.WIND_UP + 1, i], self._wind_m_s[i]):
            wind_m_s += (north, -west, up)
        self._slope_at = -1

    def _change_plant(self, i, values):
        vehicle = self._vehicles[i]
        plant = replace(vehicle.plant, **values)
        if self._gusts:
            self._gusts.std_m_s(plant)  # raises for a plant without drag, before anything has changed
        vehicle.plant = plant
        for kind in self._kinds:
            for c in np.flatnonzero(kind.columns == i).tolist():
                fill_records(kind.records[c : c + 1], [vehicle.plant])
        self._scale_gusts()
        self._slope_at = -1

    def _advance(self):
        """Advance all systems by a step. Returns whether a vehicle touches floor or net."""
        touching = False
        for kind in self._kinds:
            vehicles = kind.columns, kind.records
            touching |= kind.advance(self._x, self._u, self._flags, *vehicles, self.step_s, self._net_m)
        return touching

    def _load_compiled(self):
        """Call each compiled function once, so that none is loaded in flight. No vehicle moves: all stand."""
        self._advance()
        self.truth()
        self.markers_m()
        closest(self._x, self._lifted, self._radius_m)
        level_motion(self._x[:, 0])

    # ------------------------------------------------------------------ what on-board logic decides

    def _take_over(self, i):
        """Copy the decisions of the firmware into the arrays."""
        firmware = self._vehicles[i].firmware
        command = firmware.tell()
        if command is not None:
            self._commands[i] = command
        if i in self._carried and not firmware.lifted:
            self._carried[i].rest(self._x)
        self._motors[i] = firmware.motors_on and firmware.lifted
        if not firmware.motors_on:
            self._u[U.CLIMB_TRIM, i] = 0.0
        self._lifted[i] = firmware.lifted

    def _vertical_motion(self, i):
        """Height [m] and climb rate [m/s]."""
        return self._x.item(X.H, i), level_motion(self._x[:, i])[0]

    # ------------------------------------------------------------------ floor, net and each other

    def _meet_wall_or_floor(self, i):
        firmware, net = self._vehicles[i].firmware, self._net
        north, east, height = self._x[: X.H + 1, i].tolist()
        _, climb_m_s = self._motions[i]()
        if height < REST_HEIGHT_M:
            reason = firmware.touch_down(self.time_s, -climb_m_s)
            # it stands: level, at rest, heading kept; remaining thrust lifts it off again in the next step
            self._x[X.U : X.PSI, i] = 0.0
            self._x[X.P : X.R + 1, i] = 0.0
            self._x[X.H, i] = REST_HEIGHT_M
        else:
            reason = ""
        if abs(north) > net.half_x_m or abs(east) > net.half_y_m or height > net.height_m:
            if firmware.phase is not FlightPhase.EMERGENCY:
                reason = "flew into the net"
                firmware.crash(self.time_s)
            # the net holds it and throws it back a little: it comes down clear of the net
            self._x[X.P_N, i] = min(net.half_x_m, max(-net.half_x_m, north))
            self._x[X.P_E, i] = min(net.half_y_m, max(-net.half_y_m, east))
            self._x[X.H, i] = min(net.height_m, max(REST_HEIGHT_M, height))
            back_north = math.copysign(NET_REBOUND_M_S, -north) if abs(north) > net.half_x_m else 0.0
            back_east = math.copysign(NET_REBOUND_M_S, -east) if abs(east) > net.half_y_m else 0.0
            if firmware.lifted:
                back_m_s = np.array([back_north, -back_east, min(0.0, climb_m_s)])
                self._x[X.U : X.W + 1, i] = rotation_body_to_cortex(*self._x[X.PHI : X.PSI + 1, i]).T @ back_m_s
        if reason:
            self._report_crash(i, (north, east, height), reason)
        self._take_over(i)

    def _meet_each_other(self):
        in_air = np.flatnonzero(self._lifted)
        first, second = (in_air[chosen] for chosen in np.triu_indices(len(in_air), 1))
        apart_m = self._x[: X.H + 1, first] - self._x[: X.H + 1, second]
        near = (apart_m**2).sum(axis=0) < (self._radius_m[first] + self._radius_m[second]) ** 2
        for pair in zip(first[near].tolist(), second[near].tolist()):
            for this, other in (pair, pair[::-1]):
                firmware = self._vehicles[this].firmware
                if firmware.phase is not FlightPhase.EMERGENCY:  # otherwise it is falling already
                    firmware.crash(self.time_s)
                    place = self._x[: X.H + 1, this].tolist()
                    name = self._vehicles[other].namespace
                    self._report_crash(this, place, "collided with %s" % name, name)
                    self._take_over(this)

    def _report_crash(self, i, place, reason, other=""):
        north, east, height = place
        position_m = np.array([north, -east, height])
        self.crashes.append(Crash(self.time_s, self._vehicles[i].namespace, position_m, reason, other))

    def _stand(self, i):
        """Place it at its start, standing."""
        place, self._x[X.PSI, i] = self._starts[i]
        self._x[: X.H + 1, i] = place

    def check_place_for(self, vehicles):
        """Raise ValueError if Vehicles cannot be put back: out of reach, or others occupy their starts."""
        for reason in (vehicle.out_of_reach for vehicle in vehicles if vehicle.out_of_reach):
            raise ValueError("%s: land it first" % reason)
        stay = [other._index for other in self._vehicles if other not in vehicles]
        for vehicle in vehicles:
            i = vehicle._index
            apart_m = np.linalg.norm(self._x[: X.H + 1, stay].T - self._starts[i][0], axis=1)
            for k in np.flatnonzero(apart_m < self._radius_m[i] + self._radius_m[stay]).tolist():
                other = self._vehicles[stay[k]].namespace
                text = "%s is in the place of %s: put it back first, or all at once"
                raise ValueError(text % (other, vehicle.namespace))

    def _put_back(self, i, plant):
        self._agenda = [item for item in self._agenda if item[2] != i]  # drop its pending actions
        heapq.heapify(self._agenda)
        self._change_plant(i, vars(plant))
        self._vehicles[i].firmware.power_cycle(self.time_s)
        self._x[:, i] = 0.0
        self._stand(i)
        self._take_over(i)

    def _place_in_flight(self, i, position_m, yaw_rad):
        (x, y, z), net = (float(value) for value in position_m), self._net
        if not (abs(x) < net.half_x_m and abs(y) < net.half_y_m and REST_HEIGHT_M < z < net.height_m):
            raise ValueError("cannot fly at %r: outside the net" % (tuple(position_m),))
        self._x[:, i] = 0.0
        self._x[: X.H + 1, i] = x, -y, z
        self._x[X.PSI, i] = yaw_rad
        self._commands[i] = 0.0
        if i in self._carried:
            self._carried[i].rest(self._x)
        self._vehicles[i].firmware.fly_at(self.time_s, z)
        self._take_over(i)
        self._slope_at = -1

    # ------------------------------------------------------------------ what is seen

    def markers_m(self):
        """(m, 3) exact markers of all bodies in the order of `layout`, cortex frame. The next call overwrites them."""
        _place_markers(self._x, self._first_marker, self._body_markers_m, self._markers_m)
        first = self._first_carried
        for carried in self._carried.values():
            markers_m = carried.markers_m(self._x)
            self._markers_m[first : first + len(markers_m)] = markers_m
            first += len(markers_m)
        return self._markers_m

    def truth(self):
        """(n, 12) true states of the vehicles, as from perfect motion capture, in fleet order.

        Columns: position [m] and velocity [m/s] in cortex axes; roll, pitch, yaw [rad], yaw not wrapped; their rates
        of change [rad/s].
        """
        self._differentiate()
        x, slope = self._x, self._slope * self._lifted
        velocity = slope[: X.U].T * _EAST_IS_RIGHT
        return np.hstack((self.positions_m(), velocity, x[X.PHI : X.P].T, slope[X.PHI : X.P].T))

    def positions_m(self):
        """(n, 3) positions of the vehicles [m], cortex axes, in fleet order."""
        return self._x[: X.U].T * _EAST_IS_RIGHT

    def _differentiate(self):
        """Compute slopes and thrusts at world time, once per step."""
        if self._slope_at != self._steps:
            for kind in self._kinds:
                kind.differentiate(self._x, self._u, kind.columns, kind.records, self._slope, self._thrust_n)
            self._slope_at = self._steps

    def _state(self, i):
        x = self._x[:, i]
        self._differentiate()
        p_n, p_e, h, u, v, w, phi, theta, psi, p, q, r = x[: len(X)].tolist()
        slope = self._slope[:, i].tolist()
        firmware, plant = self._vehicles[i].firmware, self._vehicles[i].plant
        sin_phi, cos_phi, sin_theta, cos_theta = math.sin(phi), math.cos(phi), math.sin(theta), math.cos(theta)
        moved = velocity = (0.0, 0.0, 0.0)
        if firmware.lifted:
            moved = slope[X.U] - (r * v - q * w), slope[X.V] - (p * w - r * u), slope[X.W] - (q * u - p * v)
            velocity = slope[X.P_N], -slope[X.P_E], slope[X.H]
        pulls = -sin_theta, cos_theta * sin_phi, cos_theta * cos_phi
        force = [part - GRAVITY_M_S2 * pull for part, pull in zip(moved, pulls)]
        psi = math.pi - (math.pi - psi) % (2.0 * math.pi)  # in (-pi, pi]
        return VehicleState(
            np.array([p_n, -p_e, h]),
            np.array(velocity),
            *(phi, theta, psi, p, q, r),
            specific_force_m_s2=np.array(force),
            motor_pwm=_motor_pwm(firmware, self._thrust_n.item(i) / plant.thrust_max_n),
            battery_pct=firmware.battery_pct(self.time_s),
        )


@compiled
def _place_markers(x, first_marker, body_markers_m, markers_m):
    """Markers of the vehicles, cortex frame. body_markers_m: (m, 3) body axes; vehicle i's begin at first_marker[i]."""
    for i in range(x.shape[1]):
        sf, cf = math.sin(x[X.PHI, i]), math.cos(x[X.PHI, i])
        st, ct = math.sin(x[X.THETA, i]), math.cos(x[X.THETA, i])
        sp, cp = math.sin(x[X.PSI, i]), math.cos(x[X.PSI, i])
        for k in range(first_marker[i], first_marker[i + 1]):
            nose, right, down = body_markers_m[k, 0], body_markers_m[k, 1], body_markers_m[k, 2]
            north = nose * ct * cp + right * (sf * st * cp - cf * sp) + down * (cf * st * cp + sf * sp)
            east = nose * ct * sp + right * (sf * st * sp + cf * cp) + down * (cf * st * sp - sf * cp)
            up = nose * st - right * sf * ct - down * cf * ct
            markers_m[k, 0] = x[X.P_N, i] + north
            markers_m[k, 1] = -x[X.P_E, i] - east
            markers_m[k, 2] = x[X.H, i] + up


def _motor_pwm(firmware, thrust_fraction):
    """The four motor commands 0..255: thrust grows with the square of the speed; 40 is idling."""
    if not firmware.motors_on:
        return (0, 0, 0, 0)
    pwm = int(255.0 * math.sqrt(thrust_fraction)) if firmware.lifted else 40
    return (pwm, pwm, pwm, pwm)


def _turned(yaw_rad):
    """Rotation matrix, cortex axes, that turns an upright object from facing x to a yaw angle (+ clockwise)."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def _rng(seed, vehicle_index, stream):
    """Generator of one vehicle and purpose, independent of the size of the fleet."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(vehicle_index, stream)))


def look_up(mapping, name, what):
    """Item of a mapping. Raises ValueError that lists the known names. what: kind of item, e.g. "vehicle"."""
    if name not in mapping:
        raise ValueError("no %s '%s'; known are: %s" % (what, name, ", ".join(sorted(mapping))))
    return mapping[name]
