"""Orders to an autopilot, each from the first message to its outcome. No ROS, no sockets, no clock.

An order sends, resends while there is no answer, and ends with an `Outcome`. `Autopilot` (autopilot.py) passes it the
messages of the vehicle and the time of a monotonic clock.
"""

import math
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

RESEND_S = 0.5  # time without an answer until an order is resent
MISSION_TRIES = 5  # for each step of a mission
HEARTBEATS_S = 2.5  # least timeout of orders that a heartbeat must confirm: enough for two heartbeats
EXPLANATION_S = 0.5  # an autopilot sends the texts that explain a refusal after its answer
_WARNING = mavlink.MAV_SEVERITY_WARNING
_FORCE = 21196  # magic number of MAV_CMD_COMPONENT_ARM_DISARM: without any check


class Outcome(NamedTuple):
    """Result of an order."""

    is_done: bool
    why: str = ""  # reason if it was not done


def _name(enum, number):
    """Return the dialect's name of a number, e.g. DENIED for 2 of MAV_RESULT."""
    entry = mavlink.enums[enum].get(number)
    return entry.name.removeprefix(enum + "_") if entry else "%s %d" % (enum, number)


class Order:
    """Base class of orders: when to resend, when to give up, and which texts the autopilot sends meanwhile."""

    def __init__(self, what, timeout_s, resend_s=RESEND_S):
        """what: name for the log, e.g. "arm"."""
        self.what = what
        self.outcome = None  # an Outcome once the order has ended
        self._timeout_s, self._resend_s = timeout_s, resend_s
        self._texts = []
        self._refusal = ""
        self._send = None  # None: not begun
        self._is_taken = False  # the autopilot has accepted the order: it is not resent

    @property
    def longest_s(self):
        """Time [s] after which the order has ended in any case."""
        return self._timeout_s + EXPLANATION_S

    def begin(self, send, now_s):
        """Begin the order. send: function (name of a MAVLink message, its fields except the target)."""
        self._send = send
        self._deadline_s = now_s + self._timeout_s
        self._next_s = now_s
        self.poll(now_s)

    def poll(self, now_s):
        """Do what is due."""
        if self.outcome is not None:
            return
        if self._refusal:
            if now_s >= self._deadline_s:
                self.outcome = Outcome(False, "; ".join((self._refusal, *self._texts)))
        elif now_s >= self._deadline_s:
            self.outcome = Outcome(False, "; ".join((self._lacking(), *self._texts)))
        elif now_s >= self._next_s and not self._is_taken:
            self._next_s = now_s + self._resend_s
            self._ask()

    def on_text(self, severity, text):
        """Handle a STATUSTEXT."""
        if severity <= _WARNING and text not in self._texts:
            self._texts.append(text)

    def on_message(self, message, now_s):
        """Handle a message of the vehicle."""
        if self.outcome is None and not self._refusal:
            self._hear(message, now_s)

    def _refused(self, why, now_s):
        self._refusal, self._deadline_s = why, now_s + EXPLANATION_S

    def _ask(self):
        raise NotImplementedError

    def _hear(self, message, now_s):
        raise NotImplementedError

    def _lacking(self):
        raise NotImplementedError


class _Acknowledged(Order):
    """An order that is answered by a COMMAND_ACK and, if `_is_confirmed_by_heartbeat`, confirmed by a heartbeat."""

    _answers = ()  # numbers in COMMAND_ACK
    _is_confirmed_by_heartbeat = True

    def _hear(self, message, now_s):
        kind = message.get_type()
        if kind == "COMMAND_ACK" and message.command in self._answers:
            if message.result == mavlink.MAV_RESULT_IN_PROGRESS:
                self._is_taken = True
            elif message.result != mavlink.MAV_RESULT_ACCEPTED:
                self._refused("the autopilot answers " + _name("MAV_RESULT", message.result), now_s)
            elif self._is_confirmed_by_heartbeat:
                self._is_taken = True
            else:
                self.outcome = Outcome(True)
        elif kind == "HEARTBEAT" and self._is_confirmed_by_heartbeat and self._is_seen(message):
            self.outcome = Outcome(True)

    def _is_seen(self, heartbeat):
        raise NotImplementedError

    def _lacking(self):
        if self._is_taken:
            return "the autopilot has said yes, but does not tell that it is done"
        return "no answer of the autopilot within %g s" % self._timeout_s


