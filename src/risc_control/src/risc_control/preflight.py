"""Checks before the take-off of a vehicle that is to fly by motion capture: reasons to refuse it. No ROS.

Battery, telemetry and joystick are always checked (`vehicle_pilot`); these only with the parameter `preflight`.
"""

import math
from typing import NamedTuple

LEAST_RATE_HZ = 20.0  # of the states that the node reads
LEVEL_RAD = math.radians(15.0)
LOOKS = 20  # number of states over which the rate is taken
COUNTS = 3  # newest counts of markers, one a second: a marker must be missing for longer than that


class Facts(NamedTuple):
    """State of a vehicle that stands, for the checks."""

    state_age_s: float  # of the newest state that was believed; infinite: it was never seen
    state_late_s: float  # its age when it arrived
    state_limit_s: float
    suspect: str  # what the newest state contradicts; "" when nothing
    rate_hz: float  # of its states; 0: too few to say
    position_m: tuple  # None before the first state
    outside: bool  # of the fence
    tilt_rad: float
    controls_age_s: float  # of the newest command; infinite: no controller was heard
    needs_controller: bool  # it is not to be flown by hand
    disagreement: str  # why its controller is not obeyed; "" when nothing
    controls_limit_s: float
    markers: tuple  # numbers of markers (used for its pose, required, of its template); None: not reported
    nearest: tuple  # `Separation.nearest`: (distance [m], name) of the nearest vehicle; None: none is seen
    apart_m: float  # least distance for a take-off


def refusals(facts):
    """Reasons why it must not take off, which say what to do; () when it may."""
    found = []
    if facts.suspect:
        found.append("motion capture contradicts itself (%s): look at its markers and names in Cortex" % facts.suspect)
    elif math.isinf(facts.state_age_s):
        found.append(
            "motion capture has not seen it: are its markers free, its template in Cortex, the estimator running? "
            "To fly by hand without motion capture start the vehicle's node with preflight:=false"
        )
    elif facts.state_late_s > facts.state_limit_s:
        text = (
            "its states are %.2f s old when they come, not %.2f s at most: shorten the delays of motion capture, "
            "network and computer, or set the clocks"
        )
        found.append(text % (facts.state_late_s, facts.state_limit_s))
    elif facts.state_age_s > facts.state_limit_s:
        text = "motion capture saw it %.1f s ago: uncover its markers, or look whether frames come"
        found.append(text % facts.state_age_s)
    elif facts.rate_hz < LEAST_RATE_HZ:
        text = "motion capture sees it %.0f times a second, not %.0f: look at the rate of Cortex, and at the load"
        found.append(text % (facts.rate_hz, LEAST_RATE_HZ))
    else:
        if facts.outside:
            found.append("it stands at (%.2f, %.2f, %.2f) m, outside of the fence: carry it inside" % facts.position_m)
        if facts.markers is not None and facts.markers[0] < facts.markers[1]:
            text = "motion capture sees %d of its markers, not %d of %d: look for a lost one, and at its template"
            found.append(text % facts.markers)
        if facts.tilt_rad > LEVEL_RAD:
            text = "it is seen tilted by %.0f deg: put it on level floor, and look whether its template is right"
            found.append(text % math.degrees(facts.tilt_rad))
        if facts.nearest is not None and facts.nearest[0] < facts.apart_m:
            text = "it stands %.2f m from %s, %.2f m are needed: carry them apart"
            found.append(text % (*facts.nearest, facts.apart_m))
    if facts.disagreement:
        found.append(facts.disagreement)
    elif facts.needs_controller and math.isinf(facts.controls_age_s):
        found.append(
            "no controller was heard: start it, or look whether it sends /controls for this vehicle. To fly by hand "
            "start the vehicle's node with preflight_controller:=false"
        )
    elif facts.controls_limit_s < facts.controls_age_s < math.inf:
        text = "its controller has been silent for %.1f s: start it again, or this node to fly by hand"
        found.append(text % facts.controls_age_s)
    return tuple(found)
