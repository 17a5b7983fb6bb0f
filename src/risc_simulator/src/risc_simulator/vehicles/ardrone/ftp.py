"""The FTP server of an AR.Drone, TCP 5551: Parrot's own library reads version.txt there before it does anything else.

The server is pyftpdlib's; its own event loop is a member of the host's, like a socket.
"""

import logging

from pyftpdlib.authorizers import DummyAuthorizer
from pyftpdlib.handlers import FTPHandler
from pyftpdlib.ioloop import IOLoop
from pyftpdlib.servers import FTPServer

from risc_lab.lab.yaml_reader import package_file
from risc_simulator.socket_host import reset

MAX_SOCKETS, MAX_OF_ONE_ADDRESS = 16, 8

_LOG = logging.getLogger("pyftpdlib")
_LOG.setLevel(logging.ERROR)  # clients are logged by Notices
_LOG.addHandler(logging.NullHandler())  # else pyftpdlib sets up logging of its own at the first client


class FtpServer:
    """Serves the files of an aircraft (config/ardrone_ftp) to any client, read-only."""

    def __init__(self, listener, notices, stream):
        """listener: bound TCP socket, the server's from now on.  notices: Notices of the host.

        stream: wires.Stream that clients' commands pass, so that all answers are delayed or cut with them.
        """
        server = self
        self._now_s = 0.0

        class Handler(FTPHandler):
            authorizer = DummyAuthorizer()
            banner = "AR.Drone 2.0 of the virtual lab"

            def on_connect(self):
                notices.event("reads files by FTP", (self.remote_ip, self.remote_port))

            def pre_process_command(self, line, cmd, arg):
                if stream.is_full(self):
                    _cut(self)
                else:
                    stream.carry((line, cmd, arg), self, server._now_s, _obey, _cut)

        Handler.authorizer.add_anonymous(str(package_file("risc_simulator", "config/ardrone_ftp")))
        self._loop = IOLoop.factory()
        self._server = FTPServer(listener, Handler, self._loop)
        self._server.max_cons, self._server.max_cons_per_ip = MAX_SOCKETS, MAX_OF_ONE_ADDRESS

    def fileno(self):
        """Descriptor to wait on: when it can be read call serve()."""
        return self._loop.fileno()

    def serve(self, now_s):
        """Serve all that is pending, at lab time now_s."""
        self._now_s = now_s
        self._loop.loop(timeout=0, blocking=False)

    def close(self):
        """Close all sockets."""
        self._loop.close()


def _obey(command, handler, _now_s):
    if handler.connected:
        FTPHandler.pre_process_command(handler, *command)


def _cut(handler):
    if handler.connected:
        reset(handler.socket)
        handler.close()
