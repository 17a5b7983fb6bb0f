"""A small process beside the driver: it keeps vehicles hovering when the driver dies or hangs, and then lands them.

Without commands the aircraft flies on with its last tilt for a second, and restarting the driver takes longer. The
keeper stops the aircraft and then lands it: a hovering aircraft drifts by some centimetres a second, and its neighbours
may have lost their driver, too. The driver tells the keeper by shared memory what each vehicle does; apart from that
they share nothing that could fail together. A restarted driver takes its vehicles over from the keeper of the driver
that died (`take_over`); programs of other users cannot.

    hovers  at once when the driver has died, after STALE_S when it hangs
    lands   HOVER_S later, if no driver has taken over

This file has both sides: the driver's (`Keeper`), and the process itself, which imports only the standard library and
runs in its own session, so that no signal to the driver reaches it.
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

STALE_S = 0.15  # the driver reports 40 times a second
HOVER_S = 1.0  # the aircraft has stopped by then; a driver that hung for a moment resumes earlier
LAND_S = 4.0  # how long the landing command is sent
_LOOK_S = 0.05
_SEND_S = 0.025  # as in the driver
_AT_PORT = 5556
_END_S = 2.0  # time for the process to end
_MOST_READ = 16  # messages read at a time
# Constant sequence numbers: 1 resets the aircraft's count, so it accepts each datagram, and the driver's next ones.
_HOVER = b"AT*PCMD_MAG=1,0,0,0,0,0,0,0\r"
_FLY, _LAND = (_HOVER + b"AT*REF=2,%d\r" % bits for bits in (0x11540200, 0x11540000))
_SLOT = struct.Struct("=dd")  # per vehicle: time of the driver's report [s, monotonic], state (next line)
_NOBODY, _GROUND, _FLIES = 0.0, 1.0, 2.0
_CREDENTIALS = struct.Struct("=3i")  # process, user and group of the sender of a message, added by the kernel


def _door(address):
    """Address at which a keeper listens after its driver has died: an abstract socket in this network namespace."""
    return "\0ardrone_keeper %s" % address


def take_over(address):
    """Tell the keeper of a dead driver that this process commands the vehicle from now on."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock, contextlib.suppress(OSError):  # there is no keeper
        sock.sendto(b"\0", socket.MSG_DONTWAIT, _door(address))


class Keeper:
    """The driver's side."""

    def __init__(self, addresses):
        """Start the process. addresses: of the vehicles. Raises OSError."""
        size = _SLOT.size * len(addresses)
        memory = os.memfd_create("ardrone_keeper")
        try:
            os.ftruncate(memory, size)
            self._memory = mmap.mmap(memory, size)
            command = [sys.executable, "-I", "-S", __file__, str(memory), *addresses]
            # the pipe closes when the driver ends, for whatever reason
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, pass_fds=(memory,), start_new_session=True, cwd="/"
            )
        finally:
            os.close(memory)

    def note(self, k, now_s, connected, flies):
        """Report the k-th vehicle. connected: it has answered; flies: it is to stay in the air."""
        what = (_FLIES if flies else _GROUND) if connected else _NOBODY
        _SLOT.pack_into(self._memory, k * _SLOT.size, now_s, what)

    @property
    def runs(self):
        """Whether the process is running."""
        return self._process.poll() is None

    def close(self):
        """End the process: the driver has given its last orders."""
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
        """Send what is due. Returns True while it must be called every _SEND_S."""
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
        """Whether a program of our user has taken over."""
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
    """Run the process until the driver ends it, or until everything is done for a driver that has died."""
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
