"""Shows the uploaded copy of a log."""

import time
from collections.abc import Callable, Iterator
from datetime import datetime
from typing import TYPE_CHECKING

from drcli.base.errors import StorageError
from drcli.cli import console
from drcli.cli.log_tail import POLL_S, chosen

if TYPE_CHECKING:
    from drcli.runs.uploaded_log import UploadedLog

LOOK_S = 20.0
"""Logs are uploaded every five minutes."""


def show_uploaded_log(log: "UploadedLog", last_lines: int | None, since: datetime | None) -> bytes:
    """Print a log or its end, and return that."""
    if last_lines is not None and since is None:
        text = log.last_lines(last_lines)
        console.write(text.decode("utf-8", "replace"))
        return text
    end = b""

    def read() -> Iterator[str]:
        nonlocal end
        for piece in log.pieces(since):
            end = piece
            yield piece.decode("utf-8", "replace")

    for piece in chosen(read(), last_lines, since):
        console.write(piece)
    return end


def follow_uploaded_log(log: "UploadedLog", shown: bytes, until: Callable[[], bool]) -> None:
    from drcli.runs.uploaded_log import UploadedTail

    tail = UploadedTail(log.bucket, log.key, shown)
    failure = ""
    while not until():
        try:
            text = tail.read()
            failure = ""
        except StorageError as error:  # it may answer again
            text = b""
            if str(error) != failure:
                failure = str(error)
                console.warn(failure)
        console.write(text.decode("utf-8", "replace"), followed=True)
        next_look = time.monotonic() + LOOK_S
        while time.monotonic() < next_look and not until():
            time.sleep(POLL_S)
