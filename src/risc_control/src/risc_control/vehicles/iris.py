"""3DR IRIS+ (thesis 5.2): sticks of a radio, a throttle whose middle moves with the battery (eq. 5.5).

Entries of /controls are stick fractions, with the signs of the angles of the states: + phi moves right, + theta noses
up, + psi turns right; T is the throttle, -1 the lowest. An autopilot in STABILIZE takes the first two as angles, the
third as a yaw rate, and passes the throttle on: it holds neither height nor position.
"""

import contextlib
import math
import queue
import threading
import time
from collections import deque
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from functools import partial

import numpy as np

from risc_control import vehicles
from risc_control.joystick import Sticks, limited
from risc_control.vehicles import Command, EventTopic, FlightState, Status
from risc_lab.command_history import Channel
from risc_lab.frames import GRAVITY_M_S2
from risc_lab.lab.vehicle_types import own_numbers
from risc_lab.radio_sticks import RadioSticks
from risc_lab.ros.sender import sender

MODE = "STABILIZE"  # in which it takes our commands
ANSWER_S = 4.0  # a service of its driver that has not answered by then is not waited for; arming takes up to 3 s
_MOST_UNANSWERED = 4
NOMINAL_BATTERY_PCT = 70.0  # while the vehicle has reported none
STICKS = 4  # channels that fly it, the first ones of the radio
OTHER_US = 60  # received pulses differ by more from those sent: they are not ours,
SAME_US = 30  # until they differ by less
REPORTS = 8  # of received pulses that are judged together
_DELAYS_S = [0.1 * k for k in range(10)]  # candidate delays from the board's report to the autopilot's,
_SPREAD_S = 0.25  # and their additional variation from one report to the next
_BURST_S, _GAP_S = 0.01, 1.0  # between reports: those that were delayed, and those before a gap, do not count

_CLIMB_SHARE = 1.5  # of the type's greatest climb rate: limit for a controller; courses need less than that rate
_FORGETS_S = 0.4  # without commands for this long the board may have changed to other ones
_BOARD = {0: "waiting for commands", 1: "locked, waiting for the lowest throttle", 2: "follows commands", 3: "failsafe"}


