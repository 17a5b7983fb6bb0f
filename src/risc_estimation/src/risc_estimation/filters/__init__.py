"""Filters of the estimator, by name: raw poses with covariance, residual and stamp in, states with covariance out.

The second stage of `risc_estimation.state_estimator`. A filter is one file here with a class `Filter`, and
config/filters/NAME.yaml with its settings. Filters from elsewhere, e.g. a student's: filters/NAME.py and
filters/NAME.yaml in a folder of RISC_MAAP_MEMBERS, see `risc_lab.registry`. `./maap fly --estimator NAME` flies it.
What runs in every frame is compiled, one call for all bodies, see `risc_lab/compiled.py`.
"""

import enum
from typing import NamedTuple

import numpy as np

from risc_lab.compiled import record, with_row
from risc_lab.registry import Registry
from risc_lab.settings import settings_from
from risc_lab.states import S

REGISTRY = Registry("filters", __name__)
DEFAULT = "least_squares"
COMMAND = "command"  # what `on_board` calls a command that was sent to a vehicle


class Status(enum.IntEnum):
    """How the state of a body was obtained. From TRACKED on it is visible."""

    LOST = 0  # no pose, and the filter does not predict without one
    OUTSIDE = 1  # seen outside of the arena
    SETTLING = 2  # seen, but not for long enough
    TRACKED = 3
    PREDICTED = 4  # no pose in this frame: the filter predicts
    SUSPECT = 5  # an implausible pose: the filter predicts
    REACQUIRED = 6  # tracked again, for a short time so far: the state may have jumped


# What became of the poses of a body since the start; `risc_maap_msgs/BodyStatus` explains them.
COUNTS = record(*[(name, int) for name in ("poses", "positions_refused", "attitudes_refused", "late", "resets")])


class Innovations(NamedTuple):
    """Innovations of the poses of the newest frame. Rows are bodies."""

    # (n, 3) y^T S^-1 y of position, of attitude (3 degrees of freedom each) and of both (6); NaN without a pose or
    # without a prediction
    squares: np.ndarray
    taken: np.ndarray  # (n, 2) bool: position, attitude


class VelocityFilter:
    """Interface of all filters. Rows are bodies, in the order in which they were added. SI units, cortex frame."""

    PARAMS = None  # dataclass of settings (`risc_lab.settings`), a field for each key of the YAML file
    late_s = 0.0  # [s] poses may be this much older than the newest one given; 0 = only newer ones are given
    COASTS = False  # it goes on without frames, see `coast`
    GATES = False  # it refuses poses by itself, and wants those that contradict the track, too
    ON_BOARD = ()  # what `on_board` is to be given: COMMAND, quantities of `risc_estimation.sensors`; () costs nothing

    def __init__(self, params):
        """params: PARAMS."""
        self.params = params
        self.states = np.zeros((0, len(S)))  # (bodies, 12), columns `S`; last known values where not visible, first 0
        self.visible = np.zeros(0, dtype=bool)  # (bodies,) the states are of the newest frame, and good to fly by

    def add_body(self, template, vehicle_type=None):
        """Add a row. template: risc_lab.lab.templates.Template; the attitude of an attached body means nothing.
        vehicle_type: VehicleType of a vehicle of the fleet.
        """
        self.states, self.visible = with_row(self.states), with_row(self.visible)

    def reset(self):
        """Forget all measurements: their times mean nothing on the clock of the next frame."""
        raise NotImplementedError

    def update(self, poses):
        """Bring states and visible up to date with a frame of raw `risc_estimation.pose_fit.Poses`.

        poses.stamp_s is later than that of the frame before, or at most late_s earlier. A body that is seen outside of
        the arena must not be visible.
        """
        raise NotImplementedError

    def coast(self, stamp_s):
        """Bring states and visible to a time for which no frame has come. True if any body is visible then."""
        return False

    def on_board(self, row, stamp_s, what, values):
        """Take a command or an on-board measurement, in the order of arrival: only what ON_BOARD lists.

        row: of the body; stamp_s: of the measurement, or when the command was sent [s], maybe later than that of the
        next frame; values: array. Of a COMMAND as in `risc_maap_msgs/CommandSent`: values at which roll, pitch [rad],
        climb loop and yaw rate [rad/s] settle, in force until the next one; else as in `risc_estimation.sensors`.
        """

    def status(self, poses):
        """List of Status of the bodies in the newest frame. poses: its `Poses`."""
        return status_of(poses, self.visible)

    def counters(self):
        """(bodies,) COUNTS up to now; None if it does not count."""

    def covariances(self):
        """(bodies, 12, 12) covariances of the states; None if the filter has none. Called on demand.

        states_estimation publishes them on state_covariances while there is a subscriber.
        """

    def accelerations(self):
        """(bodies, 3) accelerations [m/s^2] in cortex axes, by its model, at the newest states: 0 in a hover.

        NaN for a body without a known command. None if the filter has no model. Called on demand.
        """

    def innovations(self, poses):
        """Innovations of the newest frame; None if the filter has none. poses: its `Poses`. Called on demand."""


def make_filter(name=DEFAULT, given=None):
    """A filter by name, with the settings of its YAML file; the dict `given` replaces some of them.

    Raises ValueError for an unknown name, an unknown key or a bad value.
    """
    kind = REGISTRY.module(name).Filter
    return kind(settings_from(kind.PARAMS, {**REGISTRY.settings(name), **(given or {})}, "filter %s" % name))


def status_of(poses, visible):
    """List of Status of the bodies of `Poses`. visible: (bodies,) bool, of the filter."""
    return [
        (Status.TRACKED if present else Status.PREDICTED)
        if shown
        else (Status.SETTLING if inside else Status.OUTSIDE if present else Status.LOST)
        for present, inside, shown in zip(poses.present, poses.inside, visible)
    ]
