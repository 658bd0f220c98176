"""The console of a folder, served on a free port by a thread of the tests."""

import contextlib
import json
import socket
import threading
from collections import defaultdict, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

from drcli.base.clock import wait_until
from drcli.web.console_app import build_app
from drcli.web.serve import server_of

SOON_S = 30.0


@dataclass
class ServedConsole:
    """A console that runs."""

    folder: Path
    port: int

    @property
    def url(self) -> str:
        """Its address."""
        return f"http://127.0.0.1:{self.port}"

    @contextlib.contextmanager
    def watching(self, *topics: str, **options: Any) -> Iterator["Watcher"]:
        """A WebSocket that watches topics."""
        given = {"origin": self.url, "open_timeout": SOON_S, **options}
        with connect(f"ws://127.0.0.1:{self.port}/ws", **given) as opened:
            watcher = Watcher(opened)
            watcher.watch(*topics)
            yield watcher

    def raw(self, data: bytes = b"") -> socket.socket:
        """A connection over which something was sent."""
        peer = socket.create_connection(("127.0.0.1", self.port), timeout=SOON_S)
        try:
            peer.sendall(data)
        except OSError:  # the server has ended it before it read everything
            peer.close()
            raise
        return peer


@dataclass
class Watcher:
    """A page as the server sees it."""

    connection: ClientConnection
    waiting: dict[str, deque[Any]] = field(default_factory=lambda: defaultdict(deque))

    def watch(self, *topics: str) -> None:
        """Watch these topics."""
        self.connection.send(json.dumps({"watch": list(topics)}))

    def next(self, topic: str, accept: Callable[[Any], bool] = lambda data: True) -> Any:
        """The next data of a topic that is accepted; pictures are left out."""
        while True:
            while self.waiting[topic]:
                if accept(data := self.waiting[topic].popleft()):
                    return data
            received = self.connection.recv(timeout=SOON_S)
            if not isinstance(received, str):
                continue  # a picture
            message = json.loads(received)
            self.waiting[message["topic"]].append(message["data"])


@contextlib.contextmanager
def served_console(
    folder: Path, token: str | None = None, port: int = 0
) -> Iterator[ServedConsole]:
    """Serve the console of a folder."""
    with socket.socket() as bound:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind(("127.0.0.1", port))
        server = server_of(build_app(folder, token))
        thread = threading.Thread(target=server.run, args=([bound],), daemon=True)
        thread.start()
        assert wait_until(lambda: server.started, patience_s=SOON_S)
        try:
            yield ServedConsole(folder, bound.getsockname()[1])
        finally:
            server.should_exit = True
            thread.join(SOON_S)
