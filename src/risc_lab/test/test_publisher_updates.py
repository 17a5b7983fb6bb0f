"""A publisher that the master announces while a subscriber is being registered is connected to."""

import threading

import pytest

pytest.importorskip("rospy")

from rospy.impl import registration  # noqa: E402

from risc_lab.ros.publisher_updates import publisher_update  # noqa: E402

ANNOUNCED, ANSWERED = ["http://early:1/"], ["http://known:2/"]


class Handler:
    """Handler of a node; done once all wanted connections are made."""

    def __init__(self, wanted):
        self._wanted, self.connected = set(wanted), set()
        self.over = threading.Event()

    @property
    def done(self):
        return self.over.is_set()

    def _connect_topic(self, topic, uri):
        self.connected.add((topic, uri))
        if self.connected >= self._wanted:
            self.over.set()
        return 1, "", 0


def connected(updates, wanted, patience_s):
    """Connections made after updates that were queued before the manager ran."""
    handler = Handler(wanted)
    manager = registration.RegManager(handler)
    for topic, uris in updates:
        manager.publisher_update(topic, uris)
    thread = threading.Thread(target=manager.run, daemon=True)
    thread.start()
    handler.over.wait(patience_s)
    handler.over.set()
    thread.join()
    return handler.connected


RACE = [("/a", ANNOUNCED), ("/b", ANNOUNCED), ("/a", []), ("/b", ANSWERED)]
ALL = {("/a", ANNOUNCED[0]), ("/b", ANNOUNCED[0]), ("/b", ANSWERED[0])}


def test_what_was_announced_before_the_answer_is_connected(monkeypatch):
    monkeypatch.setattr(registration.RegManager, "publisher_update", publisher_update)
    assert connected(RACE, ALL, 30.0) == ALL


def test_rospy_alone_forgets_it():
    """The control arm: when this fails, the module can be removed."""
    assert connected(RACE, ALL, 2.0) == {("/b", ANSWERED[0])}