class Command(_Acknowledged):
    """Sends COMMAND_LONG until its COMMAND_ACK."""

    _is_confirmed_by_heartbeat = False

    def __init__(self, what, number, parameters, timeout_s):
        """parameters: up to seven; the others are 0."""
        super().__init__(what, timeout_s)
        self._number, self._answers, self._tries = number, (number,), 0
        values = [*parameters] + [0.0] * (7 - len(parameters))
        self._parameters = {"param%d" % k: float(value) for k, value in enumerate(values, 1)}

    def _ask(self):
        self._send("command_long", command=self._number, confirmation=min(self._tries, 255), **self._parameters)
        self._tries += 1


class Arm(Command):
    """Arms or disarms, until a heartbeat confirms it."""

    _is_confirmed_by_heartbeat = True

    def __init__(self, is_armed, timeout_s):
        what = "arm" if is_armed else "disarm"
        super().__init__(what, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, [is_armed], max(timeout_s, HEARTBEATS_S))
        self._wanted = is_armed

    def _is_seen(self, heartbeat):
        return is_armed(heartbeat) == self._wanted


class SetMode(_Acknowledged):
    """Sends SET_MODE until a heartbeat reports the mode."""

    _answers = (mavlink.MAVLINK_MSG_ID_SET_MODE, mavlink.MAV_CMD_DO_SET_MODE)

    def __init__(self, name, number, timeout_s):
        super().__init__("mode " + name, max(timeout_s, HEARTBEATS_S))
        self._number = number

    def _ask(self):
        self._send("set_mode", base_mode=mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, custom_mode=self._number)

    def _is_seen(self, heartbeat):
        is_custom = heartbeat.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        return bool(is_custom) and heartbeat.custom_mode == self._number


class Sequence(Order):
    """Orders one after the other; ends when one fails."""

    def __init__(self, what, orders):
        super().__init__(what, sum(order.longest_s for order in orders))
        self._orders = list(orders)

    def poll(self, now_s):
        if self.outcome is not None:
            return
        first = self._orders[0]
        if first._send is None:
            first.begin(self._send, now_s)
        first.poll(now_s)
        if first.outcome is None:
            return
        if not first.outcome.is_done:
            self.outcome = Outcome(False, "%s: %s" % (first.what, first.outcome.why))
        elif len(self._orders) == 1:
            self.outcome = first.outcome
        else:
            del self._orders[0]
            self.poll(now_s)

    def on_text(self, severity, text):
        self._orders[0].on_text(severity, text)

    def on_message(self, message, now_s):
        self._orders[0].on_message(message, now_s)


def is_armed(heartbeat):
    """Whether a HEARTBEAT reports the vehicle as armed."""
    return bool(heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)


def take_off(altitude_m, timeout_s):
    """Return the Order to take off, in guided mode."""
    return Command("take off", mavlink.MAV_CMD_NAV_TAKEOFF, [0, 0, 0, 0, 0, 0, altitude_m], timeout_s)


def land(timeout_s):
    """Return the Order to land here."""
    return Command("land", mavlink.MAV_CMD_NAV_LAND, [], timeout_s)


KILL = {  # fields of the COMMAND_LONG that stops the motors, wherever the vehicle is
    "command": mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
    "confirmation": 0,
    "param1": 0.0,
    "param2": float(_FORCE),
    **{"param%d" % k: 0.0 for k in range(3, 8)},
}


# ------------------------------------------------------------------------------------------------------- missions


