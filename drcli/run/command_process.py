"""Runs one of our commands as a child process of a supervisor."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from drcli.base.json_record import RecordError, decode_json
from drcli.base.log import get_logger
from drcli.config import activation, secret_environment
from drcli.records.job import LOG_ENCODING, Job

_logger = get_logger(__name__)

_POLL_S = 0.1
_READ_S = 2.0
_ERROR = "Error: "
_REMEDY = "Try: "


@dataclass(frozen=True)
class CommandEnd:
    """How a command ended; a negative `code` is a signal, `report` is what --json printed."""

    code: int
    report: Mapping[str, Any] = field(default_factory=dict)
    reason: str = ""
    seconds: float = 0.0
    killed: bool = False

    @property
    def ok(self) -> bool:
        return self.code == 0


class CommandProcess:
    """Runs with the settings of the start of the training.

    It gets secrets through a pipe, has low priority and one thread, logs to our log, and ends
    with this process.
    """

    def __init__(self, job: Job, *arguments: str) -> None:
        self._name = arguments[0]
        self._began_s = time.monotonic()
        self._killed = False
        self._out: list[str] = []
        self._errors: list[str] = []
        plain, _ = secret_environment.split(os.environ)
        secrets = secret_environment.all_secrets()
        if secrets:
            secret_environment.hide_process()
        call = {
            "arguments": arguments,
            "secrets": secrets,
            "folder": str(job.folder),
            "session": job.session,
            "caller": os.getpid(),
        }
        self._process = subprocess.Popen(
            # -P: a file of the working folder must not replace a module of the same name.
            [sys.executable, "-P", "-m", "drcli.cli.called_command"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            cwd=job.directory,
            env=_environment(plain, job),
            start_new_session=True,
        )
        assert self._process.stdin is not None
        with suppress(BrokenPipeError), self._process.stdin as pipe:
            pipe.write(json.dumps(call).encode())
        self._readers = [
            threading.Thread(target=self._read_report, daemon=True),
            threading.Thread(target=self._log_messages, daemon=True),
        ]
        for reader in self._readers:
            reader.start()

    @property
    def pid(self) -> int:
        return self._process.pid

    def poll(self) -> CommandEnd | None:
        code = self._process.poll()
        return None if code is None else self._ended(code)

    def wait(self, within_s: float, give_up: Callable[[], bool] = lambda: False) -> CommandEnd:
        deadline_s = time.monotonic() + within_s
        while (code := self._process.poll()) is None:
            left_s = deadline_s - time.monotonic()
            if left_s <= 0.0 or give_up():
                return self.kill()
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(min(_POLL_S, left_s))
        return self._ended(code)

    def kill(self) -> CommandEnd:
        """What it wrote to a bucket stays usable."""
        if self._process.poll() is None:
            self._killed = True
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
        return self._ended(self._process.wait())

    def _ended(self, code: int) -> CommandEnd:
        for reader in self._readers:
            reader.join(_READ_S)
        report: Any = {}
        for line in reversed(self._out):
            if line.startswith("{"):
                with suppress(RecordError):
                    report = decode_json(dict[str, Any], line.encode())
                break
        reason = ""
        if self._killed:
            reason = f"{self._name} was killed because its time was over."
        elif code != 0:
            reason = " ".join(self._errors) or f"{self._name} ended with exit code {code}."
        seconds = time.monotonic() - self._began_s
        return CommandEnd(code, report, reason, seconds, self._killed)

    def _read_report(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as pipe:
            for line in pipe:
                self._out.append(line.decode("utf-8", "replace").strip())
                del self._out[:-8]

    def _log_messages(self) -> None:
        assert self._process.stderr is not None
        with self._process.stderr as pipe:
            for line in pipe:
                text = line.decode("utf-8", "replace").strip()
                if not text:
                    continue
                if text.startswith((_ERROR, _REMEDY)):  # the caller tells them, once
                    self._errors.append(text.removeprefix(_ERROR).removeprefix(_REMEDY))
                else:
                    _logger.info("%s: %s", self._name, text)


Start = Callable[..., CommandProcess]


def _environment(plain: Mapping[str, str], job: Job) -> dict[str, str]:
    kept = activation.chosen(plain)
    return {
        **kept,
        **job.config.given,
        **LOG_ENCODING,
        "DR_DIR": str(job.directory),
        "DR_LOCAL_S3_MODEL_PREFIX": job.config.model.prefix,
        "DR_RUN_ID": str(job.config.run_id),
        "NO_COLOR": "1",
        "COLUMNS": "100000",
        "OMP_NUM_THREADS": "1",  # one core at most: the training needs the others
        "MUJOCO_GL": "disable",
    }
