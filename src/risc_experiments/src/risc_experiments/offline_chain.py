"""From /controls to a vehicle's on-board logic in flights without ROS: its vehicle node, its link, its reports."""

from functools import partial

from risc_control.safety import FailsafeLevel
from risc_control.vehicle_pilot import OwnState, VehiclePilot
from risc_control.vehicles import Controls, FlightState, Status, adapter_class
from risc_lab.states import S
from risc_simulator.models.flight import FlightAction, FlightPhase

FRAME_S = 0.005
LATENCY_S = 0.006  # exposure to the controller's answer: 3 ms in the mocap host, 3 ms in the nodes
TICK_EVERY = 3  # frames: the clock of the vehicle nodes, twice the command rate

_REPORTS = {  # what a vehicle reports in each phase
    FlightPhase.LANDED: FlightState.LANDED,
    FlightPhase.TAKING_OFF: FlightState.TAKING_OFF,
    FlightPhase.HOVERING: FlightState.HOVERING,
    FlightPhase.FLYING: FlightState.FLYING,
    FlightPhase.LANDING: FlightState.LANDING,
    FlightPhase.EMERGENCY: FlightState.UNKNOWN,
}


class Chain:
    """From /controls to the vehicle's on-board logic: vehicle node, and the link of its type."""

    def __init__(self, vehicle, phase, noise, params, wires, on_sent, on_battery):
        """phase: of the radio's clock, a fraction of its period.  noise: factor on the noise of the vehicle's sensors.
        params: VehicleNodeParams.  on_sent: called with time and command, as `CommandHistory.append`, of each command.
        on_battery: called with the charge that the vehicle reports, and the time.
        """
        self._on_sent, self._on_battery = on_sent, on_battery
        self._flies_itself = adapter_class(vehicle.type).FLIES_ITSELF
        self._link = vehicle.virtual.OfflineLink(vehicle, phase, noise)
        self._report_every = TICK_EVERY * round(self._link.REPORT_PERIOD_S / (TICK_EVERY * FRAME_S))  # frames
        self.pilot = VehiclePilot(params, vehicle.type, 0.0)
        self._autonomy_button = params.JoytoWay
        self.name, self._vehicle, self._phase = vehicle.namespace, vehicle, None
        self.said = []  # (time [s], Verdict) of its ladder, from the first level above OK on
        self.fell_s = None  # when its motors were cut in the air
        self.descents_s = []  # when it began to land, for any reason
        self.lost = None  # "controls" or "laptop"
        self.deliver = self._link.deliver  # called with the time: gives the vehicle what has come by radio
        self._wire = wires.wire("%s/commands" % vehicle.namespace)
        self._wires, self._reports = wires, wires.wire("%s/navdata" % vehicle.namespace)

    def press_autonomous(self, now_s):
        """Press the button for autonomous mode, as the operator does."""
        buttons = [0] * 11
        self.pilot.on_joy(buttons, [0.0] * 8, now_s)
        buttons[self._autonomy_button] = 1
        self.pilot.on_joy(buttons, [0.0] * 8, now_s)

    def lose(self, what, now_s):
        """Take away the controller or the laptop for good; the vehicle itself notices that the laptop is lost."""
        if what == "laptop" and self.lost is None:
            self._link.lose(now_s)
        self.lost = what

    @property
    def landed(self):
        """Whether the vehicle stands on the floor by its own report."""
        return self._link.phase is FlightPhase.LANDED

    def levels(self, begin_s, end_s):
        """Levels that its ladder entered from begin_s to end_s."""
        return [verdict.level for said_s, verdict in self.said if begin_s <= said_s < end_s]

    @property
    def lands(self):
        """Whether its ladder has ordered a landing, and it is not down yet."""
        return self.pilot.ladder.verdict.level is FailsafeLevel.LAND and not self.down

    @property
    def down(self):
        """Whether the vehicle stands, or lies, on the floor."""
        return not self._vehicle.firmware.lifted

    @property
    def rests(self):
        """Whether it is down for good: its motors stand still."""
        return self.down and not self._vehicle.firmware.motors_on

    def see(self, visible, state, stamp_s, now_s, frame, look, suspect=""):
        """Update the vehicle node, once a tick. state: list of 12, columns `S`.  suspect: doubt about it, or ""."""
        pilot = self.pilot
        if frame % self._report_every == 0:
            self._report(now_s)
            self._watch(self._vehicle.phase, now_s)
            if not self._flies_itself:
                pilot.on_wire(now_s)
        if visible and suspect:
            pilot.on_suspect(suspect, now_s)
        elif visible:
            own = OwnState(state[: S.U], state[S.U : S.PHI], *state[S.PHI : S.P])
            pilot.on_state(own, now_s - stamp_s, now_s, look)

    def _report(self, now_s):
        """Send the vehicle's report of its own status."""
        report, late_s = self._link.report(now_s), self._link.report_delay_s
        if late_s > 0.0:
            self._wires.call_at(now_s + late_s, lambda at_s: self._reports.carry(report, None, at_s, self._hear))
        else:
            self._reports.carry(report, None, now_s, self._hear)

    def _watch(self, phase, now_s):
        if phase is FlightPhase.EMERGENCY and self.fell_s is None:
            self.fell_s = now_s - LATENCY_S
        if phase is FlightPhase.LANDING and self._phase is not phase:
            self.descents_s.append(now_s)
        self._phase = phase

    def _hear(self, report, _, now_s):
        """The vehicle's report has arrived."""
        phase, battery_pct, said = report
        self.pilot.on_status(Status(_REPORTS[phase], battery_pct, **said), now_s)
        self._on_battery(battery_pct, now_s)

    def send(self, orders, now_s):
        """Pass the orders of the vehicle node to the vehicle's link."""
        if orders.safety is not None and (self.said or self.pilot.ladder.verdict.level > FailsafeLevel.OK):
            self.said.append((now_s, orders.safety))
        if orders.land:
            self._wire.carry(FlightAction.LAND, None, now_s, self._order)
        if orders.disarm:
            self._wire.carry(FlightAction.CUT_MOTORS, None, now_s, self._order)
        if orders.command is not None:
            self._on_sent(now_s, orders.command.settles_at)
            send = partial(self._send, orders.level_only)
            self._wire.carry(orders.command.sticks, None, now_s, send)

    def _send(self, level_only, sticks, _, now_s):
        self._link.send(sticks, now_s, level_only)

    def _order(self, action, _, at_s):
        self._link.order(action, at_s)