class Item(NamedTuple):
    """One item of a mission."""

    command: int
    param1: float = 0.0
    param2: float = 0.0
    param3: float = 0.0
    param4: float = 0.0
    latitude: int = 0  # [1e-7 deg]
    longitude: int = 0  # [1e-7 deg]
    altitude_m: float = 0.0  # above home
    frame: int = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT


def longest_mission_s(items, step_s):
    """Longest time [s] for sending a mission of this many items, or clearing it. step_s: time for each answer."""
    return (items + 3) * MISSION_TRIES * step_s + EXPLANATION_S  # 3: home position, item count, last answer


class _MissionOrder(Order):
    """Order about the mission; ignores answers about fences and rally points."""

    def __init__(self, what, step_s):
        super().__init__(what, math.inf, step_s)
        self._tries = 0

    def poll(self, now_s):
        if self.outcome is None and now_s >= self._next_s and self._tries == MISSION_TRIES:
            self.outcome = Outcome(False, "; ".join((self._lacking(), *self._texts)))
        super().poll(now_s)

    def _ask(self):
        self._tries += 1
        self._ask_step()

    def _hear(self, message, now_s):
        if getattr(message, "mission_type", mavlink.MAV_MISSION_TYPE_MISSION) != mavlink.MAV_MISSION_TYPE_MISSION:
            return
        is_answer = message.get_type() == "MISSION_ACK"
        if is_answer and message.type == mavlink.MAV_MISSION_INVALID_SEQUENCE:
            return  # for an item that was sent twice, because its request or the item was late
        if is_answer and message.type != mavlink.MAV_MISSION_ACCEPTED:
            self._refused("the autopilot answers " + _name("MAV_MISSION_RESULT", message.type), now_s)
        else:
            self._step(message, now_s)

    def _ask_step(self):
        raise NotImplementedError

    def _step(self, message, now_s):
        raise NotImplementedError


class SendMission(_MissionOrder):
    """Uploads a mission: sends the number of items, then each item when the autopilot requests it."""

    def __init__(self, items, step_s):
        """items: the first is the home position, which autopilots keep as item 0.  step_s: time for each answer."""
        super().__init__("mission of %d item(s)" % (len(items) - 1), step_s)
        self._items = items
        self._asked_for = None  # (number of the item last requested, whether as MISSION_ITEM_INT)

    def _ask_step(self):
        if self._asked_for is None:
            self._send("mission_count", count=len(self._items))
        else:
            self._send_item(*self._asked_for)

    def _step(self, message, now_s):
        kind = message.get_type()
        if kind == "MISSION_ACK" and self._asked_for and self._asked_for[0] == len(self._items) - 1:
            self.outcome = Outcome(True)
        elif kind in ("MISSION_REQUEST", "MISSION_REQUEST_INT") and message.seq < len(self._items):
            asked_for = message.seq, kind == "MISSION_REQUEST_INT"
            if asked_for != self._asked_for:
                self._tries = 0
            self._asked_for, self._next_s = asked_for, now_s
            self.poll(now_s)

    def _send_item(self, number, is_int):
        item = self._items[number]
        where = {"x": item.latitude, "y": item.longitude}
        if not is_int:
            where = {axis: value * 1e-7 for axis, value in where.items()}
        self._send(
            "mission_item_int" if is_int else "mission_item",
            seq=number,
            frame=item.frame,
            command=item.command,
            current=0,
            autocontinue=1,
            param1=item.param1,
            param2=item.param2,
            param3=item.param3,
            param4=item.param4,
            z=item.altitude_m,
            **where,
        )

    def _lacking(self):
        if self._asked_for is None:
            return "the autopilot does not ask for the items"
        return "the autopilot stopped at item %d of %d" % (self._asked_for[0], len(self._items) - 1)


class ClearMission(_MissionOrder):
    """Clears the autopilot's mission."""

    def __init__(self, step_s):
        super().__init__("clear the mission", step_s)

    def _ask_step(self):
        self._send("mission_clear_all")

    def _step(self, message, now_s):
        if message.get_type() == "MISSION_ACK":
            self.outcome = Outcome(True)

    def _lacking(self):
        return "no answer of the autopilot"
