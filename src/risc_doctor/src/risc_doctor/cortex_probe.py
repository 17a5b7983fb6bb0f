"""Query of a Cortex host over its own protocol: its identity, its bodies, and whether its stream arrives."""

import contextlib
import errno
import time
from dataclasses import dataclass, field

from cortex_ros import wire
from cortex_ros.connection import CortexConnection
from risc_doctor.socket_owners import users_of_port

LISTEN_S = 1.0  # to the stream
_STREAM_PATIENCE_S = 0.5  # for its first frame
_POLL_PAUSE_S = 0.1  # between two polls of a host whose stream does not arrive: twenty frames
_IDENTITY = wire.Identity("maap_doctor", (2, 1, 0, 0))


@dataclass
class CortexReport:
    """What the host answered and sent."""

    error: str = ""  # why it does not answer; "" when it does
    refused: bool = False  # the computer is there, but no program listens
    identity: wire.Identity | None = None
    bodies: tuple[wire.BodyDef, ...] | None = None  # None: it does not say
    told_rate_hz: float | None = None
    mm_per_unit: float | None = None
    up_axis: int | None = None  # 0 = x, 1 = y, 2 = z
    stream_error: str = ""  # why the stream could not be listened to
    listeners: tuple[str, ...] = ()  # other programs on the stream's port: unicast frames go to them
    frames: list[tuple[float, wire.Frame]] = field(default_factory=list)  # (monotonic time of arrival [s], frame)
    malformed: int = 0
    polled: list[wire.Frame] = field(default_factory=list)  # frames on request, if the stream did not arrive

    @property
    def live(self):
        """True when it shows new frames, streamed or on request."""
        return len(self.frames) > 1 or len({frame.number for frame in self.polled}) > 1

    @property
    def rate_hz(self):
        """Measured rate of the stream [Hz]; None when fewer than two frames arrived."""
        if len(self.frames) < 2:
            return None
        return (len(self.frames) - 1) / max(self.frames[-1][0] - self.frames[0][0], 1e-6)

    @property
    def lost(self):
        """Fraction of the stream's frames that did not arrive, by their numbers."""
        numbers = sorted({frame.number for _, frame in self.frames})
        if len(numbers) < 2:
            return 0.0
        return 1.0 - len(numbers) / (numbers[-1] - numbers[0] + 1)

    @property
    def metres_per_unit(self):
        return (self.mm_per_unit or 1.0) / 1000.0

    def shown(self):
        """The frames that arrived, streamed or on request."""
        return [frame for _, frame in self.frames] or self.polled


class EndpointConnection(CortexConnection):
    """Connection to a risc_lab.lab.MocapEndpoint, with its stream. To be closed. Raises OSError."""

    def __init__(self, endpoint):
        super().__init__(_IDENTITY, endpoint.host, endpoint.command_port, endpoint.interface)
        self.stream_error, self.listeners = "", tuple(users_of_port(endpoint.stream_port))
        try:
            self.open_stream(endpoint.stream_group, endpoint.stream_port, group_only=bool(self.listeners))
        except OSError as error:
            self.stream_error = error.strerror or str(error)


def probe(endpoint, live=False, listen_s=LISTEN_S):
    """CortexReport of the host at an endpoint. live: ask it for live mode first."""
    report = CortexReport()
    try:
        with contextlib.closing(EndpointConnection(endpoint)) as connection:
            report.stream_error, report.listeners = connection.stream_error, connection.listeners
            report.identity, definitions = connection.hello(), connection.body_defs()
            report.bodies = definitions and tuple(definitions.bodies)
            report.told_rate_hz = connection.number("GetContextFrameRate", "<f")
            report.mm_per_unit = connection.number("GetConversionToMillimeters", "<f")
            report.up_axis = connection.number("GetUpAxis", "<i")
            if live:
                connection.go_live()
            connection.forget_stream()  # frames queued meanwhile would falsify the rate
            report.frames = list(connection.stream(listen_s, _STREAM_PATIENCE_S))
            for _ in range(2 if len(report.frames) < 2 else 0):
                report.polled += filter(None, [connection.poll()])
                time.sleep(_POLL_PAUSE_S)
            report.malformed = len(connection.malformed)
    except ConnectionRefusedError:
        report.refused, report.error = True, "refused, as nothing listens on that port"
    except OSError as error:
        report.error = error.strerror or str(error)
        if error.errno == errno.EADDRNOTAVAIL:
            report.error = "this computer does not have the address that the fleet file calls mocap interface"
    return report
