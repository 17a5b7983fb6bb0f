"""Vehicle types, flight side: from a physical command to the inputs of a vehicle. Needs no ROS.

A controller commands roll, pitch, yaw rate and thrust (`Command`) for any type. Only the type's `Adapter` knows the
rest: the units of its entry on /controls, climb rates, sticks, calls to take off and to land, status, and what it can
hold by itself. On the way

    controller -- Command --> ControlsConverter -- /controls --> vehicle node: VehiclePilot, Adapter -- Sticks --> link

a command is converted twice: into the unit of /controls (a fraction of the full scale for an AR.Drone, unchanged by
default), and in the vehicle node into the inputs of the vehicle.

A type is one file here with a class `Adapter`, and risc_lab/config/vehicle_types/NAME.yaml with its numbers; those that
no other type has are its `own`, see `Adapter.PARAMS`. From elsewhere: vehicle_types/NAME.py and .yaml, see
`risc_lab.registry`.
"""

import math
from enum import IntEnum
from functools import partial
from typing import NamedTuple

import numpy as np

from risc_lab.compiled import compiled, record
from risc_lab.frames import GRAVITY_M_S2
from risc_lab.lab.vehicle_types import own_numbers
from risc_lab.registry import Registry
from risc_lab.ros.sender import sender
from risc_lab.settings import NoParams


class Command(NamedTuple):
    """What a controller commands: numbers, or arrays (n,). NED senses, as in `risc_lab.states`."""

    roll_rad: float  # + right wing down; the angle that the vehicle reaches, the gain of its attitude loop included
    pitch_rad: float  # + nose up
    yaw_rate_rad_s: float  # + clockwise from above
    thrust_n: float


class Controls(NamedTuple):
    """An entry of /controls in the units of its vehicle's type: numbers, or arrays (n,)."""

    phi: float
    theta: float
    psi: float
    thrust_n: float


class FlightState(IntEnum):
    """What a vehicle reports to be doing. The numbers are those of ardrone_autonomy's Navdata."""

    UNKNOWN = 0
    INIT = 1
    LANDED = 2
    FLYING = 3
    HOVERING = 4
    TEST = 5
    TAKING_OFF = 6
    GOTO = 7
    LANDING = 8
    LOOPING = 9
    OTHER_MODE = 32  # not in Navdata: a mode chosen by its pilot, in which it ignores our commands
    PILOT = 33  # not in Navdata: it follows the sticks of its pilot's transmitter, not what we send


ON_GROUND = frozenset((FlightState.INIT, FlightState.LANDED))
NO_EVIDENCE = frozenset((FlightState.UNKNOWN, FlightState.TEST))  # air or ground: an emergency in the air reports 0
TAKES_COMMANDS = frozenset((FlightState.FLYING, FlightState.HOVERING, FlightState.GOTO))


def state_text(state):
    """Name of a FlightState; "not known" for numbers that only its type knows."""
    return FlightState(state).name.lower().replace("_", " ") if state in tuple(FlightState) else "not known"


class Status(NamedTuple):
    """A vehicle's report of itself."""

    state: int  # FlightState, or another number that its type has
    battery_pct: float | None  # None: this report has none
    # measured by its own sensors, `VehicleType.report_delay_s` ago; None: this report has none
    velocity_m_s: tuple | None = None  # horizontal: forward, right; the same again and again counts as no report
    tilt_rad: tuple | None = None  # its own estimate of roll, pitch
    height_m: float | None = None  # above any fixed level
    climb_m_s: float | None = None


class EventTopic(NamedTuple):
    """A topic of a type's driver whose messages are events of a recording, and how its readers are told of them."""

    message: str  # name of its type, without the package
    words: object  # function of a message that returns the text
    each: bool = False  # True: each message is an event; False: only one with another text than the one before


# How a vehicle climbs, around hover: acceleration = gain * command - damping * climb rate, |command| <= most.
CLIMB_LOOP = record("gain damping_1_s most")


