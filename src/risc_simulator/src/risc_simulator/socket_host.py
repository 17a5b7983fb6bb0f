"""What the hosts of the virtual lab have in common: sockets and their event loop."""

import enum
import errno
import math
import selectors
import socket
import struct
from collections import Counter

from risc_simulator.wires import Wires

DATAGRAMS_PER_CALL = 64
_CURES = {
    errno.EADDRINUSE: "in use. Stop the other virtual lab, or use another address in the fleet file",
    errno.EADDRNOTAVAIL: "this computer has no such address. Use one of its own, or of 127.0.0.0/8, in the fleet file",
    errno.EACCES: "ports below 1024 need root. Use a higher one in the fleet file",
}


def open_socket(kind, address, port, whose, share=False):
    """Open a non-blocking socket, bound to address and port. kind: SOCK_DGRAM, or SOCK_STREAM, which then listens.

    share: others may have the same address.  Raises OSError that names its owner (whose), the cause and the cure.
    """
    sock = socket.socket(socket.AF_INET, kind)
    try:
        sock.setblocking(False)
        if share or kind == socket.SOCK_STREAM:  # listen again at once although old connections linger
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind((address, port))
        if kind == socket.SOCK_STREAM:
            sock.listen()
    except OSError as error:
        sock.close()
        what = "%s: cannot use %s %s:%d" % (whose, "tcp" if kind == socket.SOCK_STREAM else "udp", address, port)
        raise OSError(error.errno, "%s: %s" % (what, _CURES.get(error.errno, error.strerror or error))) from error
    return sock


def reset(sock):
    """Make close() reset a TCP connection: its client gets an error, not an ordinary end."""
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


def greediest(addresses, newcomer):
    """Address that holds the most places and must give one up for a newcomer; None if none must.

    addresses: one for each place taken. Without this rule a single address could keep all places.
    """
    times = Counter(addresses)
    address, most = times.most_common(1)[0]
    return address if most > times[newcomer] + 1 else None


class SocketSet(selectors.EpollSelector):
    """Waits by epoll for members that have a fileno(): a wake costs time for readable members only, not for all.

    A set has a fileno() itself, which is readable when a member is, so sets nest. A closed set has no members.
    """

    def __iter__(self):
        return iter([key.fileobj for key in (self.get_map() or {}).values()])

    def add(self, member):
        """Add a member, unless it is one already."""
        if member not in self.get_map():
            self.register(member, selectors.EVENT_READ)

    def discard(self, member):
        """Remove a member. To be called before the member is closed."""
        if member in self.get_map():
            self.unregister(member)

    def readable(self):
        """Members that can be read now."""
        return [key.fileobj for key, _ in self.select(0)]


class TcpClients:
    """Clients of a TCP listener that are only written to: what they send is discarded, their hang-ups are noticed.

    A member of its host's SocketSet.
    """

    def __init__(self, listener, stream, notices, asks, most, arrive):
        """stream: wires.Stream that all data passes.  notices: Notices.  asks: notice for a new client.

        most: clients at a time.  arrive: called with (data, socket) when data has passed the stream, to be added to
        the socket's backlog.
        """
        self._listener, self._stream, self._notices, self._asks, self._most = listener, stream, notices, asks, most
        self._arrive, self._waiting = arrive, SocketSet()
        if listener is not None:
            self._waiting.add(listener)
        self.fileno = self._waiting.fileno
        self.backlogs = {}  # socket -> bytes still to be sent
        self._addresses = {}  # socket -> IPv4 address of its other end
        self.refused = 0

    def serve(self, _now_s):
        """Accept new clients, discard what they send, notice hang-ups."""
        for sock in self._waiting.readable():
            if sock is self._listener:
                self.accept()
            else:
                self._drain(sock)

    def accept(self):
        """Accept a new client, if there is room."""
        try:
            client, sender = self._listener.accept()
        except OSError:  # gone again
            return
        if len(self.backlogs) >= self._most and not self._make_room(sender[0]):
            self.refused += 1
            self._notices.complaint("is turned away: too many clients", sender)
            client.close()
            return
        self._notices.event(self._asks, sender)
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.backlogs[client], self._addresses[client] = bytearray(), sender[0]
        self._waiting.add(client)

    def _make_room(self, newcomer):
        """Disconnect the oldest client of the address that has most, if it has more than the newcomer's will have."""
        greedy = greediest(self._addresses.values(), newcomer)
        if greedy is None:
            return False
        self._notices.complaint("loses a connection: it holds the most, and there is no room for others", (greedy, 0))
        self.hang_up(next(sock for sock, address in self._addresses.items() if address == greedy))
        return True

    def _drain(self, sock):
        try:
            gone = not sock.recv(4096)
        except BlockingIOError:
            return
        except OSError:
            gone = True
        if gone:
            self.hang_up(sock)

    def write(self, data, now_s):
        """Send data to all clients through the stream, at lab time now_s."""
        for sock in list(self.backlogs):
            if self._stream.is_full(sock):
                self.overflow(sock)
            else:
                self._stream.carry(data, sock, now_s, self._come_through, self._cut)

    def overflow(self, sock):
        """Handle data that could not be written: the stream is held up, and its buffer is full."""
        self.hang_up(sock)

    def flush(self):
        """Send as much of the backlogs as the sockets take now."""
        for sock, backlog in list(self.backlogs.items()):
            if backlog:
                try:
                    del backlog[: sock.send(backlog)]
                except BlockingIOError:
                    pass
                except OSError:
                    self.hang_up(sock)

    def hang_up(self, sock):
        """Close a connection."""
        if self.backlogs.pop(sock, None) is not None:
            del self._addresses[sock]
            self._waiting.discard(sock)
            self._stream.forget(sock)
            sock.close()

    def close(self):
        """Disconnect all clients. May be called twice."""
        for sock in list(self.backlogs):
            self.hang_up(sock)
        self._waiting.close()

    def _come_through(self, data, sock, _now_s):
        if sock in self.backlogs:
            self._arrive(data, sock)

    def _cut(self, sock):
        if sock in self.backlogs:
            reset(sock)
            self.hang_up(sock)


