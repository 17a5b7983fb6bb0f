"""What a vehicle can carry that moves by itself: each body is a module here, coupled to the vehicle by its equations.

A body is a module with
    SIZE        rows of its own state, which follow the vehicle's twelve (models.quadrotor.X)
    FIELDS      names of the numbers that its equations read from vehicle.body; its YAML file gives their values
and, compiled (risc_lab.compiled),
    couple      (x, vehicle, x_dot): writes its own rows of x_dot, and adds its force to those of the vehicle, which
                hold the motion without it (models.quadrotor.push is of use)
    rest        (x, vehicle): writes its own rows of x as they are while the vehicle stands, or is put into the air
    place       (x, vehicle, position_m, axes): writes where its template is, cortex frame: position_m (3,), and, where
                it turns, axes (3, 3): its axes as columns; they are those of the frame otherwise
vehicle: record with the true mass and all else of models.quadrotor.QUADROTOR_FIELDS. The floor and the net do not stop
a body. The fleet file attaches it:  attached: {body: NAME, template: TEMPLATE}  at a vehicle; YAML files are
config/bodies/NAME.yaml. One from elsewhere is bodies/NAME.py and bodies/NAME.yaml in a folder of RISC_MAAP_MEMBERS (see
risc_lab.registry).
"""

from dataclasses import astuple, make_dataclass
from typing import NamedTuple

import numpy as np

from risc_lab.compiled import record
from risc_lab.registry import Registry

REGISTRY = Registry("bodies", __name__)


class Body(NamedTuple):
    """What the world knows of a body."""

    size: int
    record: np.dtype
    values: tuple  # of the record
    couple: object
    rest: object
    place: object


def load_body(name):
    """Body of this name. Raises ValueError for an unknown one, or when its module or YAML file is not complete."""
    module = REGISTRY.module(name)
    try:
        numbers = make_dataclass(name, [(field, float) for field in module.FIELDS])
        values = astuple(REGISTRY.settings(name, numbers))
        fields = record(*[(field, float) for field in module.FIELDS])
        return Body(module.SIZE, fields, values, module.couple, module.rest, module.place)
    except AttributeError as error:
        raise ValueError("body %r (%s): %s" % (name, module.__file__, error)) from error
