"""Controllers: states and references in, physical commands out. Needs no ROS.

A controller is one file here with a class `Controller`, and config/controllers/NAME.yaml with its `PARAMS`. From
elsewhere, e.g. a student's: controllers/NAME.py and controllers/NAME.yaml in a folder of RISC_MAAP_MEMBERS (see
`risc_lab.registry`). `./maap fly --controller NAME` and `python3 -m risc_experiments.offline --controller NAME` fly it:

    @dataclass(frozen=True)
    class Params:
        gain_1_s2: float = 2.0

    class Controller(controllers.Controller):
        PARAMS = Params

        def step(self, t, states, reference, params):
            position, velocity, acceleration = reference.present[:3, :, :3]
            up = acceleration[:, 2] + params.gain_1_s2 * (position - states.vehicles.position_m)[:, 2] + ...
            return Command(roll_rad, pitch_rad, yaw_rate_rad_s, self.mass_kg * (GRAVITY_M_S2 + up))

It flies all vehicles of a fleet at once, whatever their types. `states.bodies` are bodies that they carry (`attached`
in the fleet file), such as the tip of a pendulum; `states.covariances` come from state filters that provide them.
Vehicles that cannot be flown (not seen, no reference), limits and the units of /controls are handled by `ControlLoop`,
which is what nodes and offline flights run.
"""

from dataclasses import replace
from itertools import groupby
from typing import NamedTuple

import numpy as np

from risc_control.reference_buffer import MOST_ORDER, Axis, Order
from risc_control.vehicles import Command, Controls, ControlsConverter
from risc_lab.command_history import CommandHistory
from risc_lab.lab.vehicle_types import load_vehicle_type, vehicle_type_file
from risc_lab.lab.yaml_reader import config_files, key_comments
from risc_lab.registry import Registry
from risc_lab.settings import NoParams, settings_from
from risc_lab.states import S, States

REGISTRY = Registry("controllers", __name__)


class Times(NamedTuple):
    """Times of a step."""

    stamp_s: float  # of the states: when they were measured
    now_s: float  # when the command will be sent


class Bundle(NamedTuple):
    """All inputs other than the reference, including those that only some fleets or filters provide."""

    vehicles: States
    autonomous: np.ndarray  # (n,) bool, False where this controller does not fly the vehicle: its commands are not sent
    sent: CommandHistory  # commands actually sent to the vehicles, where known; on the clock of `Times`
    bodies: States  # row i: the body that vehicle i carries; not visible if there is none. Its angles are meaningless
    # (n, 12, 12) of `vehicles`, rows and columns as in `S`, NaN where unknown; the newest estimate, which nodes receive
    # one frame late. None: the filter provides none, or the controller does not read them
    covariances: np.ndarray | None = None


class Reference(NamedTuple):
    """References: arrays (orders, n, 4), position to `Controller.ORDER` of x, y, z, psi in the cortex frame."""

    present: np.ndarray  # at the stamp of the states
    ahead: np.ndarray  # at the time of sending plus the vehicle's `Controller.delay_s`
    usable: np.ndarray  # (n,) bool, False where there is no fresh reference: its numbers are then meaningless


class Controller:
    """Controller of n vehicles. `step` is called in order of time."""

    PARAMS = NoParams  # dataclass of numbers: the keys of its YAML file; dynamic_reconfigure changes them in flight
    ORDER = Order.ACCELERATION  # highest derivative of the reference that it reads, at most MOST_ORDER
    COVARIANCES = False  # whether it reads `Bundle.covariances`
    ESTIMATOR = ""  # velocity filter of its flights unless another one is named; "" = the default filter

    def __init__(self, vehicle_types, params):
        """vehicle_types: VehicleType of each vehicle, in the order of all arrays."""
        self.mass_kg = np.array([vehicle_type.mass_kg for vehicle_type in vehicle_types])
        self.delay_s = np.zeros(len(vehicle_types))  # command delay that it assumes for each vehicle
        self.saturated = np.zeros(len(vehicle_types), dtype=bool)  # True where it limited its last command
        self.designed = None  # result of `design` for the parameters of the current step

    def step(self, t, states, reference, params):
        """`Command` of arrays (n,).  t: Times.  states: Bundle.  reference: Reference.  params: PARAMS.

        A vehicle with a number that is not finite gets no command; the others fly on.
        """
        raise NotImplementedError

    def design(self, params):
        """Return what depends on the parameters only (gains ...), so that no step computes it. Called in any thread.

        Raises ValueError when there is no solution.
        """

    def reset(self):
        """Forget everything that was learnt in flight."""
        self.forget_times()

    def forget_times(self):
        """The clock of stamps and commands was set: forget all times."""