def step_chains(chains, frame, stamp_s, now_s, states, controls, looks, suspects=()):
    """Run the vehicle nodes for one frame: they send a command where one is due, and update themselves once a tick.

    states: States at stamp_s.  controls: the controller's answer; None: no frame has come.
    looks: `separation.Look` of each vehicle.  suspects: doubt about the state of each, "" or a reason; () = no doubts.
    """
    ticks, commands = frame % TICK_EVERY == 0, None
    if ticks:
        visible, x = states.visible.tolist(), states.x.tolist()
    for i, chain in enumerate(chains):
        pilot = chain.pilot
        if chain.lost == "laptop":
            continue
        if ticks:
            if controls is not None and not visible[i]:
                pilot.on_unseen()
            chain.see(visible[i], x[i], stamp_s, now_s, frame, looks[i], suspects[i] if suspects else "")
        sends = now_s >= pilot.next_command_s
        if (sends or ticks) and chain.lost is None and controls is not None:
            if commands is None:
                commands = list(zip(*[part.tolist() for part in controls]))
            own = Controls(*commands[i])
            if sends:
                chain.send(pilot.on_controls(own, stamp_s, now_s - stamp_s, now_s), now_s)
            else:
                pilot.hear_controls(own, now_s - stamp_s, now_s)
        if ticks:
            chain.send(pilot.tick(now_s), now_s)
        chain.deliver(now_s)
