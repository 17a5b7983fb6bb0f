"""Query of one AR.Drone over its own protocol: whether it answers, and its battery charge."""

import contextlib
import socket
import time
from dataclasses import dataclass

from ardrone_autonomy.protocol import AT_PORT, NAVDATA_PORT, at
from ardrone_autonomy.protocol.navdata import WAKE_UP, Navdata, NavdataError, State, Tag
from risc_doctor.interfaces import IP_RECVERR

PATIENCE_S = 1.5
_WAKE_UP_PERIOD_S = 0.25
_PACKET_BYTES = 8192


@dataclass(frozen=True)
class VehicleReport:
    """What the vehicle answered."""

    error: str = ""  # why nothing came; "" when something did
    state: int = 0  # bits of navdata.State
    battery_pct: float | None = None  # None: it did not tell


def probe(address, patience_s=PATIENCE_S):
    """VehicleReport of the vehicle at an address.

    A vehicle sends its telemetry to the client that asked last: do not ask one that a driver flies (the driver would
    take it back 0.25 s later). One that was just switched on reports its battery only after a configuration write.
    """
    state, deadline = None, time.monotonic() + patience_s
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.setsockopt(socket.IPPROTO_IP, IP_RECVERR, 1)
        sock.settimeout(_WAKE_UP_PERIOD_S)
        try:
            while time.monotonic() < deadline:
                if state is not None and state & State.BOOTSTRAP:
                    sock.sendto(at.encode("CONFIG", 1, "general:navdata_demo", "TRUE"), (address, AT_PORT))
                sock.sendto(WAKE_UP, (address, NAVDATA_PORT))
                with contextlib.suppress(TimeoutError, NavdataError):
                    data, source = sock.recvfrom(_PACKET_BYTES)
                    if source == (address, NAVDATA_PORT):
                        packet = Navdata(data)
                        state, demo = packet.state, packet.option(Tag.DEMO)
                        if demo is not None:
                            return VehicleReport(state=state, battery_pct=float(demo.vbat_flying_percentage))
        except ConnectionRefusedError:
            return VehicleReport("the address answers, but nothing listens on udp %d" % NAVDATA_PORT)
        except OSError as error:
            return VehicleReport(error.strerror or str(error))
    return VehicleReport("no telemetry within %g s" % patience_s) if state is None else VehicleReport(state=state)