class Adapter(vehicles.Adapter):
    """See `vehicles.Adapter`. Sticks are those of the radio: they include the autopilot's dead zone; `up` is T."""

    PARAMS = RadioSticks
    FLIES_ITSELF = False
    REPORTS, LINK, COMMANDS = "telemetry", "telemetry radio", "controls"
    NODES = {"driver": "roscopter", "transmitter": "arduino"}  # the latter: between its vehicle node and its radio
    EVENT_TOPICS = {
        "apm/state": EventTopic("State", lambda m: "autopilot: %s, %s" % (m.mode, "armed" if m.armed else "disarmed")),
        "ppm_status": EventTopic(
            "PpmStatus", lambda m: "PPM of the transmitter's board: " + _BOARD.get(m.state, "unknown")
        ),
    }
    SILENT_S = 2.5  # its state comes with a heartbeat once a second
    MODE_CURE = "set it to %s" % MODE
    NEEDS_BATTERY = True
    THRUST_MOST = 1.0

    def __init__(self, vehicle_type, command_rate_hz):
        super().__init__(vehicle_type, command_rate_hz)
        self._charge = vehicles.Charge()
        self._unit = self.units(vehicle_type)
        self._hover = hover_throttle(vehicle_type, None)
        self._newest, self._newest_s = Sticks(0.0, 0.0, 0.0, 0.0), -math.inf  # that it was sent

    @staticmethod
    def units(vehicle_type):
        most = vehicles.greatest_command(vehicle_type)
        return Command(most.roll_rad, most.pitch_rad, most.yaw_rate_rad_s, vehicle_type.mass_kg * GRAVITY_M_S2)

    @staticmethod
    def zero_thrust(vehicle_type, battery_pct):
        return hover_throttle(vehicle_type, battery_pct) - 1.0

    @staticmethod
    def swing_s(vehicle_type):
        return 1.0 / own_numbers(vehicle_type, RadioSticks).stick_rate_1_s  # 1 is 45 degrees, and a weight of thrust

    @staticmethod
    def climb_loop(vehicle_type):
        """Its command is the throttle above that of hover: 1 is an acceleration of g."""
        hovers = [hover_throttle(vehicle_type, pct) for pct in range(101)]
        most = min(1.0 - max(hovers), 1.0 + min(hovers))
        return GRAVITY_M_S2, vehicle_type.drag_n_s_m / vehicle_type.mass_kg, most

    def tell_battery(self, battery_pct, now_s):
        self._charge.note(battery_pct, now_s)
        self._hover = hover_throttle(self.type, self._charge.pct)

    def answer(self, controls, own, own_s, now_s, sent):
        throttle = self._within_climb(controls.thrust_n, own) + self.trim_m_s2 / GRAVITY_M_S2
        return self._sticks(controls.phi, controls.theta, controls.psi, throttle)

    def fly(self, command):
        if command is None:
            self._newest_s = -math.inf  # at once, without the rate limit: nothing predicts its motion without thrust
            return Sticks(0.0, 0.0, -1.0, 0.0)
        phi, theta, psi, weights = (part / one for part, one in zip(command, self._unit))
        return self._sticks(phi, theta, psi, self._hover + weights - 1.0 + self.trim_m_s2 / GRAVITY_M_S2)

    def sendable(self, sticks, now_s):
        """The board of the transmitter has the same limit, but would delay commands beyond their predicted time."""
        since_s = now_s - self._newest_s
        if since_s < _FORGETS_S:
            most = min(self.numbers.stick_rate_1_s * since_s, self.numbers.stick_step)
            sticks = Sticks(*(min(max(s, last - most), last + most) for s, last in zip(sticks, self._newest)))
        self._newest, self._newest_s = sticks, now_s
        return sticks

    def _within_climb(self, throttle, own):
        """The throttle, limited so that the vehicle can stop before net or floor: nothing on board limits its climb."""
        if own is None:
            return throttle
        most_m_s, cosine = _CLIMB_SHARE * self.type.climb_max_m_s, max(0.5, _cosine(own))
        low, high = (
            (1.0 + (limit_m_s - own.velocity_m_s[2]) / self.type.climb_time_constant_s / GRAVITY_M_S2) / cosine
            for limit_m_s in (-most_m_s, most_m_s)
        )
        hovers = self._hover - 1.0
        return min(max(throttle, hovers + low), hovers + high)

    def settles_at(self, sticks, own):
        unit, dead = self._unit, self.numbers.stick_dead_zone
        phi, theta, psi = (-without_dead_zone(s, dead) for s in (sticks.left, sticks.forward, sticks.turn_left))
        settles = np.empty(len(Channel))
        settles[Channel.PHI], settles[Channel.THETA] = phi * unit.roll_rad, theta * unit.pitch_rad
        weights = 1.0 + sticks.up - self._hover - self.trim_m_s2 / GRAVITY_M_S2
        settles[Channel.CLIMB] = weights * _cosine(own) - 1.0
        settles[Channel.YAW_RATE] = psi * unit.yaw_rate_rad_s
        return settles

    @staticmethod
    def listen(prefix, on_status, subscribe):
        _Reports(prefix, on_status, subscribe)

    @staticmethod
    def listen_to_wire(prefix, on_wire, subscribe):
        from risc_maap_msgs.msg import PpmStatus

        def on_board(message):
            if message.state == PpmStatus.FLYING:
                on_wire()

        subscribe(prefix + "ppm_status", PpmStatus, on_board)

    @staticmethod
    def connect(prefix, name, on_refusal):
        return Link(prefix, name, on_refusal)

    def _sticks(self, phi, theta, psi, throttle):
        dead = self.numbers.stick_dead_zone
        left, forward, turn_left = (-with_dead_zone(limited(fraction), dead) for fraction in (phi, theta, psi))
        return Sticks(forward, left, limited(throttle), turn_left)


def hover_throttle(vehicle_type, battery_pct):
    """Hover throttle at a charge, eq. 5.5 with the c4 of the original release; None: for an average battery."""
    pct = NOMINAL_BATTERY_PCT if battery_pct is None else min(max(battery_pct, 0.0), 100.0)
    return own_numbers(vehicle_type, RadioSticks).hovers_at(pct)


def with_dead_zone(fraction, dead):
    """The stick for which an autopilot takes this fraction of full scale: sticks within +-dead count as 0."""
    return math.copysign(dead + (1.0 - dead) * abs(fraction), fraction) if fraction else 0.0


def without_dead_zone(stick, dead):
    """Inverse of `with_dead_zone`: the fraction that the autopilot takes for a stick."""
    return math.copysign(max(0.0, abs(stick) - dead) / (1.0 - dead), stick)


def _cosine(own):
    return math.cos(own.phi_rad) * math.cos(own.theta_rad) if own else 1.0


