"""Runs a reward function in the sandbox process."""

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from threading import Event
from time import monotonic

from drcli.base.installation import installation_error
from drcli.base.json_record import RecordError
from drcli.config import secret_environment
from drcli.exchange.job import LOG_ENCODING, PROCESS_TUNING
from drcli.rewards.reward_timeout import source_line, stuck_place
from drcli.rewards.sandbox.sandbox_records import (
    FAULTS_FILE,
    Failure,
    FailureKind,
    SandboxRequest,
    SandboxResult,
)
from drcli.store.keys import REWARD_FUNCTION_FILE

_MODULE = "drcli.rewards.sandbox.sandbox_process"
_PATIENCE_S = 280.0
"""The file is loaded four times."""

_POLL_S = 0.05


class Sandbox:
    """A context manager that ends it and all that it has started."""

    def __init__(self, request: SandboxRequest, content: bytes | None, directory: Path) -> None:
        self._request = request
        self._scratch = tempfile.TemporaryDirectory(prefix="dr-reward-")
        self._folder = Path(self._scratch.name)
        # A training uses a copy too: a function finds the same files next to it.
        self._copy = self._folder / REWARD_FUNCTION_FILE
        if content is not None:
            self._copy.write_bytes(content)
        request.write(self._folder)
        if secret_environment.all_secrets():
            secret_environment.hide_process()
        plain, _ = secret_environment.split(os.environ)
        self._process = subprocess.Popen(
            # -P: files of the working folder must not be taken for modules of that name.
            [sys.executable, "-P", "-m", _MODULE, str(self._folder), str(os.getpid())],
            cwd=directory,
            env={**PROCESS_TUNING, **plain, **LOG_ENCODING},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # signals that it sends to its group reach only itself
        )

    def __enter__(self) -> "Sandbox":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()  # it kills what it has started
        self._process.wait()
        self._scratch.cleanup()

    def result(self, given_up: Event | None = None) -> SandboxResult:
        """The result, empty if `given_up`.

        Raises:
            NotAvailable: A library cannot be loaded.
            RuntimeError: It ended before the racer's code was loaded.
        """
        code: int | None = None
        end_s = monotonic() + _PATIENCE_S
        while code is None and monotonic() < end_s:
            if given_up is not None and given_up.is_set():
                return SandboxResult()
            with contextlib.suppress(subprocess.TimeoutExpired):
                code = self._process.wait(_POLL_S)
        faults = self._folder / FAULTS_FILE
        trace = faults.read_text("utf-8", "replace") if faults.is_file() else ""
        try:
            result = SandboxResult.read(self._folder)
        except RecordError as why:
            what = f"The reward function has overwritten the result of the sandbox: {why}."
            return SandboxResult(failures=[Failure("ends", what)])
        if result is None:
            raise installation_error() or RuntimeError(
                f"The sandbox did not start (exit code {code}):\n{trace}"
            )
        return result if result.finished else self._ended(result, code, trace)

    def _ended(self, result: SandboxResult, code: int | None, trace: str) -> SandboxResult:
        kind: FailureKind = "ends"
        reason = signal.Signals(-code).name if code and code < 0 else f"exit code {code}"
        if code is None or trace.startswith("Timeout"):
            kind, what = "endless", "does not return, and cannot be interrupted"
        elif "Fatal Python error" in trace:
            kind, what = "crashes", f"crashes Python ({reason})"
        elif code == -signal.SIGKILL:
            what = "ends the process, or makes the system end it (SIGKILL)"
        elif trace.startswith("Traceback"):
            what = f"ends the process with {trace.splitlines()[-1]}"
        else:
            what = f"ends the process ({reason})"
        _, line = stuck_place(trace)
        source = source_line(self._copy, line)
        failure = Failure(kind, f"The reward function {what}.", line or None, source)
        values: list[list[float | None]] = [[None] * len(c) for c in self._request.sequences]
        return SandboxResult(problems=result.problems, failures=[failure], values=values)
