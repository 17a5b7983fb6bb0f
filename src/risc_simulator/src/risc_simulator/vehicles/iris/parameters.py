"""Parameters of the virtual Pixhawk: config/iris_parameters.yaml, and what has been set since."""

import math
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from risc_lab.lab.yaml_reader import load_yaml, package_file

_KINDS = {  # name in the file: (MAV_PARAM_TYPE, lowest, highest)
    "int8": (mavlink.MAV_PARAM_TYPE_INT8, -(2**7), 2**7 - 1),
    "int16": (mavlink.MAV_PARAM_TYPE_INT16, -(2**15), 2**15 - 1),
    "int32": (mavlink.MAV_PARAM_TYPE_INT32, -(2**31), 2**31 - 1),
    "float": (mavlink.MAV_PARAM_TYPE_REAL32, -math.inf, math.inf),
}


class Parameter(NamedTuple):
    """Properties of a parameter beside its value."""

    index: int
    kind: int  # MAV_PARAM_TYPE
    lowest: float
    highest: float


class Parameters:
    """Values by name: parameters["ANGLE_MAX"] [the unit that ArduCopter uses]."""

    def __init__(self, **values):
        """values: of this vehicle, where they differ from the file's. Raises ValueError for an unknown name."""
        path = package_file("risc_simulator", "config/iris_parameters.yaml")
        self.about, self._values = {}, {}
        self.changes = 0  # number of changes so far
        for index, (name, (kind, value, *limits)) in enumerate(load_yaml(path).items()):
            kind, *widest = _KINDS[kind]
            self.about[name] = Parameter(index, kind, *(limits or widest))
            self._values[name] = value
        for name, value in values.items():
            if not self.set(name, value):
                raise ValueError("the autopilot has no parameter %s that can be %r" % (name, value))
        self.names = tuple(self.about)

    def __getitem__(self, name):
        return self._values[name]

    def __len__(self):
        return len(self._values)

    def set(self, name, value):
        """Set a value. Returns whether it was set: not for an unknown name or a value outside its limits."""
        known = self.about.get(name)
        if known is None or not math.isfinite(value):
            return False
        if known.kind != mavlink.MAV_PARAM_TYPE_REAL32:
            value = round(value)
        if not known.lowest <= value <= known.highest:
            return False
        self._values[name] = value
        self.changes += 1
        return True