class Adapter:
    """One vehicle of a type, as its vehicle node flies it.

    own: `vehicle_pilot.OwnState`, the newest state of the vehicle; None before the first.  Sticks: what it takes, as
    fractions of its full scales; the meaning of `up` is the type's. `move` and `by_hand` are called only for types that
    fly themselves, `fly` only for the others.
    """

    FLIES_ITSELF = True  # takes off, hovers and lands when told to; False: its vehicle node does all that, see `hover`
    PARAMS = NoParams  # dataclass of numbers that only this type has: `own` of its YAML file
    HOLDS_POSITION = False  # with all sticks centred, by itself and without motion capture
    REPORTS = "reports"  # what people call its reports
    LINK = "link"  # what people call the link by which they come
    COMMANDS = "commands"  # topic below its namespace for the commands to it
    EVENT_TOPICS = {}  # {topic below its namespace: EventTopic}
    NODES = {}  # {role: node of its driver}, by which injected faults find it: `driver` takes the commands
    SILENT_S = 0.0  # longest normal gap between reports; a shorter `SafetyLimits.navdata_timeout_s` is raised to it
    NEEDS_BATTERY = False  # whether T on /controls depends on the charge, see `zero_thrust`
    THRUST_MOST = math.inf  # greatest |T| on /controls

    def __init__(self, vehicle_type, command_rate_hz):
        """vehicle_type: VehicleType.  command_rate_hz: rate of the commands to the vehicle."""
        self.type, self.numbers = vehicle_type, own_numbers(vehicle_type, self.PARAMS)

    @staticmethod
    def units(vehicle_type):
        """The `Command` for which phi, theta, psi and T on /controls are 1."""
        return Command(1.0, 1.0, 1.0, 1.0)

    @staticmethod
    def zero_thrust(vehicle_type, battery_pct):
        """T on /controls for a thrust of 0 N, at this charge; None: the charge is unknown."""
        return 0.0

    @staticmethod
    def swing_s(vehicle_type):
        """Time [s] that its command takes to change by an acceleration of g, horizontal or upward; 0: at once."""
        return 0.0

    @staticmethod
    def climb_loop(vehicle_type):
        """(gain, damping, most) of the CLIMB_LOOP that controllers assume."""
        raise NotImplementedError

    def answer(self, controls, own, own_s, now_s, sent):
        """Sticks for the vehicle's `Controls`. own_s: time of the state [s].  sent: HISTORY of what it was sent."""
        raise NotImplementedError

    def move(self, forward_rad, left_rad, climb_m_s, own):
        """Sticks that tilt by these angles and climb: to avoid others. All 0: level, at this height."""
        raise NotImplementedError

    def by_hand(self, sticks, own):
        """Sticks to send for those of an operator, whose `up` is a climb rate."""
        return sticks

    def sendable(self, sticks, now_s):
        """The sticks, limited to the change from the last ones that the vehicle follows at once. Called for each
        message.
        """
        return sticks

    def settles_at(self, sticks, own):
        """(4,) what the vehicle settles at when it is sent these: see `command_history.Channel`."""
        raise NotImplementedError

    @staticmethod
    def listen(prefix, on_status, subscribe):
        """Call on_status(Status, name of the driver's node) for what the vehicle reports. prefix: as of `connect`.

        subscribe: makes a subscription of a topic, a message class and a callback.
        """
        raise NotImplementedError

    @classmethod
    def watch(cls, prefix, on_status, subscribe):
        """As `listen`, for programs other than its vehicle node that need to know whether it hovers: of a type that
        does not fly itself, only that node knows.
        """
        if cls.FLIES_ITSELF:
            cls.listen(prefix, on_status, subscribe)
            return
        from risc_maap_msgs.msg import VehicleStatus  # the rest needs no ROS

        def on_message(message):
            battery_pct = message.battery_pct if math.isfinite(message.battery_pct) else None
            on_status(Status(message.state, battery_pct), sender(message))

        subscribe(prefix + "vehicle_status", VehicleStatus, on_message)

    @staticmethod
    def connect(prefix, name, on_refusal):
        """Link to the vehicle by ROS, e.g. `ardrone.Link`.

        prefix: of its topics, with the last "/".  name: of the vehicle.  on_refusal: called with the reason why it does
        not take off, by types that report it.
        """
        raise NotImplementedError

    # --- of a type that does not fly itself --------------------------------------------------------------------------

    MODE_CURE = ""  # what to do when it is in another mode than the one that takes our commands
    trim_m_s2 = 0.0  # to add to the thrust of every command, as an upward acceleration: what was learnt in flight

    @staticmethod
    def listen_to_wire(prefix, on_wire, subscribe):
        """Call on_wire() for each report of the transmitter's board that it sends our commands to the vehicle."""
        raise NotImplementedError

    def tell_battery(self, battery_pct, now_s):
        """The vehicle has reported its charge."""

    def fly(self, command):
        """Sticks for a `Command`; None: those for a vehicle that stands, which let one in the air drop."""
        raise NotImplementedError


