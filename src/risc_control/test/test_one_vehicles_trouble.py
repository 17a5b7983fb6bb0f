"""A failure of one vehicle of a fleet, in the nodes, affects no other vehicle. Without a ROS graph."""

import io
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from risc_control import controllers
from risc_control.vehicles import Command
from risc_lab.lab import generated_fleet
from risc_lab.lab.fleet import FleetVehicle

rospy = pytest.importorskip("rospy")

from risc_control.ros import compensator_node, controller_node, vehicle_node  # noqa: E402  (needs ROS)
from risc_lab.ros import guard  # noqa: E402
from risc_msgs.msg import Cortex, States, Trajectories, Trajectory  # noqa: E402

VEHICLES: list[FleetVehicle] = list(generated_fleet(3).vehicles)
NAMES = [vehicle.template for vehicle in VEHICLES]
NOW_S = 1000.0


class Student(controllers.Controller):
    """Divides by the distance of a vehicle from its reference: 0/0 on the reference."""

    WRONG = None  # raised by every step

    def step(self, t, states, reference, params):
        if self.WRONG is not None:
            raise self.WRONG
        with np.errstate(invalid="ignore"):
            off_m = (reference.present[0, :, :3] - states.vehicles.position_m)[:, 0]
            return Command(0.1 * off_m / off_m, *np.zeros((2, len(off_m))), np.full(len(off_m), 4.4))


@pytest.fixture
def desk(monkeypatch):
    """Logged texts, {topic: callback} of the subscriptions, {topic: messages} that were published."""
    found = SimpleNamespace(logs=[], callbacks={}, published={})

    def subscriber(topic, kind, callback, **_options):
        found.callbacks[topic] = callback
        return SimpleNamespace(unregister=lambda: None)

    def publisher(topic, *_args, **_options):
        def publish(message):
            found.published.setdefault(topic, []).append(message)

        return SimpleNamespace(publish=publish, resolved_name=topic)

    for name, value in (
        ("get_param", lambda name, default=None: default),
        ("has_param", lambda name: False),
        ("set_param", lambda *item: None),
        ("Subscriber", subscriber),
        ("Publisher", publisher),
    ):
        monkeypatch.setattr(rospy, name, value)
    for level in ("logerr", "logwarn"):
        monkeypatch.setattr(rospy, level, lambda text, *values: found.logs.append(text % values if values else text))
        monkeypatch.setattr(
            rospy, level + "_throttle", lambda _period_s, text, *values: found.logs.append(text % values)
        )
    monkeypatch.setattr(guard, "is_closing", lambda: False)
    quiet = SimpleNamespace(add=lambda *part: None)
    for module in (controller_node, compensator_node):
        monkeypatch.setattr(module, "ticking_updater", lambda *args: quiet)
        monkeypatch.setattr(module, "ros_time_s", lambda: NOW_S)
    return found


@pytest.fixture
def node(desk, monkeypatch):
    """A ControllerNode of three vehicles with a student's controller."""
    monkeypatch.setattr(controller_node, "Server", lambda *args: None)
    monkeypatch.setattr(controllers.REGISTRY, "module", lambda name: SimpleNamespace(Controller=Student))
    monkeypatch.setattr(controllers.REGISTRY, "settings", lambda name, kind: kind())
    return controller_node.ControllerNode("student", VEHICLES)


def sent(desk, topic, message, stamp_s=NOW_S):
    """Deliver a message on a topic, as its bytes."""
    wire = io.BytesIO()
    message.header.stamp = rospy.Time.from_sec(stamp_s)
    message.serialize(wire)
    desk.callbacks[topic](SimpleNamespace(buff=wire.getvalue()))


def commanded(desk):
    """Names in the newest message on /controls, and its numbers."""
    message = desk.published["/controls"][-1]
    return list(message.names), message.controls.copy()


def fly(desk, places_m=(0.0, 0.0, 0.0), references_m=(1.0, 1.0, 1.0), stamp_s=NOW_S):
    """Send a reference and a state of each vehicle."""
    wanted = [Trajectory(name=name, x=x) for name, x in zip(NAMES, references_m)]
    sent(desk, "/trajectory", Trajectories(Obj=wanted), stamp_s)
    seen = [States(name=name, visible=True, x=x) for name, x in zip(NAMES, places_m)]
    sent(desk, "/cortex_raw", Cortex(Obj=seen), stamp_s)