class _Mixed(Controller):
    """A controller for vehicles with different parameters: one instance per run of neighbours with equal parameters."""

    def __init__(self, kind, vehicle_types, params, own):
        super().__init__(vehicle_types, params)
        self.ORDER, self.COVARIANCES = kind.ORDER, kind.COVARIANCES
        self._parts, begin = [], 0  # (rows, parameters that differ from the YAML file, Controller)
        self._bodies, self._bodies_of = None, ()  # bodies of all vehicles, and those of each part
        for numbers, equals in groupby(own):
            rows = slice(begin, begin + len(list(equals)))
            part = kind(vehicle_types[rows], replace(params, **numbers))
            self.delay_s[rows] = part.delay_s
            self._parts.append((rows, numbers, part))
            begin = rows.stop

    def design(self, params):
        own = [replace(params, **numbers) for _, numbers, _ in self._parts]
        return [(params, part.design(params)) for params, (_, _, part) in zip(own, self._parts)]

    def step(self, t, states, reference, params):
        commands = np.empty((len(Command._fields), len(self.delay_s)))
        if states.bodies is not self._bodies:  # while no vehicle carries anything it is the same object in every frame
            self._bodies = states.bodies
            self._bodies_of = [_rows_of(states.bodies, rows) for rows, _, _ in self._parts]
        for (rows, _, part), (own, part.designed), bodies in zip(self._parts, self.designed, self._bodies_of):
            vehicles = _rows_of(states.vehicles, rows)
            covariances = None if states.covariances is None else states.covariances[rows]
            bundle = Bundle(vehicles, states.autonomous[rows], states.sent.of(rows), bodies, covariances)
            wanted = Reference(reference.present[:, rows], reference.ahead[:, rows], reference.usable[rows])
            commands[:, rows] = part.step(t, bundle, wanted, own)
            self.saturated[rows] = part.saturated
        return Command(*commands)

    def reset(self):
        for _, _, part in self._parts:
            part.reset()

    def forget_times(self):
        for _, _, part in self._parts:
            part.forget_times()


def _rows_of(states, rows):
    return States(states.visible[rows], states.x[rows])


class Output(NamedTuple):
    """Commands for n vehicles."""

    controls: Controls  # of arrays (n,); NaN, all four, where `finite` is False
    saturated: np.ndarray  # (n,) bool: a limit of the vehicle cut the command
    finite: np.ndarray  # (n,) bool, False where the controller's command is not a number: the vehicle gets none


