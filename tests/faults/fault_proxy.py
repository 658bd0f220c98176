"""A proxy between the S3 clients of one machine and their server, which makes a network fail.

It forwards HTTP/1.1 requests unchanged (the signature covers the header Host, so that stays too),
and while a `Network` says so, it refuses, delays, answers with errors, or cuts bodies. Every
request that changes an object is remembered with its time, so that an auditor can tell which
machine wrote what, and when.
"""

import asyncio
import random
import threading
import time
from collections.abc import Callable, Coroutine
from contextlib import suppress
from dataclasses import dataclass, replace
from email.utils import formatdate, parsedate_to_datetime
from typing import Any, Literal
from urllib.parse import unquote, urlsplit

HEAD_BYTES = 1 << 16
CHUNK_BYTES = 1 << 14

Part = Literal["request", "answer"]

CODES = {
    "internal": (500, "InternalError"),
    "busy": (503, "ServiceUnavailable"),
    "slow_down": (503, "SlowDown"),
    "full": (507, "XMinioStorageFull"),
}
"""HTTP status and code of the errors that the proxy may answer."""


@dataclass(frozen=True)
class Network:
    """How the network treats requests from now on.

    Attributes:
        refused: No connection is accepted, and open ones are closed.
        silent: Connections are accepted, but nothing is answered.
        latency_s: Delay of each request.
        bytes_per_s: Bandwidth of all connections together, in each direction; None for no limit.
        error: A key of `CODES`; only writes are answered with `full`.
        error_share: Share of the requests that are answered so.
        cut: Whether bodies break off in the middle of the request or of the answer.
        cut_share: Share of the requests with a body for which they do.
        old_lists: A listing that was asked for before is answered as it was then.
        server_ahead_s: The server's clock is ahead by so much in the header Date.
    """

    refused: bool = False
    silent: bool = False
    latency_s: float = 0.0
    bytes_per_s: float | None = None
    error: str = "internal"
    error_share: float = 0.0
    cut: Part = "answer"
    cut_share: float = 0.0
    old_lists: bool = False
    server_ahead_s: float = 0.0


@dataclass(frozen=True)
class Trap:
    """Does something when an object is written, and then breaks that connection.

    Attributes:
        catches: Whether it is about this path, which is bucket and key.
        when: Whether the server has the object by then.
        do: Called in the thread of the proxy; may kill the client.
    """

    catches: Callable[[str], bool]
    when: Literal["before", "after"]
    do: Callable[[], object]


@dataclass(frozen=True)
class Write:
    """A request that changed objects and was answered with success.

    Attributes:
        began_s: When it was complete at the proxy, monotonic seconds.
        ended_s: When the server had answered.
        method: PUT, DELETE or POST.
        path: Bucket and key.
    """

    began_s: float
    ended_s: float
    method: str
    path: str


@dataclass
class Counts:
    """What has passed through the proxy."""

    requests: int = 0
    sent_bytes: int = 0
    received_bytes: int = 0
    failed: int = 0


@dataclass(frozen=True)
class _Head:
    lines: list[bytes]
    headers: dict[str, str]

    @property
    def first(self) -> list[str]:
        return self.lines[0].decode("latin-1").split(" ", 2)

    def encode(self) -> bytes:
        return b"\r\n".join([*self.lines, b"", b""])

    def without(self, name: str) -> "_Head":
        start = f"{name.lower()}:".encode()
        kept = [line for line in self.lines if not line.lower().startswith(start)]
        return _Head(kept, {k: v for k, v in self.headers.items() if k != name.lower()})

    def with_line(self, name: str, value: str) -> "_Head":
        head = self.without(name)
        line = f"{name}: {value}".encode("latin-1")
        return _Head([*head.lines, line], {**head.headers, name.lower(): value})


class _Cut(Exception):
    """A connection breaks off."""


