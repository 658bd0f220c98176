"""Connections that stand still or come in crowds: they are ended, and other pages go on."""

import contextlib
import json
import socket
import struct
import urllib.request

import pytest

from drcli.web import console_app as connection_limits
from drcli.web import serve, socket_route
from drcli.web.hub import Stored
from drcli.web.topics import Snapshot

HEAD = "GET /app.js HTTP/1.1\r\nHost: 127.0.0.1\r\n"


@pytest.fixture
def impatient(monkeypatch):
    """Limits of a tenth of a second."""
    for name in ("REQUEST_S", "STALLED_S", "POLL_S", "FAREWELL_S"):
        monkeypatch.setattr(connection_limits, name, 0.1)
    monkeypatch.setattr(socket_route, "SEND_S", 0.2)
    monkeypatch.setattr(serve, "IDLE_S", 1)


def rest_of(peer):
    """What the server still says until it ends the connection."""
    said = b""
    peer.settimeout(20.0)
    with contextlib.suppress(ConnectionError):
        while part := peer.recv(65_536):
            said += part
    peer.close()
    return said


def is_served(console):
    """Whether another page is answered."""
    with urllib.request.urlopen(f"{console.url}/app.js", timeout=20.0) as answer:
        return answer.status == 200


@pytest.mark.parametrize(
    "begun",
    [b"", b"G", b"GET / HTTP/1.1\r\nHo", HEAD.encode(), HEAD.encode() + b"X: " + b"y" * 1000],
)
def test_half_a_request_is_given_up(impatient, served, begun):
    assert rest_of(served.raw(begun)) == b""
    assert is_served(served)


def test_a_second_request_that_stops_half_way_is_given_up(impatient, served):
    peer = served.raw((HEAD + "\r\n").encode())
    said = peer.recv(65_536)
    peer.sendall(HEAD.encode())

    assert b"200 OK" in said + rest_of(peer)


def test_a_body_that_never_comes_is_given_up(impatient, served):
    head = f"POST /api/x HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: {served.url}\r\n"
    peer = served.raw(head.encode() + b"Content-Length: 1000\r\n\r\n{")

    assert b"200 OK" not in rest_of(peer)
    assert is_served(served)


