"""The process of the console: `python -m drcli.web.serve FOLDER`, with a `Listen` as its input."""

import asyncio
import os
import socket
import sys
from pathlib import Path

import uvicorn
from starlette.types import ASGIApp

from drcli.base.log import LogFile
from drcli.config import secret_environment
from drcli.config.value_types import LOOPBACK_HOSTS
from drcli.web.console_app import TimedHttp, TimedWebSocket, build_app
from drcli.web.listen import Listen
from drcli.web.viewer_process import log_path

LOG_BYTES = 4 << 20

IDLE_S = 15
GRACE_S = 0.8


def main() -> None:
    directory = Path(sys.argv[1])
    listen = Listen.of_line(sys.stdin.buffer.readline())
    secret_environment.keep(listen.secrets)
    if listen.secrets:
        secret_environment.hide_process()
    log = LogFile(log_path(directory), LOG_BYTES)
    try:
        with socket.socket(fileno=listen.descriptor) as bound:
            here_only = bound.getsockname()[0] in LOOPBACK_HOSTS
            app = build_app(directory, listen.token or None, here_only=here_only)
            server_of(app).run([bound])
    finally:
        log.end()
    # Threads whose work was cut short may take minutes; `Tasks.close` has said what becomes of it.
    os._exit(0)


class ConsoleServer(uvicorn.Server):
    """Ends requests itself: uvicorn reports cancelled ones as errors."""

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        cancelling = asyncio.get_running_loop().call_later(GRACE_S, self._cancel_requests)
        try:
            await super().shutdown(sockets)
        finally:
            cancelling.cancel()

    def _cancel_requests(self) -> None:
        for connection in list(self.server_state.connections):
            if (
                isinstance(connection, TimedHttp)
                and connection.cycle is not None
                and connection.cycle.response_started
            ):
                connection.transport.abort()  # what receives it must not take a part for all
        for task in self.server_state.tasks:
            task.cancel()


def server_of(app: ASGIApp) -> uvicorn.Server:
    return ConsoleServer(
        uvicorn.Config(
            app,
            http=TimedHttp,
            ws=TimedWebSocket,
            ws_max_size=65_536,
            ws_ping_interval=IDLE_S,
            ws_ping_timeout=IDLE_S,
            # JPEG cannot be compressed further, and the page is on this machine.
            ws_per_message_deflate=False,
            timeout_keep_alive=IDLE_S,
            timeout_graceful_shutdown=2,
            h11_max_incomplete_event_size=32_768,
            server_header=False,
            proxy_headers=False,
            access_log=False,
            log_level="warning",
            # With one, Python closes the handlers of all libraries: absl's (2.5.1, which
            # openvino imports) then closes what was standard error at that import.
            log_config=None,
        )
    )


if __name__ == "__main__":
    main()
