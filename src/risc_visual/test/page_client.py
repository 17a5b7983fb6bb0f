"""A client for the page of the browser view that does not draw: for tests without a browser."""

import contextlib
import threading

import msgspec
import viser
import zstandard
from websockets.exceptions import ConnectionClosedError
from websockets.sync.client import connect

_CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (0.0, 0.0, 5.0),
    "fov": 1.0,
    "near": 0.1,
    "far": 100.0,
    "image_height": 600,
    "image_width": 800,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}
_LENGTHS = 16  # [bytes] of the two lengths before the compressed part


class PageClient:
    """An open page: the nodes of the scene, the texts and the buttons of the panel."""

    def __init__(self, port, origin=None):
        """origin: address of the page that connects, as a browser tells it."""
        self.nodes = {}  # path -> type of the message that made it
        self.made = {}  # as nodes, with those that are gone
        self.messages = 0
        self.kinds = set()  # types of all messages
        self._texts, self._buttons, self._inputs = {}, {}, {}  # uuid -> content; label -> uuid, of both
        self._socket = connect(
            "ws://127.0.0.1:%d" % port,
            origin=origin,
            subprotocols=["viser-v%s" % viser.__version__],
            max_size=None,
            compression=None,
        )
        self._send(_CAMERA)
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def text(self):
        """Return the HTML of the panel."""
        return "".join(dict(self._texts).values())

    def labels(self):
        """Labels of the buttons."""
        return set(self._buttons)

    def press(self, label):
        """Click a button."""
        self._send({"type": "GuiUpdateMessage", "uuid": self._buttons[label], "updates": {"value": True}})

    def enter(self, label, value):
        """Type a text, or choose an option."""
        self._send({"type": "GuiUpdateMessage", "uuid": self._inputs[label], "updates": {"value": value}})

    def ask_for_tunnel(self):
        """Send what the share button of viser's page sends; our page has none."""
        self._send({"type": "ShareUrlRequest"})

    def close(self):
        """Disconnect, as by closing the tab."""
        self._socket.close()
        self._thread.join()

    def _send(self, message):
        self._socket.send(msgspec.msgpack.encode(message))

    def _listen(self):
        with contextlib.suppress(ConnectionClosedError):  # the server closed the connection
            for window in self._socket:
                length = int.from_bytes(window[8:_LENGTHS], "little")
                content = zstandard.ZstdDecompressor().decompress(window[_LENGTHS : _LENGTHS + length])
                for message in msgspec.msgpack.decode(content)["messages"]:
                    self.messages += 1
                    self.kinds.add(message["type"])
                    self._take(message)

    def _take(self, message):
        kind, uuid = message["type"], message.get("uuid")
        if kind == "RemoveSceneNodeMessage":
            self.nodes = {
                path: made
                for path, made in self.nodes.items()
                if path != message["name"] and not path.startswith(message["name"] + "/")
            }
        elif kind == "GuiHtmlMessage":
            self._texts[uuid] = message["props"]["content"]
        elif kind == "GuiUpdateMessage" and uuid in self._texts:
            self._texts[uuid] = message["updates"].get("content", self._texts[uuid])
        elif kind == "GuiButtonMessage":
            self._buttons[message["props"]["label"]] = uuid
        elif kind in ("GuiTextMessage", "GuiDropdownMessage"):
            self._inputs[message["props"]["label"]] = uuid
        elif kind == "GuiRemoveMessage":
            self._texts.pop(uuid, None)
            self._buttons = {label: other for label, other in self._buttons.items() if other != uuid}
        elif "name" in message and "props" in message:
            self.nodes[message["name"]] = self.made[message["name"]] = kind
