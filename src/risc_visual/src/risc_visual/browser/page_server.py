"""viser's server, which accepts connections of its own page only.

All use of undocumented parts of viser and websockets is here: that viser calls websockets' `serve`, viser's
`request_share_url`, its message of an upload, and the name of websockets' log.
"""

import contextlib
import errno
import functools
import http
import io
import ipaddress
import logging
import socket
import threading
import urllib.parse
from collections import Counter

import viser
import websockets.asyncio.server

from risc_lab.strangers import Guests, Strangers

MAX_CONNECTIONS, MAX_OF_ONE_ADDRESS = 64, 16  # at a time; a page has one, and a few more while it loads
MAX_MESSAGE_BYTES = 1 << 18  # pages send clicks and their viewpoint
MAX_MESSAGES_S = 500  # of one page; while the view is turned it sends some tens a second


def open_server(host, port, guests=None, strangers=None):
    """viser.ViserServer on an address and port of this computer. Raises ValueError that says what to change.

    guests: risc_lab.strangers.Guests that may connect beside this computer.  strangers: Strangers, which counts others.
    """
    threading.Thread(target=_full_name, daemon=True).start()
    _check_free(host, port)
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)  # else: a traceback for every page that closes
    strangers = strangers or Strangers(lambda level, text: None, "port %d" % port)
    with (
        _guard_server(guests or Guests(), strangers),
        contextlib.redirect_stdout(io.StringIO()),
    ):  # hides viser's banner; the caller logs the address
        server = viser.ViserServer(host=host, port=port, verbose=False)
    if server.get_port() != port:
        server.stop()
        raise ValueError(_taken(host, port))
    server.request_share_url = lambda: None  # else anyone who opens the page could ask for a tunnel to the internet
    # else anyone who sees a button could send a file of any size, which nothing here reads
    server.gui._websock_interface.unregister_handler(viser._messages.FileTransferStartUpload)
    return server


@contextlib.contextmanager
def _guard_server(guests, strangers):
    """A server started in this context limits its connections and accepts those of its own page only.

    A browser lets any page connect to any address, and names the page's address in Origin. viser has no setting for
    either, so the checks are put into its call of websockets.
    """
    serve = websockets.asyncio.server.serve
    guarded = []

    def serve_own_page(*args, process_request, **settings):
        def answer(connection, request):
            if is_page_of_others(request.headers):
                text = "not for pages of another address: open this one by the computer's address or its name, %s\n"
                return connection.respond(http.HTTPStatus.FORBIDDEN, text % socket.gethostname())
            return process_request(connection, request)

        guarded.append(True)
        settings.update(max_size=MAX_MESSAGE_BYTES, create_connection=_guarded_connections(guests, strangers))
        return serve(*args, process_request=answer, **settings)

    websockets.asyncio.server.serve = serve_own_page
    try:
        yield
    finally:
        websockets.asyncio.server.serve = serve
    if not guarded:
        raise RuntimeError("this release of viser serves pages differently: install the one in requirements.txt")


def _guarded_connections(guests, strangers):
    """Class of a server's connections: accepts guests only, limits their number and how much they send. Silent ones
    are closed by websockets.
    """
    present = Counter()  # connections by address

    class Connection(websockets.asyncio.server.ServerConnection):
        _address = None  # None: it was refused
        _second = _messages = 0  # second of the server's clock; messages in it

        def connection_made(self, transport):
            peer, here = transport.get_extra_info("peername"), transport.get_extra_info("sockname")
            trouble = "it has gone" if peer is None else _trouble(peer[0], here[0])
            if trouble:
                if peer is not None:
                    strangers.refuse(peer[0], trouble)
                transport.abort()
                return
            self._address = peer[0]
            present[self._address] += 1
            super().connection_made(transport)

        def process_event(self, event):
            second = int(self.loop.time())
            self._messages = self._messages + 1 if second == self._second else 1
            self._second = second
            if self._messages <= MAX_MESSAGES_S:
                super().process_event(event)
            elif not self.transport.is_closing():
                strangers.refuse(self._address, "it sends more than %d messages a second" % MAX_MESSAGES_S)
                self.transport.abort()

        def connection_lost(self, exc):
            if self._address is not None:
                present[self._address] -= 1
                if not present[self._address]:
                    del present[self._address]
                super().connection_lost(exc)

    def _trouble(address, local_address):
        if not guests.may_come(address, local_address):
            return "if it may see the page and land the vehicles add it to ~guests"
        if present[address] >= MAX_OF_ONE_ADDRESS or present.total() >= MAX_CONNECTIONS:
            return "it has %d connections of %d" % (present[address], present.total())
        return ""

    return Connection


def is_page_of_others(headers):
    """True when a request comes from a page of another address (Origin), or asks for a host that is not ours (Host).

    headers: of the request. The owner of a name on the internet can point it to this computer (DNS rebinding), and
    his page then has the same Host as Origin: so Host must be a name that this computer has, or an address, which
    cannot be redirected.
    """
    host = headers.get("Host", "").lower()
    origin = headers.get("Origin")
    try:
        if origin is not None and urllib.parse.urlsplit(origin).netloc.lower() != host:
            return True
        name = urllib.parse.urlsplit("//" + host).hostname or ""
    except ValueError:  # no browser sends such headers
        return True
    return not _is_ours(name)


def _is_ours(name):
    """Whether a host's name, in lower case, is one of this computer's; addresses always are."""
    own = socket.gethostname().lower()
    if name in ("localhost", own, own + ".local"):
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return name == _full_name()
    return True


@functools.cache
def _full_name():
    """Name with domain. Looked up once, before the server runs: with an unreachable name server it takes seconds."""
    return socket.getfqdn().lower()


def _check_free(host, port):
    """Raise ValueError when the port cannot be used: viser would silently take the next free one."""
    try:
        socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET).close()
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise ValueError(_taken(host, port)) from None
        if error.errno == errno.EACCES:
            raise ValueError("port %d needs root: choose one from 1024 to 65535" % port) from None
        raise ValueError(
            "host '%s' is not an address of this computer (%s): use 127.0.0.1 for this computer only, 0.0.0.0 for the "
            "network" % (host, error.strerror.partition(" (")[0])
        ) from None


def _taken(host, port):
    return "port %d of %s is in use (by another browser view?): choose another one" % (port, host)
