"""The end of the server: requests that run are answered, and nothing is reported as an error."""

import asyncio
import http.client
import logging
import socket
import threading

import pytest
from starlette.applications import Starlette
from starlette.responses import StreamingResponse
from starlette.routing import Route

from drcli.base.clock import wait_until
from drcli.web.answers import answers
from drcli.web.security import Guard
from drcli.web.serve import server_of

SOON_S = 20.0


@pytest.fixture
def slow():
    """A server with two requests that do not end; gives its port and how to stop it."""
    entered, go = threading.Semaphore(0), threading.Event()

    def wait(_):
        entered.release()
        go.wait(SOON_S)
        return {}

    async def half(_):
        async def parts():
            yield b"half of it"
            entered.release()
            await asyncio.sleep(SOON_S)

        return StreamingResponse(parts())

    routes = [Route("/wait", answers(wait)), Route("/half", half)]
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        server = server_of(Guard(Starlette(routes=routes), None))
        thread = threading.Thread(target=server.run, args=([bound],), daemon=True)
        thread.start()
        assert wait_until(lambda: server.started, patience_s=SOON_S)
        port = bound.getsockname()[1]

        def stop():
            server.should_exit = True
            return thread

        try:
            yield port, entered, stop
        finally:
            go.set()
            stop().join(SOON_S)


def test_a_request_that_runs_at_the_end_is_answered_with_a_sentence(slow, capfd, caplog):
    port, entered, stop = slow
    waiting, half = (http.client.HTTPConnection("127.0.0.1", port, SOON_S) for _ in range(2))
    try:
        waiting.request("GET", "/wait")
        half.request("GET", "/half")
        assert all(entered.acquire(timeout=SOON_S) for _ in range(2))
        thread = stop()
        answer = waiting.getresponse()
        said = answer.read()
        part = half.getresponse()
        with pytest.raises((http.client.IncompleteRead, ConnectionError)):
            part.read()
    finally:
        waiting.close()
        half.close()

    assert answer.status == 503
    assert b"The console was stopped before it could answer." in said
    assert answer.headers["content-security-policy"]
    thread.join(SOON_S)
    assert capfd.readouterr().err == ""
    assert not caplog.records


def test_making_a_server_leaves_the_handlers_of_other_libraries_open():
    class Handler(logging.Handler):
        closed = False

        def close(self):
            self.closed = True
            super().close()

    handler = Handler()
    server_of(Starlette())
    assert not handler.closed