class SocketHost:
    """A host: on_readable() serves input on the members of self._waiting: sockets, and objects with a serve().

    Each datagram that it receives or sends passes one of its wires, and what it writes to TCP clients one of its
    streams, where faults may act on it.
    """

    def __init__(self, name, wires=None):
        """name: prefix of its channels' names. wires: wires.Wires of the lab; None = its own."""
        self._waiting = SocketSet()
        self._counts = Counter()
        self._name, self.wires = name, Wires() if wires is None else wires
        self._heard = {}  # socket -> (wire that its datagrams pass, function that takes them)
        self._now_s = 0.0  # newest lab time that it was given

    def wire(self, what):
        """Make the wires.Wire of one of its channels, in its constructor. what: name without the host's."""
        return self.wires.wire("%s/%s" % (self._name, what))

    def stream(self, what, is_cable=False):
        """Make the wires.Stream of one of its channels, in its constructor.  is_cable: faults of its radio spare it."""
        return self.wires.stream("%s/%s" % (self._name, what), is_cable)

    def hear(self, sock, wire, take):
        """Pass the datagrams of a socket through a wire to take(datagram, sender, time)."""
        self._heard[sock] = wire, take
        self._waiting.add(sock)

    def fileno(self):
        """Descriptor to wait on: when it can be read call serve()."""
        return self._waiting.fileno()

    def sockets(self):
        """Sockets that are waited for. Empty after close()."""
        return list(self._waiting)

    def receive(self, sock):
        """Yield (datagram, sender) of waiting datagrams, a limited number: a flood must not hold up the lab."""
        for _ in range(DATAGRAMS_PER_CALL):
            try:
                yield sock.recvfrom(65536)
            except BlockingIOError:
                return
            except OSError:
                self._counts["receive_errors"] += 1
                return

    def serve(self, now_s):
        """Handle everything that has come in, at lab time now_s."""
        for member in self._waiting.readable():
            self.on_readable(member, now_s)

    def on_readable(self, member, now_s):
        """Handle input on a member of self._waiting."""
        self._now_s = now_s
        if member in self._heard:
            wire, take = self._heard[member]
            for datagram, sender in self.receive(member):
                wire.carry(datagram, sender, now_s, take)
        else:
            member.serve(now_s)


class Told(enum.IntEnum):
    """Order that a vehicle receives over its link: the numbers of risc_maap_msgs/Told."""

    NOTHING, FLY, HOVER, LAND = range(4)


class VehicleHost(SocketHost):
    """Network side of one vehicle. Constructed with (vehicle, address, seed, radio_loss, wires), see VirtualLab.

    vehicle: world.Vehicle.  address: IPv4 address of this computer to listen on.  Raises OSError naming the cause and
    the cure if the address cannot be used; input that arrives later never raises.
    A type defines close(), tick(now_s), called once per cycle after the world has moved, describe(): a line for people,
    and on_readable() where hear() is not enough.
    """

    video_listener = None  # the TCP listener for video, bound; None: it has no camera

    def __init__(self, vehicle, wires=None):
        super().__init__(vehicle.namespace, wires)
        self._vehicle = vehicle
        self.told, self.told_s = Told.NOTHING, -math.inf  # newest order that the type can distinguish; since when
        self._inputs, self.inputs_s = None, -math.inf  # what it was sent last to fly by; since when

    def note_told(self, told, now_s):
        """Note the order that the vehicle receives now."""
        if told is not self.told:
            self.told, self.told_s = told, now_s

    def note_inputs(self, inputs, now_s):
        """Note the sticks, or what takes their place, that the vehicle receives now."""
        if inputs != self._inputs:
            self._inputs, self.inputs_s = inputs, now_s

    def attach_video(self, video):
        """video: video.server.Station, which serves the video clients; the host passes its configuration on to it."""

    def power_cycle(self, now_s):
        """Restart its communication: the vehicle, which stands, was switched off and on at lab time now_s."""

    def statistics(self):
        """Counts since the start, with the `notices` of its Notices, for JSON."""
        return {"notices": {"events": {}, "complaints": {}}}
