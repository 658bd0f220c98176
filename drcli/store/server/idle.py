"""Stops the embedded server after some minutes without use; the next command starts it again.

It runs as `python -m drcli.store.server.idle FOLDER PORT PID`, because the command that started the
server may have ended. It loads little and sleeps most of the time.

There are two signs of use. Our commands and workers lock a file next to the buckets until they end
(`in_use`), so that a training may compute for an hour. Other programs, such as the AWS command or
deepracer-utils, change the number of bytes that the server reads and writes.
"""

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

from drcli.base.errors import StorageError
from drcli.base.file_lock import exclusive, leads_to
from drcli.base.system_calls import ExitWait, try_lock
from drcli.store.server import server_process
from drcli.store.server.state import ServerState, own_file, trim_log

LOOK_S = 30.0
"""How often the watcher checks whether the server was used."""

NOISE_BYTES = 100
"""Limit for the traffic of an unused server between two checks: 1 byte in ten seconds was measured.
The shortest request and its answer have 200."""

_held: dict[Path, int] = {}


def in_use(folder: Path) -> None:
    """Register this process as a user of the server of a folder until it ends.

    Called while the lock is held, so that the server is not being stopped.
    """
    path = own_file(folder, "users")
    if path in _held and leads_to(path, _held[path]):
        return
    not_in_use(folder)
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    try_lock(descriptor, shared=True)
    _held[path] = descriptor


def not_in_use(folder: Path) -> None:
    """Undo `in_use`."""
    descriptor = _held.pop(own_file(folder, "users"), None)
    if descriptor is not None:
        os.close(descriptor)


def traffic_bytes(pid: int) -> int | None:
    """How many bytes a process has read and written; None on systems without /proc."""
    try:
        text = Path(f"/proc/{pid}/io").read_text()
    except OSError:
        return None
    counts = dict(line.split(": ") for line in text.splitlines())
    return int(counts["rchar"]) + int(counts["wchar"])


class IdleWatcher:
    """Watches one server; tests replace the clock."""

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
        """Check once, and end the server if it is time; whether the watch is over."""
        if not server_process.is_running(self._pid, self._mark):
            return True
        trim_log(self._folder)
        idle_s = self._idle_s()
        if idle_s == 0.0 or self._traffic is None:
            return True
        if self._was_used():
            self._used_s = self._clock()
        if self._clock() - self._used_s < idle_s:
            return False
        try:
            with exclusive(own_file(self._folder, "lock"), patience_s=0.0):
                return self._end_if_unused()
        except FileNotFoundError:  # somebody has deleted the folder
            server_process.end(self._pid, self._mark)
            return True
        except StorageError:  # a command is using the lock
            return False

    def _idle_s(self) -> float:
        """The seconds without use after which to stop the server, by the last command."""
        try:
            state = ServerState.read(own_file(self._folder, "json"))
        except StorageError:
            state = None
        return 60.0 * (ServerState.idle_minutes if state is None else state.idle_minutes)

    def _was_used(self) -> bool:
        before, self._traffic = self._traffic, traffic_bytes(self._pid)
        return before is None or self._traffic is None or self._traffic > before + NOISE_BYTES

    def _end_if_unused(self) -> bool:
        descriptor = os.open(own_file(self._folder, "users"), os.O_RDWR | os.O_CREAT, 0o600)
        try:
            if not try_lock(descriptor):
                return False
            if self._was_used():
                self._used_s = self._clock()
                return False
            # Its id stays in the state, so that a start waits until the port is free.
            server_process.end(self._pid, self._mark)
        finally:
            os.close(descriptor)
        return True


def watch(folder: Path, port: int, pid: int) -> None:
    """Watch a server until it has ended."""
    watcher = IdleWatcher(folder, port, pid)
    end = ExitWait(pid)
    while not watcher.look():
        end.wait(LOOK_S)


if __name__ == "__main__":
    watch(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
