"""TrajectoryManager: hold, approach, course, home; continuous to snap; vehicles keep apart on their ways."""

import itertools
import threading

import numpy as np
import pytest

from risc_control.trajectories import COURSES, SAFE_SEPARATION_M, make_course, minimum_separation
from risc_control.trajectory_manager import Home, Phase, TrajectoryManager, make_manager
from risc_control.transitions import WayLimits, plan_ways
from risc_lab.lab.fleet import FleetVehicle, Start

STARTS = {"fluffy_II": (0.9, 0.0, 0.0), "albatross": (-0.45, 0.78, 0.0), "Raven": (-0.45, -0.78, 0.0)}
NAMES = tuple(STARTS)
DT_S = 0.005


def fleet(vehicles=3, types=("ardrone",) * 3):
    return [
        FleetVehicle("risc%d" % (k + 1), name, types[k], "127.0.0.%d" % (k + 1), Start(STARTS[name]))
        for k, name in enumerate(NAMES[:vehicles])
    ]


def flying_manager(course="circle", vehicles=3, now_s=10.0, types=("ardrone",) * 3, **options):
    """All vehicles hover 0.9 m above their starts and become autonomous at now_s."""
    manager = make_manager(fleet(vehicles, types), make_course(course, vehicles), **options)
    rng = np.random.default_rng(1)
    for name in manager.names:
        place = np.array(STARTS[name]) + [0.0, 0.0, 0.9] + rng.uniform(-0.05, 0.05, 3)
        manager.see(name, place, np.zeros(3), 0.05)
        manager.set_autonomous(name, True, now_s)
    return manager


def record(manager, begin_s, end_s, step_s=0.02):
    """(times, (k, 5, n, 4) derivatives, list of phases)."""
    times = np.arange(begin_s, end_s, step_s)
    references = [manager.sample(time_s) for time_s in times]
    return times, np.array([r.derivatives for r in references]), [r.phases for r in references]


def assert_smooth(times, derivatives):
    """Each row is the derivative of the row before, through all changes of phase: continuous to snap."""
    step_s = times[1] - times[0]
    middle = 0.5 * (derivatives[1:] + derivatives[:-1])
    # The fifth derivative of a least-snap step jumps at its ends, by up to 40 m/s^5 for ways of 1.5 m in 4 s: the
    # trapezoidal rule for the snap is off by an eighth of that times the step; for the position by a twelfth of the
    # jerk, up to 5 m/s^3, times its square.
    for order, largest in ((0, 5.0 * step_s**2 / 12.0), (1, 1e-3), (2, 5e-3), (3, 40.0 * step_s / 8.0)):
        slope = (derivatives[1:, order, :, :3] - derivatives[:-1, order, :, :3]) / step_s
        assert np.abs(slope - middle[:, order + 1, :, :3]).max() < largest, order
    assert np.abs(np.diff(derivatives[:, 4, :, :3], axis=0)).max() < 3.0, "snap has no steps"
    turn = np.angle(np.exp(1j * (derivatives[1:, 0, :, 3] - derivatives[:-1, 0, :, 3]))) / step_s
    assert np.abs(turn - middle[:, 1, :, 3]).max() < 1e-3


def test_while_nobody_flies_it_the_reference_is_where_the_vehicle_is():
    manager = make_manager(fleet(), make_course("circle", 3))
    assert manager.watching
    manager.see("Raven", [0.1, 0.2, 0.3], [0.5, 0.0, 0.0], 1.0)
    reference = manager.sample(5.0)
    assert reference.phases == (Phase.HOLD,) * 3
    assert reference.derivatives[0, 2].tolist() == [0.1, 0.2, 0.3, 1.0]
    assert np.all(reference.derivatives[1:] == 0.0)
    manager.see("Raven", [np.nan, 0.2, 0.3], np.zeros(3), 1.0)
    assert manager.sample(5.1).derivatives[0, 2, 0] == 0.1, "what is not a number was not seen"


