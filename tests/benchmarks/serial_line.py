"""The serial line of an IRIS+: recovery time after damage, and time from a ROS message to the board and the radio.

First the node's link and the board's firmware in simulated time, at 57600 baud, with seeded damage. Then serial_node
itself in real time, with a master of its own, on a pseudo-terminal whose other end is the firmware's build for this
computer, or its machine code in an emulator.
"""

import argparse
import bisect
import contextlib
import io
import json
import os
import pathlib
import random
import select
import socket
import subprocess
import sys
import tempfile
import threading
import time
import tty

import genpy
import numpy as np
import rospy

from risc_lab.ros.publisher_updates import init_node
from risc_lab.testing import wait_for
from risc_maap_msgs.msg import PpmStatus
from risc_msgs.msg import Control, Controls
from risc_simulator.vehicles.iris.transmitter import TICKS_PER_US, Board, PpmReceiver
from rosserial_python import protocol
from rosserial_python.link import Link, State
from rosserial_python.protocol import Decoder, Id

BAUD = 57600
BYTE_S = 10 / BAUD
COMMAND_S = 1 / 45  # between two commands, as an IRIS+ is sent them
STEP_S = 0.001
APART_S = 0.5  # between two damages, at least; up to twice that
STEP_US, STEP_FRACTION = 5, 0.01
STEPS = 20  # of a channel: from any to any other within one frame (slew limit: 100 us), without confirmation
COMMANDS = STEPS**3  # that differ in roll, pitch and yaw: a frame tells which command it shows
# of damage; after 0.3 s the link is lost, after 0.5 s the failsafe acts, after 2.5 s the board may have another sketch
SHORT_S, LONG_S, LONGEST_S = (0.002, 0.06), (0.1, 2.0), (3.0, 6.0)
UNPLUGGED_S = (0.05, 2.0)
WARM_UP = 20  # messages that do not count
REQUIRED_BACK_S, REQUIRED_NOTICED_S = 0.1, 0.3  # limits: of the 99th percentile; of the worst


def controls(number, stamp_s=0.0):
    """Controls of one vehicle; its sticks are never where the failsafe has them."""
    digits = number % STEPS, number // STEPS % STEPS, number // STEPS**2 % STEPS
    roll, pitch, yaw = (STEP_FRACTION * (1 + digit) for digit in digits)
    message = Controls(Obj=[Control("IRIS", roll, pitch, yaw, -1.0)])
    message.header.frame_id = "cortex"
    message.header.stamp = genpy.Time.from_sec(stamp_s)
    return message


def number_of(sticks, count):
    """Number of the newest of `count` commands that has these sticks; None: no command has, as in failsafe.

    sticks: (roll, pitch, yaw), steps from their centres.
    """
    if not all(stick in range(1, STEPS + 1) for stick in sticks):
        return None
    newest = count - 1
    return newest - (newest - sum((stick - 1) * STEPS**k for k, stick in enumerate(sticks))) % COMMANDS


def number_shown(channels_us, count):
    """`number_of` a frame of the signal."""
    roll_us, pitch_us, _, yaw_us = channels_us
    return number_of([(us - 1500) / STEP_US for us in (roll_us, pitch_us, yaw_us)], count)


def serialised(message):
    data = io.BytesIO()
    message.serialize(data)
    return data.getvalue()


