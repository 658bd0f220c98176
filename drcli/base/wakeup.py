"""Ends the pause of another process; Linux only.

A wake-up may be lost, so pauses end in any case. Sockets have abstract names, so no file stays.
"""

import hashlib
import select
import socket
import sys
import time
from contextlib import suppress
from pathlib import Path

_MOST_QUEUED = 1_000


class Wakeup:
    """Close it when done.

    Attributes:
        works: If not, `pause` only waits.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self.works = False
        self._socket: socket.socket | None = None
        if sys.platform != "linux":
            return
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        listener.setblocking(False)
        try:
            listener.bind(_address(folder, name))
        except OSError:  # a process of an earlier start still has that name
            listener.close()
            return
        self._socket, self.works = listener, True

    def pause(self, seconds: float) -> bool:
        """Wait until woken, and return whether so.

        A wake-up before the pause ends it at once.
        """
        if self._socket is None:
            time.sleep(seconds)
            return False
        if not select.select([self._socket], [], [], max(0.0, seconds))[0]:
            return False
        with suppress(OSError):
            for _ in range(_MOST_QUEUED):
                self._socket.recv(1)
        return True

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket, self.works = None, False


def wake(folder: Path, *names: str) -> None:
    if sys.platform != "linux":
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.setblocking(False)
        for name in names:
            with suppress(OSError):  # nobody listens, or it has enough wake-ups in its queue
                sender.sendto(b"w", _address(folder, name))


def _address(folder: Path, name: str) -> bytes:
    """At most 108 bytes."""
    key = hashlib.sha256(f"{folder.resolve()}\n{name}".encode()).hexdigest()[:32]
    return f"\0drcli-{key}".encode()