@pytest.mark.parametrize("course", sorted(COURSES))
def test_from_hover_to_the_course_and_home(course):
    manager = flying_manager(course)
    times, derivatives, phases = record(manager, 10.0, 45.0)
    for i in range(3):
        order = [phase for phase, _ in itertools.groupby(p[i] for p in phases)]
        assert order == [Phase.HOLD, Phase.APPROACH, Phase.COURSE]
    assert_smooth(times[times > 10.4], derivatives[times > 10.4])
    assert not manager.watching
    assert set(manager.go_home(45.0)) == set(NAMES)
    times, derivatives, phases = record(manager, 45.0, 75.0)
    assert phases[-1] == (Phase.HOMED,) * 3
    assert_smooth(times, derivatives)
    for i, name in enumerate(NAMES):
        assert derivatives[-1, 0, i, :3] == pytest.approx([*STARTS[name][:2], 1.0])
    assert np.all(derivatives[-1, 1:] == 0.0)


def test_a_vehicle_that_is_seen_while_it_flies_its_way_flies_it_unchanged():
    """States keep coming while another vehicle is flown by hand."""
    seen, unseen = flying_manager(vehicles=1), flying_manager(vehicles=1)
    for now_s in np.arange(10.5, 20.0, 0.1):
        assert (seen.sample(now_s).derivatives == unseen.sample(now_s).derivatives).all()
        seen.see(NAMES[0], (0.1, 0.2, 0.9), (0.5, -0.4, 0.1), 2.0)


@pytest.mark.parametrize("course", sorted(COURSES))
def test_ways_keep_the_vehicles_apart(course):
    manager = flying_manager(course)
    _, out, _ = record(manager, 10.0, 40.0, 0.05)
    manager.go_home(40.0)
    _, back, _ = record(manager, 40.0, 65.0, 0.05)
    assert minimum_separation(out[:, 0, :, :3]) >= SAFE_SEPARATION_M
    assert minimum_separation(back[:, 0, :, :3]) >= SAFE_SEPARATION_M
    furthest = np.abs(np.concatenate([out, back])[:, 0, :, :2]).max(axis=(0, 1))
    assert furthest[0] < 2.2 and furthest[1] < 1.8
    assert np.concatenate([out, back])[:, 0, :, 2].min() > 0.4


@pytest.mark.parametrize("course", ["circle", "flat8", "slanted8"])
def test_ways_keep_wide_vehicles_farther_apart(course):
    manager = flying_manager(course, types=("iris", "ardrone", "iris"))
    _, out, _ = record(manager, 10.0, 40.0, 0.05)
    manager.go_home(40.0)
    _, back, _ = record(manager, 40.0, 65.0, 0.05)
    assert manager.safe_m == pytest.approx(SAFE_SEPARATION_M + 0.3)
    assert min(minimum_separation(part[:, 0, :, :3]) for part in (out, back)) >= manager.safe_m


@pytest.mark.parametrize("course", ["circle", "flat8", "slanted8"])
@pytest.mark.parametrize("leave_s", [41.0, 44.0, 47.5, 50.0])
def test_whenever_they_are_called_home_they_keep_apart(course, leave_s):
    manager = flying_manager(course)
    record(manager, 10.0, 12.0)
    manager.go_home(leave_s)
    _, back, phases = record(manager, leave_s, leave_s + 25.0, 0.05)
    assert minimum_separation(back[:, 0, :, :3]) >= 0.7
    assert phases[-1] == (Phase.HOMED,) * 3


def hovering_manager(course, **options):
    manager = make_manager(fleet(), make_course(course, 3), **options)
    for name in NAMES:
        manager.see(name, np.array(STARTS[name]) + [0, 0, 0.9], np.zeros(3), 0.0)
    return manager


def test_nobody_starts_while_another_hovers_in_the_way():
    """The circle leads through the places where the others hover."""
    manager, begin_s = hovering_manager("circle"), 0.0
    for k, name in enumerate(NAMES):
        assert manager.sample(begin_s).phases == (Phase.HOLD,) * 3
        manager.set_autonomous(name, True, begin_s)
        assert manager.waiting_for(begin_s + 1.0) == NAMES[k + 1 :]
        begin_s += 5.0
    _, derivatives, phases = record(manager, begin_s - 5.0, begin_s + 20.0, 0.05)
    assert phases[-1] == (Phase.COURSE,) * 3
    assert minimum_separation(derivatives[:, 0, :, :3]) >= SAFE_SEPARATION_M


