"""Counts the S3 requests of a run: passes bytes between its processes and their server."""

import asyncio
import re
import threading
from collections import Counter
from contextlib import suppress

_REQUEST = re.compile(rb"(GET|PUT|POST|HEAD|DELETE) (\S+) HTTP/1\.1\r\n")

_BY_TIME = re.compile(rb"lease\.json|GET \S*\.coach_checkpoint|GET \S*prefix=rollouts")
"""Requests that are repeated while a process waits: their number depends on the time."""


class CountingProxy:
    """Listens on a port of this machine in a thread of its own. Close it when done.

    Attributes:
        url: Where it listens.
        counts: Requests by method, without those in `waiting`.
        waiting: Requests that are repeated while a process waits: lease, pointer, rollouts.
        sent_bytes: Bytes that clients have sent.
        received_bytes: Bytes that clients have received.
    """

    def __init__(self, port: int) -> None:
        self._port = port
        self.counts: Counter[str] = Counter()
        self.waiting = 0
        self.sent_bytes = self.received_bytes = 0
        self._loop = asyncio.new_event_loop()
        ready = threading.Event()
        self._thread = threading.Thread(target=self._serve, args=(ready,), daemon=True)
        self._thread.start()
        ready.wait()

    @property
    def requests(self) -> int:
        """How many there were without those that are repeated while a process waits."""
        return sum(self.counts.values())

    def close(self) -> None:
        """Stop listening, and end all connections."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(timeout=5.0)

    def _serve(self, ready: threading.Event) -> None:
        asyncio.set_event_loop(self._loop)
        server = self._loop.run_until_complete(asyncio.start_server(self._connect, "127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}"
        ready.set()
        self._loop.run_forever()
        server.close()
        for task in asyncio.all_tasks(self._loop):
            task.cancel()

    async def _connect(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            to_server = await asyncio.open_connection("127.0.0.1", self._port)
        except OSError:
            writer.close()
            return
        await asyncio.gather(
            self._pass(reader, to_server[1], counts=True),
            self._pass(to_server[0], writer, counts=False),
        )

    async def _pass(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, *, counts: bool
    ) -> None:
        with suppress(OSError):
            while data := await reader.read(1 << 18):
                if counts:
                    # A client waits for the answer before its next request, so that a request
                    # always begins what is read.
                    request = _REQUEST.match(data)
                    if request is not None and _BY_TIME.search(request[0]):
                        self.waiting += 1
                    elif request is not None:
                        self.counts[request[1].decode()] += 1
                    self.sent_bytes += len(data)
                else:
                    self.received_bytes += len(data)
                writer.write(data)
                await writer.drain()
        with suppress(OSError):
            writer.close()