class Chain:
    """Link, line and board in simulated time [s]. A command every `COMMAND_S`."""

    byte_s = BYTE_S

    def __init__(self):
        self.link, self.board, self.receiver = Link(), Board(), PpmReceiver()
        self.now_s = 0.0
        self.to_board = self.to_host = lambda data: data  # how the line changes bytes
        self.heard_s = []  # when intact packets came
        self.frames = []  # (begin, number of the command that it shows), without those that show none
        self.posted_s = []  # when commands were given, by their numbers
        self.plugged_in = True
        self._written, self._topic, self._next_s, self._due_s = b"", None, 0.0, 0.0
        self.link.opened(self, 0.0)

    # --- the line, as the link sees it
    def write(self, data):
        self._written += data
        return len(data)

    def queued(self):
        return 0

    def discard(self):
        """The board's library has what was written."""

    # --- time
    def run(self, until_s):
        while self.now_s < until_s:
            self.now_s += STEP_S
            if self.now_s >= self._next_s and self._topic is not None:
                command = serialised(controls(len(self.posted_s)))
                self.posted_s.append(self.now_s)
                self.link.post(self._topic, command, self.now_s, self.now_s + 0.25)
                self._next_s = self.now_s + COMMAND_S
                self._due_s = self.now_s
            self.board.advance(self.now_s)
            data = self.to_host(self.board.sent())
            if self.plugged_in and (data or self.now_s >= self._due_s):
                self._look(data)
            written, self._written = self.to_board(self._written), b""
            if written:
                self.board.receive(written)
            frames = self.receiver.feed(self.board.edges(), int(1e6 * self.now_s) * TICKS_PER_US)
            for begin_ticks, channels in frames:
                if (number := number_shown(channels, len(self.posted_s))) is not None:
                    self.frames.append((1e-6 * begin_ticks / TICKS_PER_US, number))

    def unplug(self):
        """Remove the port; the board runs on."""
        self.link.closed(self.now_s, is_gone=True)
        self.plugged_in = False

    def plug_in(self, resets):
        """Open the port again. resets: opening it resets the board."""
        if resets:
            self.board.reset()
        self.plugged_in, self._due_s = True, self.now_s
        self.link.opened(self, self.now_s)

    def _look(self, data):
        for topic_id, payload in self.link.received(data, self.now_s):
            self.heard_s.append(self.now_s)
            if topic_id in (Id.PUBLISHER, Id.SUBSCRIBER):
                with contextlib.suppress(protocol.PayloadError):
                    topic = protocol.topic_of(payload)
                    self.link.confirm(topic, self.now_s)
                    self._topic = topic.topic_id if topic_id == Id.SUBSCRIBER else self._topic
            elif topic_id == Id.TIME:
                self.link.reply(Id.TIME, protocol.time_payload(int(self.now_s), 0), self.now_s)
        self.link.tick(self.now_s)
        self._due_s = self.link.due_s(self.now_s)

    def back_s(self, since_s):
        """(until an intact packet comes, until the signal shows a command that was given later) [s]; inf: not yet."""
        heard_s = next((at_s for at_s in self.heard_s if at_s > since_s), np.inf)
        first = bisect.bisect_left(self.posted_s, since_s)
        return heard_s - since_s, *delays_s([(since_s, first)], self.frames)

    def forget(self):
        """Forget what was heard and seen until now."""
        del self.heard_s[:], self.frames[:]

    def close(self):
        self.board.close()


def noise(rng):
    """Damage bytes, and insert others."""

    def damage(data):
        spoilt = bytes(byte ^ rng.randrange(256) if rng.random() < 0.3 else byte for byte in data)
        return spoilt + rng.randbytes(rng.randrange(4)) if rng.random() < 0.5 else spoilt

    return damage


def loss(rng):
    """Lose bytes."""
    return lambda data: bytes(byte for byte in data if rng.random() < 0.3)


def cut(_rng):
    """Lose all bytes."""
    return lambda data: b""


DAMAGES = {  # what: (kind, to the host, to the board)
    "%s %s" % (kind.__name__, way): (kind, *ends)
    for kind in (noise, loss, cut)
    for way, ends in (("to the host", (True, False)), ("to the board", (False, True)), ("both ways", (True, True)))
}
REOPENED = {"board runs on": False, "board is reset": True}  # by opening
SEEN = {"host": "host hears", "signal": "signal follows"}


def percentiles(values_s):
    """Dict of percentiles and maximum, in milliseconds."""
    p50, p90, p99 = np.percentile(values_s, (50, 90, 99), method="higher")
    return {"p50_ms": 1e3 * p50, "p90_ms": 1e3 * p90, "p99_ms": 1e3 * p99, "max_ms": 1e3 * max(values_s)}


def after_damage(what, trials, lasts_s, seed=1):
    """{"host", "signal": percentiles}: until an intact packet comes (of damage to the host), until the signal follows.

    lasts_s: bounds of how long each damage lasts. It begins at a random time.
    """
    kind, to_host, to_board = DAMAGES[what]
    rng, chain, back_s = random.Random(seed), Chain(), []
    chain.run(3.0)
    for _ in range(trials):
        chain.run(chain.now_s + APART_S * (1.0 + rng.random()))
        chain.to_host = kind(rng) if to_host else chain.to_host
        chain.to_board = kind(rng) if to_board else chain.to_board
        chain.run(chain.now_s + rng.uniform(*lasts_s))
        chain.to_host = chain.to_board = lambda data: data
        back_s.append(_back_s(chain))
    chain.close()
    hosts_s, signals_s = zip(*back_s)
    rows = {"host": hosts_s, "signal": signals_s} if to_host else {"signal": signals_s}
    return {of: percentiles(times_s) for of, times_s in rows.items()}


