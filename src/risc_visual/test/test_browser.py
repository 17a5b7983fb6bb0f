"""The server of the page and its panel; also the internals of viser and websockets that it uses, which may change.

The page in a browser: tests/test_live_view.py.
"""

import contextlib
import socket
import urllib.error
import urllib.request

import pytest
import viser
from page_client import PageClient
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from risc_lab.ros.launching import free_tcp_port
from risc_lab.strangers import Guests, Strangers
from risc_lab.testing import wait_for
from risc_visual.browser import page_server
from risc_visual.browser.live_status import BrowserPanel
from risc_visual.browser.page_server import is_page_of_others, open_server


@pytest.fixture(scope="module")
def server():
    opened = open_server("127.0.0.1", free_tcp_port())
    yield opened
    opened.stop()


def test_the_page_is_one_file_that_loads_nothing_from_elsewhere(server):
    with urllib.request.urlopen("http://127.0.0.1:%d" % server.get_port(), timeout=20.0) as answer:
        page = answer.read().decode()
    assert "<html" in page
    assert 'src="http' not in page and 'href="http' not in page


def test_nobody_gets_a_tunnel_to_the_internet(server):
    page = PageClient(server.get_port())
    try:
        page.ask_for_tunnel()
        wait_for(lambda: server.get_clients(), "the page")
        button = server.gui.add_button("asked later, so the request has been worked off")
        wait_for(lambda: button.label in page.labels(), "the button")
        button.remove()
    finally:
        page.close()
    assert "ShareUrlUpdated" not in page.kinds
    assert server.request_share_url() is None


def test_a_port_that_is_taken_is_told(server):
    with pytest.raises(ValueError, match="%d.*127.0.0.1" % server.get_port()):
        open_server("127.0.0.1", server.get_port())


def test_an_address_of_another_computer_is_told():
    with pytest.raises(ValueError, match="192.0.2.1.*127.0.0.1"):
        open_server("192.0.2.1", free_tcp_port())


def test_two_buttons_pressed_at_once_land_both(server):
    """Each press is carried out later, in a thread of its own."""
    landed = []
    BrowserPanel(server, ["risc1", "risc2"], lambda: landed.append("all"), landed.append)
    page = PageClient(server.get_port())
    try:
        wait_for(lambda: page.labels() == {"LAND ALL", "land risc1", "land risc2"}, lambda: str(page.labels()))
        for label in ("land risc1", "land risc2", "LAND ALL"):
            page.press(label)
        wait_for(lambda: len(landed) == 3, lambda: str(landed))
    finally:
        page.close()
        server.gui.reset()
    assert sorted(landed) == ["all", "risc1", "risc2"]


@pytest.mark.parametrize("origin", ["http://elsewhere.example", "http://127.0.0.1:1", "http://localhost:%d", "null"])
def test_pages_of_others_are_refused(server, origin):
    if "%" in origin:  # asked for as 127.0.0.1
        origin %= server.get_port()
    with pytest.raises(InvalidStatus, match="403"):
        PageClient(server.get_port(), origin)


def test_a_name_that_was_made_to_lead_here_is_refused(server):
    """DNS rebinding: a page of evil.example, whose name now resolves to this computer. Origin and Host agree."""
    host = "evil.example:%d" % server.get_port()
    for headers in ({"Host": host, "Origin": "http://" + host}, {"Host": host}):
        request = urllib.request.Request("http://127.0.0.1:%d/" % server.get_port(), headers=headers)
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(request, timeout=10.0)


@pytest.mark.parametrize("name", ["localhost", "127.0.0.1", "[::1]", "192.168.0.10", socket.gethostname()])
def test_names_and_addresses_of_this_computer_are_served(name):
    host = name + ":8080"
    assert not is_page_of_others({"Host": host, "Origin": "http://" + host})
    assert not is_page_of_others({"Host": name.upper()})


@pytest.mark.parametrize("host", ["", "[::1", "evil.example", "localhost.evil.example:80", "127.0.0.1.evil.example"])
def test_names_of_others_are_not(host):
    assert is_page_of_others({"Host": host, "Origin": "http://" + host})


def is_served(port, source="127.0.0.1"):
    """Whether a client that connects from this loopback address gets the page."""
    with contextlib.suppress(ConnectionError):
        with socket.create_connection(("127.0.0.1", port), 20.0, source_address=(source, 0)) as sock:
            sock.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
            return sock.recv(100).startswith(b"HTTP/1.1 200")
    return False


