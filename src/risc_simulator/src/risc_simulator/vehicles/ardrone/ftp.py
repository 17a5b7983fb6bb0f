"""The FTP server of an AR.Drone, TCP 5551: Parrot's own library reads version.txt there before it does anything else.

The server is pyftpdlib's; it has a loop of its own, which waits in the host's like a socket.
"""

import logging

from pyftpdlib.authorizers import DummyAuthorizer
from pyftpdlib.handlers import FTPHandler
from pyftpdlib.ioloop import IOLoop
from pyftpdlib.servers import FTPServer

from risc_lab.lab.yaml_reader import package_file

MAX_SOCKETS = 16

_LOG = logging.getLogger("pyftpdlib")
_LOG.setLevel(logging.ERROR)  # who comes is said by Notices
_LOG.addHandler(logging.NullHandler())  # else it takes a logger of its own for the first client


class FtpServer:
    """Lets anybody read the files of an aircraft (config/ardrone_ftp), and nobody write."""

    def __init__(self, listener, notices):
        """listener: bound TCP socket, the server's from now on.  notices: Notices of the host."""

        class Handler(FTPHandler):
            authorizer = DummyAuthorizer()
            banner = "AR.Drone 2.0 of the virtual lab"

            def on_connect(self):
                notices.event("reads files by FTP", (self.remote_ip, self.remote_port))

        Handler.authorizer.add_anonymous(str(package_file("risc_simulator", "config/ardrone_ftp")))
        self._loop = IOLoop.factory()
        self._server = FTPServer(listener, Handler, self._loop)
        self._server.max_cons = MAX_SOCKETS

    def fileno(self):
        """Descriptor to wait on: when it can be read call serve()."""
        return self._loop.fileno()

    def serve(self):
        """Do all that can be done now."""
        self._loop.loop(timeout=0, blocking=False)

    def close(self):
        """Close all sockets."""
        self._loop.close()
