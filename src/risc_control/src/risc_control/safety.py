"""Levels, rules, limits and verdicts of a vehicle's safety ladder (`failsafe`). Plain data, quick to import: programs
that only show or check it need no compiled code.
"""

import enum
import functools
from dataclasses import dataclass

from risc_lab.lab.arena import Arena
from risc_lab.settings import NotNegative, Positive, Settings


class FailsafeLevel(enum.IntEnum):
    OK = 0
    HOLD = 1
    LAND = 2


class Rule(enum.IntEnum):
    """What set the level: the numbers of risc_maap_msgs/Safety, as are those of `FailsafeLevel`."""

    NONE = 0
    JOYSTICK = 1
    STATE = 2
    CONTROLS = 3
    NAVDATA = 4
    FENCE = 5
    BATTERY = 6
    SEPARATION = 7
    REQUEST = 8
    SUSPECT = 9


WITHOUT_EFFECT = "; it does not land: the operator must use the emergency stop"  # behind the reason of such a verdict
LOSSES = frozenset((Rule.STATE, Rule.SUSPECT, Rule.CONTROLS))  # loss of an input that it flies on


def fence_of(arena):
    """Fence of `SafetyLimits` at the net of an Arena; the floor is no limit."""
    return {
        "fence_min_m": (-arena.half_x_m, -arena.half_y_m, -1.0),
        "fence_max_m": (arena.half_x_m, arena.half_y_m, arena.height_m),
    }


@dataclass(frozen=True)
class SafetyLimits(Settings):
    """Thresholds of the ladder; 0 switches a rule off where noted."""

    ladder: bool = True  # False: no level is entered automatically; only to show what the ladder is good for
    state_hold_s: Positive = 0.1  # [s] own state older than this: HOLD; a suspect one is ignored, see `plausibility`
    state_land_s: Positive = 0.5  # [s] ... LAND; also when it has held for this time less state_hold_s without a break
    # What the noise of motion capture adds to what a vehicle can do from one state to the next
    suspect_position_m: Positive = 0.03
    suspect_velocity_m_s: Positive = 0.3
    suspect_angle_deg: Positive = 5.0  # roll, pitch and yaw
    state_least_step_m: NotNegative = 1e-7  # [m] moved less since the last state: frozen; 0 = off (exact simulators)
    controls_hold_s: Positive = 0.1  # [s] own command older than this: HOLD
    controls_land_s: Positive = 0.5  # [s] ... LAND, likewise
    saturated_land_s: NotNegative = 1.5  # [s] full tilt or thrust for half of it: HOLD, for all of it: LAND; 0 = off
    navdata_timeout_s: NotNegative = 1.0  # [s] nothing heard from the vehicle: LAND; 0 = off
    # [s] no joystick heard, or one of several silent: LAND; 0 = off, for joysticks that send on change only
    joystick_timeout: NotNegative = 1.0
    operator_after_s: NotNegative = 2.0  # [s] LAND without effect: the operator must use the emergency stop
    clock_tolerance_s: NotNegative = 0.1  # [s] a stamp that far in the future means that clocks differ
    battery_min_pct: NotNegative = 10.0  # [%] at or below: LAND, and no take-off; 0 = off
    battery_delay_s: NotNegative = 0.5  # [s] reported low for this long: LAND (one false report is not enough)
    # [m] x, y, z, cortex frame; a node's are the net of its fleet file
    fence_min_m: tuple[float, float, float] = fence_of(Arena())["fence_min_m"]
    fence_max_m: tuple[float, float, float] = fence_of(Arena())["fence_max_m"]
    # [m] the centre of an AR.Drone must stay this far inside, that of a wider vehicle farther, else LAND; one that will
    # soon be unable to stop inside: HOLD, see `fence`
    fence_margin_m: NotNegative = 0.2
    fence_delay_s: NotNegative = 0.05  # [s] ... for this long (one false measurement is not enough)
    fence_land_s: Positive = 1.5  # [s] ... one that is still unable after this time, or that is held again: LAND
    # Distances between the centres of vehicles in the air, see `separation`. They are for two AR.Drones: larger types
    # are kept farther apart by as much as the two reach farther (`radius_m` of the types), e.g. two IRIS+ by 0.30 m.
    separation_m: NotNegative = 0.55  # [m] nearer: HOLD, then LAND; the width of a hull, courses keep 0.63 m; 0 = off
    separation_stray_m: NotNegative = 1.0  # [m] ... from one that has left its course, is not seen, or holds itself
    separation_course_m: NotNegative = 0.5  # [m] farther than this from its reference a vehicle has left its course
    separation_lookahead_s: NotNegative = 1.2  # [s] ... now or within this time, in which an AR.Drone stops;
    separation_follow_s: NotNegative = 0.8  # [s] of vehicles that follow their references: within this time
    separation_delay_s: NotNegative = 0.05  # [s] too near for this long: HOLD (one false measurement is not enough)
    separation_speed_m_s: NotNegative = 0.3  # [m/s] speed of moving apart, while holding is not enough
    separation_land_s: NotNegative = 1.0  # [s] held for this long: LAND
    separation_wait_s: NotNegative = 10.0  # [s] ... but only after this time when another one is straight below
    separation_forget_s: NotNegative = 10.0  # [s] one that is not seen for this long is taken to stand on the floor

    def __post_init__(self):
        super().__post_init__()
        for least, most in (
            ("state_hold_s", "state_land_s"),
            ("controls_hold_s", "controls_land_s"),
            ("separation_m", "separation_stray_m"),
        ):
            if getattr(self, least) > getattr(self, most):
                raise ValueError(
                    "need %s <= %s, found %r and %r" % (least, most, getattr(self, least), getattr(self, most))
                )
        if any(low >= high for low, high in self.room_m):
            raise ValueError(
                "the fence leaves no room: fence_min_m %r, fence_max_m %r, fence_margin_m %r"
                % (self.fence_min_m, self.fence_max_m, self.fence_margin_m)
            )

    @property
    def room_m(self):
        """((low, high) of x, y, z) where a vehicle's centre may be."""
        margin_m, sides = self.fence_margin_m, zip(self.fence_min_m, self.fence_max_m)
        return tuple((low + margin_m, high - margin_m) for low, high in sides)


@dataclass(frozen=True)
class Verdict:
    """Where on the ladder the vehicle stands."""

    level: FailsafeLevel
    reason: str  # for people; "" when OK; numbers in it are those of the moment the level was entered
    operator: bool = False  # LAND has no effect: the operator must use the emergency stop
    rule: Rule = Rule.NONE
    age_s: float | None = None  # of the newest good message of the rule, when entered; None = the rule has none
    limit_s: float | None = None  # beyond which the level is entered

    @functools.cached_property
    def text(self):
        """For people, e.g. "hold: state 120 ms old"."""
        if self.level == FailsafeLevel.OK:
            return "ok"
        text = "%s: %s" % (self.level.name.lower(), self.reason)
        return text + WITHOUT_EFFECT if self.operator else text
