"""References of all vehicles at any time: hold, approach, course, home (the core of all trajectory nodes).

The reference of a vehicle in manual mode is the place where it is seen. When its vehicle node reports autonomous mode
it flies smoothly to its place on the course, meeting it in position to snap, and stays on the course until it is sent
home. Ways are planned together (`transitions.py`), so that vehicles keep apart on them too. Times are seconds of any
one clock.

Planning takes up to some tenths of a second. Offline the manager plans at once. A node that publishes references sets
how long after the order ways begin (`lead_s`), takes the `task`, plans it in another thread with `plan_ways`, and
passes the plan to `accept`. Until its way begins a vehicle continues as before. If an order or a change of mode changes
the task meanwhile, `accept` refuses the old plan.
"""

import math
from typing import NamedTuple

import numpy as np

from risc_control.motions import Chains, coasting, standing
from risc_control.reference_buffer import Axis, Order, sample_orders
from risc_control.trajectories import SAFE_SEPARATION_M, on_course
from risc_control.transitions import Home, Task, WayLimits, load, plan_ways
from risc_lab.lab.fleet import widest_pair_m
from risc_lab.phases import TrajectoryPhase as Phase
from risc_lab.states import AIRBORNE_M

_FLIES = (Phase.APPROACH, Phase.COURSE)
_GATHER_S = 0.3  # vehicles that become autonomous within this time start together
_DEEPEST = 4  # nested blends; after more orders in a short time the next way begins at a coasting vehicle


class Reference(NamedTuple):
    """References of all vehicles at one time."""

    derivatives: np.ndarray  # (orders, n, 4) x, y, z, psi: value to snap, or to the order that was asked for
    phases: tuple  # of Phase


