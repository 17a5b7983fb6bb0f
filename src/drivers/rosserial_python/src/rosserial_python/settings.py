"""Parameters of serial_node."""

from dataclasses import dataclass

from risc_lab.settings import Count, Port, Positive, Settings, between
from risc_lab.strangers import Guests
from rosserial_python.link import USUAL_SILENCE_S

USUAL_BAUD = 57600
LISTEN = "tcp"  # as ~port: devices connect to ~tcp_port


@dataclass(frozen=True)
class SerialParams(Settings):
    """The first five are those of the original node."""

    port: str = "/dev/ttyUSB0"  # device or URL of pyserial, e.g. /dev/ttyACM0; socket://HOST:PORT; tcp: listen
    # [bit/s] of a serial line, None: 57600. With TCP: of a serial line behind the network, None: no such line, no limit
    baud: between(300, 12000000) | None = None
    tcp_port: Port = 11411  # with tcp
    fork_server: bool = False  # with tcp: several devices at a time
    tcp_from: tuple[str, ...] = ()  # with tcp: addresses of devices, or networks A.B.C.0/24; others than this computer
    fix_pyserial_for_test: bool = False  # opens with rtscts and dsrdtr
    silence: Positive = USUAL_SILENCE_S  # [s] without a valid packet after which the link is lost
    max_age: Positive = 0.25  # [s] a message that is older by its header.stamp is not sent
    reopen_after: Count = 10  # [s] of silence after which a serial port is opened again (which resets most boards)

    def __post_init__(self):
        super().__post_init__()
        self.guests()

    def guests(self):
        """Return the risc_lab.strangers.Guests of `tcp_from`."""
        try:
            return Guests(self.tcp_from)
        except ValueError as error:
            raise ValueError("tcp_from: %s" % error) from None
