"""This computer's network cards and the routes that the kernel would take."""

import ipaddress
import pathlib
import socket
from dataclasses import dataclass

import psutil

_LOOPBACK = ipaddress.IPv4Network("127.0.0.0/8")
_CARDS = pathlib.Path("/sys/class/net")
_NO_LINK = ("down", "lowerlayerdown", "dormant")  # of operstate
_ANY_PORT = 9  # connecting a UDP socket sends nothing
IP_RECVERR = 11  # linux/in.h: if set, a refusal by the other computer is reported, too


@dataclass(frozen=True)
class Interface:
    """One network card."""

    name: str
    addresses: tuple[ipaddress.IPv4Interface, ...]  # with their networks
    up: bool = True
    connected: bool = True  # a cable is in, or a Wi-Fi network joined
    multicast: bool = True

    @property
    def is_loopback(self):
        return any(address.ip in _LOOPBACK for address in self.addresses)

    def has(self, address):
        """Whether the address (text) is its own; each of 127.x.x.x is that of the loopback card."""
        wanted = ipaddress.IPv4Address(address)
        return any(own.ip == wanted or (own.ip in _LOOPBACK and wanted in _LOOPBACK) for own in self.addresses)

    def describe(self):
        """E.g. "eth0 192.168.0.10/24"."""
        return "%s %s" % (self.name, ", ".join(map(str, self.addresses)) or "without an address")


def read_interfaces():
    """All network cards of this computer, as a list of `Interface`. A bridge is always connected."""
    cards, found = psutil.net_if_stats(), []
    for name, entries in psutil.net_if_addrs().items():
        card = name.partition(":")[0]  # eth0:1 is a second address of eth0
        folder, flags = _CARDS / card, cards[card].flags.split(",") if card in cards else ()
        addresses = tuple(
            ipaddress.IPv4Interface("%s/%s" % (entry.address, entry.netmask or "255.255.255.255"))
            for entry in entries
            if entry.family == socket.AF_INET
        )
        connected = (folder / "bridge").is_dir() or _read(folder / "operstate") not in _NO_LINK
        found.append(Interface(name, addresses, "up" in flags, connected, "multicast" in flags))
    return found


def leading_out(interfaces):
    """The cards that lead to other computers."""
    return [card for card in interfaces if card.up and card.addresses and not card.is_loopback]


def is_own(interfaces, address):
    """True when this computer has the address (text), on a card that is up."""
    return any(card.up and card.has(address) for card in interfaces)


def is_loopback(address):
    """True for 127.x.x.x and ::1 (text)."""
    return ipaddress.ip_address(address).is_loopback


def interface_towards(interfaces, address):
    """(card, own address in that network) that reaches the address (text) without a router, or None."""
    wanted = ipaddress.IPv4Address(address)
    ways = [(card, own) for card in interfaces if card.up for own in card.addresses if wanted in own.network]
    return max(ways, key=lambda way: way[1].network.prefixlen, default=None)


def source_towards(address):
    """Own address that the kernel would send from to the address (text); None when it knows no route."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        try:
            sock.connect((address, _ANY_PORT))
        except OSError:
            return None
        return sock.getsockname()[0]


def _read(path):
    try:
        return path.read_text().strip()
    except OSError:
        return ""  # a card that is gone, or a container without /sys