def test_a_vehicle_on_the_floor_is_not_waited_for():
    manager = make_manager(fleet(2), make_course("circle", 2))
    manager.see("fluffy_II", [0.9, 0.0, 0.9], np.zeros(3), 0.0)
    manager.see("albatross", [-0.45, 0.78, 0.05], np.zeros(3), 0.0)
    manager.set_autonomous("fluffy_II", True, 1.0)
    assert manager.waiting_for(2.0) == ()
    assert manager.sample(1.5).phases == (Phase.APPROACH, Phase.HOLD)


def test_one_after_the_other():
    """Each becomes autonomous when those before are on their course: ways between vehicles that fly."""
    manager, tracks, begin_s = hovering_manager("flat8", wait_for_all=False), [], 0.0
    for k, name in enumerate(NAMES):
        assert manager.watching
        manager.set_autonomous(name, True, begin_s)
        _, derivatives, phases = record(manager, begin_s, begin_s + 40.0, 0.05)
        assert [phase is Phase.COURSE for phase in phases[-1]] == [True] * (k + 1) + [False] * (2 - k)
        tracks.append(minimum_separation(derivatives[:, 0, : k + 1, :3]))
        begin_s += 40.0
    assert min(tracks) >= 0.7, "those who fly already do not make room"


def test_limits_of_the_ways():
    limits = WayLimits(speed_m_s=0.3, acceleration_m_s2=0.3, yaw_rate_rad_s=0.2)
    manager = flying_manager("origin", limits=limits)
    _, derivatives, phases = record(manager, 10.0, 30.0)
    speed = np.linalg.norm(derivatives[:, 1, :, :3], axis=2)
    acceleration = np.linalg.norm(derivatives[:, 2, :, :3], axis=2)
    assert speed.max() <= 0.3 + 1e-6 and acceleration.max() <= 0.3 + 1e-6
    assert np.abs(derivatives[:, 1, :, 3]).max() <= 0.2 + 1e-6
    with pytest.raises(ValueError, match="speed_m_s"):
        WayLimits(speed_m_s=0.0)


def test_back_to_manual_and_on_again():
    manager = flying_manager()
    record(manager, 10.0, 30.0)
    where = manager.sample(30.0).derivatives[0, 1]
    assert manager.set_autonomous("albatross", False, 30.0)
    assert not manager.set_autonomous("albatross", False, 30.0)
    assert manager.watching
    assert manager.sample(30.01).phases[1] is Phase.HOLD
    assert manager.sample(30.01).derivatives[0, 1] == pytest.approx(where), "until it is seen again"
    manager.see("albatross", [-1.5, 1.2, 1.3], np.zeros(3), 0.4)
    manager.set_autonomous("albatross", True, 33.0)
    times, derivatives, phases = record(manager, 33.0, 75.0)
    assert phases[0][1] is Phase.HOLD and phases[-1] == (Phase.COURSE,) * 3
    assert derivatives[0, 0, 1] == pytest.approx([-1.5, 1.2, 1.3, 0.4])
    assert_smooth(times[times > 33.4], derivatives[times > 33.4])


def test_starts_with_the_velocity_that_the_vehicle_has():
    manager = make_manager(fleet(1), make_course("origin", 1))
    manager.see("fluffy_II", [0.9, 0.0, 1.0], [0.0, 0.3, 0.0], 0.0)
    manager.set_autonomous("fluffy_II", True, 1.0)
    reference = manager.sample(1.301)
    assert reference.phases == (Phase.APPROACH,)
    assert reference.derivatives[1, 0, :3] == pytest.approx([0.0, 0.3, 0.0], abs=1e-2)


def test_start_again_from_home():
    manager = flying_manager()
    record(manager, 10.0, 30.0)
    assert manager.start(30.0) == []
    manager.go_home(30.0)
    assert record(manager, 30.0, 55.0)[2][-1] == (Phase.HOMED,) * 3
    assert manager.go_home(55.0) == []
    assert manager.start(55.0) == list(NAMES)
    times, derivatives, phases = record(manager, 55.0, 75.0)
    assert phases[-1] == (Phase.COURSE,) * 3
    assert_smooth(times, derivatives)


def test_home_during_the_approach():
    manager = flying_manager()
    record(manager, 10.0, 12.0)
    manager.go_home(12.0)
    times, derivatives, phases = record(manager, 12.0, 40.0)
    assert phases[-1] == (Phase.HOMED,) * 3
    assert_smooth(times, derivatives)


