"""The lab's side of the camera process: starts it, ahead or when the first client wants video; keeps the blackboard."""

import contextlib
import logging
import math
import multiprocessing
import subprocess
import sys
import time

from risc_simulator.vehicles import virtual_type
from risc_simulator.video.blackboard import BAD_FILES, BITRATES_KBIT_S, COUNTS, RATES_HZ, Blackboard

_LOG = logging.getLogger(__name__)
_MODULE = "risc_simulator.video.host"
STOP_PATIENCE_S = 3.0
START_REST_S = 5.0  # a camera process that has ended is started again after this time, not sooner


class VideoLauncher:
    """Video for all vehicles of one lab. Used from the lab's thread."""

    def __init__(self, fleet, seed, listeners):
        """listeners: TCP listeners of the vehicles, None without cameras, in fleet order; they stay the caller's."""
        self.fleet, self._seed, self._listeners = fleet, seed, listeners
        self._index = {vehicle.namespace: index for index, vehicle in enumerate(fleet.vehicles)}
        self.board = Blackboard(len(listeners))
        self._process = self._link = None
        self._orders = []  # to the wires of the video streams, so far
        self._rest_until_s = -math.inf
        self._said_ready = False

    @property
    def ready(self):
        """Whether the camera process is up: a client is served at once."""
        return self.running and bool(self.board.ready)

    @property
    def running(self):
        """Whether the camera process serves the listeners."""
        return self._process is not None

    @property
    def may_start(self):
        """Whether `start` would start the camera process: it does not run, and has not just ended."""
        return not self.running and any(self._listeners) and time.monotonic() >= self._rest_until_s

    def start(self):
        """Start the camera process if it may. A computer that cannot start it now is asked again later."""
        if not self.may_start:
            return
        self.board.ready[...] = 0
        descriptors = [listener and listener.fileno() for listener in self._listeners]
        self._link, theirs = multiprocessing.Pipe()
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-m", _MODULE, str(theirs.fileno())],
                pass_fds=[theirs.fileno(), self.board.fd, *(fd for fd in descriptors if fd is not None)],
                start_new_session=True,  # Ctrl-C is for the lab, whose end ends this process
            )
        except OSError as error:  # no memory, too many processes: the lab goes on
            _LOG.error("the camera process cannot be started (%s), the next try is in %g s", error, START_REST_S)
            self._rest_until_s = time.monotonic() + START_REST_S
            self._link.close()
            return
        finally:
            theirs.close()
        self._send((self.fleet, self._seed, self.board.fd, descriptors))
        for order in self._orders:
            self._send(order)

    def tell_wires(self, method, argument):
        """Let the camera process, now and whenever it is started again, call a method of its faults.Wires."""
        self._orders.append((method, argument))
        if self.running:
            self._send(self._orders[-1])

    def _send(self, what):
        with contextlib.suppress(BrokenPipeError):  # it has ended: `check` will tell
            self._link.send(what)

    def check(self):
        """Say that the camera process is up, once, and notice its end. To be called now and then."""
        if self.ready and not self._said_ready:
            self._said_ready = True
            _LOG.info("cameras are ready: video is sent as soon as a client connects")
        if not self.running or self._process.poll() is None:
            return
        code = self._process.returncode
        if code == BAD_FILES:
            rest_s = math.inf
            _LOG.error(
                "vehicles send no video: the camera process cannot use what its last line names. Mend that and start "
                "the lab again"
            )
        else:
            rest_s = START_REST_S
            _LOG.error(
                "the camera process has ended (code %s), its last lines say why: vehicles send no video until it is "
                "started again, in %g s",
                code,
                rest_s,
            )
        self._link.close()
        self._process = None
        self._rest_until_s = time.monotonic() + rest_s
        self.board.watchers[:] = 0

    def wave_board(self, namespace, duration_s):
        """Wave a checkerboard in front of a vehicle's camera from now on."""
        index, now_s = self._index[namespace], time.monotonic()
        self.board.board_since_s[index], self.board.board_until_s[index] = now_s, now_s + duration_s

    def statistics(self, namespace):
        """What a vehicle's camera has done, as plain numbers."""
        index = self._index[namespace]
        return {
            "pictures": int(self.board.pictures[index]),
            "skipped": int(self.board.skipped[index]),
            "late_ms": 1e3 * float(self.board.late_s[index]),
        }

    def wire_statistics(self):
        """See faults.Wires.statistics."""
        faults = self.board.faults.tolist()
        return {"%s/video" % name: dict(zip(COUNTS, faults[k])) for name, k in self._index.items() if any(faults[k])}

    def close(self):
        """End the camera process. May be called twice."""
        if self._process is not None:
            self._link.close()
            try:
                self._process.wait(STOP_PATIENCE_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
            self._process = None
        self.board.close()


class VehicleVideo:
    """The video of one vehicle, as its host sees it."""

    def __init__(self, launcher, index):
        self._launcher, self._index = launcher, index
        self._channels = len(virtual_type(launcher.fleet.vehicles[index].type).cameras) or 1

    @property
    def wants_clients(self):
        """Whether somebody has to wait for clients and call `start` for them."""
        return self._launcher.may_start

    @property
    def watchers(self):
        """How many clients are connected."""
        return int(self._launcher.board.watchers[self._index])

    @property
    def newest_picture(self):
        """(bytes, number) of the newest picture that was made; (0, 0) before the first."""
        number, picture_bytes = divmod(self._launcher.board.newest_picture.item(self._index), 1 << 32)
        return picture_bytes, number

    def start(self):
        """A client has come: let the camera process serve it."""
        self._launcher.start()

    def set_link(self, is_up):
        """Whether anything passes."""
        self._launcher.board.link_up[self._index] = is_up

    def configure(self, channel, rate_hz, bitrate_kbit_s, enabled):
        """What the vehicle's configuration says; clients write any number there, cameras do what they can."""
        board, index = self._launcher.board, self._index
        board.channel[index], board.enabled[index] = channel % self._channels, enabled
        board.rate_hz[index] = _within(RATES_HZ, rate_hz)
        board.bitrate_kbit_s[index] = _within(BITRATES_KBIT_S, bitrate_kbit_s)


def _within(limits, value):
    return min(max(value, limits[0]), limits[1])
