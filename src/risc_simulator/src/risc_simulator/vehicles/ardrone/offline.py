"""An AR.Drone without sockets, for offline flights: see vehicles/__init__.py."""

from ardrone_autonomy.link import LOST_S
from risc_simulator.models import offline_link
from risc_simulator.models.flight import FlightAction, Setpoint
from risc_simulator.vehicles.ardrone.firmware import LOST_HOVER_S


class OfflineLink(offline_link.OfflineLink):
    """See there."""

    def lose(self, now_s):
        """It takes notice, hovers, and lands."""
        self.vehicle.schedule(now_s + LOST_S, Setpoint(hover=True))
        self.vehicle.schedule(now_s + LOST_S + LOST_HOVER_S, FlightAction.LAND)
