"""A small aircraft on loopback for the tests: obeys at once, records commands, can fall silent and reboot.

It has no physics and no radio; the virtual lab has.
"""

import os
import select
import socket
import threading
import time

from ardrone_autonomy.protocol import AT_PORT, NAVDATA_PORT, at, navdata
from ardrone_autonomy.protocol.navdata import ControlState, State, Tag
from risc_lab.testing import wait_for
from risc_simulator.vehicles.ardrone.profiles import ConfigurationStore
from risc_simulator.vehicles.ardrone.wire import NavdataEncoder, SequenceGate, parse_datagram

PERIOD_S = 0.005
TAKE_OFF_S = 0.3
LANDING_S = 0.3


def free_address():
    """A loopback address whose ports are unused."""
    for attempt in range(200):
        number = os.getpid() * 7 + attempt
        address = "127.%d.%d.%d" % (100 + number // 62500 % 100, 1 + number // 250 % 250, 1 + number % 250)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind((address, AT_PORT))
            except OSError:
                continue
            return address
    raise OSError("no loopback address with a free UDP port %d" % AT_PORT)


def fly_until(thread, sticks, condition):
    """Fly with these sticks; as a pilot would, take off again when the computer stood still and the driver landed."""

    def fly():
        if not thread.link.keeps_flying:
            thread.post(thread.link.take_off)
        thread.post(thread.link.steer, sticks)
        return condition()

    wait_for(fly)


class ScriptedDrone:
    """A context manager. All attributes may be read from other threads; lists only grow."""

    def __init__(self, address=None):
        self.address = address or free_address()
        self.options = {}  # tag -> fields to add to the next packets
        self.silent = False  # True: neither hears nor speaks
        self.garbage = ()  # datagrams that are sent beside every packet of navdata
        self.reboots = 0
        self.packets = 0  # navdata packets sent
        self._stop = threading.Event()
        self._lock = threading.Lock()  # a reboot happens between two steps of the thread
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._sockets = []
        for port in (NAVDATA_PORT, AT_PORT):
            sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            sock.bind((self.address, port))
            sock.setblocking(False)
            self._sockets.append(sock)
        self._forget()

    def _forget(self):
        self.commands = []  # (time, AtCommand)
        self.writes = []  # (key, text, ids)
        self.wake_ups = 0
        self.phase = ControlState.LANDED
        self.emergency = False
        self.bootstrap = True
        self.watchdog = True
        self.configuration = ConfigurationStore()
        self._client = None
        self._ids = None
        self._ack = False
        self._gate = SequenceGate()
        self._sequence = 0
        self._phase_since_s = time.monotonic()
        self._select = self._start = False
        self._encoder = NavdataEncoder(navdata.ALL_TAGS, gps=False)

    def reboot(self):
        """Lose all state, as after a battery change."""
        with self._lock:
            self.reboots += 1
            self._forget()

    def named(self, *names):
        """The commands of these names received since the last reboot: list of (time, AtCommand)."""
        return [item for item in list(self.commands) if item[1].name in names]

    def sticks(self):
        """(flags, roll, pitch, gaz, yaw) of the newest PCMD_MAG, None before the first."""
        commands = self.named("PCMD_MAG")
        return commands[-1][1].arguments[:5] if commands else None

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()
        for sock in self._sockets:
            sock.close()

    def _run(self):
        next_s = time.monotonic()
        while not self._stop.is_set():
            readable, _, _ = select.select(self._sockets, (), (), max(0.0, next_s - time.monotonic()))
            with self._lock:
                next_s = self._step(readable, next_s)

    def _step(self, readable, next_s):
        """Read what has arrived and send what is due. Returns the time of the next packet [s]."""
        for sock in readable:
            data, sender = sock.recvfrom(4096)
            if self.silent:
                continue
            if sock is self._sockets[0]:
                self.wake_ups += 1
                self._client = sender
            else:
                for command in parse_datagram(data).commands:
                    self._obey(command)
        if time.monotonic() >= next_s:
            next_s += PERIOD_S
            self._advance()
            if self._client is not None and not self.silent:
                for datagram in (self.packet(), *self.garbage):
                    self._sockets[0].sendto(datagram, self._client)
                self.packets += 1
        return next_s

    def _obey(self, command):
        if not self._gate.accept(command.sequence):
            return
        self.commands.append((time.monotonic(), command))
        arguments = command.arguments
        if command.name == "REF":
            select_bit, start = bool(arguments[0] & at.Ref.SELECT), bool(arguments[0] & at.Ref.START)
            if select_bit and not self._select:
                self.emergency = not self.emergency
                self._enter(ControlState.LANDED)
            self._select, self._start = select_bit, start
        elif command.name == "CONFIG_IDS":
            self._ids = arguments
        elif command.name == "CONFIG":
            self.configuration.write(*arguments, ids=self._ids)
            self.writes.append((*arguments, self._ids))
            self._ack = True
            if arguments[0] == "general:navdata_demo":
                self.bootstrap = False
        elif command.name == "CTRL" and arguments[0] == at.CtrlMode.CLEAR_ACK:
            self._ack = False
        elif command.name == "COMWDG":
            self.watchdog = False

    def _enter(self, phase):
        if phase is not self.phase:
            self.phase = phase
            self._phase_since_s = time.monotonic()

    def _advance(self):
        """Update the flight phase from the bits of the last REF and PCMD."""
        if self.emergency:
            return
        since_s = time.monotonic() - self._phase_since_s
        in_the_air = self.phase in (ControlState.TAKING_OFF, ControlState.HOVERING, ControlState.FLYING)
        if self._start and self.phase is ControlState.LANDED:
            self._enter(ControlState.TAKING_OFF)
        elif not self._start and in_the_air:
            self._enter(ControlState.LANDING)
        elif self.phase is ControlState.LANDING and since_s > LANDING_S:
            self._enter(ControlState.LANDED)
        elif in_the_air and (self.phase is not ControlState.TAKING_OFF or since_s > TAKE_OFF_S):
            sticks = self.sticks()
            self._enter(ControlState.FLYING if sticks and sticks[0] else ControlState.HOVERING)

    def packet(self):
        """The next navdata packet."""
        self._sequence += 1
        state = State.ALTITUDE_CONTROL
        if self._ack:
            state |= State.COMMAND_ACK
        if self.emergency:
            state |= State.EMERGENCY
        if self.watchdog:
            state |= State.COM_WATCHDOG
        if self.phase is not ControlState.LANDED:
            state |= State.FLYING
        if self.bootstrap:
            return NavdataEncoder().finish(int(state | State.BOOTSTRAP), self._sequence)
        self._encoder.put(Tag.DEMO, ctrl_state=self.phase << 16, vbat_flying_percentage=87)
        for tag, fields in self.options.items():
            self._encoder.put(tag, **fields)
        return self._encoder.finish(int(state), self._sequence)
