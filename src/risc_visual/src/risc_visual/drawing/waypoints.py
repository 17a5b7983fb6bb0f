"""Places that vehicles are to go to. Frame: cortex. Needs no ROS."""

from typing import NamedTuple

_NAMELESS = "waypoint"


class Waypoint(NamedTuple):
    """Where a vehicle is to go, and where its nose is to point there."""

    name: str  # of the vehicle; bags of the original release may hold none
    number: int  # from 1: which of the waypoints that have this name
    position_m: tuple[float, float, float]
    heading_rad: float  # + clockwise seen from above

    @property
    def key(self):
        """What it is known by."""
        return self.name, self.number

    @property
    def ns(self):
        """Namespace of its markers."""
        return self.name or _NAMELESS
