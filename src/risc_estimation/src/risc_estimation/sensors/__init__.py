"""On-board measurements of vehicles, by type, for filters that use them. Needs no ROS.

A type is one file here, or sensors/NAME.py in a folder of RISC_MAAP_MEMBERS:

    TOPIC, TYPE    of its driver: the topic below the vehicle's namespace, the type of its messages
    readings(m)    {name of a quantity: array} of one message; SI units, body axes (x nose, y right, z down)

Quantities that several types have share a name: `attitude` (3,) roll, pitch, yaw [rad], yaw by the vehicle's own
reference; `velocity` (3,) [m/s]; `height` (1,) above the ground [m]; `specific_force` (3,) [m/s^2].
"""

from risc_lab.registry import Registry

REGISTRY = Registry("sensors", __name__)


def of_type(name):
    """Module of a type of vehicle; None for a type that has none here."""
    return REGISTRY.module(name) if name in REGISTRY.names() else None


def give(estimator, name, kind, message):
    """Hand a StatesEstimator the readings in one message of a vehicle. kind: module of its type."""
    for what, values in kind.readings(message).items():
        estimator.on_board(name, message.header.stamp.to_sec(), what, values)
