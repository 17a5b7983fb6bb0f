"""Processor time of a recording: our recorder and `rosbag record` in turn, of the same messages.

One process publishes ten topics at 200 Hz; the processor time is that of the recorder's process, from its start to the
end of the bag.
"""

import argparse
import contextlib
import json
import os
import pathlib
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time

import rosbag

from risc_lab.ros.launching import free_tcp_port

ROOT = pathlib.Path(__file__).resolve().parents[2]
TALKER = ROOT / "src/data_extraction/test/talker.py"
TOPICS = ["/topic%d" % k for k in range(10)]
RATE_HZ = 200
MESSAGE_BYTES = 500  # about a Cortex of five objects
RECORDERS = {
    "rosbag record": ["/usr/lib/rosbag/record", "-O", "{bag}", *TOPICS],
    "recorder": [str(ROOT / "devel/lib/data_extraction/recorder"), "-O", "{bag}", "/topic.*"],
}


@contextlib.contextmanager
def program(command, environment, **options):
    """Run a program while the block runs."""
    process = subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL, **options)
    try:
        yield process
    finally:
        if process.returncode is None:
            process.kill()
            process.wait()


def record(command, seconds, folder):
    """Make one recording. Returns its processor time [s], and how many messages are in the bag."""
    bag = folder / "recording.bag"
    port = free_tcp_port()
    environment = dict(
        os.environ, ROS_MASTER_URI="http://127.0.0.1:%d" % port, ROS_IP="127.0.0.1", ROS_HOME=str(folder)
    )
    order = {"topics": dict.fromkeys(TOPICS, "std_msgs/String"), "count": RATE_HZ * seconds, "size": MESSAGE_BYTES,
             "hz": RATE_HZ}  # fmt: skip
    with contextlib.ExitStack() as programs:
        programs.enter_context(
            program(["rosmaster", "--core", "-p", str(port)], environment, stdout=subprocess.DEVNULL)
        )
        while socket.socket().connect_ex(("127.0.0.1", port)) != 0:
            time.sleep(0.1)
        talker = programs.enter_context(
            program(
                [sys.executable, str(TALKER)], environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
        )
        recorder = programs.enter_context(
            program([part.format(bag=bag) for part in command], environment, stdout=subprocess.DEVNULL)
        )
        print(json.dumps(order), file=talker.stdin, flush=True)
        if talker.stdout.readline() != "published\n":
            raise RuntimeError("the talker ended before it had published everything")
        time.sleep(1.0)  # messages on their way arrive
        recorder.send_signal(signal.SIGINT)
        _, status, usage = os.wait4(recorder.pid, 0)
        recorder.returncode = os.waitstatus_to_exitcode(status)
    with rosbag.Bag(str(bag)) as written:
        count = written.get_message_count()
    bag.unlink()
    return usage.ru_utime + usage.ru_stime, count


def main():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=int, default=20, metavar="S", help="of one recording")
    parser.add_argument("--repetitions", type=int, default=3, metavar="N", help="of each, in turn")
    parser.add_argument("--json", type=pathlib.Path, metavar="FILE")
    args = parser.parse_args()
    figures = {name: {"cpu_s": [], "messages": []} for name in RECORDERS}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(args.repetitions):
            for name, command in RECORDERS.items():
                cpu_s, messages = record(command, args.seconds, pathlib.Path(folder))
                figures[name]["cpu_s"].append(cpu_s)
                figures[name]["messages"].append(messages)
    print("%d topics at %d Hz, %d bytes a message, %d s" % (len(TOPICS), RATE_HZ, MESSAGE_BYTES, args.seconds))
    print("%-14s %-30s %10s   messages" % ("", "processor time [s]", "median"))
    for name, found in figures.items():
        each = " ".join("%.2f" % cpu_s for cpu_s in found["cpu_s"])
        print("%-14s %-30s %10.2f   %s" % (name, each, statistics.median(found["cpu_s"]), found["messages"]))
    if args.json:
        args.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
