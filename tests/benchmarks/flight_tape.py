"""A flight that is replayed to estimators: flown once, offline, then seen repeatedly by cameras with other noise.

The estimates do not change how it was flown, so thousands of false frames and long outages can happen to a fleet on its
course.
"""

from typing import NamedTuple

import numpy as np

from risc_estimation.filters import COMMAND
from risc_estimation.pose_fit import PoseFitParams
from risc_estimation.state_estimator import StatesEstimator
from risc_experiments.offline import RunningFlight
from risc_experiments.offline_sensors import OnBoardReadings
from risc_lab.lab import load_templates
from risc_simulator.faults import Bodies
from risc_simulator.models.mocap_cameras import CameraParams, MocapCameras


class Tape(NamedTuple):
    """A recorded flight of n vehicles in k frames, from when all were on the course, settled, to the end."""

    fleet: object  # Fleet
    vehicle_types: dict  # {name in motion capture: VehicleType} of the vehicles, in the order of the fleet
    markers_on_m: dict  # {name: (j, 3)} where the markers of each vehicle are, body axes
    layout: tuple  # as `MocapCameras.observe` takes it; vehicles come first
    times_s: np.ndarray  # (k,) of exposure
    markers_m: np.ndarray  # (k, m, 3) exact ones of all bodies
    truths: np.ndarray  # (k, n, 12) true states of the vehicles, as from perfect motion capture, columns `S`
    # of each frame: [(name, stamp_s, what, values)] that reach an estimator before it, arguments of
    # `StatesEstimator.on_board`; the first frame also has those of the whole flight before
    told: list

    @property
    def names(self):
        """Names of the vehicles in motion capture."""
        return tuple(self.vehicle_types)

    def bodies(self, *meant):
        """`faults.Bodies` of a fault that is meant for the vehicles with these names."""
        return Bodies(meant, tuple(name for name in self.names if name not in meant), self.markers_on_m)

    def cameras(self, seed):
        """MocapCameras of the fleet's arena. seed: int or SeedSequence."""
        return MocapCameras(CameraParams.of_arena(self.fleet.arena), seed)

    def estimator(self, velocity_filter, **pose_fit):
        """StatesEstimator of the fleet with a new filter. pose_fit: PoseFitParams that differ from the defaults."""
        params = PoseFitParams(**pose_fit).within(self.fleet.arena)
        templates = load_templates(fleet=self.fleet)
        return StatesEstimator(templates, params, self.names, velocity_filter, self.vehicle_types)


def record(flight, on_board):
    """Tape of a Flight. on_board: what estimators will get besides frames, as in `VelocityFilter.ON_BOARD`.

    Raises as `offline.fly`; ImportError without ROS where sensors are to be read.
    """
    running = _Taped(flight, frozenset(on_board))
    while not running.is_over:
        running.frame()
    return running.tape()


def replay(tape, estimator, cameras, see=lambda k, seen: seen):
    """Yields (k, Observation, FrameEstimate) of each frame; the estimator can be queried meanwhile.

    see: function of k and what the cameras have seen, which returns what reaches the estimator.
    """
    for k, (time_s, markers_m, told) in enumerate(zip(tape.times_s.tolist(), tape.markers_m, tape.told)):
        for said in told:
            estimator.on_board(*said)
        seen = see(k, cameras.observe(time_s, tape.layout, markers_m))
        yield k, seen, estimator.update(time_s, seen.layout, seen.markers_m, seen.unidentified_m)


class _Taped(RunningFlight):
    """A flight that records what other estimators will get."""

    def __init__(self, flight, on_board):
        self.on_board_wanted, self._told, self._frames_told = on_board, [], []
        super().__init__(flight)

    def _set_up_lab(self, fleet, types, vehicle_types):
        super()._set_up_lab(fleet, types, vehicle_types)
        self._fleet, self._types = fleet, vehicle_types
        vehicles, seed, noise = self._world.vehicles.values(), self._flight.seed, float(self._flight.noise)
        self._for_others = OnBoardReadings(self, vehicles, self._wires, seed, noise)

    def on_board(self, name, stamp_s, what, values):
        """Record what an estimator would get: see `StatesEstimator.on_board`."""
        if what in self.on_board_wanted:
            self._told.append((name, stamp_s, what, values))

    def _note_command(self, i, time_s, command):
        super()._note_command(i, time_s, command)
        self.on_board(self._names[i], time_s, COMMAND, np.array(command))

    def _let_lab_go_on(self):
        super()._let_lab_go_on()
        self._for_others.send(self._time_s)
        if self._time_s >= self._settled_s:
            now = self._time_s, self._world.markers_m().copy(), self._world.truth(), self._told
            self._frames_told.append(now)
            self._told = []

    def tape(self):
        """The flight's Tape."""
        vehicles = self._world.vehicles.values()
        times_s, markers_m, truths, told = zip(*self._frames_told)
        return Tape(
            self._fleet,
            dict(zip(self._names, self._types)),
            {vehicle.name: vehicle.markers_m for vehicle in vehicles},
            self._world.layout,
            *(np.array(values) for values in (times_s, markers_m, truths)),
            list(told),
        )
