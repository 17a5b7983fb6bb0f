"""Parameters of a launch file as a node gets them."""

import re

from roslaunch.core import Param


def unroll(config):
    """Add to a ROSLaunchConfig the single parameters of those that it sets together: ~vehicles of a driver, as far
    as they have the same, and ~mocap of stream_markers.
    """
    together, different = {}, set()
    for name, param in list(config.params.items()):
        vehicle = re.fullmatch("(.*)/vehicles/[^/]+/([^/]+)", name)
        if vehicle:
            name = "/".join(vehicle.groups())
            if together.setdefault(name, param.value) != param.value:
                different.add(name)
        elif name.endswith("/mocap") and isinstance(param.value, dict):
            together.update((name.replace("mocap", key), value) for key, value in param.value.items())
    for name, value in together.items():
        if name not in different:
            config.params.setdefault(name, Param(name, value))