REGISTRY = Registry("vehicle_types", __name__)


def adapter_class(vehicle_type):
    """`Adapter` of a VehicleType. Raises ValueError when it has none, or when it cannot read the type's `own`."""
    adapter = REGISTRY.module(vehicle_type.name).Adapter
    own_numbers(vehicle_type, adapter.PARAMS)
    return adapter


def event_topics():
    """{topic below a vehicle's namespace: EventTopic} of all types."""
    adapters = (REGISTRY.module(name).Adapter for name in REGISTRY.names())
    return {name: topic for adapter in adapters for name, topic in adapter.EVENT_TOPICS.items()}


def driver_nodes():
    """{role: nodes of drivers} of all types, see `Adapter.NODES`."""
    nodes = {}
    for name in REGISTRY.names():
        for role, node in REGISTRY.module(name).Adapter.NODES.items():
            nodes.setdefault(role, []).append(node)
    return nodes


def climb_loops(vehicle_types):
    """(n,) CLIMB_LOOP of VehicleTypes."""
    return np.array([tuple(adapter_class(t).climb_loop(t)) for t in vehicle_types], CLIMB_LOOP)


# --- a vehicle's limits, and its entry of /controls ---------------------------------------------------------------

_COMMAND = record(" ".join(Command._fields))
# What commands of a type are limited to, and what 1 on /controls means.
_CONVERSION = record(("most", _COMMAND), ("unit", _COMMAND), "hover_n zero_thrust greatest_thrust")


def greatest_command(vehicle_type):
    """The largest `Command` that a VehicleType reaches: the tilt of its attitude loops at full scale."""
    return Command(
        vehicle_type.roll.gain * vehicle_type.tilt_max_rad,
        vehicle_type.pitch.gain * vehicle_type.tilt_max_rad,
        vehicle_type.yaw_rate_max_rad_s,
        math.inf,
    )


# Converts to the arrays that the code is compiled for, so that nothing is compiled in flight.
floats = partial(np.ascontiguousarray, dtype=float)


_CHARGE_S = 3.0  # time constant


class Charge:
    """A battery's charge, smoothed: each whole percent that is reported would be a step of the throttle."""

    def __init__(self):
        self.pct = None  # None before the first report
        self._noted_s = 0.0

    def note(self, battery_pct, now_s):
        """A report."""
        if self.pct is None:
            self.pct = battery_pct
        else:
            self.pct += (battery_pct - self.pct) * -math.expm1(-max(0.0, now_s - self._noted_s) / _CHARGE_S)
        self._noted_s = now_s


