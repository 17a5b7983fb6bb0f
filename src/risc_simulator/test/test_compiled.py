"""Compiled code gives the same results as plain Python, and nothing is compiled or loaded in flight."""

import os
import pathlib
import subprocess
import sys

import pytest

HERE = pathlib.Path(__file__).parent

IN_FLIGHT = """
import gc
import test_world
from numba.core.dispatcher import Dispatcher
from cortex_ros.wire import FrameEncoder
from risc_simulator.models.mocap_cameras import MocapCameras

def compiled():
    return {id(f): len(f.signatures) for f in gc.get_objects() if isinstance(f, Dispatcher)}

make = test_world.make_world

def make_world(*arguments, **options):
    global world, cameras, encoder, at_start
    world = make(*arguments, **options)
    cameras, encoder = MocapCameras(seed=1), FrameEncoder(world.layout, 1000.0)
    at_start = compiled()
    return world

test_world.make_world = make_world
test_world.fly_the_golden_flight()
for k in range(500):
    seen = cameras.observe(0.005 * k, world.layout, world.markers_m())
    encoder.encode(k, seen.markers_m, seen.unidentified_m)
assert sum(at_start.values()) > 5
assert compiled() == at_start
"""


def run(*arguments, **environment):
    path = os.pathsep.join([str(HERE), *sys.path])
    return subprocess.run(
        [sys.executable, *arguments],
        env=dict(os.environ, PYTHONPATH=path, **environment),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=300,
    )


@pytest.mark.parametrize(
    "file, pattern",
    [
        pytest.param("test_world.py", "golden or at_rest", marks=pytest.mark.release),
        pytest.param("test_members.py", "exchange or own_equations", marks=pytest.mark.release),
        ("test_iris_plant.py", "lag or attitude or carry"),
        ("test_mocap_cameras.py", "as_ever"),
        ("../../cortex_ros/test/test_wire.py", "fast_encoder"),
    ],
)
def test_the_same_source_uncompiled(file, pattern):
    arguments = ("-m", "pytest", "-q", "-p", "no:cacheprovider", str(HERE / file), "-k", pattern)
    ended = run(*arguments, NUMBA_DISABLE_JIT="1")
    assert ended.returncode == 0, ended.stdout


IRIS_IN_FLIGHT = """
import gc
import test_iris_plant
from numba.core.dispatcher import Dispatcher

def compiled():
    return {id(f): len(f.signatures) for f in gc.get_objects() if isinstance(f, Dispatcher)}

make = test_iris_plant.make_world

def make_world(*arguments, **options):
    global world, at_start
    world = make(*arguments, **options)
    at_start = compiled()
    return world

test_iris_plant.make_world = make_world
test_iris_plant.wander(seed=4, n=2)
assert sum(at_start.values()) > 1, at_start
assert compiled() == at_start
"""


@pytest.mark.parametrize("flight", [IN_FLIGHT, IRIS_IN_FLIGHT], ids=["ardrone", "iris"])
def test_nothing_is_compiled_or_loaded_in_flight(flight):
    ended = run("-c", flight)
    assert ended.returncode == 0, ended.stdout
