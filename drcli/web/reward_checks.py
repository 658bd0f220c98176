"""Checks reward functions while they are typed: one at a time, only the newest of a page."""

import itertools
import json
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from drcli.base.errors import WorkerDied
from drcli.base.installation import installation_error
from drcli.web.answers import BadRequest

PATIENCE_S = 240.0
"""Includes compiling the simulation."""

COOL_DOWN_S = 0.4
"""So that typing does not take a core from a training."""

IDLE_S = 120.0
MOST_WAITING = 8
MOST_PAGES = 64


class RewardChecks:
    """Uses one process. Any thread may call it."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._numbers = itertools.count(1)
        self._newest: dict[str, int] = {}
        self._lock = threading.Lock()
        self._turn = threading.Lock()
        self._waiting = 0
        self._running: tuple[str, int] | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._ended_s = 0.0
        self._idle: threading.Timer | None = None

    def check(self, page: str, text: str, known: str) -> dict[str, Any]:
        """Check a reward function; waits for its turn.

        Args:
            page: Its earlier requests no longer count.
            text: The function.
            known: Key of the course that the page has.

        Returns:
            A `LiveReport` or an error as JSON, or `{"superseded": true}`.

        Raises:
            BadRequest: Too many checks wait.
            WorkerDied: The process does not answer.
        """
        with self._lock:
            if self._waiting >= MOST_WAITING:
                raise BadRequest("Too many checks wait; try again in a moment.", 429)
            number = next(self._numbers)
            self._newest.pop(page, None)
            self._newest[page] = number
            while len(self._newest) > MOST_PAGES:
                del self._newest[next(iter(self._newest))]
            self._waiting += 1
            if self._running is not None and self._running[0] == page:
                self._send({"cancel": self._running[1]})
        try:
            with self._turn:
                time.sleep(max(0.0, self._ended_s + COOL_DOWN_S - time.monotonic()))
                with self._lock:
                    if self._newest.get(page) != number:
                        return {"superseded": True}
                    self._running = (page, number)
                try:
                    return self._ask(number, text, known)
                finally:
                    with self._lock:
                        self._running = None
                    self._ended_s = time.monotonic()
        finally:
            with self._lock:
                self._waiting -= 1

    def close(self) -> None:
        if self._idle is not None:
            self._idle.cancel()
        with self._lock:
            process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.wait()
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    with suppress(OSError):
                        pipe.close()

    def _ask(self, number: int, text: str, known: str) -> dict[str, Any]:
        process = self._started()
        request = {"number": number, "folder": str(self._folder), "text": text, "known": known}
        late = threading.Timer(PATIENCE_S, process.kill)
        late.start()
        try:
            with self._lock:
                self._send(request)
            assert process.stdout is not None
            line = process.stdout.readline()
        finally:
            late.cancel()
        if not line:
            self.close()
            raise installation_error() or WorkerDied(
                "The check of the reward function did not end.",
                remedy="Change the function, or try `dr-reward check` in a terminal.",
            )
        self._wait_idle()
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _started(self) -> subprocess.Popen[bytes]:
        if self._idle is not None:
            self._idle.cancel()
        if self._process is not None and self._process.poll() is None:
            return self._process
        self.close()
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "drcli.web.reward_process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        with self._lock:
            self._process = process
        return process

    def _send(self, message: dict[str, Any]) -> None:
        process = self._process
        if process is not None and process.stdin is not None:
            with suppress(OSError, ValueError):  # its end is noticed by the reader
                process.stdin.write(json.dumps(message).encode() + b"\n")
                process.stdin.flush()

    def _wait_idle(self) -> None:
        self._idle = threading.Timer(IDLE_S, self._close_idle)
        self._idle.daemon = True
        self._idle.start()

    def _close_idle(self) -> None:
        if self._turn.acquire(blocking=False):
            try:
                self.close()
            finally:
                self._turn.release()
