"""How long the nodes of a flight take to start: from the command until the last registration with the master.

One node after the other, with nothing to listen to: estimator, controller, trajectory, vehicle node and driver, with a
generated fleet.
"""

import argparse
import contextlib
import json
import math
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time
import xmlrpc.client

from risc_lab.lab import generated_fleet
from risc_lab.ros.launching import free_tcp_port

COUNTS = (1, 3, 50)
REPETITIONS = 3
NODES = {  # name: (package, program, topics that it listens to before it is of use)
    "states_estimation": ("risc_estimation", "states_estimation.py", ("/mocap_data",)),
    "controller": ("risc_control", "generic_DF_controller.py", ("/cortex_raw", "/trajectory")),
    "trajectory": ("risc_control", "circles3_traj.py", ("/cortex_raw",)),
    "vehicles": ("risc_control", "risc_controller.py", ("/cortex_raw", "/controls")),
    "ardrone_driver": ("ardrone_autonomy", "ardrone_driver", ("/{last}/cmd_vel",)),
}
POLL_S = 0.01
MOST_S = 60.0
QUIET_S = 0.5  # after a registration, without another one: it was the last


@contextlib.contextmanager
def program(command, environment):
    """Run a program while the block runs."""
    process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()  # rospy may wait for itself forever when it is interrupted while it registers something
        process.wait()


def parameters(name, vehicles):
    """Private parameters of a node."""
    names = [vehicle.namespace for vehicle in vehicles]
    if name == "ardrone_driver":
        return {"vehicles": {vehicle.namespace: {"drone_ip": vehicle.address} for vehicle in vehicles}}
    return {} if name == "states_estimation" else {"vehicles": names if name == "vehicles" else " ".join(names)}


def start_s(name, repetition, vehicles, master, environment):
    """How long one start takes [s]."""
    package, executable, topics = NODES[name]
    node = "/%s%d" % (name, repetition)  # the master does not notice that the one before has ended
    master.setParam(node, node, parameters(name, vehicles))
    path = subprocess.run(
        ["catkin_find", "--first-only", "--libexec", package, executable], capture_output=True, text=True, check=True
    ).stdout.strip()
    topics = {topic.format(last=vehicles[-1].namespace) for topic in topics}
    begin_s, known, changed_s = time.monotonic(), None, math.inf
    with program([path, "__name:=" + node[1:]], environment) as process:
        while time.monotonic() < begin_s + MOST_S:
            _, _, registered = master.getSystemState(node)  # of topics published, topics subscribed to, services
            own = [{name for name, nodes in kind if node in nodes} for kind in registered]
            if own != known:
                known, changed_s = own, time.monotonic()
            if topics <= own[1] and time.monotonic() > changed_s + QUIET_S:
                return changed_s - begin_s
            if process.poll() is not None:
                raise RuntimeError("%s ended while it started (exit code %d)" % (name, process.returncode))
            time.sleep(POLL_S)
    raise RuntimeError("%s had not started after %g s" % (name, MOST_S))


def measure(count, repetitions):
    """{node: median of its start-up time [s]} for `count` vehicles."""
    fleet = generated_fleet(count)
    port = free_tcp_port()
    uri = "http://127.0.0.1:%d" % port
    with tempfile.TemporaryDirectory() as folder:
        environment = dict(os.environ, ROS_MASTER_URI=uri, ROS_IP="127.0.0.1", ROS_HOME=folder)
        with program(["rosmaster", "--core", "-p", str(port)], environment):
            master = xmlrpc.client.ServerProxy(uri)
            deadline_s = time.monotonic() + MOST_S
            while True:
                try:
                    master.setParam("/startup", "/fleet", fleet.to_dict())
                    break
                except OSError:
                    if time.monotonic() > deadline_s:
                        raise
                    time.sleep(POLL_S)
            return {
                name: statistics.median(
                    start_s(name, k, fleet.vehicles, master, environment) for k in range(repetitions)
                )
                for name in NODES
            }


def main():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", type=int, nargs="+", default=COUNTS, metavar="N")
    parser.add_argument("--repetitions", type=int, default=REPETITIONS, metavar="N", help="the median is told")
    parser.add_argument("--json", type=pathlib.Path, metavar="FILE")
    args = parser.parse_args()
    print("%-18s" % "start [s]" + "".join("%14s" % ("%d vehicles" % count) for count in args.vehicles))
    figures = {count: measure(count, args.repetitions) for count in args.vehicles}
    for name in NODES:
        print("%-18s" % name + "".join("%14.2f" % figures[count][name] for count in args.vehicles))
    if args.json:
        args.json.write_text(json.dumps({"simulated": True, "start_s": figures}, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
