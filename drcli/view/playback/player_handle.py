"""Starts the player's process when needed, and ends it when idle.

torch, mujoco and numba load slowly and take hundreds of megabytes, too much for the server.
"""

import json
import os
import signal
import subprocess
import sys
import threading
import weakref
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from drcli.base.errors import DrError, NotAvailable, SettingsError, StorageError
from drcli.base.installation import installation_error
from drcli.base.json_record import plain
from drcli.config import secret_environment
from drcli.records.job import LOG_ENCODING

# The form of answers: JSON facts, then pictures.


LENGTH_BYTES = 4


def pack(facts: dict[str, Any], pictures: Sequence[bytes] = ()) -> bytes:
    """Four bytes of length (big endian), JSON facts, pictures.

    The facts get `lengths`, the pictures' bytes.
    """
    told = {**plain(facts), "lengths": [len(picture) for picture in pictures]}
    head = json.dumps(told, separators=(",", ":")).encode()
    return b"".join([len(head).to_bytes(LENGTH_BYTES, "big"), head, *pictures])


def unpack(data: bytes) -> tuple[dict[str, Any], list[bytes]]:
    """Facts and pictures.

    Raises:
        ValueError: It is not a packed answer.
    """
    head_end = LENGTH_BYTES + int.from_bytes(data[:LENGTH_BYTES], "big")
    if len(data) < head_end:
        raise ValueError("The answer is cut off.")
    facts = json.loads(data[LENGTH_BYTES:head_end])
    pictures, at = [], head_end
    for length in facts.pop("lengths"):
        pictures.append(data[at : at + length])
        at += length
    if at != len(data):
        raise ValueError("The pictures of the answer do not have the lengths that it tells.")
    return facts, pictures


def facts_of(data: bytes) -> dict[str, Any]:
    """Of an answer known to be whole."""
    head_end = LENGTH_BYTES + int.from_bytes(data[:LENGTH_BYTES], "big")
    facts: dict[str, Any] = json.loads(data[LENGTH_BYTES:head_end])
    del facts["lengths"]
    return facts


MODULE = "drcli.view.playback.player_process"

IDLE_S = 300.0
"""Then the process ends until the next request."""

PATIENCE_S = 120.0
"""For an answer while all cores train."""

MOST_WAITING = 8
_LENGTH_BYTES = 8

_TUNING = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "MUJOCO_GL": "disable"}
"""Leaves the cores to a training."""

_REMEDY = "Try again: it is started anew. The details are in data/logs/viewer.log."


class PlayerBusy(SettingsError):
    """Too many requests wait."""


class PlayerEnded(StorageError):
    """The player's process ended during a request."""


class PlayerHandle:
    """A working folder's player, for any thread."""

    def __init__(
        self, directory: Path, *, idle_s: float = IDLE_S, patience_s: float = PATIENCE_S
    ) -> None:
        self._directory = directory
        self._idle_s, self._patience_s = idle_s, patience_s
        self._lock = threading.Lock()
        self._count = threading.Lock()
        self._waiting = 0
        self._process: subprocess.Popen[bytes] | None = None
        self._idle: threading.Timer | None = None
        self._end_with_me: weakref.finalize[..., PlayerHandle] | None = None

    @property
    def pid(self) -> int | None:
        process = self._process
        return process.pid if process is not None and process.poll() is None else None

    def ask(self, request: dict[str, Any]) -> bytes:
        """Raises DrError from the player, or because it cannot answer."""
        with self._count:
            if self._waiting >= MOST_WAITING:
                raise PlayerBusy(
                    "The episode player has too much to do.",
                    remedy="Wait some seconds, or close other pages that show episodes.",
                )
            self._waiting += 1
        try:
            with self._lock:
                data = self._answer(json.dumps(request).encode() + b"\n")
        finally:
            with self._count:
                self._waiting -= 1
        facts = facts_of(data) if data[4:12] == b'{"error"' else {}
        if "error" in facts:
            raise _error(facts["error"])
        return data

    def close(self) -> None:
        with self._lock:
            self._end()

    def _answer(self, line: bytes) -> bytes:
        if self._idle is not None:
            self._idle.cancel()
        process = self._running()
        assert process.stdin is not None
        assert process.stdout is not None
        late = threading.Event()

        def give_up() -> None:
            late.set()
            process.kill()

        patience = threading.Timer(self._patience_s, give_up)
        patience.daemon = True
        patience.start()
        try:
            process.stdin.write(line)
            process.stdin.flush()
            length = process.stdout.read(_LENGTH_BYTES)
            size = int.from_bytes(length, "big")
            data = process.stdout.read(size) if len(length) == _LENGTH_BYTES else b""
        except OSError:
            data, size = b"", 1
        finally:
            patience.cancel()
        if not data or len(data) < size:
            raise self._failure(process, is_late=late.is_set())
        self._idle = threading.Timer(self._idle_s, self._end_idle, [process])
        self._idle.daemon = True
        self._idle.start()
        return data

    def _running(self) -> "subprocess.Popen[bytes]":
        if self._process is not None and self._process.poll() is None:
            return self._process
        self._end()
        plain, _ = secret_environment.split(os.environ)
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", MODULE, str(self._directory)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env={**plain, **_TUNING, **LOG_ENCODING},
                cwd=self._directory,
            )
        except OSError as error:
            raise StorageError(
                f"The episode player cannot be started: {error.strerror or error}.",
                remedy="Free memory, or end processes that are not needed.",
            ) from None
        # For a server that is alive without its player; otherwise, the process ends with its input.
        if self._end_with_me is not None:
            self._end_with_me.detach()
        self._end_with_me = weakref.finalize(self, _finish, self._process)
        return self._process

    def _failure(self, process: "subprocess.Popen[bytes]", *, is_late: bool) -> DrError:
        self._end()
        if is_late:
            return PlayerEnded(
                f"The episode player did not answer within {self._patience_s:g} s and was ended.",
                remedy="Try again when the machine has less to do.",
            )
        code = process.returncode or 0
        with suppress(ValueError):
            if code < 0:
                name = signal.Signals(-code).name
                return PlayerEnded(f"The episode player was ended by {name}.", remedy=_REMEDY)
        ended = PlayerEnded(f"The episode player ended with exit code {code}.", remedy=_REMEDY)
        return installation_error() or ended

    def _end_idle(self, process: "subprocess.Popen[bytes]") -> None:
        # A request that has just begun holds the lock, and needs the process.
        if self._lock.acquire(blocking=False):
            try:
                if self._process is process:
                    self._end()
            finally:
                self._lock.release()

    def _end(self) -> None:
        if self._idle is not None:
            self._idle.cancel()
            self._idle = None
        if self._process is not None:
            _finish(self._process)
            self._process = None


def _finish(process: "subprocess.Popen[bytes]") -> None:
    process.kill()
    process.wait()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with suppress(OSError):
                pipe.close()


_KINDS: dict[int, type[DrError]] = {
    kind.code: kind for kind in (SettingsError, StorageError, NotAvailable)
}


def _error(told: dict[str, Any]) -> DrError:
    kind = _KINDS.get(int(told["code"]), SettingsError)
    return kind(str(told["message"]), remedy=str(told["remedy"]))
