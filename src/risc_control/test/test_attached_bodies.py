"""What vehicles carry: a controller gets these bodies in the rows of their vehicles, from /cortex_raw as well."""

import io
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from risc_control import controllers
from risc_control.controllers import ControlLoop
from risc_control.vehicles import Command
from risc_lab.lab import fleet_from_dict, load_vehicle_type
from risc_lab.states import S, States


@dataclass(frozen=True)
class Params:
    """One parameter, which vehicles may have of their own."""

    number: float = 0.0


class Looker(controllers.Controller):
    """Controller that records the states it is given."""

    PARAMS = Params
    SEEN = []  # Bundle of each step, as the controller gets them

    def step(self, t, states, reference, params):
        self.SEEN.append(states)
        return Command(*np.zeros((4, len(self.delay_s))))


@pytest.fixture
def seen(monkeypatch):
    monkeypatch.setattr(Looker, "SEEN", [])
    return Looker.SEEN


SHARED = [{}, {"number": 1.0}, {"number": 1.0}]  # by two controllers


def looking(seen, own):
    """ControlLoop of three vehicles, before its first frame."""
    loop = ControlLoop(Looker, [load_vehicle_type("ardrone")] * 3, own=own)
    seen.clear()
    return loop


def update(loop, bodies):
    """Feed one frame to the loop."""
    everyone, reference = np.ones(3, dtype=bool), np.zeros((3, 3, 4))
    states = States(everyone, np.zeros((3, len(S))))
    loop.update(0.0, 0.006, states, reference, reference, everyone, everyone, bodies)


def test_controllers_that_share_a_fleet_see_what_their_own_vehicles_carry(seen):
    loop = looking(seen, SHARED)
    for k in range(2):
        x = 10.0 * np.arange(1.0, 4.0)[:, None] * np.ones(len(S)) + k
        update(loop, States(np.array([False, True, True]), x))
        first, others = (bundle.bodies for bundle in seen[-2:])
        assert first.visible.tolist() == [False] and others.visible.tolist() == [True, True]
        assert first.x[:, S.X].tolist() == [10.0 + k] and others.x[:, S.X].tolist() == [20.0 + k, 30.0 + k]
    update(loop, None)
    assert [bundle.bodies.visible.tolist() for bundle in seen[-2:]] == [[False], [False, False]]


@pytest.mark.parametrize("own", [(), SHARED])
def test_where_nobody_carries_anything_nothing_is_made_for_it(seen, own):
    loop = looking(seen, own)
    update(loop, None)
    update(loop, None)
    half = len(seen) // 2
    assert all(former.bodies is newer.bodies for former, newer in zip(seen[:half], seen[half:]))
    assert sum(len(bundle.bodies.x) for bundle in seen[:half]) == 3
    assert not any(bundle.bodies.visible.any() for bundle in seen)


BALL = {"body": "toy_spring", "template": "ball"}
ENTRIES = [
    {"namespace": "risc%d" % k, "template": "T%d" % k, "address": "127.0.0.%d" % k, "type": "ardrone"}
    | {"start": {"position_m": [k, 0, 0]}}
    | ({"attached": BALL} if k == 2 else {})
    for k in (1, 2)
]
CONTENT = {
    "name": "test",
    "mocap": {"host": "127.0.0.9"},
    "vehicles": ENTRIES,
    "templates": {
        "geometries": {"ball": {"top": [0.0, 0.0, 0.02]}},
        "templates": {"ball": {"kind": "attached", "geometry": "ball"}},
    },
}


@pytest.fixture
def node(monkeypatch, seen):
    """A ControllerNode of the fleet, without a graph."""
    rospy = pytest.importorskip("rospy")
    from risc_control.ros import controller_node

    told = {"/fleet": CONTENT}
    monkeypatch.setattr(rospy, "get_param", told.get)
    monkeypatch.setattr(rospy, "has_param", told.__contains__)
    monkeypatch.setattr(rospy, "set_param", lambda *item: None)
    quiet = SimpleNamespace(publish=lambda message: None, add=lambda *part: None)
    for owner, name in ((rospy, "Publisher"), (rospy, "Subscriber"), (controller_node, "PacedSubscriber")):
        monkeypatch.setattr(owner, name, lambda *args, **options: quiet)
    monkeypatch.setattr(controller_node, "Server", lambda *args: None)
    monkeypatch.setattr(controller_node, "ticking_updater", lambda *args: quiet)
    monkeypatch.setattr(controllers.REGISTRY, "module", lambda name: SimpleNamespace(Controller=Looker))
    monkeypatch.setattr(controllers.REGISTRY, "settings", lambda name, kind: kind())
    return controller_node.ControllerNode("looker", fleet_from_dict(CONTENT).vehicles)


def test_the_node_shows_a_controller_what_motion_capture_sees_of_it(node, seen, monkeypatch):
    import rospy

    from risc_control.ros import controller_node
    from risc_msgs.msg import Cortex
    from risc_msgs.msg import States as Body

    now_s = 1000.0
    monkeypatch.setattr(controller_node, "ros_time_s", lambda: now_s)
    for stamp_s, visible in ((now_s - 1.0, [False, False]), (now_s, [False, True])):
        message, wire = Cortex(Obj=[Body("ball", True, *range(12)), Body("T2", True, *[1.0] * 12)]), io.BytesIO()
        message.header.stamp = rospy.Time.from_sec(stamp_s)
        message.serialize(wire)
        node._on_states(SimpleNamespace(buff=wire.getvalue()))
        assert seen[-1].bodies.visible.tolist() == visible, "not what is old"
    assert seen[-1].bodies.position_m.tolist() == [[0.0, 0.0, 0.0], [0.0, 1.0, 2.0]]
    assert seen[-1].vehicles.position_m.tolist() == [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]
    assert node._reader.unknown == []
