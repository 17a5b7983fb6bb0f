"""What is compiled runs as plain Python, too, and flies the golden flight: numba adds nothing of its own."""

import os
import pathlib
import subprocess
import sys

import pytest

HERE = pathlib.Path(__file__).parent


@pytest.mark.parametrize(
    "file, pattern",
    [("test_world.py", "golden"), ("test_mocap_cameras.py", "as_ever"), ("test_cortex_wire.py", "fast_encoder")],
)
def test_the_same_source_uncompiled(file, pattern):
    environment = dict(os.environ, NUMBA_DISABLE_JIT="1", PYTHONPATH=os.pathsep.join(sys.path))
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(HERE / file), "-k", pattern],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=300,
    )
    assert run.returncode == 0, run.stdout
