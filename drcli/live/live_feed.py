"""Watches running workers of this machine: cameras, poses.

Nothing is read from a worker that nobody watches.
"""

import socket
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from drcli.base.files import find_files
from drcli.base.framing import WireError, receive
from drcli.base.json_record import RecordError
from drcli.live.live_record import (
    HOST,
    LIVE_FILES,
    MOST_MESSAGE_BYTES,
    LiveAddress,
    LiveMessage,
    LiveRequest,
    LiveView,
    enter,
    send,
)

POLL_S = 1.0
CONNECT_S = 3.0

SILENCE_S = 8.0
"""A worker sends its state every two seconds."""

REPEAT_S = 3.0
"""The request is a sign of life."""

BUFFER_BYTES = 1 << 16
"""In the kernel: pictures must not become old there."""

WorkerKey = tuple[int, str]
OnMessage = Callable[[int, str, LiveMessage], None]


@dataclass(frozen=True)
class LiveWorker:
    run_id: int
    worker: str
    pid: int
    watched: bool = False


class LiveFeed:
    """The newest messages of the workers of a folder that somebody watches.

    One thread for each worker calls the callbacks, and drops messages meanwhile. They may call
    all methods but `close`.
    """

    def __init__(
        self,
        directory: Path,
        on_message: OnMessage,
        on_gone: Callable[[int, str], None] = lambda run_id, worker: None,
        *,
        poll_s: float = POLL_S,
    ) -> None:
        """Begin to look for workers.

        `on_gone` is called when a connection has ended; it is made again.
        """
        self._runs = directory / "data" / "runs"
        self._on_message = on_message
        self._on_gone = on_gone
        self._poll_s = poll_s
        self._lock = threading.Lock()
        self._wanted: dict[WorkerKey, LiveRequest] = {}
        self._links: dict[WorkerKey, _Link] = {}
        self._wake = threading.Event()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="live-feed", daemon=True)
        self._thread.start()

    def watch(
        self, run_id: int, worker: str, views: Iterable[LiveView], car: int | None = None
    ) -> None:
        """Say what to watch, also of a worker that does not run yet.

        Without `car`, it is the one that has come furthest.
        """
        request = LiveRequest(tuple(sorted(set(views))), car)
        key = run_id, worker
        with self._lock:
            if request.views:
                self._wanted[key] = request
            else:
                self._wanted.pop(key, None)
            link = self._links.get(key)
        if link is not None:
            link.ask(request if request.views else None)
        self._wake.set()

    def workers(self) -> list[LiveWorker]:
        with self._lock:
            watched = {key for key, link in self._links.items() if link.is_open}
        return [
            LiveWorker(*key, address.pid, key in watched)
            for key, address in sorted(self._found().items())
        ]

    def close(self) -> None:
        """No callback is called after it."""
        with self._lock:
            self._closed = True
            links = list(self._links.values())
        for link in links:
            link.ask(None)
        self._wake.set()
        for thread in (self._thread, *(link.thread for link in links)):
            if thread is not threading.current_thread():
                thread.join(CONNECT_S)

    def _found(self) -> dict[WorkerKey, LiveAddress]:
        found = {}
        for path in [
            *find_files(self._runs, f"*/{LIVE_FILES}"),
            *find_files(self._runs, f"*/evaluations/*/{LIVE_FILES}"),
        ]:
            key = _key(path)
            address = LiveAddress.read(path) if key is not None else None
            if key is not None and address is not None and address.is_usable:
                found[key] = address
        return found

    def _run(self) -> None:
        while not self._closed:
            with self._lock:
                missing = self._wanted.keys() - self._links.keys()
            if missing:
                self._connect(missing)
            # Without a wanted worker there is nothing to look for.
            self._wake.wait(self._poll_s if self._wanted else None)
            self._wake.clear()

    def _connect(self, missing: Iterable[WorkerKey]) -> None:
        with suppress(OSError):
            found = self._found()
            for key in missing:
                if key in found:
                    self._begin(key, found[key])

    def _begin(self, key: WorkerKey, address: LiveAddress) -> None:
        with self._lock:
            request = self._wanted.get(key)
            if request is None or self._closed or key in self._links:
                return
            link = self._links[key] = _Link(address, request)
            link.thread = threading.Thread(
                target=self._follow, args=(key, link), name="live-link", daemon=True
            )
        link.thread.start()

    def _follow(self, key: WorkerKey, link: "_Link") -> None:
        was_open = False
        try:
            link.open()
            was_open = True
            while (message := link.next_message()) is not None:
                if not self._closed:
                    self._on_message(*key, message)
        except (OSError, WireError, RecordError):
            pass  # it has ended, or is another program; it is looked for again
        finally:
            link.end()
            with self._lock:
                self._links.pop(key, None)
            if was_open and not self._closed:
                self._on_gone(*key)


class _Link:
    def __init__(self, address: LiveAddress, request: LiveRequest) -> None:
        self.thread = threading.current_thread()
        self.is_open = False
        self._address = address
        self._request: LiveRequest | None = request
        self._peer: socket.socket | None = None
        self._lock = threading.Lock()
        self._ended = threading.Event()

    def open(self) -> None:
        peer = socket.create_connection((HOST, self._address.port), timeout=CONNECT_S)
        with self._lock:
            self._peer = peer
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        enter(peer, self._address.secret)
        self._send()
        peer.settimeout(SILENCE_S)
        self.is_open = True
        threading.Thread(target=self._repeat, name="live-repeat", daemon=True).start()

    def ask(self, request: LiveRequest | None) -> None:
        self._request = request
        if request is None:
            self.end()
        elif self.is_open:
            with suppress(OSError):
                self._send()

    def next_message(self) -> LiveMessage | None:
        assert self._peer is not None, "opened before"
        try:
            return LiveMessage.decode(receive(self._peer, MOST_MESSAGE_BYTES))
        except (OSError, WireError):
            if self._ended.is_set():
                return None
            raise

    def end(self) -> None:
        self._ended.set()
        self.is_open = False
        with self._lock:
            if self._peer is not None:
                with suppress(OSError):
                    self._peer.shutdown(socket.SHUT_RDWR)
                self._peer.close()

    def _send(self) -> None:
        with self._lock:
            request = self._request
            if self._peer is not None and request is not None:
                send(self._peer, request.encode())

    def _repeat(self) -> None:
        while not self._ended.wait(REPEAT_S):
            try:
                self._send()
            except OSError:
                return


def _key(path: Path) -> WorkerKey | None:
    name = path.stem.removeprefix("live-")
    folder = path.parent
    if folder.parent.name == "evaluations":
        name, folder = f"{name}-{folder.name}", folder.parent.parent
    return (int(folder.name), name) if folder.name.isdecimal() and name else None
