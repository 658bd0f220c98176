"""Ends connections that stand still; uvicorn waits without an end."""

import asyncio
from contextlib import suppress
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

MOST_CONNECTIONS = 256
"""For another, the oldest that has asked for nothing is ended."""

REQUEST_S = 10.0
"""From the moment of the connection."""

STALLED_S = 20.0
"""Without progress of a request or an answer."""

LOOK_S = 2.0
WAITING_BYTES = 4 << 20
"""Answers to pings that nobody reads."""

FAREWELL_S = 2.0


class TimedHttp(H11Protocol):
    """Ends waiting."""

    _asked = False
    _written_s: float | None = None
    _read_s = 0.0
    _began_s = 0.0
    _look: asyncio.TimerHandle | None = None

    # uvicorn asks for a narrower transport than asyncio's protocol does.
    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Within `MOST_CONNECTIONS`."""
        super().connection_made(transport)
        self._began_s = self._read_s = self.loop.time()
        if len(self.connections) > MOST_CONNECTIONS:
            _idle_one(self.connections, self).transport.abort()
        self._look = self.loop.call_later(LOOK_S, self._check)

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop_looking()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        self._read_s = self.loop.time()
        if self.timeout_keep_alive_task is not None:  # another request begins
            self._began_s = self._read_s
        super().data_received(data)
        self._asked = self._asked or self.scope is not None

    def pause_writing(self) -> None:
        self._written_s = self.loop.time()
        super().pause_writing()

    def resume_writing(self) -> None:
        self._written_s = None
        super().resume_writing()

    def handle_websocket_upgrade(self, event: Any) -> None:
        self._stop_looking()
        super().handle_websocket_upgrade(event)

    def _stop_looking(self) -> None:
        if self._look is not None:
            self._look.cancel()
            self._look = None

    def _check(self) -> None:
        now = self.loop.time()
        cycle = self.cycle
        waits_for_body = cycle is not None and cycle.more_body and not cycle.response_complete
        between = (
            cycle is None or cycle.response_complete
        ) and self.timeout_keep_alive_task is None
        if (
            (between and now - self._began_s > REQUEST_S)
            or (waits_for_body and now - self._read_s > STALLED_S)
            or (self._written_s is not None and now - self._written_s > STALLED_S)
        ):
            self.transport.abort()
            return
        self._look = self.loop.call_later(LOOK_S, self._check)


def _idle_one(connections: Any, newest: TimedHttp) -> TimedHttp:
    idle = [each for each in connections if isinstance(each, TimedHttp) and not each._asked]
    return min(idle, key=lambda each: each._began_s, default=newest)


class TimedWebSocket(WebSocketsSansIOProtocol):
    """Ends waiting."""

    def data_received(self, data: bytes) -> None:
        """Within `WAITING_BYTES`."""
        if self.transport.get_write_buffer_size() > WAITING_BYTES:
            self.transport.abort()
            return
        super().data_received(data)

    def keepalive_timeout(self) -> None:
        super().keepalive_timeout()
        self.loop.call_later(FAREWELL_S, self._cut)

    async def run_asgi(self) -> None:
        try:
            await super().run_asgi()
        finally:
            with suppress(RuntimeError):  # the loop has been closed
                self.loop.call_later(FAREWELL_S, self._cut)

    def _cut(self) -> None:
        if not self.disconnected:
            self.transport.abort()
