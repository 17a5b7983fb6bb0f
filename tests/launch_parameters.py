"""Parameters of a launch file as a node gets them."""

import dataclasses
import re

from roslaunch.core import Param

from risc_control.vehicle_pilot import VehicleNodeParams


def unroll(config):
    """Add to a ROSLaunchConfig the single parameters of those that it sets together: ~vehicles of a driver, as far
    as they have the same, and ~mocap of stream_markers. Joystick nodes get the defaults that their class says.
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
    for node in config.nodes:
        if node.name == "joystick_controller":
            for item in dataclasses.fields(VehicleNodeParams):
                name = "%s%s/%s" % (node.namespace, node.name, item.name)
                config.params.setdefault(name, Param(name, item.default))
