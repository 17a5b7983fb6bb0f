"""What the hosts of the virtual lab have in common: sockets that are waited for."""

import select


class SocketSet:
    """Waits for members that have a fileno(), by epoll: a wake costs what can be read, not what is waited for.

    A set has a fileno() itself, which can be read when a member can: sets nest.
    """

    def __init__(self):
        self._epoll = select.epoll()
        self._members = {}  # descriptor -> member, in the order of joining

    def fileno(self):
        """Descriptor to wait on."""
        return self._epoll.fileno()

    def __iter__(self):
        return iter(list(self._members.values()))

    def add(self, member):
        """Wait for this one, too; nothing happens when it is a member."""
        descriptor = member.fileno()
        if descriptor not in self._members:
            self._epoll.register(descriptor, select.EPOLLIN)
            self._members[descriptor] = member

    def discard(self, member):
        """Do not wait for this one any longer. To be called before it is closed."""
        descriptor = member.fileno()
        if self._members.pop(descriptor, None) is not None:
            self._epoll.unregister(descriptor)

    def readable(self):
        """Members that can be read now."""
        return [self._members[descriptor] for descriptor, _ in self._epoll.poll(0)]

    def close(self):
        """Forget all members, which stay open. May be called twice."""
        self._members = {}
        self._epoll.close()


class SocketHost:
    """A host: on_readable(sock, now_s) of the subclass serves what comes in on the sockets of self._waiting."""

    def __init__(self):
        self._waiting = SocketSet()

    def fileno(self):
        """Descriptor to wait on: when it can be read call serve()."""
        return self._waiting.fileno()

    def sockets(self):
        """Sockets that are waited for. Empty after close()."""
        return list(self._waiting)

    def serve(self, now_s):
        """Take all that has come in, at lab time now_s."""
        for sock in self._waiting.readable():
            if sock.fileno() >= 0:  # an earlier one of this round may have closed it
                self.on_readable(sock, now_s)
