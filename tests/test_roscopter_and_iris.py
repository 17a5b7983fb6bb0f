"""driver.py and the IRIS+ of the virtual lab, as a user runs them: three programs, and the tools of ROS."""

import contextlib
import os
import random
import re
import socket
import subprocess
import sys

import pytest
import yaml

from risc_lab.ros.launching import free_tcp_port
from risc_lab.testing import wait_for

PATIENCE_S = 60.0  # far more than anything here takes
NAMESPACE = "/iris1/apm"
ARM, ALT_HOLD, AUTO, STABILIZE = 3, 8, 9, 7
LOWEST_THROTTLE = "[1500, 1500, 1000, 1500, 1500, 1500, 1500, 1500]"
FLEET = """
name: one
mocap: {host: %s, command_port: 26000, stream_group: 225.1.1.77, stream_port: 26001, interface: 127.0.0.1}
vehicles:
  - {namespace: iris1, template: IRIS, type: iris, address: %s, start: {position_m: [0, 0, 0], yaw_deg: 0}}
"""


class Computer:
    """A master, the virtual lab and a driver; all of them end with the test."""

    def __init__(self, folder, programs):
        self._folder, self._programs = folder, programs
        self._address = "127.%d.%d.%d" % tuple(random.SystemRandom().randrange(1, 250) for _ in range(3))
        (folder / "fleet.yaml").write_text(FLEET % (self._address, self._address))
        port = free_tcp_port()
        self._environment = dict(
            os.environ, ROS_MASTER_URI="http://127.0.0.1:%d" % port, ROS_IP="127.0.0.1", ROS_HOME=str(folder)
        )
        self._environment.pop("ROS_HOSTNAME", None)
        self.start("master", "rosmaster", "--core", "-p", str(port))
        wait_for(lambda: socket.socket().connect_ex(("127.0.0.1", port)) == 0, "a master")

    def start(self, name, *command, **variables):
        """A program whose output goes to the file of its name."""
        output = self._programs.enter_context((self._folder / name).open("w"))
        environment = dict(self._environment, PYTHONUNBUFFERED="1", **variables)
        process = self._programs.enter_context(
            subprocess.Popen(command, env=environment, stdout=output, stderr=subprocess.STDOUT)
        )
        self._programs.callback(process.kill)
        return process

    def said(self, name):
        return (self._folder / name).read_text()

    def start_lab(self):
        return self.start("lab", sys.executable, "-m", "risc_simulator.virtual_lab", str(self._folder / "fleet.yaml"))

    def start_driver(self, *options):
        device = "--device=udpout:%s:14550" % self._address
        return self.start("driver", "rosrun", "roscopter", "driver.py", device, *options, ROS_NAMESPACE=NAMESPACE)

    def run(self, *command):
        done = subprocess.run(command, env=self._environment, capture_output=True, text=True, timeout=PATIENCE_S)
        assert done.returncode == 0, "%s\n%s\n%s" % (done.stderr, self.said("driver"), self.said("lab"))
        return done.stdout

    def newest(self, topic):
        """One message of a topic, as a dict."""
        return yaml.safe_load(self.run("rostopic", "echo", "-n", "1", NAMESPACE + "/" + topic).partition("---")[0])

    def command(self, number):
        return "True" in self.run("rosservice", "call", NAMESPACE + "/command", str(number))


@pytest.fixture
def computer(tmp_path):
    with contextlib.ExitStack() as programs:
        yield Computer(tmp_path, programs)


@pytest.mark.release  # many programs are started; that the driver serves a flight, `./maap fly iris` proves
def test_battery_commands_sticks_emergency_stop_and_the_way_back(computer):
    lab = computer.start_lab()
    computer.start_driver("--enable-rc-control=true")
    assert 90 <= computer.newest("status")["battery_remaining"] <= 100
    assert computer.newest("state") == {"armed": False, "guided": False, "mode": "STABILIZE"}
    assert computer.newest("attitude")["roll"] == pytest.approx(0.0, abs=0.1)

    assert not computer.command(ARM)  # no transmitter
    assert re.search(r"arm failed: .*PreArm: Radio failsafe", computer.said("driver"))
    assert computer.command(ALT_HOLD)
    wait_for(lambda: computer.newest("state")["mode"] == "ALT_HOLD", "the mode in a heartbeat")
    assert not computer.command(AUTO)
    assert "requires position" in computer.said("driver")
    assert computer.command(STABILIZE)

    sticks = computer.start(
        "sticks", "rostopic", "pub", "-r", "20", NAMESPACE + "/send_rc", "roscopter/RC", "channel: " + LOWEST_THROTTLE
    )
    wait_for(lambda: computer.newest("rc")["channel"] == yaml.safe_load(LOWEST_THROTTLE), "the sticks")
    assert computer.command(ARM)
    wait_for(lambda: computer.newest("state")["armed"], "an armed heartbeat")
    computer.run("rostopic", "pub", "-1", NAMESPACE + "/emergency_stop", "std_msgs/Empty")
    wait_for(lambda: not computer.newest("state")["armed"], "the motors to stop")
    sticks.kill()
    wait_for(lambda: computer.newest("rc")["channel"] != yaml.safe_load(LOWEST_THROTTLE), "the release")

    lab.kill()
    lab.wait()
    wait_for(lambda: "no word from the autopilot" in computer.said("driver"), "the loss")
    computer.start_lab()
    assert computer.newest("status")["battery_remaining"] >= 90
