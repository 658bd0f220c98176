"""Ends the server of a folder's bucket, which whatever is tested may have started."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drcli.bucket.server import server

REQUEST_S = 30.0
"""How long a request to a console may go on after its test."""


@contextmanager
def without_server(folder: Path) -> Iterator[None]:
    """End it behind the block, and behind requests to a console.

    Those go on for a moment when the console has ended, and may start that server.
    """
    before = set(threading.enumerate())
    yield
    for thread in set(threading.enumerate()) - before:
        if thread.name.startswith("AnyIO worker"):
            thread.join(REQUEST_S)
    server.stop_default(folder)