class ControlsConverter:
    """Commands of a fleet -> its entries of /controls."""

    def __init__(self, vehicle_types):
        """vehicle_types: of each vehicle."""
        self._types = tuple(vehicle_types)
        self._adapters = [adapter_class(vehicle_type) for vehicle_type in self._types]
        self._charges = [Charge() for _ in self._types]
        self._conversions = np.zeros(len(self._types), _CONVERSION)
        for i, vehicle_type in enumerate(self._types):
            conversion, adapter = self._conversions[i], self._adapters[i]
            conversion.most = greatest_command(vehicle_type)
            conversion.unit = adapter.units(vehicle_type)
            conversion.hover_n = vehicle_type.mass_kg * GRAVITY_M_S2
            conversion.zero_thrust = adapter.zero_thrust(vehicle_type, None)
            conversion.greatest_thrust = adapter.THRUST_MOST
        n = len(self._types)
        nobody = np.zeros(n, dtype=bool)
        self(Command(*np.zeros((4, n))), nobody, nobody)  # loads the compiled code

    def tell_battery(self, i, battery_pct, now_s):
        """Take the charge [%] that vehicle i has reported; NaN: it has reported none."""
        if math.isfinite(battery_pct):
            charge = self._charges[i]
            charge.note(battery_pct, now_s)
            self._conversions["zero_thrust"][i] = self._adapters[i].zero_thrust(self._types[i], charge.pct)

    def __call__(self, command, known, saturated):
        """(`Controls` of arrays (n,), (n,) bool: a limit of the vehicle cut its command, or `saturated` said so).

        known: (n,) bool; where it is False the answer is level with the thrust of hover (zero acceleration, thesis
        7.7).  A vehicle that is known and whose command is not finite gets NaN, which must not be sent.
        """
        roll, pitch, yaw_rate, thrust = map(floats, command)
        controls, cut = np.empty((4, len(known))), np.array(saturated)
        _convert(roll, pitch, yaw_rate, thrust, known, self._conversions, controls, cut)
        return Controls(controls[0], controls[1], controls[2], controls[3]), cut


@compiled
def _convert(roll_rad, pitch_rad, yaw_rate_rad_s, thrust_n, known, conversions, controls, cut):
    """Fill controls (4, n), and set cut (n,), from arrays (n,)."""
    for i in range(len(known)):
        most, unit = conversions[i].most, conversions[i].unit
        if not known[i]:
            cut[i] = False
            controls[0, i] = controls[1, i] = controls[2, i] = 0.0
            controls[3, i] = conversions[i].hover_n / unit.thrust_n + conversions[i].zero_thrust
            continue
        if not math.isfinite(roll_rad[i] + pitch_rad[i] + yaw_rate_rad_s[i] + thrust_n[i]):
            cut[i] = False
            controls[:, i] = math.nan
            continue
        roll, pitch = clipped(roll_rad[i], most.roll_rad), clipped(pitch_rad[i], most.pitch_rad)
        rate = clipped(yaw_rate_rad_s[i], most.yaw_rate_rad_s)
        thrust = thrust_n[i] / unit.thrust_n + conversions[i].zero_thrust
        controls[3, i] = clipped(thrust, conversions[i].greatest_thrust)
        cut[i] |= roll != roll_rad[i] or pitch != pitch_rad[i] or rate != yaw_rate_rad_s[i] or controls[3, i] != thrust
        controls[0, i], controls[1, i] = roll / unit.roll_rad, pitch / unit.pitch_rad
        controls[2, i] = rate / unit.yaw_rate_rad_s


@compiled
def clipped(value, most):
    """Value limited to +-most; NaN stays NaN."""
    if value > most:
        return most
    return -most if value < -most else value


@compiled
def climb_command(up_m_s2, climb_m_s, loop):
    """The command of a CLIMB_LOOP that makes an acceleration at this climb rate; of a loop of the first order with
    the time constant tau it is eq. 5.4, climb rate + tau * acceleration.
    """
    return (up_m_s2 + loop.damping_1_s * climb_m_s) / loop.gain


@compiled
def climb_acceleration(command, climb_m_s, loop):
    """Upward acceleration [m/s^2] for a command: the inverse of `climb_command`."""
    return loop.gain * command - loop.damping_1_s * climb_m_s