@pytest.mark.parametrize(
    "sent",
    [
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
        b"\x00" * 5000,
        b"GET / HTTP/9.9\r\n\r\n",
        b"GET /\xff\xfe HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
        b"GET  HTTP/1.1\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nHost: evil.example\r\n\r\n",
        b"GET / HTTP/1.1\r\nContent-Length: -1\r\nHost: 127.0.0.1\r\n\r\n",
        b"GET http://evil.example/ HTTP/1.1\r\nHost: evil.example\r\n\r\n",
        b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n",
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: " + b"a" * 1_000_000 + b"\r\n\r\n",
        b"CONNECT evil.example:443 HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    ],
)
def test_what_is_no_request_is_refused(impatient, served, sent):
    with contextlib.suppress(ConnectionError):
        said = rest_of(served.raw(sent))
        assert b"200 OK" not in said
    assert is_served(served)


@pytest.mark.parametrize(
    "path",
    [
        "/../../../../etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/..%2f..%2fetc/passwd",
        "/\\..\\..\\etc\\passwd",
        "//etc/passwd",
        "/./app.js",
        "//app.js",
        "/data/viewer/viewer.json",
        "/system.env%00.js",
        "/api/../app.js/../../system.env",
        "/api/tasks/..%2f..%2fsystem.env",
        "/api/tasks/%00",
    ],
)
def test_no_file_outside_of_the_page_is_sent_however_its_path_is_written(served, path):
    request = f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n"

    said = rest_of(served.raw(request.encode()))

    assert b" 404 " in said.partition(b"\r\n")[0]
    assert b"root:" not in said
    assert b"DR_CLOUD" not in said


def test_a_huge_body_is_refused_and_not_kept(served):
    head = f"POST /api/nothing HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: {served.url}\r\n"
    peer = served.raw(head.encode() + b"Content-Length: 1000000000\r\nConnection: close\r\n\r\n")
    with contextlib.suppress(ConnectionError):
        for _ in range(200):
            peer.sendall(b" " * 65_536)

    assert b" 404 " in rest_of(peer).partition(b"\r\n")[0] or is_served(served)
    assert is_served(served)


def test_a_crowd_of_connections_keeps_no_page_from_being_served(served, monkeypatch):
    monkeypatch.setattr(connection_limits, "MOST_CONNECTIONS", 40)
    with served.watching("tasks") as page, contextlib.ExitStack() as crowd:
        assert page.next("tasks") == {"tasks": []}
        for _ in range(1000):
            crowd.enter_context(served.raw())
        assert is_served(served)
        page.watch("tasks", "machine")
        assert page.next("machine")["cores"] >= 1


def test_pages_that_are_used_are_never_ended_for_newer_connections(served, monkeypatch):
    monkeypatch.setattr(connection_limits, "MOST_CONNECTIONS", 5)
    with contextlib.ExitStack() as pages:
        opened = [pages.enter_context(served.watching("tasks")) for _ in range(5)]
        for page in opened:
            page.next("tasks")
        assert rest_of(served.raw(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")) == b""
        for page in opened:
            page.watch("machine")
            assert page.next("machine")["cores"] >= 1


def never_reads(served, topic):
    """A page with small buffers that opens a WebSocket, watches, and reads nothing more."""
    peer = socket.socket()
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    peer.connect(("127.0.0.1", served.port))
    head = f"GET /ws HTTP/1.1\r\nHost: 127.0.0.1:{served.port}\r\nOrigin: {served.url}\r\n"
    head += "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
    peer.sendall((head + "Sec-WebSocket-Key: MDEyMzQ1Njc4OTAxMjM0NQ==\r\n\r\n").encode())
    assert b"101" in peer.recv(300)
    peer.sendall(frame(json.dumps({"watch": [topic]}).encode()))
    return peer


def frame(data, opcode=1):
    """A frame of a client, with a mask of zeros."""
    size = len(data)
    length = bytes([0x80 | size]) if size < 126 else b"\xfe" + struct.pack(">H", size)
    return bytes([0x80 | opcode]) + length + bytes(4) + data


@pytest.fixture
def flood(served_app):
    """A topic `flood` with large values; publishing it gives all clients the next one."""
    _, folder = served_app
    count = iter(range(1 << 30))

    def value():
        return Snapshot.of("flood", [next(count), "x" * 500_000])

    folder.hub.add_kind("flood", lambda _, publish: Stored(publish, value))
    return lambda: folder.hub.publish("flood", value())


@pytest.fixture
def served_app(working_folder, monkeypatch):
    """A served console and what its routes share."""
    from drcli.web import console_app
    from served_console import served_console

    folders = []
    monkeypatch.setattr(
        console_app, "PARTS", (lambda folder: folders.append(folder) or [], *console_app.PARTS)
    )
    with served_console(working_folder) as console:
        yield console, folders[0]


def test_a_page_that_never_reads_is_cut_off_and_others_get_everything(impatient, served_app, flood):
    console, folder = served_app
    with console.watching("flood") as page:
        page.next("flood")
        lazy = never_reads(console, "flood")
        seen = page.next("flood")[0] if page.waiting["flood"] else -1
        for _ in range(400):
            flood()
            number = page.next("flood")[0]
            assert number > seen
            seen = number
            if len(folder.hub._clients) == 1 and number > 20:
                break
        assert len(folder.hub._clients) == 1
        lazy.close()
    assert is_served(console)


def test_answers_to_pings_that_nobody_reads_do_not_fill_the_memory(served, monkeypatch):
    monkeypatch.setattr(connection_limits, "WAITING_BYTES", 200_000)
    lazy = never_reads(served, "tasks")
    lazy.settimeout(20.0)
    pings = frame(b"x" * 120, opcode=9) * 500
    with pytest.raises(ConnectionError):
        lazy.sendall(pings * 2000)
    lazy.close()

    assert is_served(served)


def test_a_page_that_asks_all_the_time_is_slowed_and_gets_its_last_wish(served):
    with served.watching("tasks") as page:
        for number in range(40):
            page.watch(f"nothing:{number}")
        page.watch("machine")
        assert page.next("machine")["cores"] >= 1