def test_another_course_in_flight():
    """What the bumpers of DF_experiment_joy do."""
    manager = flying_manager("origin", vehicles=1)
    begin_s = 10.0
    for course in ("slanted8", "origin", "circle"):
        record(manager, begin_s, begin_s + 12.0)
        begin_s += 12.0
        manager.set_course(make_course(course, 1), begin_s)
        times, derivatives, phases = record(manager, begin_s, begin_s + 12.0)
        assert phases[0] == (Phase.APPROACH,) and phases[-1] == (Phase.COURSE,)
        assert_smooth(times, derivatives)
    with pytest.raises(ValueError, match=" 2 vehicles"):
        manager.set_course(make_course("circle", 2), begin_s)


# ------------------------------------------------------------------------------- planned while the vehicles fly on

LEAD_S = 0.5


def fly_with_a_planner(manager, begin_s, end_s, takes_s, events=()):
    """As `record`, with a planner that takes takes_s. events: (time, function of the time)."""
    rows, phases, events = [], [], list(events)
    task, ready_s = None, np.inf
    times = np.arange(begin_s, end_s, 0.02)
    for time_s in times:
        while events and time_s >= events[0][0]:
            events.pop(0)[1](time_s)
        reference = manager.sample(time_s)
        rows.append(reference.derivatives)
        phases.append(reference.phases)
        if task is None and manager.task is not None:
            task, ready_s = manager.task, time_s + takes_s
        elif task is not None and time_s >= ready_s:
            manager.accept(task, plan_ways(task), time_s)
            task = None
    return times, np.array(rows), phases


def all_of_it(manager):
    """Events from the course to another one, home and out again."""
    return [
        (30.0, lambda now_s: manager.set_course(make_course("circle", 3), now_s)),
        (33.0, manager.go_home),
        (55.0, manager.start),
        (57.0, lambda now_s: manager.set_course(make_course("knot", 3), now_s)),
        (75.0, manager.go_home),
    ]


def test_planned_in_another_thread_the_references_are_the_same():
    """A manager that plans at once, for the same times, gives the same references bit for bit."""
    planned, at_once = flying_manager("flat8", lead_s=LEAD_S), flying_manager("flat8", lead_s=LEAD_S)
    at_once._inline = True
    times, references, phases = fly_with_a_planner(planned, 10.0, 95.0, 0.3, all_of_it(planned))
    _, expected, _ = fly_with_a_planner(at_once, 10.0, 95.0, 0.0, all_of_it(at_once))
    assert (references == expected).all()
    assert phases[-1] == (Phase.HOMED,) * 3
    assert_smooth(times[times > 10.4], references[times > 10.4])
    assert minimum_separation(references[:, 0, :, :3]) >= SAFE_SEPARATION_M


def test_until_their_ways_begin_they_go_on_as_before():
    manager = flying_manager("flat8", lead_s=LEAD_S)
    times, references, phases = fly_with_a_planner(manager, 10.0, 40.0, 0.3)
    assert not references[times < 10.3, 1].any() and phases[int(0.7 / 0.02)] == (Phase.HOLD,) * 3
    assert phases[int(0.9 / 0.02)] == (Phase.APPROACH,) * 3
    manager.go_home(40.0)
    before = manager.course.at(40.4 - manager._epoch_s)
    assert manager.sample(40.4).derivatives[..., :3] == pytest.approx(before[..., :3])
    assert manager.sample(70.0).phases == (Phase.COURSE,) * 3, "nothing was planned"


def test_sampling_never_waits_for_the_planner():
    """The lock stays free, too: the planner is a thread that hangs."""
    manager, lock, goes_on = flying_manager(lead_s=LEAD_S), threading.Lock(), threading.Event()
    manager.sample(10.4)
    task = manager.task

    def plan():
        goes_on.wait(60.0)
        made = plan_ways(task)
        with lock:
            manager.accept(task, made, 10.7)

    planner = threading.Thread(target=plan)
    planner.start()
    for time_s in np.arange(10.4, 10.7, DT_S):
        assert lock.acquire(blocking=False)
        assert manager.sample(time_s).phases == (Phase.HOLD,) * 3
        lock.release()
    assert planner.is_alive()
    goes_on.set()
    planner.join()
    assert manager.sample(10.95).phases == (Phase.APPROACH,) * 3