def after_unplugging(resets, trials, seed=1):
    """{"host", "signal": percentiles}: from opening the port again. resets: whether that resets the board."""
    rng, chain, back_s = random.Random(seed), Chain(), []
    chain.run(3.0)
    for _ in range(trials):
        chain.run(chain.now_s + APART_S * (1.0 + rng.random()))
        chain.unplug()
        chain.run(chain.now_s + rng.uniform(*UNPLUGGED_S))
        chain.plug_in(resets)
        back_s.append(_back_s(chain))
    chain.close()
    return {of: percentiles(times_s) for of, times_s in zip(("host", "signal"), zip(*back_s))}


def _back_s(chain):
    """`Chain.back_s` from now on."""
    chain.forget()
    since_s = chain.now_s
    chain.run(since_s + APART_S)
    return chain.back_s(since_s)


def dead_line(trials, seed=1):
    """Percentiles of how soon a dead line is noticed, after its last byte."""
    rng, noticed_s = random.Random(seed), []
    for _ in range(trials):
        chain = Chain()
        chain.run(1.5 + rng.random())
        chain.to_host = lambda data: b""
        cut_s = chain.now_s
        while chain.link.facts.state is State.UP:
            chain.run(chain.now_s + STEP_S)
        noticed_s.append(chain.now_s - cut_s)
        chain.close()
    return percentiles(noticed_s)


def reset_board(trials, seed=1):
    """Percentiles of how soon the signal follows commands again after the reset button."""
    rng, back_s, chain = random.Random(seed), [], Chain()
    chain.run(3.0)
    for _ in range(trials):
        chain.run(chain.now_s + APART_S * (1.0 + rng.random()))
        chain.board.reset()
        back_s.append(_back_s(chain)[1])
    chain.close()
    return percentiles(back_s)


class BoardOnTerminal:
    """The firmware in real time on a pseudo-terminal, in a thread. A board that is late answers late."""

    def __init__(self, board):
        ours, theirs = os.openpty()
        tty.setraw(theirs)
        os.set_blocking(ours, False)
        self.path, self._ends = os.ttyname(theirs), (ours, theirs)
        self.board, self._receiver, self._decoder = board, PpmReceiver(), Decoder()
        self.arrived, self.frames = [], []  # (when, number) of commands that had come, and of frames of the signal
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        begin_s, (line, _) = time.monotonic(), self._ends
        while not self._over.is_set():
            if select.select([line], [], [], STEP_S)[0]:
                data = os.read(line, 4096)
                now_s = time.monotonic()
                for topic_id, payload in self._decoder.feed(data, now_s):
                    if topic_id >= protocol.FIRST_TOPIC:
                        sent = Controls().deserialize(payload).Obj[0]
                        steps = [round(stick / STEP_FRACTION) for stick in (sent.phi, sent.theta, sent.psi)]
                        self.arrived.append((now_s, number_of(steps, COMMANDS)))
                self.board.advance(now_s - begin_s)  # no byte comes before it was sent
                self.board.receive(data)
            board_s = time.monotonic() - begin_s
            self.board.advance(board_s)
            if sent := self.board.sent():
                os.write(line, sent)
            for begin_ticks, channels in self._receiver.feed(self.board.edges(), int(1e6 * board_s) * TICKS_PER_US):
                if (number := number_shown(channels, COMMANDS)) is not None:
                    self.frames.append((begin_s + 1e-6 * begin_ticks / TICKS_PER_US, number))

    def close(self):
        self._over.set()
        self._thread.join()
        self.board.close()
        for end in self._ends:
            os.close(end)


def machine_code():
    """A board that runs the firmware as machine code of the Due; takes half of a core."""
    sys.path.append(str(pathlib.Path(__file__).resolve().parents[1]))
    import due

    with tempfile.TemporaryDirectory() as folder:
        return due.MachineCode(due.build(due.FIRMWARE / "dueppm", folder))


