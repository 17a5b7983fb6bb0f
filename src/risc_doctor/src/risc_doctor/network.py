"""Network cards, subnets and the card on which the mocap stream arrives."""

import collections
import ipaddress
import pathlib
import socket

from risc_doctor import interfaces as net
from risc_doctor.findings import Findings

_STRICT = 1  # of rp_filter: drop packets that arrive on another card than a reply would leave by


def check(situation):
    """Are the cards up, and is this computer in the networks of Cortex and of the vehicles?"""
    return judge(situation.fleet, situation.interfaces(), situation.simulated, net.source_towards)


def judge(fleet, interfaces, simulated, source_towards):
    """Findings. source_towards: address -> own address that the kernel would send from, None without a route."""
    found, cards = Findings("network"), net.leading_out(interfaces)
    if not any(card.up and card.is_loopback for card in interfaces):
        found.say("loopback_down")
    if cards:
        found.say("cards", cards="; ".join(card.describe() for card in cards))
    else:
        found.say("no_card_needed" if simulated else "no_card")
    for card in cards:
        if not card.connected:
            found.say("unplugged", card=card.name)
    if fleet.mocap.interface and not net.is_own(interfaces, fleet.mocap.interface):
        found.say("wrong_interface", interface=fleet.mocap.interface)
    ways = [("the Cortex host", fleet.mocap.host, "routed_host")]
    if not fleet.own_networks:  # else `vehicles` says which of the networks this computer has joined
        addresses = [vehicle.address for vehicle in fleet.vehicles if vehicle.address]
        outside = [address for address in addresses if not net.interface_towards(interfaces, address)]
        ways += [("vehicle", address, "routed_vehicle") for address in outside]
    for what, address, routed in ways:
        direct = net.interface_towards(interfaces, address)
        source = None if direct else source_towards(address)
        if direct and direct[0].is_loopback:
            found.say("here", what=what, address=address)
        elif direct:
            found.say("near", what=what, address=address, card=direct[0].name, own=direct[1].ip)
        elif source is None:
            found.say("no_way", what=what, address=address)
        else:
            found.say(routed, what=what, address=address, source=source)
    if not fleet.own_networks and addresses and not outside:
        found.say("vehicles_near", count=len(addresses))
    return found


def check_subnets(situation):
    """Is each card in a network of its own?"""
    return judge_subnets(situation.interfaces(), [v.address for v in situation.vehicles() if v.address])


def judge_subnets(interfaces, vehicles):
    """Findings about cards in one network: the kernel sends by either, and the stream may arrive on the other one.

    vehicles: addresses of those that are flown.
    """
    by_network, found = collections.defaultdict(set), Findings("subnets")
    for card in net.leading_out(interfaces):
        for address in card.addresses:
            if address.network.prefixlen < 31:
                by_network[address.network].add(card.name)
    for network, cards in by_network.items():
        if len(cards) > 1:
            flown = next((address for address in vehicles if ipaddress.ip_address(address) in network), None)
            code = "shared_with_vehicle" if flown else "shared"
            found.say(code, cards=" and ".join(sorted(cards)), network=network, last=max(cards), vehicle=flown)
    return found or found.say("apart")


def check_multicast(situation):
    """Can the stream's group be joined on the card that leads to Cortex, and does the kernel let it in?"""
    mocap, interfaces, found = situation.fleet.mocap, situation.interfaces(), Findings("multicast")
    own = mocap.interface or net.source_towards(mocap.host)
    if own is None:
        return found.say("no_way", host=mocap.host)
    card = next((card for card in interfaces if card.has(own)), None)
    if card is None:
        return found.say("no_card", own=own)
    paths = {name: pathlib.Path("/proc/sys/net/ipv4/conf", name, "rp_filter") for name in ("all", card.name)}
    filters = {name: int(path.read_text()) for name, path in paths.items() if path.exists()}
    return judge_multicast(mocap, own, card, join_error(mocap.stream_group, own), filters)


def judge_multicast(mocap, own, card, error, filters):
    """Findings. error: of joining, "" when it worked; filters: {"all" or card: number of rp_filter}."""
    found, way = Findings("multicast"), "%s by %s (%s)" % (mocap.stream_group, card.name, own)
    if error:
        return found.say("not_joined", way=way, error=error, card=card.name)
    if not (card.multicast or card.is_loopback):
        return found.say("not_taken", card=card.name, group=mocap.stream_group)
    found.say("joined", way=way)
    if max(filters.values(), default=0) == _STRICT and net.interface_towards([card], mocap.host) is None:
        found.say("filtered", card=card.name, host=mocap.host)
    return found


def join_error(group, own):
    """Why a group cannot be joined on the card with this address; "" when it can."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        try:
            membership = socket.inet_aton(group) + socket.inet_aton(own)
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
        except OSError as error:
            return error.strerror or str(error)
    return ""
