"""Stops the embedded server when it was not used for a while; the next command starts it again.

Started beside the server, as `python -m drcli.store.server.idle FOLDER PORT PID`, in a process of
its own, because the command that started the server may have ended. It loads little and sleeps
most of the time.

There are two signs that the server is used. Our commands and workers hold a lock on a
file beside the buckets for as long as they live (`in_use`), so that a training is safe that only
computes for an hour. Other programs, such as the AWS command or deepracer-utils, show in the number
of bytes that the server reads and writes.
"""

import fcntl
import os
import select
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from drcli.base.errors import StorageError
from drcli.base.file_lock import exclusive
from drcli.store.server import server_process
from drcli.store.server.state import ServerState

LOOK_S = 30.0
"""How often the watcher checks whether the server was used."""

NOISE_BYTES = 100
"""What the server reads and writes between two checks without a request: 1 byte in ten seconds was
measured. The shortest request and its answer have 200."""

STATE, LOCK, USERS, LOG = ".server.json", ".server.lock", ".server.users", ".server.log"
"""Files beside the buckets: the server's state, the lock on it, what its users hold, its log."""

LOG_BYTES = 1_000_000
"""Maximum size of the server's log, which repeats itself for months."""

_held: dict[Path, int] = {}


def in_use(folder: Path) -> None:
    """Say that this process may use the server of a folder for as long as it lives.

    Called while the lock is held, so that the server cannot just be ending.
    """
    path = folder / USERS
    if path in _held and _is(path, _held[path]):
        return
    not_in_use(folder)
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    _held[path] = descriptor


def not_in_use(folder: Path) -> None:
    """Take that back."""
    descriptor = _held.pop(folder / USERS, None)
    if descriptor is not None:
        os.close(descriptor)


def traffic_bytes(pid: int) -> int | None:
    """How many bytes a process has read and written; None where the system does not tell."""
    try:
        text = Path(f"/proc/{pid}/io").read_text()
    except OSError:
        return None
    counts = dict(line.split(": ") for line in text.splitlines())
    return int(counts["rchar"]) + int(counts["wchar"])


class Watch:
    """Watches one server.

    Args:
        clock: Monotonic seconds, for tests.
    """

    def __init__(
        self, folder: Path, port: int, pid: int, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._folder = folder
        self._mark = f"127.0.0.1:{port}"
        self._pid = pid
        self._clock = clock
        self._traffic = traffic_bytes(pid)
        self._used_s = clock()

    def look(self) -> bool:
        """Look once, and end the server if it is time.

        Returns:
            Whether the watch is over.
        """
        if not server_process.is_running(self._pid, self._mark):
            return True
        self._keep_log_small()
        idle_s = self._idle_s()
        if idle_s == 0.0 or self._traffic is None:
            return True
        if self._was_used():
            self._used_s = self._clock()
        if self._clock() - self._used_s < idle_s:
            return False
        try:
            with exclusive(self._folder / LOCK, patience_s=0.0):
                return self._end_if_unused()
        except FileNotFoundError:  # somebody has deleted the folder
            server_process.end(self._pid, self._mark)
            return True
        except StorageError:  # a command is just looking for the server
            return False

    def _keep_log_small(self) -> None:
        log = self._folder / LOG
        with suppress(OSError):
            if log.stat().st_size > LOG_BYTES:
                os.truncate(log, 0)  # the server appends, so it goes on at the beginning

    def _idle_s(self) -> float:
        """After how many seconds without use the server is stopped, as the last command had it."""
        try:
            state = ServerState.read(self._folder / STATE)
        except StorageError:
            state = None
        return 60.0 * (ServerState.idle_minutes if state is None else state.idle_minutes)

    def _was_used(self) -> bool:
        before, self._traffic = self._traffic, traffic_bytes(self._pid)
        return before is None or self._traffic is None or self._traffic > before + NOISE_BYTES

    def _end_if_unused(self) -> bool:
        descriptor = os.open(self._folder / USERS, os.O_RDWR | os.O_CREAT, 0o600)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if self._was_used():
                self._used_s = self._clock()
                return False
            # Its id stays in the state: a start waits then until the port is free, and takes it.
            server_process.end(self._pid, self._mark)
        except BlockingIOError:
            return False
        finally:
            os.close(descriptor)
        return True


def watch(folder: Path, port: int, pid: int) -> None:
    """Watch a server until it has ended."""
    watched = Watch(folder, port, pid)
    descriptor = _handle(pid)
    while not watched.look():
        if descriptor is None:
            time.sleep(LOOK_S)
        else:
            select.select([descriptor], [], [], LOOK_S)  # returns at once when the process ends


def _handle(pid: int) -> int | None:
    """A descriptor by which the end of a process is seen; None where the system has none."""
    try:
        return os.pidfd_open(pid)
    except (AttributeError, OSError):
        return None


def _is(path: Path, descriptor: int) -> bool:
    """Whether a path still leads to an open file."""
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except OSError:
        return False


if __name__ == "__main__":
    watch(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