class Proxy:
    """Forwards requests to the S3 server on a local port. Close it when done.

    Args:
        port: Of the server; may change later.
        seed: Decides which requests fail.
    """

    def __init__(self, port: int, seed: int = 0) -> None:
        self.server_port = port
        self.writes: list[Write] = []
        self.trap: Trap | None = None
        self.counts = Counts()
        self._network = Network()
        self._random = random.Random(seed)
        self._lists: dict[str, tuple[bytes, bytes]] = {}
        self._old_lists: dict[str, tuple[bytes, bytes]] = {}
        self._free_at_s = 0.0
        self._connections: set[asyncio.StreamWriter] = set()
        self._server: asyncio.Server | None = None
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="proxy", daemon=True)
        self._thread.start()
        self.port = 0
        self._call(self._listen())

    @property
    def url(self) -> str:
        """The address for clients."""
        return f"http://127.0.0.1:{self.port}"

    @property
    def network(self) -> Network:
        """How the network is now."""
        return self._network

    def set(self, **changes: Any) -> None:
        """Change the network; nothing happens if the proxy is closed."""
        before = self._network
        self._network = replace(before, **changes)
        if self._network.old_lists and not before.old_lists:
            self._old_lists = dict(self._lists)
        if self._network.refused != before.refused and not self._loop.is_closed():
            self._call(self._hang_up() if self._network.refused else self._listen())

    def close(self) -> None:
        """End all connections and the proxy."""
        self._call(self._hang_up())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def _call(self, task: Coroutine[Any, Any, None]) -> None:
        asyncio.run_coroutine_threadsafe(task, self._loop).result(30)

    async def _listen(self) -> None:
        self._server = await asyncio.start_server(
            self._serve, "127.0.0.1", self.port, limit=HEAD_BYTES, reuse_address=True
        )
        self.port = self._server.sockets[0].getsockname()[1]

    async def _hang_up(self) -> None:
        if self._server is not None:
            self._server.close()
            self._server = None
        for writer in list(self._connections):
            writer.transport.abort()
        await asyncio.sleep(0)
        ours = asyncio.current_task()
        others = [task for task in asyncio.all_tasks() if task is not ours]
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._connections.add(writer)
        try:
            while (head := await _read_head(reader)) is not None:
                await self._exchange(head, reader, writer)
        except (_Cut, OSError, EOFError, asyncio.CancelledError, asyncio.LimitOverrunError):
            writer.transport.abort()
        finally:
            self._connections.discard(writer)
            writer.close()

    async def _exchange(
        self, head: _Head, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        """Forward one request and its answer."""
        network = self._network
        self.counts.requests += 1
        if network.silent:
            while self._network.silent:
                await asyncio.sleep(0.1)
            raise _Cut
        await asyncio.sleep(network.latency_s)
        if "100-continue" in head.headers.get("expect", ""):
            writer.write(b"HTTP/1.1 100 Continue\r\n\r\n")
            await writer.drain()
        body = await reader.readexactly(int(head.headers.get("content-length", "0")))
        await self._pace(len(body))
        self.counts.received_bytes += len(body)
        method, path, _ = head.first
        changes = method in ("PUT", "DELETE", "POST")
        if self._random.random() < network.error_share and (network.error != "full" or changes):
            self.counts.failed += 1
            writer.write(_error_answer(*CODES[network.error], body_too=method != "HEAD"))
            await writer.drain()
            return
        cuts = self._random.random() < network.cut_share
        request = head.without("Expect").encode()
        if cuts and network.cut == "request" and body:
            self.counts.failed += 1
            await self._send_half(request, body)
            raise _Cut
        if network.old_lists and path in self._old_lists:
            answer, content = self._old_lists[path]
            writer.write(answer + content)
            await writer.drain()
            return
        place = unquote(urlsplit(path).path).lstrip("/")
        trap = self.trap if method == "PUT" else None
        if trap is not None and not trap.catches(place):
            trap = None
        if trap is not None and trap.when == "before":
            self._spring(trap)
        began_s = time.monotonic()
        answer_head, content = await self._ask_server(request + body, method)
        if changes and answer_head.first[1].startswith("2"):
            # A POST deletes several objects, or completes one that was sent in parts.
            self.writes.append(Write(began_s, time.monotonic(), method, place))
        if trap is not None:
            self._spring(trap)
        if network.server_ahead_s and "date" in answer_head.headers:
            at = parsedate_to_datetime(answer_head.headers["date"]).timestamp()
            shifted = formatdate(at + network.server_ahead_s, usegmt=True)
            answer_head = answer_head.with_line("Date", shifted)
        answer = answer_head.encode()
        if "list-type=2" in path and answer_head.first[1] == "200":
            self._lists[path] = answer, content
        self.counts.sent_bytes += len(content)
        await self._pace(len(content))
        writer.write(answer)
        if cuts and network.cut == "answer" and content:
            self.counts.failed += 1
            writer.write(content[: len(content) // 2])
            await writer.drain()
            raise _Cut
        writer.write(content)
        await writer.drain()

    def _spring(self, trap: Trap) -> None:
        self.trap = None
        self.counts.failed += 1
        trap.do()
        raise _Cut

    async def _pace(self, size: int) -> None:
        rate = self._network.bytes_per_s
        if rate is None or not size:
            return
        now_s = time.monotonic()
        self._free_at_s = max(now_s, self._free_at_s) + size / rate
        await asyncio.sleep(self._free_at_s - now_s)

    async def _send_half(self, request: bytes, body: bytes) -> None:
        """Let the server see a request whose body breaks off."""
        with suppress(OSError):
            _, to_server = await asyncio.open_connection("127.0.0.1", self.server_port)
            to_server.write(request + body[: len(body) // 2])
            await to_server.drain()
            to_server.transport.abort()

    async def _ask_server(self, request: bytes, method: str) -> tuple[_Head, bytes]:
        """The server's answer, with all of its body."""
        reader, writer = await asyncio.open_connection(
            "127.0.0.1", self.server_port, limit=HEAD_BYTES
        )
        try:
            writer.write(request)
            await writer.drain()
            head = await _read_head(reader)
            while head is not None and head.first[1] == "100":
                head = await _read_head(reader)
            if head is None:
                raise _Cut
            if method == "HEAD" or head.first[1] in ("204", "304"):
                return head, b""
            if "chunked" in head.headers.get("transfer-encoding", ""):
                content = await _read_chunks(reader)
                head = head.without("Transfer-Encoding")
                return head.with_line("Content-Length", str(len(content))), content
            size = int(head.headers.get("content-length", "0"))
            return head, await reader.readexactly(size)
        finally:
            writer.close()


async def _read_head(reader: asyncio.StreamReader) -> _Head | None:
    try:
        data = await reader.readuntil(b"\r\n\r\n")
    except asyncio.IncompleteReadError:
        return None
    lines = data[:-4].split(b"\r\n")
    pairs = (line.decode("latin-1").partition(":") for line in lines[1:])
    return _Head(lines, {name.strip().lower(): value.strip() for name, _, value in pairs})


async def _read_chunks(reader: asyncio.StreamReader) -> bytes:
    content = b""
    while size := int((await reader.readline()).split(b";")[0], 16):
        content += await reader.readexactly(size)
        await reader.readline()
    await reader.readline()
    return content


def _error_answer(status: int, code: str, *, body_too: bool) -> bytes:
    text = (
        f'<?xml version="1.0" encoding="UTF-8"?><Error><Code>{code}</Code>'
        f"<Message>Made by the proxy.</Message></Error>"
    ).encode()
    head = (
        f"HTTP/1.1 {status} {code}\r\nContent-Type: application/xml\r\n"
        f"Content-Length: {len(text)}\r\nDate: {formatdate(usegmt=True)}\r\n\r\n"
    ).encode()
    return head + (text if body_too else b"")
