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

It flies all vehicles of a fleet at once, of whatever types. Who cannot be flown (not seen, no reference), limits and
the units of /controls are not its business: `ControlLoop` sees to them, and it is what nodes and offline flights run.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from risc_control.reference_buffer import Axis, Order
from risc_control.vehicles import Command, Controls, ControlsConverter
from risc_lab.command_history import CommandHistory
from risc_lab.registry import Registry
from risc_lab.states import S, States

REGISTRY = Registry("controllers", __name__)


class Times(NamedTuple):
    """When a step is."""

    stamp_s: float  # of the states: when they held
    now_s: float  # when the command will be sent


class Bundle(NamedTuple):
    """What is known of the world. What only some have (attached bodies, covariances, disturbances) goes here, too."""

    vehicles: States
    autonomous: np.ndarray  # (n,) bool, False where somebody else flies the vehicle: our commands are not sent
    sent: CommandHistory  # what the vehicles were really sent, as far as that is known; its times are those of `Times`


class Reference(NamedTuple):
    """What is wanted: arrays (orders, n, 4), position to `Controller.ORDER` of x, y, z, psi in the cortex frame."""

    present: np.ndarray  # at the stamp of the states
    ahead: np.ndarray  # at the time of sending plus the vehicle's `Controller.delay_s`
    usable: np.ndarray  # (n,) bool, False where there is no fresh one: its numbers, or that of a state, mean nothing


@dataclass(frozen=True)
class NoParams:
    """Of a controller without any."""


class Controller:
    """Flies n vehicles. Steps come in the order of time."""

    PARAMS = NoParams  # dataclass of numbers: the keys of its YAML file
    ORDER = Order.ACCELERATION  # highest derivative of the reference that it reads, at most MOST_ORDER
    RECONFIGURE = ""  # what dynamic_reconfigure changes of its parameters: a file cfg/NAME.cfg

    def __init__(self, vehicle_types, params):
        """vehicle_types: VehicleType of each vehicle, in the order of all arrays."""
        self.mass_kg = np.array([vehicle_type.mass_kg for vehicle_type in vehicle_types])
        self.delay_s = np.zeros(len(vehicle_types))  # that it counts on, of each vehicle's commands
        self.saturated = np.zeros(len(vehicle_types), dtype=bool)  # of its last commands, those that it has limited
        self.designed = None  # by `design`, for the parameters of the step under way

    def step(self, t, states, reference, params):
        """`Command` of arrays (n,).  t: Times.  states: Bundle.  reference: Reference.  params: PARAMS.

        Raises ValueError when a number of a vehicle that is seen is not finite.
        """
        raise NotImplementedError

    def design(self, params):
        """What follows from parameters and takes its time (gains ...), which no step must wait for; from any thread.

        Raises ValueError when there is no solution.
        """

    def reset(self):
        """Forget everything that was learnt in flight."""
        self.forget_times()

    def forget_times(self):
        """The clock of stamps and commands was set: what was sent when means nothing now."""


class Output(NamedTuple):
    """What goes to n vehicles."""

    controls: Controls  # of arrays (n,)
    saturated: np.ndarray  # (n,) bool: a limit of the vehicle cut the command


class ControlLoop:
    """A controller with its parameters, its references in time, and the way to /controls."""

    def __init__(self, controller, vehicle_types, params=None):
        """controller: a name of the REGISTRY, or a class.  params: None = of its YAML file, of a class its defaults."""
        if isinstance(controller, str):
            params = params or default_params(controller)
            controller = REGISTRY.module(controller).Controller
        params = params or controller.PARAMS()
        self.controller = controller(vehicle_types, params)
        self._to_controls = ControlsConverter(vehicle_types)
        self._delays_s, self._which = np.unique(self.controller.delay_s, return_inverse=True)
        self._everyone = np.arange(len(vehicle_types))
        self.sent = CommandHistory(len(vehicle_types))  # whoever knows what was really sent appends it here
        self.set_params(params)
        n = len(vehicle_types)  # load what is compiled, by an update in which no vehicle is seen
        none, nowhere = np.zeros(n, dtype=bool), np.zeros((self.controller.ORDER + 1, n, len(Axis)))
        self.update(0.0, 0.0, States(none, np.zeros((n, len(S)))), nowhere, nowhere, none, none)
        self.controller.reset()

    def set_params(self, params):
        """Fly with other parameters. Raises ValueError, and keeps the old ones, when there is no solution."""
        self._flown = params, self.controller.design(params)

    @property
    def params(self):
        """Those that it flies with."""
        return self._flown[0]

    def forget_times(self):
        """The clock of stamps and commands was set."""
        self.sent.clear()
        self.controller.forget_times()

    def times_s(self, stamp_s, now_s):
        """(1 + k,) times of the references that an update wants: at the stamp, and where its commands take effect."""
        times_s = np.empty(1 + len(self._delays_s))
        times_s[0] = stamp_s
        times_s[1:] = self._delays_s + (stamp_s + max(0.0, now_s - stamp_s))
        return times_s

    def pick(self, values):
        """(present, ahead), both (orders, n, 4), of references (1 + k, orders, n, 4) at `times_s`."""
        if len(values) == 2:
            return values[0], values[1]
        return values[0], np.ascontiguousarray(values[1 + self._which, :, self._everyone].transpose(1, 0, 2))

    def update(self, stamp_s, now_s, states, present, ahead, usable, autonomous):
        """`Output` for the States at stamp_s, to be sent at now_s; level with hover thrust where nothing is known.

        present, ahead, usable: see `Reference`.  autonomous: see `Bundle`.  Raises ValueError, and nothing counts as
        sent, when a number of a vehicle that is seen is not finite.
        """
        params, self.controller.designed = self._flown
        reference, bundle = Reference(present, ahead, usable), Bundle(states, autonomous, self.sent)
        command = self.controller.step(Times(stamp_s, now_s), bundle, reference, params)
        return Output(*self._to_controls(command, states.visible & usable, self.controller.saturated))


def checked(is_finite, commands):
    """`Command` of the rows of commands (4, n). Raises ValueError when a number was not finite."""
    # raised here: an exception out of compiled code leaves its arrays in memory for ever
    if not is_finite:
        raise ValueError("refusing to command: a state or a reference is not finite")
    return Command(commands[0], commands[1], commands[2], commands[3])


def default_params(name):
    """PARAMS of a member with the numbers of its YAML file. Raises ValueError, also for keys that it does not know."""
    return REGISTRY.settings(name, REGISTRY.module(name).Controller.PARAMS)
