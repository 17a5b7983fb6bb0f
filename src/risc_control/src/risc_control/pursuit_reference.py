"""References of a vehicle that pursues a virtual target (`virtual_target.py`): a place to wait at, then the target.

The vehicle flies to the place where it waits (the original's "WP") as to any course. From the moment the target is
released (its "NGC") the reference is the target, which the vehicle only follows at a distance. So every way from there
begins where the vehicle is seen, not at the reference.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from risc_control.motions import coasting
from risc_control.reference_buffer import Axis, Order
from risc_control.trajectories import YawProgram, make_course, on_course, points
from risc_control.trajectory_manager import Phase, TrajectoryManager
from risc_lab.settings import Positive, Settings

# The target's speed is published this long before it moves, and after it has stopped: its topic is separate, so its
# order with the references is not defined. Meanwhile the vehicle pursues the reference where it stands; otherwise it
# would fly to a moving target.
_LEAD_S = 0.1


@dataclass(frozen=True)
class TargetParams(Settings):
    """Where the vehicle waits, and the circle around the origin on which its target moves. Numbers of the original."""

    start_x_m: float = 0.5643  # cortex frame
    start_y_m: float = 1.2213
    height_m: Positive = 1.0
    psi_deg: float = -90.0  # constant heading
    radius_m: Positive = 0.8
    target_speed_m_s: Positive = 0.2  # of the target, counter-clockwise from above
    phase_deg: float = 90.0  # where on the circle it begins; 0 = on the x axis, + towards y

    def waiting_place(self):
        """Course that stands where the vehicle waits."""
        course = points("WP", [(self.start_x_m, self.start_y_m, self.height_m)])
        return course.with_yaw(self._yaw())

    def target_course(self):
        """Course of the target."""
        period_s = 2.0 * math.pi * self.radius_m / self.target_speed_m_s
        numbers = {"radius_m": self.radius_m, "period_s": period_s, "height_m": self.height_m}
        course = make_course("circle", 1, **numbers).with_yaw(self._yaw())
        return replace(course, name="NGC", paths=(on_course(course, 0, -self.phase_deg / 360.0 * period_s),))

    def _yaw(self):
        return YawProgram(math.radians(self.psi_deg))


class VirtualTarget(TrajectoryManager):
    """TrajectoryManager of one vehicle whose course is the place where it waits; see the module."""

    target = TargetParams().target_course()
    _wanted = False  # the target is to be released as soon as the vehicle waits
    _epoch_of_target_s = None  # when it begins to move; None = it rests
    _told_until_s = -math.inf  # until when its speed is still published after it has stopped

    @property
    def watching(self):
        """Always True: the position of the vehicle is not known from the reference."""
        return True

    @property
    def pursuing(self):
        """Whether the target moves, or is about to."""
        return self._epoch_of_target_s is not None

    def target_speed_m_s(self, now_s):
        """Speed of the target to publish on its topic, 0 while it rests."""
        told = self.pursuing or now_s < self._told_until_s
        return float(np.linalg.norm(self.target.at(0.0)[Order.VELOCITY, 0, : Axis.PSI])) if told else 0.0

    def let_go(self, now_s):
        """Release the target, as soon as the vehicle is where it waits. Returns whether it will be released.

        Does nothing while the target moves already, or when the vehicle is not on its way to where it waits.
        """
        if self.pursuing or self.sample(now_s).phases[0] not in (Phase.APPROACH, Phase.COURSE):
            return False
        self._wanted = True
        return True

    def sample(self, now_s):
        """As `TrajectoryManager.sample`."""
        reference = super().sample(now_s)
        if reference.phases[0] is not Phase.COURSE:
            return reference
        if self._wanted:
            self._wanted, self._epoch_of_target_s = False, now_s + _LEAD_S
        if self.pursuing and now_s >= self._epoch_of_target_s:
            derivatives = self.target.at(now_s - self._epoch_of_target_s, len(reference.derivatives) - 1)
            reference = reference._replace(derivatives=derivatives)
        return reference

    def set_autonomous(self, name, autonomous, now_s):
        """As `TrajectoryManager.set_autonomous`; the target rests from then on."""
        if autonomous != self._autonomous[0]:
            self._stop(now_s)
        return super().set_autonomous(name, autonomous, now_s)

    def go_home(self, now_s):
        """As `TrajectoryManager.go_home`, from where the vehicle is."""
        self._stop(now_s)
        return super().go_home(now_s)

    def start(self, now_s):
        """As `TrajectoryManager.start`; the target rests until it is released again."""
        self._wanted = False
        return super().start(now_s)

    def _stop(self, now_s):
        self._wanted = False
        if self.pursuing:
            self._epoch_of_target_s, self._told_until_s = None, now_s + _LEAD_S
            self._hold(0, coasting(self._seen_m[0], self._velocity[0], self._seen_yaw_rad[0], now_s))