def test_who_changes_his_mind_meanwhile_is_planned_anew():
    """Any of these changes makes a new task, and the plan of the old one is not accepted."""
    changes = {
        "left": lambda manager: manager.set_autonomous("Raven", False, 10.5),
        "home": lambda manager: manager.go_home(10.5),
        "course": lambda manager: manager.set_course(make_course("origin", 3), 10.5),
    }
    for name, change in changes.items():
        manager = flying_manager(lead_s=LEAD_S)
        manager.sample(10.4)
        task = manager.task
        plan = plan_ways(task)
        change(manager)
        if name == "course":  # they hold, so the new course is for those that are about to join
            assert manager.task.course.name == "origin"
        assert not manager.accept(task, plan, 10.55)
        if name == "left":
            assert manager.waiting_for(10.55) == ("Raven",) and manager.task is None
            manager.see("Raven", (-0.45, -0.78, 0.05), np.zeros(3), 0.0)  # it has landed
        _, references, phases = fly_with_a_planner(manager, 10.55, 50.0, 0.1)
        others = Phase.HOMED if name == "home" else Phase.COURSE
        assert phases[-1] == (others, others, Phase.HOLD if name == "left" else others), name
        assert minimum_separation(references[:, 0, :, :3]) >= 0.7
        assert manager.task is None


def test_nobody_is_left_to_be_planned():
    manager = flying_manager(vehicles=1, lead_s=LEAD_S)
    manager.sample(10.4)
    task = manager.task
    manager.set_autonomous("fluffy_II", False, 10.5)
    assert manager.task is None and not manager.accept(task, plan_ways(task), 10.6)
    assert manager.sample(30.0).phases == (Phase.HOLD,)


def test_a_start_that_is_taken_back():
    manager = flying_manager(lead_s=LEAD_S)
    fly_with_a_planner(manager, 10.0, 60.0, 0.1, [(30.0, manager.go_home)])
    assert manager.start(60.0) == list(NAMES) and manager.task is not None
    assert manager.go_home(60.1) == list(NAMES) and manager.task is None
    assert manager.sample(80.0).phases == (Phase.HOMED,) * 3


def test_one_goes_home_while_another_starts():
    """Two orders at once: one is planned after the other."""
    manager = flying_manager(lead_s=LEAD_S)
    fly_with_a_planner(manager, 10.0, 60.0, 0.1, [(30.0, manager.go_home)])
    manager.set_autonomous("Raven", False, 60.0)
    manager.set_autonomous("Raven", True, 60.0)
    manager.sample(60.4)  # Raven is to fly to the course, and then to go home again
    assert manager.go_home(60.45) == ["Raven"]
    assert manager.start(60.5) == ["fluffy_II", "albatross"]
    _, _, phases = fly_with_a_planner(manager, 60.5, 100.0, 0.1)
    assert phases[-1] == (Phase.COURSE, Phase.COURSE, Phase.HOMED)


def test_a_plan_that_comes_too_late_is_made_again_for_later():
    manager = flying_manager(lead_s=LEAD_S)
    manager.sample(10.4)
    task = manager.task
    assert not manager.accept(task, plan_ways(task), 11.5)
    assert manager.sample(11.5).phases == (Phase.HOLD,) * 3
    assert manager.task.begin_s > 11.5 + 2.0 * (11.5 - task.begin_s), "as long again is not too short"
    times, references, phases = fly_with_a_planner(manager, 11.5, 40.0, 1.0)
    assert phases[-1] == (Phase.COURSE,) * 3
    assert_smooth(times, references)


def test_without_smooth_start_it_is_on_the_course_at_once():
    manager = TrajectoryManager(["a"], [Home((0, 0, 1), 0.0)], make_course("circle", 1), smooth=False)
    assert manager.sample(100.0).phases == (Phase.COURSE,)
    assert manager.sample(102.0).derivatives[0, 0, :3] == pytest.approx([0.0, 0.8, 1.0])
    manager.set_autonomous("a", True, 102.0)
    assert manager.go_home(102.0) == manager.start(102.0) == []
    assert manager.sample(104.0).derivatives[0, 0, :3] == pytest.approx([-0.8, 0.0, 1.0])


def test_numbers_must_match():
    with pytest.raises(ValueError, match="1 vehicles, 1 homes .* 2"):
        TrajectoryManager(["a"], [Home((0, 0, 1), 0.0)], make_course("circle", 2))
