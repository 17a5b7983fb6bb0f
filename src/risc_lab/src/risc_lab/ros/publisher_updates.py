"""Publishers that rospy forgets while a node starts.

A node registers a subscriber and waits for the master's answer, the list of publishers. A publisher that registers
meanwhile is announced by another thread, which may be first; rospy then goes by what came last, the answer, which does
not name that publisher. The two are never connected, and nothing says so: a flight was seen not to take off.
Connections are only ever added by these lists, so nothing that waits must be dropped.
"""

import rospy
from rospy.impl.registration import RegManager


def publisher_update(self, resolved_name, uris):
    """As `RegManager` does it, but keeps the updates that still wait. uris: of the publishers of a topic."""
    with self.cond:
        waiting = [uri for name, uris_before in self.updates if name == resolved_name for uri in uris_before]
        self.updates.append((resolved_name, list(dict.fromkeys([*uris, *waiting]))))
        self.cond.notify_all()


def init_node(name, **options):
    """rospy.init_node of a node whose subscribers forget no publisher; same arguments, same errors."""
    RegManager.publisher_update = publisher_update
    rospy.init_node(name, **options)
