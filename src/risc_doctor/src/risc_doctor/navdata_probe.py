"""One AR.Drone asked over its own protocol: are you there, and how full is your battery?"""

import select
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
    """What the vehicle said."""

    error: str = ""  # why nothing came; "" when something did
    state: int = 0  # bits of navdata.State
    battery_pct: float | None = None  # None: it did not tell


def probe(address, patience_s=PATIENCE_S):
    """VehicleReport of the vehicle at an address.

    A vehicle sends its telemetry to whoever asked last: one that a driver flies must not be asked (the driver would
    take it back 0.25 s later). One that was just switched on tells its battery only after a configuration write.
    """
    newest = None
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.setsockopt(socket.IPPROTO_IP, IP_RECVERR, 1)
        deadline, next_wake_up = time.monotonic() + patience_s, 0.0
        try:
            while True:
                now = time.monotonic()
                if now >= deadline:
                    break
                if now >= next_wake_up:
                    if newest is not None and newest.state & State.BOOTSTRAP:
                        command = at.encode("CONFIG", 1, "general:navdata_demo", "TRUE")
                        sock.sendto(command, (address, AT_PORT))
                    sock.sendto(WAKE_UP, (address, NAVDATA_PORT))
                    next_wake_up = now + _WAKE_UP_PERIOD_S
                if not select.select([sock], [], [], min(deadline, next_wake_up) - now)[0]:
                    continue
                data, source = sock.recvfrom(_PACKET_BYTES)
                if source != (address, NAVDATA_PORT):
                    continue
                try:
                    first, newest = newest is None, Navdata(data)
                    demo = newest.option(Tag.DEMO)
                except NavdataError:
                    continue
                if demo is not None:
                    return VehicleReport(state=newest.state, battery_pct=float(demo.vbat_flying_percentage))
                if first:
                    next_wake_up = 0.0  # ask for more at once
        except ConnectionRefusedError:
            return VehicleReport("the address is there, but nothing listens on udp %d" % NAVDATA_PORT)
        except OSError as error:
            return VehicleReport(error.strerror or str(error))
    if newest is None:
        return VehicleReport("no telemetry within %g s" % patience_s)
    return VehicleReport(state=newest.state)