@contextlib.contextmanager
def graph(*nodes):
    """Run a master of our own with some nodes; this program is a node, too."""
    with contextlib.ExitStack() as stack, socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        os.environ.update(ROS_MASTER_URI="http://127.0.0.1:%d" % port, ROS_IP="127.0.0.1", ROS_HOME=folder)
        os.environ.pop("ROS_HOSTNAME", None)
        free.close()
        for command in (["rosmaster", "--core", "-p", str(port)], *nodes):
            process = stack.enter_context(subprocess.Popen(command, stdout=subprocess.DEVNULL))
            stack.callback(process.terminate)
        init_node("serial_line_bench", disable_signals=True)
        yield
        rospy.signal_shutdown("done")


def through_the_node(messages, board):
    """{"board", "signal": percentiles}: from publishing a command until it has come to the board, and until a frame of
    the signal that shows it has begun. In real time: the computer's load counts.
    """
    board, status = BoardOnTerminal(board), []
    node = ["rosrun", "rosserial_python", "serial_node.py", board.path]
    with graph(node), contextlib.closing(board):
        rospy.Subscriber("ppm_status", PpmStatus, status.append, tcp_nodelay=True)
        publisher = rospy.Publisher("controls", Controls, queue_size=1, tcp_nodelay=True)
        wait_for(publisher.get_num_connections, "the node to subscribe to the board's topic")
        wait_for(lambda: status, "ppm_status of the board")
        sent, end = [], WARM_UP + messages  # (when, number)
        while not (board.frames and board.frames[-1][1] >= end):
            if len(sent) == COMMANDS:
                raise RuntimeError("the signal has not shown command %d" % end)
            message = controls(len(sent), rospy.get_time())
            sent.append((time.monotonic(), len(sent)))
            publisher.publish(message)
            time.sleep(COMMAND_S)  # the pace of commands
    wanted, seen = sent[WARM_UP:end], {"board": board.arrived, "signal": board.frames}
    return {what: percentiles(delays_s(wanted, events)) for what, events in seen.items()}


def delays_s(sent, seen):
    """Time [s] from each command until it, or a later one, was seen; inf: never. Both: (when, number), in order."""
    return [
        next((at_s for at_s, shown in seen if at_s > sent_s and shown >= number), np.inf) - sent_s
        for sent_s, number in sent
    ]


def line_of(name, row):
    return "%-49s %6.1f %6.1f %6.1f %6.1f" % (name, row["p50_ms"], row["p90_ms"], row["p99_ms"], row["max_ms"])


def main(arguments=None):
    """Command line. Returns 1 when the line takes longer to recover, or its loss to be noticed, than is required; the
    node's times are only printed.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=300, help="damages of each kind (default: %(default)s)")
    parser.add_argument("--messages", type=int, default=500, help="through the node (default: %(default)s)")
    parser.add_argument("--machine-code", action="store_true", help="the node's board is the Due's machine code")
    parser.add_argument("--json", type=pathlib.Path)
    args = parser.parse_args(arguments)
    figures = {
        "damage": {what: after_damage(what, args.trials, SHORT_S) for what in DAMAGES},
        "long damage": {what: after_damage(what, args.trials, LONG_S) for what in DAMAGES},
        "longest damage": {what: after_damage(what, args.trials, LONGEST_S) for what in DAMAGES},
        "port reopened": {what: after_unplugging(resets, args.trials) for what, resets in REOPENED.items()},
        "reset button": {"": {"signal": reset_board(args.trials)}},
    }
    back = [(group, what, of, row[of]) for group, rows in figures.items() for what, row in rows.items() for of in row]
    figures["dead_line"] = dead_line(max(10, args.trials // 5))
    print("simulated time, 57600 baud [ms]                       p50    p90    p99    max")
    for group, what, of, row in back:
        print(line_of("%s %s: %s" % (group, what, SEEN[of]), row))
    print(line_of("dead line: noticed", figures["dead_line"]))
    if args.messages:
        figures["node"] = through_the_node(args.messages, machine_code() if args.machine_code else Board())
        print("real time, pseudo-terminal, board %s [ms]" % ("emulated" if args.machine_code else "simulated"))
        print(line_of("published: came to the board", figures["node"]["board"]))
        print(line_of("published: frame begins", figures["node"]["signal"]))
    if args.json:
        args.json.write_text(json.dumps(figures, indent=2), encoding="utf-8")
    too_late = any(row["p99_ms"] > 1e3 * REQUIRED_BACK_S for *_, row in back)
    return int(too_late or figures["dead_line"]["max_ms"] > 1e3 * REQUIRED_NOTICED_S + 1.0)


if __name__ == "__main__":
    sys.exit(main())