@pytest.fixture
def guarded(monkeypatch):
    """open(guests) -> (port, Strangers). Loopback addresses are not trusted here: they stand for other computers."""
    with contextlib.ExitStack() as stack:

        def open_guarded(*guests):
            monkeypatch.setattr(Guests, "_is_loopback", lambda self, address: False)
            strangers = Strangers(lambda level, text: None, "page")
            opened = open_server("127.0.0.1", free_tcp_port(), Guests(guests), strangers)
            stack.callback(opened.stop)
            return opened.get_port(), strangers

        yield open_guarded


def test_only_guests_and_this_computer_get_the_page(guarded):
    port, strangers = guarded("127.0.0.7")
    assert is_served(port) and is_served(port, "127.0.0.7")
    assert not is_served(port, "127.0.0.8")
    assert str(strangers) == "127.0.0.8: 1"


@pytest.mark.parametrize("is_limited", [True, False])
def test_who_keeps_connections_open_keeps_nobody_out(guarded, monkeypatch, is_limited):
    """A guest opens many and sends nothing or little on them (slow loris). Control arm: no limit for one address."""
    if not is_limited:
        monkeypatch.setattr(page_server, "MAX_OF_ONE_ADDRESS", 1000)
    port, strangers = guarded("127.0.0.0/8")
    with contextlib.ExitStack() as stack:
        for number in range(page_server.MAX_CONNECTIONS + 8):
            slow = socket.create_connection(("127.0.0.1", port), 20.0, source_address=("127.0.0.7", 0))
            stack.callback(slow.close)
            with contextlib.suppress(OSError):
                slow.sendall(b"GET / HTTP/1.1\r\n"[: number % 16])
        wait_for(lambda: strangers.count >= 8, "the refusals")
        assert is_served(port, "127.0.0.9") is is_limited
    wait_for(lambda: is_served(port, "127.0.0.9"), "the room that they leave")


@pytest.mark.parametrize("takes_files", [False, True])
def test_nobody_fills_the_memory_with_a_file(takes_files):
    opened = open_server("127.0.0.1", free_tcp_port())
    if takes_files:  # the control arm
        kind = viser._messages.FileTransferStartUpload
        opened.gui._websock_interface.register_handler(kind, opened.gui._handle_file_transfer_start)
    pressed = []
    button = opened.gui.add_button("press")
    button.on_click(lambda _event: pressed.append(True))
    page = PageClient(opened.get_port())
    try:
        wait_for(lambda: "press" in page.labels(), "the button")
        whose = {"source_component_uuid": page._buttons["press"], "transfer_uuid": "1"}
        text = {"filename": "a", "mime_type": "b", "part_count": 1000, "size_bytes": 10**9}
        page._send({"type": "FileTransferStartUpload", **whose, **text})
        for index in range(10):
            page._send({"type": "FileTransferPart", **whose, "part_index": index, "content": bytes(100_000)})
        page.press("press")  # it comes after all of the data
        wait_for(lambda: pressed, "the click")
        kept = [state["transferred_bytes"] for state in opened.gui._current_file_upload_states.values()]
        assert (sum(kept) > 0) is takes_files
    finally:
        page.close()
        opened.stop()


def test_a_message_too_long_for_a_page_ends_its_connection(server):
    url = "ws://127.0.0.1:%d" % server.get_port()
    with connect(url, subprotocols=["viser-v%s" % viser.__version__], max_size=None, compression=None) as page:
        with pytest.raises(ConnectionClosed, match="message too big"):
            page.send(bytes(page_server.MAX_MESSAGE_BYTES + 1))
            while True:
                page.recv(20.0)


@pytest.mark.parametrize("is_limited", [True, False])
def test_a_page_that_sends_too_much_is_cut_off_and_named(guarded, monkeypatch, is_limited):
    if not is_limited:  # the control arm
        monkeypatch.setattr(page_server, "MAX_MESSAGES_S", 10**9)
    port, strangers = guarded("127.0.0.1")
    page = PageClient(port)
    try:
        with contextlib.suppress(ConnectionClosed):
            for _ in range(5000):
                page._socket.ping()
            assert page._socket.ping().wait(20.0) and not is_limited
        assert str(strangers) == ("127.0.0.1: 1" if is_limited else "none")
    finally:
        page.close()
    assert is_served(port), "another one is let in"


def test_its_own_page_is_served(server):
    page = PageClient(server.get_port(), "http://127.0.0.1:%d" % server.get_port())
    try:
        wait_for(lambda: server.get_clients(), "the page")
    finally:
        page.close()
