"""The camera process of the virtual lab: renders, encodes and serves every vehicle's video.

It is a process of its own so that the lab keeps its 5 ms schedule: pictures give way to flight.  The lab starts it at
its own start or when the first client asks for video (see launcher.py) and hands it the listening sockets and the
blackboard, and tells it which faults act on the streams; it ends when the pipe for that does, so it never outlives the
lab.  While nobody watches it sleeps.
"""

import contextlib
import logging
import select
import socket
import sys
import time
from multiprocessing.connection import Connection

import cv2

from risc_lab.lab import load_vehicle_type
from risc_lab.priority import set_priority
from risc_simulator.faults import Wires
from risc_simulator.notices import Notices
from risc_simulator.vehicles import virtual_type
from risc_simulator.video.blackboard import BAD_FILES, COUNTS, Blackboard
from risc_simulator.video.camera_pose import vehicle_pose
from risc_simulator.video.scene import load_scene
from risc_simulator.video.server import Eye, Station, seed_of

_LOG = logging.getLogger(__name__)
_NICENESS = 5
_IDLE_S = 0.25  # longest wait while somebody watches
_POSE_S = 0.002  # wait for the lab's next pose
_WORK_S = 0.012  # in which a picture is drawn and coded


def begin_s(due_s, now_s, patience_s, sends_s):
    """When to begin a picture that is due: no earlier than a send that would come in the middle of the work.

    Cameras keep their rhythm, so one that sent late once would do it with every picture, and the client, who takes
    those that came soonest as on time, would stamp all of them late. patience_s: longest that the picture waits.
    """
    coming_s = min((send_s for send_s in sends_s if now_s < send_s < now_s + _WORK_S), default=now_s)
    return min(coming_s, due_s + patience_s)


class VideoHost:
    """All stations on one schedule."""

    def __init__(self, fleet, seed, board, listeners):
        """board: Blackboard. listeners: bound TCP sockets in fleet order, None of a vehicle without cameras.

        Raises ValueError for bad camera files.
        """
        self._board = board
        self._wires = Wires(seed)
        self._last_unwatched = 0  # number of the newest pose when nobody watched: the lab shows no others then
        scene = load_scene(fleet)
        self._names = [vehicle.namespace for vehicle in fleet.vehicles]
        self._stations = {}  # by the vehicle's place in the fleet
        for index, (vehicle, listener) in enumerate(zip(fleet.vehicles, listeners)):
            if listener is None:
                continue
            eyes = [
                Eye(camera, vehicle, scene, seed_of(seed, index, channel))
                for channel, camera in enumerate(virtual_type(vehicle.type).cameras)
            ]
            latency_s = load_vehicle_type(vehicle.type).video_latency_s
            stream = self._wires.stream("%s/video" % vehicle.namespace)
            station = Station(listener, eyes, latency_s, Notices(_LOG, vehicle.namespace), stream)
            station.pictures = int(board.pictures[index])  # of a camera process before this one
            station.skipped = int(board.skipped[index])
            self._stations[index] = station

    def serve(self, link):
        """Until the other end of link closes, a Connection by which (method of faults.Wires, argument) may come."""
        self._board.ready[...] = 1
        while True:
            wait_s = self._work()
            readers = {sock: station for station in self._stations.values() for sock in station.sockets()}
            writers = [
                sock
                for index, station in self._stations.items()
                if self._board.link_up[index]
                for sock in station.blocked()
            ]
            readable, _, _ = select.select([link, *readers], writers, (), wait_s)
            if link in readable:
                try:
                    method, argument = link.recv()
                except EOFError:
                    return
                with contextlib.suppress(ValueError):  # it means none of these streams
                    getattr(self._wires, method)(argument)
            for sock in readable:
                if sock is not link and sock.fileno() >= 0:
                    readers[sock].on_readable(sock)

    def close(self):
        """Close all sockets."""
        for station in self._stations.values():
            station.close()

    def _work(self):
        """Do what is due. Returns how long to wait at most; None: until a client comes."""
        self._send()
        board = self._board
        if not board.watchers.any():
            self._last_unwatched = int(board.newest)
        for index, station in self._stations.items():
            board.watchers[index] = station.watchers
        snapshot = board.snapshot() if int(board.newest) != self._last_unwatched else None
        now_s = time.monotonic()
        wake_s = now_s + (_IDLE_S if snapshot is not None else _POSE_S)
        for index, station in self._stations.items():
            is_on = snapshot is not None and bool(board.enabled[index])
            due_s = station.due_s(float(board.rate_hz[index]), now_s, is_on)
            if due_s is not None:
                if due_s <= now_s:
                    sends_s = [other.send_due_s() for other in self._stations.values()]
                    patience_s = 0.5 / float(board.rate_hz[index])
                    due_s = begin_s(due_s, time.monotonic(), patience_s, [at_s for at_s in sends_s if at_s is not None])
                if due_s <= time.monotonic():
                    self._expose(index, station, snapshot)
                    self._send()
                    due_s = station.next_s
                wake_s = min(wake_s, due_s)
            send_s = station.send_due_s()
            if send_s is not None:
                wake_s = min(wake_s, send_s)
            picture_bytes, number = station.newest_picture
            board.newest_picture[index] = number << 32 | picture_bytes  # in one: a reader never sees half
            board.pictures[index] = station.pictures
            board.skipped[index] = station.skipped
            board.late_s[index] = station.late_s
            board.faults[index] = [station.stream.counts[what] for what in COUNTS]
        if not board.watchers.any():
            return None
        return max(0.0, min(wake_s, self._wires.due_s + float(board.zero_s)) - time.monotonic())

    def _send(self):
        """Send what has arrived, of all cameras: none waits for what is drawn or counted for another."""
        zero_s = float(self._board.zero_s)
        self._wires.release(time.monotonic() - zero_s)
        for index, station in self._stations.items():
            now_s = time.monotonic()
            station.send(now_s, now_s - zero_s, bool(self._board.link_up[index]))

    def _expose(self, index, station, snapshot):
        board = self._board
        is_waved = snapshot.time_s < board.board_until_s[index]
        station.expose(
            snapshot,
            index,
            int(board.channel[index]),
            float(board.rate_hz[index]),
            float(board.bitrate_kbit_s[index]),
            vehicles=[
                vehicle_pose(row, name) for k, (row, name) in enumerate(zip(snapshot.rows, self._names)) if k != index
            ],
            light=float(board.light),
            waved_s=max(0.0, snapshot.time_s - float(board.board_since_s[index])) if is_waved else None,
        )


def main():
    """Started by launcher.py, argument: descriptor of a pipe, by which the job comes. Returns the exit code."""
    logging.basicConfig(format="virtual cameras: %(message)s", level=logging.INFO)
    link = Connection(int(sys.argv[1]))
    fleet, seed, board_fd, listener_fds = link.recv()
    set_priority(_NICENESS)
    cv2.setNumThreads(1)
    try:
        board = Blackboard(len(fleet.vehicles), board_fd)
        host = VideoHost(fleet, seed, board, [fd and socket.socket(fileno=fd) for fd in listener_fds])
    except ValueError as error:
        _LOG.error("%s", error)
        return BAD_FILES
    except OSError as error:
        _LOG.error("%s", error)
        return 1
    try:
        host.serve(link)
    finally:
        host.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