class ControlLoop:
    """A controller with its parameters, the times of its references, and the conversion to /controls."""

    def __init__(self, controller, vehicle_types, params=None, own=()):
        """controller: a name of the REGISTRY, or a class.  params: None = of its YAML file; for a class, its defaults.
        own: parameters of each vehicle that differ, see `own_params`.  Raises ValueError for what cannot be flown.
        """
        if isinstance(controller, str):
            params = params or default_params(controller)
            controller = REGISTRY.module(controller).Controller
        if controller.ORDER > MOST_ORDER:  # better said now than at the first reference
            text = "%s reads derivatives to order %d of its reference, and there are %d: make its ORDER smaller"
            raise ValueError(text % (controller.__module__, controller.ORDER, MOST_ORDER))
        params = params or controller.PARAMS()
        same = not own or all(numbers == own[0] for numbers in own)
        self._of_all = own[0] if own and same else {}
        own_or_all = replace(params, **self._of_all)
        self.controller = (
            controller(vehicle_types, own_or_all) if same else _Mixed(controller, vehicle_types, params, own)
        )
        self._to_controls = ControlsConverter(vehicle_types)
        self.tell_battery = self._to_controls.tell_battery
        delays_s, self._which = np.unique(self.controller.delay_s, return_inverse=True)
        self._delays_s = delays_s.tolist()
        self._everyone = np.arange(len(vehicle_types))
        self.sent = CommandHistory(len(vehicle_types))  # the caller appends the commands actually sent, where known
        self.set_params(params)
        n = len(vehicle_types)
        none, nowhere = np.zeros(n, dtype=bool), np.zeros((self.controller.ORDER + 1, n, len(Axis)))
        self._no_bodies = States(none.copy(), np.zeros((n, len(S))))
        # load the compiled code, by an update in which no vehicle is seen
        self.update(0.0, 0.0, States(none, np.zeros((n, len(S)))), nowhere, nowhere, none, none)
        self.controller.reset()

    def set_params(self, params):
        """Change the parameters; those that differ for single vehicles are kept.

        Raises ValueError, and keeps the old parameters, when there is no solution.
        """
        flown = replace(params, **self._of_all)
        self._flown = flown, self.controller.design(flown)
        self.params = params

    def forget_times(self):
        """The clock of stamps and commands was set."""
        self.sent.clear()
        self.controller.forget_times()

    def times_s(self, stamp_s, now_s):
        """(1 + k,) times of the references that `update` needs: the stamp, and when its commands take effect."""
        sent_s = stamp_s + max(0.0, now_s - stamp_s)
        return np.array([stamp_s, *(delay_s + sent_s for delay_s in self._delays_s)])

    def pick(self, values):
        """(present, ahead), both (orders, n, 4), of references (1 + k, orders, n, 4) at `times_s`."""
        if len(values) == 2:
            return values[0], values[1]
        return values[0], np.ascontiguousarray(values[1 + self._which, :, self._everyone].transpose(1, 0, 2))

    def update(self, stamp_s, now_s, states, present, ahead, usable, autonomous, bodies=None, covariances=None):
        """`Output` for the States at stamp_s, to be sent at now_s; level with hover thrust if not seen or not usable.

        present, ahead, usable: see `Reference`.  autonomous, bodies, covariances: see `Bundle`; bodies None: no vehicle
        carries anything, or it is not seen.
        """
        params, self.controller.designed = self._flown
        reference = Reference(present, ahead, usable)
        bodies = self._no_bodies if bodies is None else bodies
        bundle = Bundle(states, autonomous, self.sent, bodies, covariances)
        command = self.controller.step(Times(stamp_s, now_s), bundle, reference, params)
        controls, cut = self._to_controls(command, states.visible & usable, self.controller.saturated)
        return Output(controls, cut, np.isfinite(controls.thrust_n))


def own_params(name, vehicles, where):
    """[{key: value}] of the parameters in which each FleetVehicle differs from the YAML file of a controller.

    They are in `controllers` of the vehicle's type; those in `controllers` of its entry in the fleet file override
    them.  where: the fleet file.  Raises ValueError that names the file, the vehicle and the key.
    """
    defaults, known = default_params(name), REGISTRY.names()
    found = []
    for vehicle in vehicles:
        of_type = load_vehicle_type(vehicle.type).controllers, str(vehicle_type_file(vehicle.type))
        of_vehicle = vehicle.controllers, "%s: vehicle '%s'" % (where, vehicle.namespace)
        own = {}
        for controllers, place in (of_type, of_vehicle):
            unknown = sorted(set(controllers) - set(known))
            if unknown:
                text = "%s: controllers: there is no '%s'; known are: %s (is RISC_MAAP_MEMBERS set?)"
                raise ValueError(text % (place, "', '".join(unknown), ", ".join(known)))
            own.update(controllers.get(name, {}))
            params = settings_from(type(defaults), {**vars(defaults), **own}, "%s: controllers: %s" % (place, name))
        found.append({key: getattr(params, key) for key in own})  # converted to the types of the class, e.g. int
    return found


def descriptions(name):
    """{name of a controller's parameter: comment beside it in the YAML file}."""
    path = config_files("controllers", "risc_control").get(name)
    return key_comments(path) if path else {}


def default_params(name):
    """PARAMS of a controller with the values of its YAML file. Raises ValueError, also for unknown keys."""
    return REGISTRY.settings(name, REGISTRY.module(name).Controller.PARAMS)
