"""A small process beside the driver: it keeps vehicles hovering when the driver dies or hangs, and then lands them.

Without commands the aircraft flies on with its last tilt for a second, and a driver that is started again
needs longer. It is brought to a stop and then down: one that hovers drifts by some centimetres a second, and its
neighbours may have lost their driver, too. What it may do is said in memory that both share; it has nothing of the
driver's that could fail with it. A driver that is started again takes its vehicles over from the keeper of the one that
died (`take_over`); programs of other users cannot.

    hovers  at once when the driver has died, after STALE_S when it hangs
    lands   HOVER_S later, if no driver has taken over

This file is both sides: the driver's (`Keeper`), and the process itself, which imports nothing but the standard library
and is not of the driver's session, so that no signal to the driver reaches it.
"""

import contextlib
import mmap
import os
import select
import socket
import struct
import subprocess
import sys
import time

STALE_S = 0.15  # the driver says what it does 40 times a second
HOVER_S = 1.0  # it has come to a stop then; a driver that hung for a moment goes on before
LAND_S = 4.0  # how long a landing is ordered
_LOOK_S = 0.05
_SEND_S = 0.025  # as the driver
_AT_PORT = 5556
_END_S = 2.0  # for the process to end
_MOST_READ = 16  # messages read at a time
# Constant numbers: 1 lets the aircraft count from there, so each datagram is accepted, and what the driver sends next.
_HOVER = b"AT*PCMD_MAG=1,0,0,0,0,0,0,0\r"
_FLY, _LAND = (_HOVER + b"AT*REF=2,%d\r" % bits for bits in (0x11540200, 0x11540000))
_SLOT = struct.Struct("=dd")  # of one vehicle: when the driver said it [s, monotonic], what
_NOBODY, _GROUND, _FLIES = 0.0, 1.0, 2.0
_CREDENTIALS = struct.Struct("=3i")  # process, user and group that sent a message, as the kernel adds them


def _door(address):
    """Where a keeper listens whose driver has died: an abstract socket, of this network namespace."""
    return "\0ardrone_keeper %s" % address


def take_over(address):
    """Only we command the vehicle from now on."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock, contextlib.suppress(OSError):  # there is no keeper
        sock.sendto(b"\0", socket.MSG_DONTWAIT, _door(address))


class Keeper:
    """The driver's side."""

    def __init__(self, addresses):
        """addresses: of the vehicles. Raises OSError."""
        size = _SLOT.size * len(addresses)
        memory = os.memfd_create("ardrone_keeper")
        try:
            os.ftruncate(memory, size)
            self._memory = mmap.mmap(memory, size)
            command = [sys.executable, "-I", "-S", __file__, str(memory), *addresses]
            # the pipe ends with the driver, whatever ends it
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, pass_fds=(memory,), start_new_session=True, cwd="/"
            )
        finally:
            os.close(memory)

    def note(self, k, now_s, connected, flies):
        """Of the k-th vehicle: it has answered; it is to stay in the air."""
        what = (_FLIES if flies else _GROUND) if connected else _NOBODY
        _SLOT.pack_into(self._memory, k * _SLOT.size, now_s, what)

    @property
    def runs(self):
        """Whether the process is there."""
        return self._process.poll() is None

    def close(self):
        """The driver ends, and has given its last orders."""
        with contextlib.suppress(OSError):  # it has ended already
            self._process.stdin.write(b"q")
            self._process.stdin.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class _Kept:
    """The process's side of one vehicle."""

    def __init__(self, address, memory, offset):
        self._address, self._memory, self._offset = address, memory, offset
        self._out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._since_s = None  # when the driver fell silent
        self._door = None
        self.over = False

    def step(self, now_s, driver_is_dead):
        """Send what is due. Returns whether it must be called soon."""
        said_s, what = _SLOT.unpack_from(self._memory, self._offset)
        silent = driver_is_dead or now_s - said_s > STALE_S
        self.over = self.over or driver_is_dead and self._is_taken_over()
        if self.over or what == _NOBODY or not silent:
            self._since_s, self.over = None, self.over or driver_is_dead
            return False
        if self._since_s is None:
            self._since_s = now_s
        held_s = now_s - self._since_s - (HOVER_S if what == _FLIES else 0.0)
        if held_s < LAND_S:
            with contextlib.suppress(OSError):  # its network is down
                self._out.sendto(_FLY if held_s < 0.0 else _LAND, (self._address, _AT_PORT))
        self.over = driver_is_dead and held_s >= LAND_S
        return True

    def _is_taken_over(self):
        """Whether a program of our user has said so."""
        if self._door is None:
            self._open_door()
        with contextlib.suppress(BlockingIOError):
            for _ in range(_MOST_READ if self._door is not None else 0):
                _, ((_, _, data),), _, _ = self._door.recvmsg(1, socket.CMSG_SPACE(_CREDENTIALS.size))
                if _CREDENTIALS.unpack(data)[1] == os.getuid():
                    return True
        return False

    def _open_door(self):
        door = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        door.setblocking(False)
        door.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
        try:
            door.bind(_door(self._address))
            self._door = door
        except OSError:  # the keeper of another dead driver has not ended yet
            door.close()


def main(memory, *addresses):
    """The process: until the driver says that it ends, or nothing is left to be done for one that has died."""
    with mmap.mmap(int(memory), _SLOT.size * len(addresses)) as shared:
        vehicles = [_Kept(address, shared, k * _SLOT.size) for k, address in enumerate(addresses)]
        pipe, driver_is_dead, soon = 0, False, False
        while not all(vehicle.over for vehicle in vehicles):
            if select.select([] if driver_is_dead else [pipe], (), (), _SEND_S if soon else _LOOK_S)[0]:
                if os.read(pipe, 1):
                    return
                driver_is_dead = True
            now_s = time.monotonic()
            steps = [vehicle.step(now_s, driver_is_dead) for vehicle in vehicles]
            soon = any(steps)


if __name__ == "__main__":
    main(*sys.argv[1:])
