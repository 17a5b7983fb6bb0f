"""From the driver of a vehicle to its on-board logic in flights without sockets: what a type has that says no other."""

from risc_simulator.models.flight import Setpoint
from risc_simulator.models.radio_link import RadioLink


class OfflineLink:
    """A radio with slots, over which sticks go as fractions of the type's full scales: those of an AR.Drone.

    Sticks are what the driver is told, (forward, left, up, turn_left), fractions in the senses of cmd_vel; `up` is the
    type's. Times are the world's [s].
    """

    REPORT_PERIOD_S = 0.06  # between two reports of the vehicle
    report_delay_s = 0.0  # of the next one, from what it tells to who hears it

    def __init__(self, vehicle, phase, noise=1.0):
        """vehicle: world.Vehicle.  phase: of the radio's clock, a fraction.  noise: factor, of its sensors."""
        self.vehicle = vehicle
        rate_hz = vehicle.type.command_rate_hz
        self._radio = RadioLink(vehicle.plant.command_delay_s, rate_hz, phase_s=phase / rate_hz)

    def send(self, sticks, now_s, level_only=False):
        """The driver was told these. level_only: all 0 mean level, and no hover."""
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
        """The driver was told a FlightAction, which takes as long as sticks."""
        self.vehicle.schedule(now_s + self.vehicle.plant.command_delay_s, action)

    def deliver(self, now_s):
        """Give the vehicle what the radio brings."""
        for arrival_s, setpoint in self._radio.collect(now_s):
            self.vehicle.schedule(arrival_s, setpoint)

    def lose(self, now_s):
        """The computer of the driver is gone from now on: nothing is sent any more."""

    @property
    def phase(self):
        """FlightPhase as the vehicle tells its driver."""
        return self.vehicle.phase

    def report(self, now_s):
        """(FlightPhase, charge in percent, {what its sensors say}) as the vehicle tells its driver. It flies as long as
        one likes: 90 is told until another charge is put in. Of sensors: with the names of `risc_control.vehicles`'
        Status.
        """
        return self.phase, self.vehicle.battery_pct if self.vehicle.battery_was_set else 90.0, {}