class TrajectoryManager:
    """References of n vehicles. Not thread-safe."""

    def __init__(
        self,
        names,
        homes,
        course,
        limits=None,
        smooth=True,
        wait_for_all=True,
        lead_s=None,
        order=Order.SNAP,
        safe_m=SAFE_SEPARATION_M,
    ):
        """names: of the vehicles.  homes: a Home each.  course: Course for that many vehicles.

        smooth=False: on the course from the first moment on, in every mode (simulations, teaching).
        wait_for_all: no vehicle starts while another one hovers that is not flown automatically: courses lead through
        the places where the others wait.
        lead_s: ways begin this long after the order [s], and another thread plans them; None: they are planned at once.
        order: see `ask`.
        safe_m: distance that ways keep between any two vehicles, if possible.
        """
        if not len(names) == len(homes) == len(course.paths):
            raise ValueError("%d vehicles, %d homes and a course for %d" % (len(names), len(homes), len(course.paths)))
        self.names = tuple(names)
        self.course = course
        self.limits, self.safe_m = limits or WayLimits(), safe_m
        self.closest_m = math.inf  # smallest planned distance of the last plan
        self.task = None  # what is to be planned now; None = nothing
        self._orders = {}  # {home: {vehicles}} not planned yet, in order; the first is the task
        self._lead_s, self._inline = lead_s or 0.0, lead_s is None
        self._homes = tuple(homes)
        self._unordered = course
        self._index = {name: i for i, name in enumerate(names)}
        self._seen_m = np.array([home.position_m for home in homes], dtype=float)
        self._seen_yaw_rad = np.array([home.yaw_rad for home in homes], dtype=float)
        self._velocity = np.zeros((len(names), 3))
        self._autonomous = [False] * len(names)
        self._airborne = [False] * len(names)
        self._smooth, self._wait_for_all = smooth, wait_for_all
        self._epoch_s = None  # when the course began; None = no vehicle flies it yet
        self._joining_s = None  # when the vehicles that became autonomous start
        self._joining = set()
        self._motions = [None] * len(names)  # None = it stands where it is seen
        self._phases = (Phase.HOLD,) * len(names)
        self._chains = None  # the motions, for compiled code; None = they have changed
        self._smooth_to = self._highest = int(Order.SNAP)  # order of the ways; highest derivative of the references
        self.ask(order)
        self._evaluate(0.0)
        load()

    def ask(self, order):
        """A controller reads derivatives to this order: from now on references have `sample_orders` of them, and ways
        are continuous to it. The order never falls below the snap, or below one asked for before.

        Raises ValueError as `sample_orders`.
        """
        self._highest = max(self._highest, sample_orders(order) - 1)
        self._smooth_to = max(self._smooth_to, int(order))

    # ---------------------------------------------------------------------------------------------- what happens

    def see(self, name, position_m, velocity_m_s, yaw_rad):
        """A vehicle was seen (cortex frame, yaw in the NED sense): this is its reference while it is in manual mode."""
        i = self._index[name]
        if not math.isfinite(sum(position_m) + sum(velocity_m_s) + yaw_rad):
            return
        self._seen_m[i], self._seen_yaw_rad[i], self._velocity[i] = position_m, yaw_rad, velocity_m_s
        self._airborne[i] = position_m[2] > AIRBORNE_M  # and in the way of the others
        if self._motions[i] is None and self._chains is not None:
            self._chains.links["position_m"][i, 0] = position_m
            self._chains.links["yaw_rad"][i, 0] = yaw_rad

    @property
    def watching(self):
        """True while measured positions are needed: some vehicles are not flown automatically."""
        return not all(self._autonomous)

    def waiting_for(self, now_s):
        """Names of the vehicles that the others wait for before they start."""
        if not self._joining or now_s < self._joining_s or self._epoch_s is not None or not self._wait_for_all:
            return ()
        others = zip(self.names, self._airborne, self._autonomous)
        return tuple(name for name, airborne, autonomous in others if airborne and not autonomous)

    def set_autonomous(self, name, autonomous, now_s):
        """A vehicle is, or is no longer, flown by its references. Returns whether that has changed."""
        i = self._index[name]
        if autonomous == self._autonomous[i]:
            return False
        if self._smooth and not autonomous:
            # until it is seen again it is assumed to be at its reference
            place = self.sample(now_s).derivatives[Order.POSITION, i]
            self._seen_m[i], self._seen_yaw_rad[i], self._velocity[i] = place[:3], place[3], 0.0
        self._autonomous[i] = autonomous
        if not self._smooth:
            return True
        stay = []
        if autonomous:
            self._hold(i, standing(self._seen_m[i], self._seen_yaw_rad[i]))
            self._joining.add(i)
            self._joining_s = now_s + _GATHER_S
        else:
            self._hold(i, None)
            self._joining.discard(i)
            if not any(self._autonomous):
                self._epoch_s = None
            stay = [i]
            if self._epoch_s is None:  # vehicles that were about to start may have to wait for this one
                about = {k for k in self._orders.get(False, set()) - {i} if self._phases[k] is Phase.HOLD}
                self._joining |= about
                stay += about
        self._drop(stay, now_s)
        return True

    def set_course(self, course, now_s):
        """Change smoothly to another course, for the same number of vehicles."""
        if len(course.paths) != len(self.names):
            raise ValueError("the course is for %d vehicles, there are %d" % (len(course.paths), len(self.names)))
        movers = [i for i, phase in enumerate(self.sample(now_s).phases) if phase in _FLIES]
        self.course = self._unordered = course
        self._epoch_s = None
        if self._smooth:
            self._order([i for i in movers if i not in self._orders.get(True, ())], False, now_s)

    def start(self, now_s):
        """Vehicles that are home and autonomous fly to the course again. Returns their names."""
        if not self._smooth:
            return []
        phases = self.sample(now_s).phases
        movers = [i for i, phase in enumerate(phases) if phase is Phase.HOMED and self._autonomous[i]]
        if movers:
            if not any(phase in _FLIES for phase in phases):
                self._epoch_s = None
            self._order(movers, False, now_s)
        return [self.names[i] for i in movers]

    def go_home(self, now_s):
        """All vehicles that fly leave for home, and those that were about to start do not. Returns their names."""
        if not self._smooth:
            return []
        self._begin_joining(now_s)
        phases = self.sample(now_s).phases
        movers = [i for i, phase in enumerate(phases) if phase in _FLIES or phase is Phase.HOLD and self._autonomous[i]]
        stay = [i for i in self._orders.get(False, ()) if phases[i] is Phase.HOMED]
        self._joining -= set(movers)
        self._drop(stay, now_s)
        self._order(movers, True, now_s)
        return [self.names[i] for i in sorted({*movers, *stay})]

    # --------------------------------------------------------------------------------------------------- planning

    def accept(self, task, plan, now_s):
        """Fly a plan. Returns False, and does not fly it, when the task has changed or the plan comes too late.

        Afterwards `task` is the next one, or None if no vehicle is left to plan.
        """
        if task is not self.task:
            return False
        if now_s > task.begin_s:
            self._lead_s += 2.0 * (now_s - task.begin_s)  # this computer needs longer
            self._plan_next(now_s)
            return False
        if task.homes is None:
            self.course, self._epoch_s = plan.course, plan.epoch_s
        for i, way in plan.ways.items():
            self._hold(i, way)
        self.closest_m = plan.closest_m
        del self._orders[task.homes is not None]
        self.task = None
        self._plan_next(now_s)
        return True

    def _order(self, movers, home, now_s):
        """Vehicles are to fly home or to the course; their earlier orders are dropped."""
        for waiting in self._orders.values():
            waiting.difference_update(movers)
        self._orders.setdefault(home, set()).update(movers)
        self._drop([], now_s)

    def _drop(self, stay, now_s):
        """Drop the orders of these vehicles, and plan the others again."""
        self._orders = {home: waiting.difference(stay) for home, waiting in self._orders.items()}
        self._orders = {home: waiting for home, waiting in self._orders.items() if waiting}
        self._plan_next(now_s)

    def _plan_next(self, now_s):
        self.task = self._next_task(now_s) if self._orders else None
        if self._inline and self.task is not None:
            self.accept(self.task, plan_ways(self.task), now_s)  # plans the next task, too

    def _next_task(self, now_s):
        home, movers = next(iter(self._orders.items()))
        begin_s = now_s + self._lead_s
        # on the way to a course vehicles in manual mode are left out: where they will be flown is unknown
        others = [i for i in range(len(self.names)) if i not in movers and (home or self._autonomous[i])]
        return Task(
            begin_s,
            {i: self._start(i, now_s, begin_s) for i in sorted(movers)},
            tuple(self._motion(i) for i in others),
            self._seen_m.copy(),
            self._unordered if self._epoch_s is None else self.course,
            self._epoch_s,
            self._homes if home else None,
            self.limits,
            (Phase.HOME, Phase.HOMED) if home else (Phase.APPROACH, Phase.COURSE),
            self._smooth_to,
            self.safe_m,
        )

    def _start(self, i, now_s, begin_s):
        """The motion that a vehicle is in, to blend from."""
        motion = self._motion(i).since(now_s).until(begin_s)
        if np.count_nonzero(motion.links["end_s"] > begin_s) >= _DEEPEST:
            position, velocity = motion.at(np.array([begin_s]), Order.VELOCITY)[:, 0]
            drifting = coasting(position[: Axis.PSI], velocity[: Axis.PSI], position[Axis.PSI], begin_s)
            motion = motion.followed_by(drifting, begin_s=begin_s, end_s=begin_s, yaw_end_s=begin_s)
        return motion

    def _begin_joining(self, now_s):
        if self._joining and now_s >= self._joining_s and not self.waiting_for(now_s):
            movers, self._joining = self._joining, set()
            for i in movers:
                self._hold(i, coasting(self._seen_m[i], self._velocity[i], self._seen_yaw_rad[i], now_s))
            self._order(movers, False, now_s)

    # --------------------------------------------------------------------------------------------------- sampling

    def sample(self, now_s):
        """Reference at now_s; times must not decrease by more than a prediction horizon."""
        now_s = float(now_s)
        if self._joining and self._smooth:
            self._begin_joining(now_s)
        if self._epoch_s is None and not self._smooth:
            self._epoch_s = now_s
            for i in range(len(self.names)):
                motion = on_course(self.course, i, now_s)
                self._hold(i, motion.with_fields(arrived=Phase.COURSE, smooth=self._smooth_to))
        return self._evaluate(now_s)

    def _evaluate(self, now_s):
        if self._chains is None:
            self._chains = Chains([self._motion(i) for i in range(len(self.names))])
        derivatives = self._chains.at(np.array([now_s]), self._highest)
        if self._chains.is_new:
            self._phases = tuple(Phase(call) for call in self._chains.calls)
        return Reference(derivatives, self._phases)

    def _hold(self, i, motion):
        """Set the motion of a vehicle; None: it stands where it is seen."""
        self._motions[i], self._chains = motion, None

    def _motion(self, i):
        return self._motions[i] or standing(self._seen_m[i], self._seen_yaw_rad[i])


def make_manager(vehicles, course, home_height_m=1.0, limits=None, kind=TrajectoryManager, **options):
    """TrajectoryManager of FleetVehicles: home is above where they started, and wide ones are kept farther apart.

    kind: TrajectoryManager or a subclass.  options: of TrajectoryManager.
    """
    homes = [Home((v.start.position_m[0], v.start.position_m[1], home_height_m), v.start.yaw_rad) for v in vehicles]
    safe_m = SAFE_SEPARATION_M + widest_pair_m(vehicles)
    return kind([v.template for v in vehicles], homes, course, limits, safe_m=safe_m, **options)
