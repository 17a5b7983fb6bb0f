"""`./maap lab` from a shell in which nothing is sourced."""

import contextlib
import os
import pathlib
import re
import subprocess
import sys
import threading

from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from risc_lab.ros.launching import PortReservation, free_tcp_port

ROOT = pathlib.Path(__file__).resolve().parents[1]
PATIENCE_S = 60.0
OF_A_WORKSPACE = ("LD_LIBRARY_PATH", "PYTHONPATH", "CMAKE_PREFIX_PATH", "ROS_PACKAGE_PATH")


@contextlib.contextmanager
def node_of_this_workspace():
    """While such a node runs, nothing is built: the test uses the existing build, whatever is edited meanwhile."""
    command = [sys.executable, "-c", "import time; time.sleep(600.0)", "__name:=pretender"]
    with subprocess.Popen(command, env=dict(os.environ, CMAKE_PREFIX_PATH=str(ROOT / "devel"))) as process:
        try:
            yield
        finally:
            process.kill()


@contextlib.contextmanager
def lab_in_a_plain_shell(*options):
    """The process of `./maap lab`; it is ended afterwards, and has to end without an error."""
    plain = {name: value for name, value in os.environ.items() if name not in OF_A_WORKSPACE}
    process = subprocess.Popen(
        [str(ROOT / "maap"), "lab", *options], env=plain, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    watchdog = threading.Timer(PATIENCE_S, process.kill)
    watchdog.start()
    try:
        yield process
    finally:
        process.terminate()
        output = process.communicate()[0]
        watchdog.cancel()
    assert process.returncode == 0 and "Traceback" not in output, output


def test_a_ground_station_finds_the_iris_of_a_lab_in_which_nothing_is_sourced():
    fleet = str(ROOT / "launch/fleets/iris1.yaml")
    with contextlib.closing(PortReservation()) as reservation, node_of_this_workspace():
        options = (fleet, "--subnet", reservation.subnet, "--stream-port", str(free_tcp_port()))
        with lab_in_a_plain_shell(*options) as lab:
            said = ""
            for line in lab.stdout:
                said += line
                endpoint = re.search(r"udp://([\d.]+:\d+)\b", line)
                if endpoint:
                    break
            else:
                raise AssertionError(said)
            assert "nothing is built" in said
            station = mavutil.mavlink_connection("udpout:" + endpoint[1], source_system=255)
            with contextlib.closing(station):
                station.mav.heartbeat_send(
                    mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE
                )
                heartbeat = station.wait_heartbeat(timeout=PATIENCE_S)
    assert heartbeat is not None and heartbeat.autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
