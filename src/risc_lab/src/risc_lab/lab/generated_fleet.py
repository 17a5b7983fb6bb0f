"""A virtual laboratory for any number of vehicles: fleet, starts, net, mocap templates. The number determines it."""

import math

import numpy as np

from risc_lab.lab.arena import NET_HALF_X_M, NET_HALF_Y_M, Arena
from risc_lab.lab.fleet import Fleet, FleetLandmark, FleetVehicle, MocapEndpoint, Start
from risc_lab.lab.landmark_catalogue import load_landmark_catalogue
from risc_lab.lab.templates import VEHICLE, Kind, TemplateSet
from risc_lab.lab.vehicle_types import DEFAULT_TYPE

MOST_VEHICLES = 250  # the last byte of an address numbers them
SPACING_M = 1.0  # between two starts: aircraft are 0.55 m wide
ROOM_M = 1.5  # from the outermost start to the net: a circle of 0.35 m, the fence and its look-ahead

_NAMES = ("fluffy_II", "albatross", "Raven", "Condor", "Kahn")  # of the laboratory; the others are ardrone6 and so on
_WITH_CAMERA = 3  # how many of them have a calibration
_CORNERS = ((1, 0.8), (1, -0.8), (-1, 0.8), (-1, -0.8))  # end of the net, y [m]; for the laboratory's first landmarks
_FROM_NET_M = 0.19  # how far inside the net a landmark hangs,
_LANDMARK_HEIGHT_M = 1.5

_SEED = 20261123
_MARKERS = 5
_REACH_M = (0.12, 0.22)  # of a marker from the middle of the hull, in plan,
_HEIGHTS_M = (-0.10, 0.02)  # and down from it
_LEAST_M = 0.08  # between two markers of a hull
_LEAST_SPREAD_M = 0.05  # root of the sum of squared distances from the plane that fits them best
_LEAST_DIFFERENCE_M = 0.03  # of two hulls: largest difference between their sorted marker distances


def rows(count, spacing_m=SPACING_M):
    """(count, 2) places on a grid around the origin, longer along x."""
    columns = math.ceil(math.sqrt(count))
    places = np.array([divmod(k, math.ceil(count / columns)) for k in range(count)], dtype=float)
    return spacing_m * (places - 0.5 * (places.min(axis=0) + places.max(axis=0)))


def generated_fleet(vehicles, room_m=ROOM_M):
    """A Fleet of this many AR.Drones in the virtual lab, in rows, in a net that is large enough. Raises ValueError.

    room_m: least distance from the outermost start to the net, which is at least as large as the laboratory's.
    """
    if not 1 <= vehicles <= MOST_VEHICLES:
        raise ValueError("a generated fleet has 1 to %d vehicles, %r were requested" % (MOST_VEHICLES, vehicles))
    places = rows(vehicles)
    half_x_m, half_y_m = np.maximum(np.abs(places).max(axis=0) + room_m, (NET_HALF_X_M, NET_HALF_Y_M)).tolist()
    names = _NAMES[:vehicles] + tuple("ardrone%d" % k for k in range(len(_NAMES) + 1, vehicles + 1))
    own = names[len(_NAMES) :]
    return Fleet(
        name="generated%d" % vehicles,
        mocap=MocapEndpoint("127.77.0.1", stream_port=11001, interface="127.0.0.1"),
        vehicles=tuple(
            FleetVehicle(
                namespace="risc%d" % k,
                template=name,
                type=DEFAULT_TYPE,
                address="127.77.1.%d" % k,
                calibration="risc%d.yaml" % k if k <= _WITH_CAMERA else "",
                start=Start((float(x), float(y), 0.0)),
                camera_mount="risc%d_mount.yaml" % k if k <= _WITH_CAMERA else "",
            )
            for k, (name, (x, y)) in enumerate(zip(names, places), start=1)
        ),
        landmarks=tuple(
            FleetLandmark(
                kind.name, (side * (half_x_m - _FROM_NET_M), y, _LANDMARK_HEIGHT_M), 180.0 if side > 0 else 0.0
            )
            for kind, (side, y) in zip(load_landmark_catalogue().landmarks, _CORNERS)
        ),
        arena=Arena(half_x_m, half_y_m),
        templates=TemplateSet(dict(_hulls(own)), {name: Kind(VEHICLE, name) for name in own}),
    )


def _hulls(names):
    """(name, markers) of hulls: five markers each, not in one plane, too different to be mistaken for each other."""
    rng = np.random.default_rng(_SEED)
    known, marker_names = [], tuple("m%d" % k for k in range(1, _MARKERS + 1))
    for name in names:
        while True:
            angles, reach_m = rng.uniform(0.0, 2.0 * math.pi, _MARKERS), rng.uniform(*_REACH_M, _MARKERS)
            heights_m = rng.uniform(*_HEIGHTS_M, _MARKERS)
            markers_m = np.stack([reach_m * np.cos(angles), reach_m * np.sin(angles), heights_m], axis=1).round(3)
            apart_m = np.sort(np.linalg.norm(markers_m[:, None] - markers_m, axis=2)[np.triu_indices(_MARKERS, 1)])
            flat_m = np.linalg.svd(markers_m - markers_m.mean(axis=0), compute_uv=False)[2]
            new = all(np.abs(apart_m - other_m).max() >= _LEAST_DIFFERENCE_M for other_m in known)
            if apart_m[0] >= _LEAST_M and flat_m >= _LEAST_SPREAD_M and new:
                break
        known.append(apart_m)
        yield name, dict(zip(marker_names, map(tuple, markers_m.tolist())))
