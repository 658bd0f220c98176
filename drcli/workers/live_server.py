"""Lets viewers on this machine connect to a worker, and sends each of them the newest it wants.

Each viewer has two threads that mostly wait. What is not sent yet is replaced by what is newer, so
a slow viewer sees less, and nobody waits for it.
"""

import socket
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from time import thread_time

from drcli.base.json_record import RecordError
from drcli.exchange.live_record import LiveRequest, LiveView
from drcli.exchange.live_wire import HOST, MOST_REQUEST_BYTES, WireError, admit, receive, send

MOST_VIEWERS = 8
"""Visitors at a time, those included that have not proved the key yet."""

GREETING_S = 3.0
"""How long a visitor may take to prove that it knows the key, and to say what it wants."""

SILENCE_S = 10.0
"""A viewer that does not read, or says nothing, for so long has gone. Viewers repeat their request
more often."""

SIGN_OF_LIFE_S = 2.0
"""If a viewer was sent nothing for so long, it gets the state once more."""

REQUEST_PAUSE_S = 0.02
"""Time between two requests of a viewer."""

BUFFER_BYTES = 1 << 16
"""Of a connection in the kernel: pictures must not become old there."""


class Viewer:
    """A connection to somebody who watches."""

    def __init__(self, peer: socket.socket, request: LiveRequest) -> None:
        self.request = request
        self.is_new = True
        self._peer = peer
        self._waiting: dict[LiveView, bytes] = {}
        self._state: dict[LiveView, bytes] = {}
        self._changed = threading.Condition()
        self._closed = False
        self._spent_s = self._told_s = 0.0

    def cost_s(self) -> float:
        """Processor time that sending to it has taken since the last call."""
        before_s, self._told_s = self._told_s, self._spent_s
        return self._told_s - before_s

    def offer(self, messages: Mapping[LiveView, bytes]) -> None:
        """Send messages as soon as the viewer takes them; returns at once."""
        with self._changed:
            self._waiting |= messages
            self._changed.notify()

    def close(self) -> None:
        """End the connection."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        with suppress(OSError):
            self._peer.shutdown(socket.SHUT_RDWR)

    def write(self) -> None:
        """Send what is offered until the connection ends."""
        try:
            while not self._closed:
                with self._changed:
                    if not (self._waiting or self._closed):
                        self._changed.wait(SIGN_OF_LIFE_S)
                    messages, self._waiting = self._waiting or self._state, {}
                    if "state" in messages:
                        self._state = {"state": messages["state"]}
                for data in messages.values():
                    send(self._peer, data)
                self._spent_s = thread_time()
        except OSError:
            self.close()


class LiveServer:
    """Listens on this machine for viewers that know the key."""

    def __init__(self, key: bytes, on_change: Callable[[], None]) -> None:
        """Begin to listen.

        Args:
            key: What viewers must know.
            on_change: Called from another thread when a viewer came, went or wants something else.

        Raises:
            OSError: This machine does not let it listen.
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
        """Stop listening, and end all connections."""
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
        """Let a visitor in, and take its requests until it leaves."""
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
