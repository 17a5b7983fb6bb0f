"""Network cards, subnets and the way that the mocap stream comes in by."""

import collections
import ipaddress
import pathlib
import socket

from risc_doctor import interfaces as net
from risc_doctor.findings import green, red, yellow

_STRICT = 1  # of rp_filter: drop what comes in by another card than the answer would leave by
_NO_WAY = "give this computer an address in that network, or correct the address in the fleet file"


def check(situation):
    """Are the cards up, and is this computer in the networks of Cortex and of the vehicles?"""
    return judge(situation.fleet, situation.interfaces(), situation.simulated, net.source_towards)


def judge(fleet, interfaces, simulated, source_towards):
    """Findings. source_towards: address -> own address that the kernel would send from, None without a route."""
    say, host = "network", fleet.mocap.host
    cards = _cards(interfaces)
    findings = []
    if not any(card.up and card.is_loopback for card in interfaces):
        text = "the loopback card is down: programs of this computer do not reach each other"
        findings.append(red(say, text, "sudo ip link set lo up"))
    if cards:
        findings.append(green(say, "; ".join(card.describe() for card in cards)))
    elif simulated:
        findings.append(green(say, "no network card with an address; the virtual lab needs none"))
    else:
        findings.append(
            red(
                say,
                "no network card has an IPv4 address",
                "plug the cable in or join the Wi-Fi; `ip address` shows the cards",
            )
        )
    for card in cards:
        if not card.connected:
            text = "%s has an address, but no cable or no Wi-Fi network" % card.name
            findings.append(yellow(say, text, "plug it in, or switch it off: sudo ip link set %s down" % card.name))
    if fleet.mocap.interface and not net.is_own(interfaces, fleet.mocap.interface):
        findings.append(
            red(
                say,
                "mocap interface %s of the fleet is no address of this computer" % fleet.mocap.interface,
                'set it to the address of the card that leads to Cortex, or to "", in the fleet file',
            )
        )
    cure = "multicast does not pass most routers: connect to that network itself, or correct the fleet file"
    findings.append(_way(say, "the Cortex host", host, interfaces, source_towards, cure))
    if not fleet.own_networks:  # else `vehicles` says which of the networks this computer has joined
        addresses = [vehicle.address for vehicle in fleet.vehicles]
        outside = [address for address in addresses if not net.interface_towards(interfaces, address)]
        cure = "join the vehicle's Wi-Fi, or correct its address in the fleet file"
        findings += [_way(say, "vehicle", address, interfaces, source_towards, cure) for address in outside]
        if not outside:
            findings.append(green(say, "every vehicle (%d) is in a network of this computer" % len(addresses)))
    return findings


def _cards(interfaces):
    """Those that lead to other computers."""
    return [card for card in interfaces if card.up and card.addresses and not card.is_loopback]


def check_subnets(situation):
    """Is each card in a network of its own?"""
    return judge_subnets(situation.interfaces(), [vehicle.address for vehicle in situation.vehicles()])


def judge_subnets(interfaces, vehicles):
    """Two cards in one network: the kernel sends by either, and the stream may come in by the other one.

    vehicles: addresses of those that are flown.
    """
    by_network, findings = collections.defaultdict(set), []
    for card in _cards(interfaces):
        for address in card.addresses:
            if address.network.prefixlen < 31:
                by_network[address.network].add(card.name)
    for network, cards in by_network.items():
        if len(cards) < 2:
            continue
        text = "%s are in the same network %s" % (" and ".join(sorted(cards)), network)
        cure = "leave it with one of them (usually the Wi-Fi while the cable is in): sudo ip link set %s down"
        cure %= max(cards)
        flown = [address for address in vehicles if ipaddress.ip_address(address) in network]
        if flown:
            text += ": what is meant for the vehicle at %s may leave by the wrong one" % flown[0]
            cure = "if one is the vehicle's own Wi-Fi: give the laboratory another network in its router; else " + cure
        findings.append(yellow("subnets", text, cure))
    return findings or [green("subnets", "no two network cards are in the same network")]


def _way(say, what, address, interfaces, source_towards, cure):
    """Finding about the way to an address. cure: for one that only a router leads to."""
    direct = net.interface_towards(interfaces, address)
    if direct is not None:
        card, own = direct
        if card.is_loopback:
            return green(say, "%s %s is on this computer" % (what, address))
        return green(say, "%s %s is in the network of %s (own address %s)" % (what, address, card.name, own.ip))
    source = source_towards(address)
    if source is None:
        return red(
            say,
            "there is no way to %s %s" % (what, address),
            _NO_WAY,
        )
    return yellow(
        say,
        "%s %s is in none of this computer's networks: it is reached by a router, from %s" % (what, address, source),
        cure,
    )


def check_multicast(situation):
    """Can the stream's group be joined on the card that leads to Cortex, and does the kernel let it in?"""
    mocap, interfaces = situation.fleet.mocap, situation.interfaces()
    own = mocap.interface or net.source_towards(mocap.host)
    if own is None:
        text = "no card leads to the Cortex host %s, so there is none to hear the stream by" % mocap.host
        return [red("multicast", text, _NO_WAY)]
    card = net.interface_of(interfaces, own)
    if card is None:
        text = "no card has the address %s that the stream is to come in by" % own
        return [red("multicast", text, "see `network`")]
    return judge_multicast(mocap, own, card, join_error(mocap.stream_group, own), _filters(card.name))


def judge_multicast(mocap, own, card, error, filters):
    """Findings. error: of joining, "" when it worked; filters: {"all" or card: number of rp_filter}."""
    say, way = "multicast", "%s by %s (%s)" % (mocap.stream_group, card.name, own)
    if error:
        return [red(say, "cannot join %s: %s" % (way, error), "is the card up? `ip link show %s`" % card.name)]
    if not (card.multicast or card.is_loopback):
        cure = "sudo ip link set %s multicast on" % card.name
        return [red(say, "%s does not take multicast (%s)" % (card.name, mocap.stream_group), cure)]
    findings = [green(say, "joined %s" % way)]
    direct = net.interface_towards([card], mocap.host)
    if max(filters.values(), default=0) == _STRICT and direct is None:
        findings.append(
            yellow(
                say,
                "the kernel drops a stream that comes in by %s, as answers to %s leave by another card (rp_filter 1)"
                % (card.name, mocap.host),
                "sudo sysctl net.ipv4.conf.%s.rp_filter=2 net.ipv4.conf.all.rp_filter=2" % card.name,
            )
        )
    return findings


def join_error(group, own):
    """Why a group cannot be joined on the card with this address; "" when it can."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        try:
            sock.setsockopt(
                socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group) + socket.inet_aton(own)
            )
        except OSError as error:
            return error.strerror or str(error)
    return ""


def _filters(card):
    paths = {name: pathlib.Path("/proc/sys/net/ipv4/conf") / name / "rp_filter" for name in ("all", card)}
    return {name: int(path.read_text()) for name, path in paths.items() if path.exists()}
