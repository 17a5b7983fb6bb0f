"""The made-up quadrotor: its attitude loops take radians; the third stick is its thrust, and nothing holds a height."""

from risc_lab.compiled import compiled
from risc_lab.frames import GRAVITY_M_S2
from risc_simulator.models import flight
from risc_simulator.models.flight import FlightAction, FlightPhase
from risc_simulator.models.quadrotor import U, level_motion

FIELDS = (("thrust_m_s2", float),)  # less gravity


@compiled
def before_step(x, inputs, vehicle):
    """The climb loop of the common equations made to ask for what the vehicle has, so that the thrust is left."""
    inputs[U.CLIMB], inputs[U.CLIMB_TRIM] = level_motion(x)[0], vehicle.thrust_m_s2


class Firmware(flight.Firmware):
    """Obeys."""

    def configure(self, record):
        self._record = record
        record["thrust_m_s2"] = 0.0

    def apply(self, action, time_s, vertical_motion):
        if isinstance(action, FlightAction):
            self.phase = FlightPhase.LANDING if action is FlightAction.LAND else self.phase
            return
        self._record["thrust_m_s2"] = GRAVITY_M_S2 * action.climb_m_s  # the stick, as a full scale of 1 leaves it
        self.command = (action.roll_rad, action.pitch_rad, action.yaw_rate_rad_s, 0.0)


class Host:
    """Has no wire: it is flown offline."""
