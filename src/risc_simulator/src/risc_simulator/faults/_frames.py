"""What faults on frames have in common: the markers of a body, in an Observation and in a datagram of Cortex."""

import struct

import numpy as np

from cortex_ros import wire
from risc_simulator.models.mocap_cameras import Observation

MISSING_M = 1e-3 * wire.MISSING_MM


def rows_of(observation, names):
    """[slice of markers_m] of the bodies with these names, in the order of the names; unknown names are skipped."""
    found, start = {}, 0
    for name, count in observation.layout:
        found[name] = slice(start, start + count)
        start += count
    return [found[name] for name in names if name in found]


def changed(observation, names, change):
    """Copy of the Observation in which change(markers (n, 3)) replaces the markers of each body with these names."""
    markers_m = observation.markers_m.copy()
    for rows in rows_of(observation, names):
        markers_m[rows] = change(markers_m[rows])
    return observation._replace(markers_m=markers_m)


def level_direction(rng):
    """(3,) horizontal unit vector in a random direction."""
    angle_rad = rng.uniform(0.0, 2.0 * np.pi)
    return np.array([np.cos(angle_rad), np.sin(angle_rad), 0.0])


def pose(markers_m, body_m):
    """(R, t) of a body: R (3, 3) rotates body axes into the mocap frame, t (3,) is the place of its origin.

    markers_m: (n, 3) as seen, NaN rows are lost.  body_m: (n, 3) the same in body axes.  None if fewer than three.
    """
    seen = np.isfinite(markers_m).all(axis=1)
    if seen.sum() < 3:
        return None
    middle_m, body_middle_m = markers_m[seen].mean(axis=0), body_m[seen].mean(axis=0)
    left, _, right = np.linalg.svd((markers_m[seen] - middle_m).T @ (body_m[seen] - body_middle_m))
    turn = left @ np.diag((1.0, 1.0, np.linalg.det(left @ right))) @ right
    return turn, middle_m - turn @ body_middle_m


def overwrite(share, rng, bodies, axis, value_m):
    """act that sets a coordinate of the bodies' markers, each with probability `share`; of Observations or packets."""

    def act(seen, now_s):
        if isinstance(seen, Observation):
            return [(0.0, changed(seen, bodies.meant, in_markers))]
        return [(0.0, in_packet(seen) if isinstance(seen, bytes) else seen)]

    def in_markers(markers_m):
        markers_m[rng.random(len(markers_m)) < share, axis] = value_m
        return markers_m

    def in_packet(packet):
        packet, value = bytearray(packet), struct.pack("<f", 1e3 * value_m)
        for name in bodies.meant:
            count = len(bodies.markers_m[name])
            head = name.encode() + b"\0" + struct.pack("<i", count)
            start = packet.find(head) + len(head)
            if start < len(head) or packet[:2] != struct.pack("<H", wire.Command.FRAME_OF_DATA):
                continue
            for k in np.flatnonzero(rng.random(count) < share).tolist():
                packet[start + 12 * k + 4 * axis : start + 12 * k + 4 * axis + 4] = value
        return bytes(packet)

    return act
