"""Between messages (degrees, risc_msgs) and the estimator's values (SI units, numpy): the only place that does it."""

import itertools

import numpy as np
from std_msgs.msg import Header

from risc_estimation.states import S
from risc_msgs.msg import Cortex, Landmark, Landmarks, Mocap_data, Mocap_marker, Mocap_markers, States

FRAME_ID = "cortex"

_TO_MESSAGE = np.ones(len(S))
_TO_MESSAGE[S.PHI :] = np.rad2deg(1.0)  # messages hold degrees and deg/s


def header_for(header):
    """Header of a message derived from one with `header`: same stamp; tf2 refuses the old bags' leading slash."""
    return Header(stamp=header.stamp, frame_id=header.frame_id.lstrip("/") or FRAME_ID)


def markers_from_msg(msg):
    """Mocap_data -> (layout ((name, number of markers), ...), (markers, 3) of all bodies [m], cortex frame)."""
    layout = tuple([(body.name, len(body.marker)) for body in msg.Obj])
    markers = [(marker.x, marker.y, marker.z) for body in msg.Obj for marker in body.marker]
    return layout, np.array(markers, dtype=float).reshape(-1, 3)


def markers_to_msg(header, layout, markers_m):
    """The inverse of `markers_from_msg`."""
    markers = iter(markers_m.tolist())
    return Mocap_data(
        header=header,
        Obj=[
            Mocap_markers(name, 0.0, [Mocap_marker(*marker) for marker in itertools.islice(markers, count)])
            for name, count in layout
        ],
    )


def cortex_from_estimate(header, estimate):
    """FrameEstimate -> Cortex, one entry per known vehicle, degrees and deg/s."""
    rows = (estimate.states * _TO_MESSAGE).tolist()
    return Cortex(
        header,
        [States(name, visible, *row) for name, visible, row in zip(estimate.names, estimate.visible.tolist(), rows)],
    )


def states_from_cortex(msg):
    """Cortex -> dict name -> (visible, (12,) state in SI units, columns `risc_estimation.states.S`)."""
    return {
        entry.name: (
            entry.visible,
            np.array(
                [
                    entry.x,
                    entry.y,
                    entry.z,
                    entry.u,
                    entry.v,
                    entry.w,
                    entry.phi,
                    entry.theta,
                    entry.psi,
                    entry.p,
                    entry.q,
                    entry.r,
                ]
            )
            / _TO_MESSAGE,
        )
        for entry in msg.Obj
    }


def landmarks_from_estimate(header, estimate):
    """FrameEstimate -> Landmarks: those seen in this frame."""
    return Landmarks(
        header, [Landmark(name, *row) for name, row in zip(estimate.landmark_names, estimate.landmarks_m.tolist())]
    )