class TrainerSwitch:
    """Detects whether the autopilot receives what the board of the transmitter sends, or its pilot has released the
    trainer switch and flies by the sticks. It cannot tell while both send the same.

    It is active once both have agreed: pulses that a transmitter modifies cannot be compared.
    """

    def __init__(self):
        self.is_off = False
        self._has_agreed = False
        self._sent = deque()  # (time [s], channels [us]), for as long as they may be needed
        self._fits = deque(maxlen=REPORTS)  # of each report received: for each delay, whether it was sent then
        self._received_s = -math.inf  # time of the newest report

    def send(self, channels_us, now_s):
        """The board reports that it sends these."""
        self._sent.append((now_s, tuple(channels_us[:STICKS])))
        self._forget(now_s)

    def receive(self, channels_us, now_s):
        """The autopilot reports that it receives these. Returns whether `is_off` has changed."""
        self._forget(now_s)
        received_us, most_us = channels_us[:STICKS], SAME_US if self.is_off else OTHER_US
        since_s, self._received_s = now_s - self._received_s, now_s
        if since_s > _GAP_S:
            self._fits.clear()
        if since_s < _BURST_S or not self._sent or not all(0 < us < 65535 for us in received_us):
            return False
        self._fits.append([self._was_sent(received_us, most_us, now_s - delay_s) for delay_s in _DELAYS_S])
        before, fitting = self.is_off, max(map(sum, zip(*self._fits)))
        if len(self._fits) == REPORTS and fitting >= REPORTS - 1:  # one may be damaged
            self._has_agreed, self.is_off = True, False
        elif len(self._fits) == REPORTS and fitting <= REPORTS // 2:
            self.is_off = self._has_agreed
        return before != self.is_off

    def _forget(self, now_s):
        while self._sent and now_s - self._sent[0][0] > _DELAYS_S[-1] + _SPREAD_S:
            self._sent.popleft()

    def _was_sent(self, received_us, most_us, then_s):
        sent = [channels for time_s, channels in self._sent if then_s - _SPREAD_S <= time_s <= then_s]
        return bool(sent) and all(
            min(values) - most_us <= us <= max(values) + most_us for us, values in zip(received_us, zip(*sent))
        )


class _Reports:
    """Reports of the autopilot by MAVLink (roscopter's topics), and of the transmitter's board on what it sends."""

    def __init__(self, prefix, on_status, subscribe):
        from risc_maap_msgs.msg import PpmStatus  # the rest needs no ROS, but for Link
        from roscopter.msg import RC, VFR_HUD, Attitude, State, Status

        self._on_status, self._switch = on_status, TrainerSwitch()
        self._state, self._state_s = FlightState.UNKNOWN, -math.inf
        self._lock = threading.Lock()  # each topic has a thread
        subscribe(prefix + "apm/state", State, self._on_state)
        subscribe(prefix + "apm/status", Status, self._on_battery)
        subscribe(prefix + "apm/rc", RC, self._on_received)
        subscribe(prefix + "apm/attitude", Attitude, self._on_attitude)
        subscribe(prefix + "apm/vfr_hud", VFR_HUD, self._on_height)
        subscribe(prefix + "ppm_status", PpmStatus, self._on_sent)

    def _on_sent(self, message):
        with self._lock:
            self._switch.send(message.channels_us, time.monotonic())

    def _on_received(self, message):
        with self._lock:
            has_changed = self._switch.receive(message.channel, time.monotonic())
        if has_changed:
            self._tell(message)

    def _on_state(self, message):
        taken = FlightState.FLYING if message.mode == MODE else FlightState.OTHER_MODE
        flies = FlightState.LANDING if message.mode == "LAND" else taken
        with self._lock:
            self._state, self._state_s = flies if message.armed else FlightState.LANDED, time.monotonic()
        self._tell(message)

    def _on_battery(self, message):
        self._tell(message, float(message.battery_remaining) if message.battery_remaining >= 0 else None)

    def _on_attitude(self, message):
        self._tell_sensed(message, tilt_rad=(message.roll, message.pitch))

    def _on_height(self, message):
        self._tell_sensed(message, height_m=message.alt, climb_m_s=message.climb)

    def _tell_sensed(self, message, **sensed):
        """Pass on measurements of its sensors; the flight state comes with other reports."""
        self._on_status(Status(FlightState.UNKNOWN, None, **sensed), sender(message))

    def _tell(self, message, battery_pct=None):
        with self._lock:
            state = self._state if time.monotonic() - self._state_s < Adapter.SILENT_S else FlightState.UNKNOWN
            if state == FlightState.FLYING and self._switch.is_off:
                state = FlightState.PILOT
        self._on_status(Status(state, battery_pct), sender(message))


