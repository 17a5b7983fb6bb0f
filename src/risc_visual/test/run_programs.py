"""Run programs of the package as a user does."""

import os
import subprocess
import sys

TIMEOUT_S = 240.0


def run_program(path, folder, *arguments):
    """Run a node's file in a folder, without a master and without a screen. Returns subprocess.CompletedProcess."""
    environment = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "ROS_MASTER_URI")}
    return subprocess.run(
        [sys.executable, str(path), *map(str, arguments)],
        cwd=str(folder),
        env=environment,
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
    )
