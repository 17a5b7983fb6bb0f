"""Parameters of a launch file as a node gets them."""

import contextlib
import dataclasses
import io
import pathlib
import re
import runpy
import shlex
import sys

import pytest
from roslaunch.core import Param
from roslaunch.xmlloader import XmlLoader

from risc_control.vehicle_pilot import VehicleNodeParams

ROOT = pathlib.Path(__file__).resolve().parents[1]
fleet_value = runpy.run_path(str(ROOT / "src/risc_control/nodes/fleet_value.py"))["main"]


class Loader(XmlLoader):
    """Runs fleet_value.py in this process: starting it for every parameter would take longer than all the rest."""

    def param_value(self, verbose, name, ptype, value, textfile, binfile, command):
        words = shlex.split(command or "")
        if words and pathlib.Path(words[0]).name == "fleet_value.py":
            with pytest.MonkeyPatch.context() as call, contextlib.redirect_stdout(io.StringIO()) as out:
                call.setattr(sys, "argv", words)
                with contextlib.suppress(SystemExit):  # it fails again as a program below, and roslaunch reports that
                    fleet_value()
                    value = out.getvalue()
        return super().param_value(verbose, name, ptype, value, textfile, binfile, command)


def unroll(config):
    """Add to a ROSLaunchConfig the single parameters of dicts: ~vehicles of a driver (values that all vehicles share),
    and ~mocap of stream_markers. Joystick nodes get the defaults of their class.
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
