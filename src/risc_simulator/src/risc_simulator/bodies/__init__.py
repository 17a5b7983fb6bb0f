"""Bodies that a vehicle can carry, with their own motion: each is a module here, coupled to the vehicle by equations.

A body is a module with
    SIZE        rows of its own state, which follow the vehicle's twelve (models.quadrotor.X)
    FIELDS      names of the numbers that its equations read from vehicle.body; its YAML file gives their values
and, compiled (risc_lab.compiled),
    couple      (x, vehicle, x_dot): writes its own rows of x_dot, and adds its force to the vehicle's rows, which
                already hold the motion without the body (models.quadrotor.push helps)
    rest        (x, vehicle): writes its own rows of x for a vehicle that stands, or is put into the air
    place       (x, vehicle, position_m, axes): writes the pose of its template, cortex frame: position_m (3,), and, if
                it turns, axes (3, 3): its axes as columns; before the call axes is the identity matrix
vehicle: record with the true values of models.quadrotor.QUADROTOR_FIELDS, e.g. the mass. The floor and the net do not
stop a body. A fleet file attaches a body to a vehicle with  attached: {body: NAME, template: TEMPLATE}. YAML files are
config/bodies/NAME.yaml. A body from outside this package is bodies/NAME.py and bodies/NAME.yaml in a folder of
RISC_MAAP_MEMBERS (see risc_lab.registry).
"""

from dataclasses import astuple, make_dataclass
from typing import NamedTuple

import numpy as np

from risc_lab.compiled import record
from risc_lab.registry import Registry

REGISTRY = Registry("bodies", __name__)


class Body(NamedTuple):
    """Definition of a body, as the world uses it."""

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
