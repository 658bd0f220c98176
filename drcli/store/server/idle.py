"""Stops the embedded server after minutes without use; the next command restarts it.

Run as `python -m drcli.store.server.idle FOLDER PORT PID`, as the starting command may have ended.

Two signs of use: our processes lock a file beside the buckets until they end (`in_use`), so a
training may compute for an hour; other programs, such as the AWS command, move bytes of the server.
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
NOISE_BYTES = 100
"""Between checks; 1 byte in ten seconds was measured unused. A request and answer have 200."""

_held: dict[Path, int] = {}


def in_use(folder: Path) -> None:
    """Until this process ends; called with the lock, so the server is not being stopped."""
    path = own_file(folder, "users")
    if path in _held and leads_to(path, _held[path]):
        return
    not_in_use(folder)
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    try_lock(descriptor, shared=True)
    _held[path] = descriptor


def not_in_use(folder: Path) -> None:
    descriptor = _held.pop(own_file(folder, "users"), None)
    if descriptor is not None:
        os.close(descriptor)


def traffic_bytes(pid: int) -> int | None:
    """Read and written; None without /proc."""
    try:
        text = Path(f"/proc/{pid}/io").read_text()
    except OSError:
        return None
    counts = dict(line.split(": ") for line in text.splitlines())
    return int(counts["rchar"]) + int(counts["wchar"])


class IdleWatcher:
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
    watcher = IdleWatcher(folder, port, pid)
    end = ExitWait(pid)
    while not watcher.look():
        end.wait(LOOK_S)


if __name__ == "__main__":
    watch(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