def test_a_command_that_is_not_finite_is_left_out_counted_and_told(node, desk):
    fly(desk)
    assert commanded(desk)[0] == NAMES and desk.logs == []
    fly(desk, places_m=(0.0, 1.0, 0.0), stamp_s=NOW_S + 0.005)
    names, numbers = commanded(desk)
    assert names == [NAMES[0], NAMES[2]] and np.isfinite(numbers).all()
    assert node._counts["not finite"] == 1 and node._counts["states"] == 2
    (text,) = desk.logs
    assert "'student'" in text and text.endswith(NAMES[1])
    fly(desk, stamp_s=NOW_S + 0.01)
    assert commanded(desk)[0] == NAMES, "and the next one counts again"


def test_a_state_or_a_reference_that_is_not_finite_leaves_out_that_vehicle_only(node, desk):
    fly(desk, places_m=(np.nan, 0.0, 0.0))
    assert commanded(desk)[0] == NAMES[1:]
    fly(desk, references_m=(1.0, np.inf, 1.0), stamp_s=NOW_S + 0.005)
    assert commanded(desk)[0] == [NAMES[0], NAMES[2]]
    (text,) = desk.logs
    assert "reference" in text and text.endswith(NAMES[1])
    assert node._counts["refused references"] == 1


def test_a_controller_that_raises_is_told_once_and_the_node_goes_on(node, desk, monkeypatch):
    monkeypatch.setattr(Student, "WRONG", ZeroDivisionError("of the test"))
    for k in range(100):
        fly(desk, stamp_s=NOW_S + 0.001 * k)
    assert "/controls" not in desk.published
    (text,) = desk.logs
    assert "ZeroDivisionError: of the test" in text and "/cortex_raw" in text
    monkeypatch.setattr(Student, "WRONG", None)
    fly(desk, stamp_s=NOW_S + 0.15)
    assert commanded(desk)[0] == NAMES


def test_states_that_the_compensation_cannot_take_are_told_once(desk, monkeypatch):
    monkeypatch.setattr(compensator_node, "vehicles", lambda: VEHICLES)
    node = compensator_node.CompensatorNode()
    monkeypatch.setattr(node._compensator, "ahead", lambda *told: 1 / 0)
    for k in range(100):
        sent(desk, "/cortex_raw", Cortex(), NOW_S + 0.001 * k)
    (text,) = desk.logs
    assert "ZeroDivisionError" in text


class _Pilot:
    """Records its calls, and whether the lock was held."""

    autonomous = True

    def __init__(self, lock):
        self._lock, self.told = lock, []

    def __getattr__(self, name):
        return lambda *values: self.told.append((name, self._lock.locked()))


@pytest.fixture
def vehicle(desk):
    """A vehicle of the vehicle node, with the test's pilot."""
    one = vehicle_node._Vehicle.__new__(vehicle_node._Vehicle)
    one.name, one._lock, one._error_land_s, one.landings = "fluffy_II", threading.Lock(), 0.0, []
    one._counts = dict.fromkeys(("states", "states while not visible", "suspect states", "errors"), 0)
    one.failures, one.pilot = guard.Failures("the test"), _Pilot(one._lock)
    one._link = SimpleNamespace(land=lambda: one.landings.append(None))
    return one


def test_whatever_the_pilot_is_told_of_states_it_is_told_with_the_lock_held(vehicle):
    vehicle.on_state(False, [0.0] * 12, 0.0, None)
    vehicle.on_state(True, [0.0] * 12, 0.0, None)
    vehicle.on_suspect("a reason")
    vehicle.on_markers(3, 4)
    assert vehicle.pilot.told == [(name, True) for name in ("on_unseen", "on_state", "on_suspect", "on_markers")]


def test_what_fails_in_the_vehicle_node_lands_the_vehicle_and_is_told_once(vehicle, desk, monkeypatch):
    monkeypatch.setattr(_Pilot, "on_state", lambda self, *told: 1 / 0, raising=False)
    for _ in range(3):
        vehicle.on_state(True, [0.0] * 12, 0.0, None)
    assert vehicle._counts["errors"] == 3 and len(vehicle.landings) == 1
    assert sum("Traceback" in text for text in desk.logs) == 1
