"""What reaches the vehicles: every REF, PCMD and PCMD_MAG that comes in by a network card, as JSON lines.

    python wire_log.py VEHICLE=CARD...         [time [s], vehicle, "REF", [bits]], [..., "PCMD", [flags, sticks...]]

It reads the network cards themselves (root only), independently of the vehicle that listens there. It runs with
real-time priority and wakes all the time: when it could not, the whole computer stood still, {"still_s": [from, to]}.
"""

import json
import os
import selectors
import socket
import struct
import sys
import time

from ardrone_autonomy.protocol import AT_PORT
from risc_simulator.vehicles.ardrone.wire import parse_datagram

IPV4, UDP = 0x0800, 17
SO_TIMESTAMPNS = 35  # Linux: name of the option and of what comes with each packet; `socket` does not have it
TIMESPEC = struct.Struct("@ll")  # [s], [ns]
WAKE_S = 0.005
STILL_S = 0.03  # a longer time without waking is noted


def go_first():
    """Take precedence over everything else on this computer, whatever its niceness. Returns whether that is allowed."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        return False
    return True


def ask_for_times(sock):
    """Have the kernel note when a packet came in; this program may be busy then."""
    sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)


def receive(sock):
    """(packet, wall-clock time at which the kernel got it [s]) of a socket that was asked for times."""
    packet, notes, _, _ = sock.recvmsg(65536, socket.CMSG_SPACE(TIMESPEC.size))
    (note,) = [data for level, kind, data in notes if (level, kind) == (socket.SOL_SOCKET, SO_TIMESTAMPNS)]
    seconds, nanoseconds = TIMESPEC.unpack(note)
    return packet, seconds + 1e-9 * nanoseconds


def at_commands(packet):
    """AT commands in an IPv4 packet: list of AtCommand, [] when it is something else."""
    header = 4 * (packet[0] & 15)
    if packet[9] != UDP or int.from_bytes(packet[header + 2 : header + 4], "big") != AT_PORT:
        return []
    return parse_datagram(packet[header + 8 :])[0]


def main(arguments):
    """Log until the process is ended."""
    cards = selectors.DefaultSelector()
    for argument in arguments:
        vehicle, _, card = argument.partition("=")
        raw = socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM, socket.htons(IPV4))
        ask_for_times(raw)
        raw.bind((card, IPV4))
        cards.register(raw, selectors.EVENT_READ, vehicle)
    wake_s = WAKE_S if go_first() else None  # else it may be our own nodes that do not let us wake
    print("ready", flush=True)
    awake_s = time.time()
    while True:
        ready = cards.select(wake_s)
        before_s, awake_s = awake_s, time.time()
        if wake_s and awake_s - before_s > STILL_S:
            print(json.dumps({"still_s": [before_s, awake_s]}), flush=True)
        for key, _ in ready:
            try:
                packet, time_s = receive(key.fileobj)
            except OSError:
                continue  # the card has gone down; it may come back
            for command in at_commands(packet):
                if command.name in ("REF", "PCMD", "PCMD_MAG"):
                    print(json.dumps([time_s, key.data, command.name, list(command.arguments)]), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
