"""Threads that watch a metadata service and the racer's program for notices."""

import os
import shlex
import signal
import subprocess
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from drcli.base.errors import DrError, SettingsError
from drcli.base.log import get_logger
from drcli.clouds.cloud import Notice, NoticeSource
from drcli.config.secret_environment import split

POLL_S = 5.0
"""As EC2 recommends."""

SILENT_POLL_S = 60.0
"""After some failures."""

SILENT_TIMES = 3

COMMAND_PAUSE_S = 5.0
COMMAND_EXIT_S = 2.0

OUTPUT_BYTES = 1 << 16

_logger = get_logger(__name__)


@dataclass(frozen=True)
class Announced:
    notice: Notice
    read_s: float

    def left_s(self, now_s: float) -> float | None:
        if self.notice.seconds_left is None:
            return None
        return max(0.0, self.notice.seconds_left - (now_s - self.read_s))


class NoticeWatch:
    def __init__(
        self,
        source: NoticeSource | None,
        command: Sequence[str] = (),
        folder: Path = Path(),
        *,
        poll_s: float = POLL_S,
        pause_s: float = COMMAND_PAUSE_S,
    ) -> None:
        self._source = source
        self._command = command
        self._folder = folder
        self._poll_s = poll_s
        self._pause_s = pause_s
        self._stopped = threading.Event()
        self._lock = threading.Lock()
        self._of_source: list[Announced] = []
        self._of_command: list[Announced] = []
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        if self._source is not None:
            threading.Thread(
                target=self._poll, args=(self._source,), name="notices", daemon=True
            ).start()
        if self._command:
            threading.Thread(target=self._run_command, name="notice command", daemon=True).start()

    def stop(self) -> None:
        self._stopped.set()
        with self._lock:
            process = self._process
        if process is not None and process.poll() is None:
            _signal_group(process, signal.SIGTERM)
            killer = threading.Timer(COMMAND_EXIT_S, _signal_group, (process, signal.SIGKILL))
            killer.daemon = True
            killer.start()

    def announced(self) -> list[Announced]:
        """A service may take notices back."""
        with self._lock:
            return [*self._of_command, *self._of_source]

    def ask_once(self) -> list[Announced]:
        """Raises MetadataSilent without a usable answer."""
        if self._source is None:
            return []
        now_s = time.monotonic()
        found = [Announced(notice, now_s) for notice in self._source.ask()]
        with self._lock:
            self._of_source = found
        return found

    def _poll(self, source: NoticeSource) -> None:
        silent, said = 0, ""
        while not self._stopped.is_set():
            try:
                self.ask_once()
                silent, said = 0, ""
            except DrError as error:
                silent += 1
                if silent == SILENT_TIMES and str(error) != said:
                    said = str(error)
                    _logger.info("No notices from %s: %s", source.name, error)
            except Exception as error:  # a fault here must not end the watch
                silent += 1
                if type(error).__name__ != said:
                    said = type(error).__name__
                    _logger.warning("No notices from %s.", source.name, exc_info=error)
            self._stopped.wait(SILENT_POLL_S if silent >= SILENT_TIMES else self._poll_s)

    def _run_command(self) -> None:
        shown = False
        while not self._stopped.is_set():
            code, output = self._run_once(say=not shown)
            if self._stopped.is_set():
                return
            if code == 0:
                notice = notice_of_command(output)
                with self._lock:
                    self._of_command = [Announced(notice, time.monotonic())]
                return
            if not shown and code is not None:
                _logger.info(
                    "%s ended with exit code %d: no notice. It is started again each time.",
                    self._command[0],
                    code,
                )
            shown = True
            self._stopped.wait(self._pause_s)

    def _run_once(self, *, say: bool) -> tuple[int | None, bytes]:
        try:
            with self._lock:
                if self._stopped.is_set():
                    return None, b""
                self._process = process = subprocess.Popen(
                    list(self._command),
                    cwd=self._folder,
                    env=split(os.environ)[0],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.PIPE,
                    start_new_session=True,
                )
        except (OSError, ValueError) as error:
            if say:
                _logger.warning("DR_INTERRUPTION_COMMAND cannot be started: %s", error)
            return None, b""
        output = b""
        with process:
            assert process.stdout is not None
            while piece := os.read(process.stdout.fileno(), 4096):
                output = (output + piece)[-OUTPUT_BYTES:]
        return process.returncode, output


def command_words(text: str, name: str = "DR_INTERRUPTION_COMMAND") -> list[str]:
    """Program and arguments; no shell reads them.

    Raises:
        SettingsError: A quotation mark is missing.
    """
    try:
        return shlex.split(text)
    except ValueError as error:
        raise SettingsError(
            f"{name}={text} cannot be read: {error}.",
            remedy="Close every quotation mark, as in: sh -c 'wait-for-notice --json'.",
        ) from error


def notice_of_command(output: bytes) -> Notice:
    """The last line of a program's output may be the seconds left."""
    lines = [line.strip() for line in output.decode("utf-8", "replace").splitlines()]
    last = next((line for line in reversed(lines) if line), "")
    left_s: float | None = None
    with suppress(ValueError):
        number = float(last)
        left_s = number if 0.0 <= number < 1e9 else None
    when = "soon" if left_s is None else f"in {left_s:.0f} s"
    text = f"DR_INTERRUPTION_COMMAND says that this machine goes away {when}."
    return Notice("command", "interruption", "terminate", left_s, text)


def _signal_group(process: "subprocess.Popen[bytes]", number: int) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, number)


def soonest(announced: Sequence[Announced], now_s: float) -> Announced | None:
    """The first interruption; one without a time comes now."""
    certain = [one for one in announced if one.notice.kind == "interruption"]
    return min(certain, key=lambda one: one.left_s(now_s) or 0.0, default=None)
