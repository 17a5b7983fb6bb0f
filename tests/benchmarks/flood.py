"""A stranger floods the port of the mocap stream: how many frames stream_markers loses, and what the flood costs it.

The virtual lab streams at 200 Hz on a loopback network of its own; the stranger has another address there.
"""

import argparse
import contextlib
import json
import os
import pathlib
import socket
import subprocess
import sys
import tempfile
import time

import psutil

from risc_lab.lab import load_fleet
from risc_lab.ros.launching import PortReservation, free_tcp_port
from risc_lab.testing import wait_for

ROOT = pathlib.Path(__file__).resolve().parents[2]
FLEET = ROOT / "launch/fleets/ardrones3.yaml"
FLOODS = {"none": (0, 0), "small": (20_000, 16), "large": (20_000, 1400)}  # datagrams/s, bytes
BURST_S = 0.001

_FLOOD = (
    """
import socket, sys, time
source, port, rate, size = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
sock.bind((source, 0))
data, sent, begin_s = bytes(size), 0, time.monotonic()
while True:
    due = int((time.monotonic() - begin_s) * rate)
    while sent < due:
        sock.sendto(data, ("127.0.0.1", port))
        sent += 1
    time.sleep(%g)
"""
    % BURST_S
)


@contextlib.contextmanager
def program(*command, environment=None):
    """Run a program while the block runs."""
    process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield psutil.Process(process.pid)
    finally:
        process.terminate()
        process.wait()


def processor_s(process):
    times = process.cpu_times()
    return times.user + times.system


def measure(mocap, process, newest, flood, source, seconds):
    """Figures of one flood."""
    rate, size = flood
    with contextlib.ExitStack() as stack:
        if rate:
            command = [sys.executable, "-c", _FLOOD, source, str(mocap.stream_port), str(rate), str(size)]
            stack.enter_context(program(*command))
            time.sleep(1.0)
        before, cpu_s, begin_s = dict(newest), processor_s(process), time.monotonic()
        time.sleep(seconds)
        wait_for(lambda: newest["at"] > before["at"], "another report")
        took_s, cpu_s = time.monotonic() - begin_s, processor_s(process) - cpu_s
        after = dict(newest)
    grown = {key: after[key] - before[key] for key in ("frames", "lost", "foreign datagrams")}
    return {**grown, "cpu": cpu_s / took_s}


def main():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0, metavar="S", help="of each flood")
    parser.add_argument("--json", type=pathlib.Path, metavar="FILE")
    args = parser.parse_args()
    reservation, port = PortReservation(), free_tcp_port()
    os.environ.update(ROS_MASTER_URI="http://127.0.0.1:%d" % port, ROS_IP="127.0.0.1")
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        os.environ["ROS_HOME"] = folder
        fleet = pathlib.Path(folder) / "fleet.yaml"
        fleet.write_text(FLEET.read_text().replace("127.77.", reservation.subnet + "."))
        mocap = load_fleet(str(fleet)).mocap
        stack.enter_context(program("rosmaster", "--core", "-p", str(port)))
        wait_for(lambda: socket.socket().connect_ex(("127.0.0.1", port)) == 0, "the master")
        stack.enter_context(program(sys.executable, "-m", "risc_simulator.virtual_lab", str(fleet)))
        client = [str(ROOT / "devel/lib/cortex_ros/stream_markers"), "_host:=" + mocap.host]
        client += ["_local_address:=127.0.0.1", "_stream_port:=%d" % mocap.stream_port]
        process = stack.enter_context(program(*client))

        import rospy  # with the environment above

        from risc_lab.ros.publisher_updates import init_node
        from risc_maap_msgs.msg import MocapStatus

        init_node("flood", disable_signals=True)
        newest = {"at": 0}

        def note(status):
            newest.update({counter.name: counter.count for counter in status.counters}, frames=status.frames)
            newest["at"] += 1

        rospy.Subscriber("mocap_status", MocapStatus, note)
        wait_for(lambda: newest.get("frames", 0) > 200, "the stream")
        source = reservation.subnet + ".0.9"
        figures = {name: measure(mocap, process, newest, flood, source, args.seconds) for name, flood in FLOODS.items()}
        rospy.signal_shutdown("done")
    print("%-28s %10s %10s %12s %14s" % ("flood", "frames", "lost", "refused [Hz]", "processor"))
    for name, found in figures.items():
        rate, size = FLOODS[name]
        what = "%d/s of %d bytes" % (rate, size) if rate else "none"
        refused_hz = found["foreign datagrams"] / args.seconds
        print(
            "%-28s %10d %10d %12.0f %13.1f%%" % (what, found["frames"], found["lost"], refused_hz, 100 * found["cpu"])
        )
    if args.json:
        args.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
