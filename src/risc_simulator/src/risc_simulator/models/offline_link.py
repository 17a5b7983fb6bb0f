"""Link from a vehicle's driver to its on-board logic in flights without sockets: the default of all types."""

from risc_simulator.models.flight import Setpoint
from risc_simulator.models.radio_link import RadioLink


class OfflineLink:
    """A slotted radio that carries sticks as fractions of the type's full scales, as of an AR.Drone.

    Sticks are the input of the driver, (forward, left, up, turn_left), fractions with the signs of cmd_vel; the scale
    of `up` is the type's. Times are world times [s].
    """

    REPORT_PERIOD_S = 0.06  # between two reports of the vehicle
    report_delay_s = 0.0  # of the next report, from vehicle to receiver

    def __init__(self, vehicle, phase, noise=1.0):
        """vehicle: world.Vehicle.  phase: of the radio's slots, a fraction of one.  noise: factor on sensor noise."""
        self.vehicle = vehicle
        rate_hz = vehicle.type.command_rate_hz
        self._radio = RadioLink(vehicle.plant.command_delay_s, rate_hz, phase_s=phase / rate_hz)

    def send(self, sticks, now_s, level_only=False):
        """Send sticks. level_only: all zeros mean level, not hover."""
        kind = self.vehicle.type
        setpoint = Setpoint(
            roll_rad=-sticks.left * kind.tilt_max_rad,
            pitch_rad=-sticks.forward * kind.tilt_max_rad,
            climb_m_s=sticks.up * kind.climb_max_m_s,
            yaw_rate_rad_s=-sticks.turn_left * kind.yaw_rate_max_rad_s,
            hover=not (any(sticks) or level_only),
        )
        self._radio.submit(now_s, setpoint)

    def order(self, action, now_s):
        """Send a FlightAction, with the same command delay as sticks."""
        self.vehicle.schedule(now_s + self.vehicle.plant.command_delay_s, action)

    def deliver(self, now_s):
        """Hand the setpoints that the radio has carried to the vehicle."""
        for arrival_s, setpoint in self._radio.collect(now_s):
            self.vehicle.schedule(arrival_s, setpoint)

    def lose(self, now_s):
        """The computer of the driver fails: nothing is sent from now on."""

    @property
    def phase(self):
        """FlightPhase as the vehicle reports it to its driver."""
        return self.vehicle.phase

    def report(self, now_s):
        """(FlightPhase, charge in percent, {sensor readings}) as the vehicle reports them to its driver. The battery
        does not limit flights: 90 is reported until a charge is set. Readings have the names of
        `risc_control.vehicles`' Status.
        """
        return self.phase, self.vehicle.battery_pct if self.vehicle.battery_was_set else 90.0, {}
