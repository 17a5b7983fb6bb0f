#!/usr/bin/env python3
"""session_guard.py roslaunch -c NAME -u URI ...: the far end of a launch, which never outlives its ssh session.

coop.sh starts it. It runs the command and passes its exit code on. When its output is not read any more, the session
is over: every process of the launch gets SIGINT, and SIGKILL when that did not help. roslaunch alone would keep its
nodes running forever when it cannot reach the base station.

Before that it looks for processes of another launch on this host. A launch is identified by the XML-RPC server of its
parent, the roslaunch of the base station (`-u`; the `--run_id` is the master's and may be equal for two launches). If
that parent is gone, its processes are ended first; if it answers, we do not start: there must not be two drivers of
one vehicle. RISC_MAAP_ALLOW_SECOND=1 allows it, for launches that share no vehicle.
"""

import argparse
import contextlib
import fcntl
import os
import select
import signal
import socket
import subprocess
import sys
import time

try:
    import psutil

    from risc_doctor.ros_master import MasterError, SilentError, call, host_and_port
    from risc_lab.ros.launching import argument_of, send_signal
except ImportError as error:
    sys.exit(
        "coop.sh: the workspace on this machine is only half built (%s): run './maap build' on it, or './maap machines "
        "deploy' on the base station" % error
    )

MARK = "RISC_MAAP_SESSION"  # every process of a launch inherits it: "<parent's URI> <name of the child>"
ALLOW = "RISC_MAAP_ALLOW_SECOND"
PATIENCE_S = 8.0  # between SIGINT and SIGKILL: a vehicle's node sends its last command in this time
KILL_S = 4.0  # from SIGKILL until we say that it did not help
PARENT_S = 3.0  # for another parent to answer
POLL_S = 0.1


def marked_processes():
    """{session: {pid: node}} of the processes that launches have started on this host, if this login can see them.

    session: value of MARK.  node: its ROS name, "" for other processes.
    A host is a network namespace: what runs in a container with addresses of its own is on another one.
    """
    host, found = os.readlink("/proc/self/ns/net"), {}
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):  # it ended while we looked, or it belongs to another user
            environment = process.environ()
            if MARK in environment and os.readlink("/proc/%d/ns/net" % process.pid) == host:
                name = argument_of(process.cmdline(), "__name")
                node = "%s/%s" % (environment.get("ROS_NAMESPACE", ""), name) if name else ""
                found.setdefault(environment[MARK], {})[process.pid] = node
    return found


def nodes_text(processes):
    """Names of the nodes, for a person."""
    return ", ".join(sorted(set(filter(None, processes.values())))) or "a roslaunch"


def end(session):
    """End all processes of a session. Returns those that are still there after SIGKILL: {pid: node}."""
    start = time.monotonic()
    interrupted = set()
    while True:
        processes = marked_processes().get(session, {})
        elapsed_s = time.monotonic() - start
        if not processes or elapsed_s > PATIENCE_S + KILL_S:
            return processes
        for pid in processes:
            if elapsed_s > PATIENCE_S:
                send_signal(pid, signal.SIGKILL)
            elif pid not in interrupted:
                send_signal(pid, signal.SIGINT)
                interrupted.add(pid)
        time.sleep(POLL_S)


def is_alive(uri):
    """Whether a roslaunch serves the URI. One that listens but is too busy, or stopped, is alive."""
    try:
        socket.create_connection(host_and_port(uri), PARENT_S).close()
        call(uri, "get_pid", caller=(), patience_s=PARENT_S)
    except SilentError:
        return True
    except (OSError, ValueError, MasterError):
        return False  # it is gone, or another program has got its port
    return True


def make_way(uri, name):
    """End processes that were left on this host by launches that are gone. Returns why we must not start, or ""."""
    for session, processes in marked_processes().items():
        other_uri, _, other_name = session.partition(" ")
        if other_uri == uri and other_name != name:
            continue  # the same launch has two <machine> tags for this host
        if other_uri != uri and is_alive(other_uri):
            if os.environ.get(ALLOW) == "1":
                continue
            return (
                "this machine already runs %s of another launch, whose roslaunch is alive (%s): end that one first. "
                'Only if the two share no vehicle: env-loader="env %s=1 .../coop.sh"'
            ) % (nodes_text(processes), other_uri, ALLOW)
        say("ending %s, left behind by a launch that is gone (%s)" % (nodes_text(processes), other_uri))
        remaining = end(session)
        if remaining:
            pids = ", ".join(map(str, remaining))
            return "cannot end process %s (%s) of a launch that is gone: restart this machine" % (
                pids,
                nodes_text(remaining),
            )
    return ""


def say(text):
    """One line for the person who launches: roslaunch shows it on the base station."""
    print("coop.sh: " + text, file=sys.stderr, flush=True)


def run(command, session, started):
    """Run the command until it ends or its session is over. Calls started() once it runs. Returns its exit code."""
    wake_read, wake_write = os.pipe()
    os.set_blocking(wake_write, False)
    signal.set_wakeup_fd(wake_write)
    for number in (signal.SIGCHLD, signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: None)  # its number comes through the pipe
    child = subprocess.Popen(command, env=dict(os.environ, **{MARK: session}))
    started()
    watch = select.poll()
    watch.register(wake_read, select.POLLIN)
    watch.register(sys.stdout.fileno(), 0)  # reports only that the reader has gone
    reason = 0
    while child.poll() is None and not reason:
        for descriptor, _ in watch.poll():
            if descriptor == wake_read:
                reason = max([reason] + [number for number in os.read(wake_read, 64) if number != signal.SIGCHLD])
            else:
                reason = signal.SIGHUP
    end(session)  # in any case: a roslaunch that was killed leaves its nodes behind
    if reason:
        child.wait()
        return 128 + reason
    return child.returncode if child.returncode >= 0 else 128 - child.returncode


def main(command):
    """Returns the exit code."""
    parser = argparse.ArgumentParser(prog="coop.sh roslaunch", allow_abbrev=False)
    parser.add_argument("-c", dest="name", required=True)
    parser.add_argument("-u", dest="uri", required=True)
    options, _ = parser.parse_known_args(command[1:])
    # One at a time on this host, or two that start together would not see each other.
    with open("/proc/self/ns/net") as host:
        fcntl.flock(host, fcntl.LOCK_EX)
        problem = make_way(options.uri, options.name)
        if problem:
            say(problem)
            return 1
        return run(command, "%s %s" % (options.uri, options.name), lambda: fcntl.flock(host, fcntl.LOCK_UN))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
