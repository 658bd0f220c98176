"""Lets viewers on this machine connect to a worker.

Each viewer has two threads. A slow viewer sees less, and nobody waits for it.
"""

import socket
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from time import monotonic, thread_time

from drcli.base.json_record import RecordError
from drcli.exchange.framing import WireError, framed, receive
from drcli.exchange.live_record import LiveRequest, LiveView
from drcli.exchange.live_wire import HOST, MOST_REQUEST_BYTES, admit

MOST_VIEWERS = 8
GREETING_S = 3.0
"""To prove the key, and to say what it wants."""

SILENCE_S = 10.0
"""Viewers repeat their request more often."""

SIGN_OF_LIFE_S = 2.0
"""Then a viewer gets the state once more."""

REQUEST_PAUSE_S = 0.02
BUFFER_BYTES = 1 << 16
"""In the kernel: pictures must not become old there."""


class Viewer:
    def __init__(self, peer: socket.socket, request: LiveRequest) -> None:
        self.request = request
        self.is_new = True
        self._peer = peer
        self._direct = peer.dup()
        self._direct.setblocking(False)
        self._waiting: dict[LiveView, bytes] = {}
        self._rest = b""
        self._state: bytes | None = None
        self._changed = threading.Condition()
        self._writes = False
        self._closed = False
        self._sent_s = monotonic()
        self._spent_s = self._told_s = 0.0

    def cost_s(self) -> float:
        """Processor time of its own thread since the last call."""
        before_s, self._told_s = self._told_s, self._spent_s
        return self._told_s - before_s

    def offer(self, messages: Mapping[LiveView, bytes]) -> None:
        """Returns at once.

        The caller sends what the connection takes: waking a thread costs more than the rest of
        a picture.
        """
        with self._changed:
            if self._closed:
                return
            self._waiting |= messages
            self._state = messages.get("state", self._state)
            if not self._writes:
                self._send_now()
            if self._waiting or self._rest:
                self._changed.notify()

    def _send_now(self) -> None:
        while self._waiting and not self._rest:
            view = next(iter(self._waiting))
            data = framed(self._waiting[view])
            try:
                count = self._direct.send(data)
            except BlockingIOError:
                return
            except OSError:  # it left; the thread that reads from it notices that, too
                self._waiting.clear()
                return
            del self._waiting[view]
            self._rest = data[count:]
            self._sent_s = monotonic()

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._direct.close()
            self._changed.notify()
        with suppress(OSError):
            self._peer.shutdown(socket.SHUT_RDWR)

    def write(self) -> None:
        try:
            while not self._closed:
                data = self._taken()
                if data:
                    self._peer.sendall(data)
                    self._sent_s = monotonic()
                self._spent_s = thread_time()
        except OSError:
            self.close()

    def _taken(self) -> bytes:
        with self._changed:
            self._writes = False
            if not (self._rest or self._waiting or self._closed):
                self._changed.wait(SIGN_OF_LIFE_S)
            rest, waiting = self._rest, self._waiting
            self._rest, self._waiting = b"", {}
            if not (rest or waiting) and self._state is not None:
                if monotonic() - self._sent_s < SIGN_OF_LIFE_S:
                    return b""
                waiting = {"state": self._state}
            self._writes = True
            return rest + b"".join(map(framed, waiting.values()))


class LiveServer:
    def __init__(self, key: bytes, on_change: Callable[[], None]) -> None:
        """Begin to listen; OSError if this machine does not allow it.

        `on_change` is called from another thread when a viewer came, went or wants something
        else.
        """
        self._key = key
        self._on_change = on_change
        self._lock = threading.Lock()
        self._visitors = 0
        self._closed = threading.Event()
        self.viewers: tuple[Viewer, ...] = ()
        """Those who watch now; replaced as a whole."""
        self._listener = socket.create_server((HOST, 0), backlog=MOST_VIEWERS)
        self.port: int = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, name="live-accept", daemon=True).start()

    def close(self) -> None:
        self._closed.set()
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for viewer in self.viewers:
            viewer.close()

    def _accept(self) -> None:
        while not self._closed.is_set():
            try:
                peer, _ = self._listener.accept()
            except OSError:  # too many open files, or this server was closed
                self._closed.wait(1.0)
                continue
            with self._lock:
                has_room = self._visitors < MOST_VIEWERS and not self._closed.is_set()
                self._visitors += has_room
            if not has_room or not self._start(self._receive, peer):
                peer.close()

    def _start(self, target: Callable[[socket.socket], None], peer: socket.socket) -> bool:
        try:
            threading.Thread(target=target, args=(peer,), name="live-viewer", daemon=True).start()
        except RuntimeError:  # no more threads; the visitor may try again
            with self._lock:
                self._visitors -= 1
            return False
        return True

    def _receive(self, peer: socket.socket) -> None:
        viewer = None
        try:
            peer.settimeout(GREETING_S)
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER_BYTES)
            admit(peer, self._key)
            request = LiveRequest.decode(receive(peer, MOST_REQUEST_BYTES))
            viewer = Viewer(peer, request)
            peer.settimeout(SILENCE_S)
            threading.Thread(target=viewer.write, name="live-sender", daemon=True).start()
            with self._lock:
                self.viewers = (*self.viewers, viewer)
            while not self._closed.is_set():
                self._on_change()
                while request == viewer.request:
                    self._closed.wait(REQUEST_PAUSE_S)
                    request = LiveRequest.decode(receive(peer, MOST_REQUEST_BYTES))
                viewer.request = request
        except (OSError, WireError, RecordError, RuntimeError):
            pass  # it left, or is none of ours
        finally:
            if viewer is not None:
                viewer.close()
            peer.close()
            with self._lock:
                self.viewers = tuple(each for each in self.viewers if each is not viewer)
                self._visitors -= 1
            self._on_change()
