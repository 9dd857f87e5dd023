"""Who may drive in the browser: pages of this machine, and no other site's."""

import contextlib
import http.client
import socket
import time

import pytest

pytest.importorskip("viser")

import msgspec
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from carpark_mj.rendering.local_pages import HOST
from carpark_mj.rendering.local_server import LocalServer


@pytest.fixture(scope="module")
def server():
    server = LocalServer(HOST, 8771, "a lot")
    yield server
    server.stop()


def answer(server, **headers):
    connection = http.client.HTTPConnection(HOST, server.get_port(), timeout=10)
    with contextlib.closing(connection):
        connection.request("GET", "/", headers=headers)
        return connection.getresponse()


def page(server, origin):
    """Opens what a page from somewhere would drive through."""
    return connect(
        f"ws://{HOST}:{server.get_port()}",
        origin=origin,
        subprotocols=[f"viser-v{viser.__version__}"],
        compression=None,
        max_size=None,
    )


@pytest.mark.parametrize(
    ("headers", "code"),
    [
        ({}, 200),
        ({"Host": "127.0.0.1:8771"}, 200),
        ({"Host": "localhost:9000"}, 200),  # through `ssh -L 9000:localhost:8771`
        ({"Host": "evil.example:8771"}, 403),  # a name that leads here, by its owner
        ({"Host": "localhost.evil.example"}, 403),
        ({"Origin": "http://evil.example"}, 403),
    ],
)
def test_the_page_is_for_who_calls_the_machine_by_its_own_name(server, headers, code):
    found = answer(server, **headers)
    assert found.status == code
    if code == 200:  # no page may frame it
        assert "frame-ancestors 'none'" in found.headers["Content-Security-Policy"]


def test_it_stops_beside_a_connection_that_sends_nothing():
    server = LocalServer(HOST, 8781, "a lot")
    with socket.create_connection((HOST, server.get_port())) as idle:
        while not server._serving.handlers:
            time.sleep(0.01)
        server.stop()
        with contextlib.suppress(ConnectionError):
            assert idle.recv(1) == b""
    assert not server._serving.handlers  # viser gave up waiting for them


def test_the_websocket_is_for_the_page_alone(server):
    own = f"http://{HOST}:{server.get_port()}"
    with page(server, own) as opened:
        assert opened.recv(timeout=10)
    for origin in ("http://evil.example", "null", None, f"http://{HOST}:1", own[:-1]):
        with pytest.raises(InvalidStatus, match="403"):
            page(server, origin)


def test_no_tunnel_is_opened_and_nonsense_prints_no_traceback(
    server, monkeypatch, capfd, caplog
):
    opened = []
    monkeypatch.setattr("viser._viser.ViserTunnel", lambda *a: opened.append(a))
    slider = server.gui.add_slider("wheel", -1.0, 1.0, 0.1, 0.0)
    update = {"type": "GuiUpdateMessage", "uuid": slider._impl.uuid}
    messages = [
        {"type": "ShareUrlRequest"},
        {"type": "ShareUrlDisconnect"},
        {**update, "updates": {"value": "fast"}},
        {**update, "updates": 5},
        {"type": "Nothing"},
    ]
    with page(server, f"http://{HOST}:{server.get_port()}") as driver:
        for message in messages:
            driver.send(msgspec.msgpack.encode(message))
        for _ in range(100):  # until the last is answered by the end
            if not server._websock_server._live_connections:
                break
            time.sleep(0.05)
    assert not opened
    assert slider.value == 0.0
    assert "Traceback" not in capfd.readouterr().err
    assert [record.exc_info for record in caplog.records] == [None] * 3  # one line each
    assert answer(server).status == 200