class Link:
    """rosserial's topic of the board of the transmitter, and roscopter's service, for one vehicle; with ROS only."""

    def __init__(self, prefix, name, on_refusal):
        import rospy  # the rest of the file needs none
        from std_msgs.msg import Empty
        from std_srvs.srv import Empty as Order

        from risc_msgs.msg import Control, Controls
        from roscopter.srv import APMCommand, APMCommandRequest

        self._rospy, self._request, self._on_refusal = rospy, APMCommandRequest, on_refusal
        self._message = Controls(Obj=[Control(name=name)])  # filled again and again
        self._controls = rospy.Publisher(prefix + "controls", Controls, queue_size=1, tcp_nodelay=True)
        self._stop = rospy.Publisher(prefix + "apm/emergency_stop", Empty, queue_size=1, tcp_nodelay=True)
        self._command = rospy.ServiceProxy(prefix + "apm/command", APMCommand)
        self._arm = rospy.ServiceProxy(prefix + "apm/arm", Order)  # its error gives the reason of a refusal
        self._call = Calls(ANSWER_S)
        self._wanted = queue.Queue(1)  # of functions, for a thread of their own: services wait for the vehicle
        threading.Thread(target=self._work, daemon=True).start()
        self.topic = self._controls.resolved_name  # of the commands

    def send(self, sticks, level_only=False):
        """Publish the fractions of the sticks."""
        message, (control,) = self._message, self._message.Obj
        message.header.stamp = self._rospy.Time.now()
        control.phi, control.theta, control.psi, control.T = -sticks.left, -sticks.forward, -sticks.turn_left, sticks.up
        self._controls.publish(message)

    def take_off(self):
        """Arm it, in the mode that takes our commands."""
        self._want(self._stabilize_and_arm)

    def land(self):
        """Let it land by itself."""
        self._want(partial(self._do, self._request.CMD_SET_LAND))

    def disarm(self):
        """Disarm it, if it accepts that."""
        self._want(partial(self._do, self._request.CMD_DISARM))

    def reset(self):
        """Motors off, also in the air."""
        self._stop.publish()
        self._want(lambda: None)  # waiting orders, e.g. to arm it, must not follow

    def driver_overrides(self, driver):
        """{field of VehicleType: value}: the driver sets none."""
        return {}

    def _want(self, order):
        """Queue an order; it replaces an older one that is still waiting."""
        with contextlib.suppress(queue.Empty):
            self._wanted.get_nowait()
        with contextlib.suppress(queue.Full):
            self._wanted.put_nowait(order)

    def _work(self):
        while True:
            try:
                self._wanted.get()()
            except Exception as error:  # after any error the next order must still be carried out
                text = "%s: %s: is its driver (roscopter) there?"
                self._rospy.logwarn_throttle(2.0, text % (self._command.resolved_name, error))

    def _stabilize_and_arm(self):
        try:
            if not self._do(self._request.CMD_SET_STABILIZE):
                self._on_refusal("it does not go into %s" % MODE)
            elif self._wanted.empty():  # not landed meanwhile
                self._call(self._arm)
        except (self._rospy.ServiceException, TimeoutError) as error:
            self._on_refusal(str(error))

    def _do(self, command):
        """Whether the vehicle has done a command of APMCommand."""
        done = self._call(self._command, command).result
        if not done:
            self._rospy.logwarn_throttle(2.0, "%s: refused: %d" % (self._command.resolved_name, command))
        return done


class Calls:
    """Calls of functions that may never return."""

    def __init__(self, limit_s):
        self._limit_s, self._free = limit_s, threading.Semaphore(_MOST_UNANSWERED)

    def __call__(self, function, *arguments):
        """Return or raise what the function does. Raises TimeoutError when it does neither in time (it is left
        running), or when too many calls have not returned.
        """
        if not self._free.acquire(blocking=False):
            raise TimeoutError("%d calls before it have not been answered" % _MOST_UNANSWERED)
        outcome = Future()

        def work():
            try:
                outcome.set_result(function(*arguments))
            except Exception as error:  # the caller's
                outcome.set_exception(error)
            finally:
                self._free.release()

        threading.Thread(target=work, daemon=True).start()
        try:
            return outcome.result(self._limit_s)
        except FutureTimeout:
            if outcome.done():
                raise
            raise TimeoutError("no answer within %g s" % self._limit_s) from None
