"""A slow way to a server: passes bytes on late, at a limited rate, or not at all."""

import asyncio
import threading
from contextlib import suppress

_CHUNK_BYTES = 1 << 14


class SlowLink:
    """Listens on a port of this machine in a thread of its own. Close it when done.

    Args:
        port: Of the server, on this machine.
        round_trip_s: Time for a byte to the server and back; half of it each way.
        bytes_per_s: Limit in each direction, for all connections together.
        address: Where to listen.

    Attributes:
        url: Where it listens.
        is_cut: While it is set, nothing arrives, and connections stay open: a network partition.
    """

    def __init__(
        self, port: int, round_trip_s: float, bytes_per_s: float, address: str = "127.0.0.1"
    ) -> None:
        self._port = port
        self._address = address
        self._delay_s = round_trip_s / 2.0
        self._bytes_per_s = bytes_per_s
        self._free_s = {"up": 0.0, "down": 0.0}
        self.is_cut = False
        self.url = ""
        self._loop = asyncio.new_event_loop()
        ready = threading.Event()
        self._thread = threading.Thread(target=self._serve, args=(ready,), daemon=True)
        self._thread.start()
        ready.wait()

    def close(self) -> None:
        """Stop listening, and close all connections."""
        asyncio.run_coroutine_threadsafe(self._end(), self._loop).result(5.0)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(5.0)

    async def _end(self) -> None:
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)

    def _serve(self, ready: threading.Event) -> None:
        asyncio.set_event_loop(self._loop)
        server = self._loop.run_until_complete(
            asyncio.start_server(self._accept, self._address, 0, limit=_CHUNK_BYTES)
        )
        self.url = f"http://{self._address}:{server.sockets[0].getsockname()[1]}"
        ready.set()
        self._loop.run_forever()

    async def _accept(self, near: asyncio.StreamReader, near_end: asyncio.StreamWriter) -> None:
        with suppress(OSError, asyncio.CancelledError):
            await asyncio.sleep(2.0 * self._delay_s)  # the handshake
            far, far_end = await asyncio.open_connection("127.0.0.1", self._port)
            await asyncio.gather(
                self._carry(near, far_end, "up"), self._carry(far, near_end, "down")
            )

    async def _carry(
        self, source: asyncio.StreamReader, target: asyncio.StreamWriter, way: str
    ) -> None:
        """Pass bytes on, each after the delay; bytes on the way do not hold up later ones."""
        under_way: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue(64)
        arriving = asyncio.create_task(self._arrive(under_way, target))
        with suppress(OSError):
            while data := await source.read(_CHUNK_BYTES):
                now_s = self._loop.time()
                self._free_s[way] = max(now_s, self._free_s[way]) + len(data) / self._bytes_per_s
                await under_way.put((self._free_s[way] + self._delay_s, data))
        await under_way.put((self._loop.time() + self._delay_s, b""))
        await arriving

    async def _arrive(
        self, under_way: "asyncio.Queue[tuple[float, bytes]]", target: asyncio.StreamWriter
    ) -> None:
        with suppress(OSError):
            while True:
                due_s, data = await under_way.get()
                await asyncio.sleep(max(0.0, due_s - self._loop.time()))
                while self.is_cut:
                    await asyncio.sleep(0.05)
                if not data:
                    break
                target.write(data)
                await target.drain()
        target.close()
