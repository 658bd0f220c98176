"""Runs a reward function in the sandbox process."""

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from io import FileIO
from pathlib import Path
from threading import Event
from time import monotonic
from typing import Any, Literal

from drcli.base import early_process
from drcli.base.early_process import ChildProcess, Order
from drcli.base.errors import Problem
from drcli.base.installation import installation_error
from drcli.base.json_record import (
    JsonRecord,
    RecordError,
    SafeInt,
    Seconds,
    decode_json,
    json_default,
)
from drcli.config import secret_environment
from drcli.config.run_config import DriveConfig
from drcli.model.keys import REWARD_FUNCTION_FILE
from drcli.records.job import LOG_ENCODING, PROCESS_TUNING
from drcli.rewards.course import Course
from drcli.rewards.source import source_line, stuck_place

# The sandbox's request and result, as JSON files.


FAULTS_FILE = "faults.txt"
"""Of Python when it ends the process."""

FailureKind = Literal[
    "load",
    "signature",
    "undefined",
    "raises",
    "type",
    "range",
    "endless",
    "ends",
    "crashes",
    "replaces",
]
EffectKind = Literal["writes", "reads", "network", "process"]

REMEDIES: dict[FailureKind, str] = {
    "load": "Correct the file, and check it again.",
    "signature": "Write `def reward_function(params):` with a `return` on every path.",
    "undefined": "Correct the name, or give it a value before that line.",
    "raises": "Correct that line: a training ends where it fails.",
    "type": "Return a number on every path, as in `return float(reward)`.",
    "range": "Return a finite number between -100000 and 100000; guard divisions and logarithms.",
    "endless": "Look for a loop that does not end, or an operation that takes too long: a call may "
    "take 5 s.",
    "ends": "Remove what ends the process, such as os._exit() or os.kill().",
    "crashes": "Remove the call into the library that crashes.",
    "replaces": "Give your own function another name.",
}

_REQUEST_FILE, _COURSE_FILE, _RESULT_FILE = "request.json", "course.json", "result.json"


@dataclass(frozen=True)
class SandboxRequest:
    """What to try.

    Attributes:
        sequences: Parameters without the waypoints.
        waypoints: By `is_reversed`. Shape (2, n, 2).
        repeated: Sequences that are called again.
        races: Their samples come first.
        drives: Drives them too.
        drive: Drives this race, and tells its course.
        metadata: model_metadata.json, for the actions.
        hyperparameters: Their file, whose discount is asked for.
    """

    name: str
    sequences: list[list[dict[str, Any]]] = field(default_factory=list)
    waypoints: list[list[tuple[float, float]]] = field(default_factory=list)
    repeated: SafeInt = 0
    races: list[DriveConfig] | None = None
    drives: bool = False
    drive: DriveConfig | None = None
    metadata: str = ""
    hyperparameters: str | None = None
    call_s: Seconds = 5.0
    load_s: Seconds = 60.0

    def encode(self) -> bytes:
        """One line."""
        given = {name: value for name, value in vars(self).items() if value is not None}
        return json.dumps(given, default=json_default).encode()

    @staticmethod
    def decode(data: bytes) -> "SandboxRequest":
        return decode_json(SandboxRequest, data)

    def write(self, folder: Path) -> None:
        (folder / _REQUEST_FILE).write_bytes(self.encode())

    @staticmethod
    def read(folder: Path) -> "SandboxRequest":
        return SandboxRequest.decode((folder / _REQUEST_FILE).read_bytes())


@dataclass(frozen=True)
class CallIndex:
    """Numbers of the sequence and in it, from 0."""

    sequence: SafeInt
    index: SafeInt


@dataclass(frozen=True)
class Failure:
    """Something that ends a training.

    Attributes:
        reason: Such as "KeyError: 'sped'".
        state: "on the start line (step 2, 0.0 % of the lap)".
        params: Those that the file reads.
        missing: The module that cannot be imported.
        times: Of the `SandboxResult.counted` calls.
        unusual: Only rare states fail like this.
    """

    kind: FailureKind
    reason: str
    line: SafeInt | None = None
    source: str = ""
    state: str = ""
    params: str = ""
    missing: str = ""
    times: SafeInt = 0
    unusual: bool = False

    @property
    def sentence(self) -> str:
        failed = f"The reward function failed {self.state}: {self.reason}."
        text = failed if self.state else self.reason
        if not self.source or self.kind in ("type", "range"):  # not the fault of one line
            return text
        return f"{text}\nThe line is `{self.source}`."


@dataclass(frozen=True)
class Effect:
    """Of a line."""

    kind: EffectKind
    what: str
    line: SafeInt
    times: SafeInt


@dataclass(frozen=True)
class Difference:
    """`times` of `of` calls returned something else in another pass, first at `place`."""

    place: CallIndex
    value: float | None
    other: float | None
    times: SafeInt
    of: SafeInt


@dataclass(frozen=True)
class SharedState:
    """`times` of `of` rewards of a car are others beside a second car.

    `names` are what the file sets elsewhere, such as `math.last`.
    """

    names: list[str]
    times: SafeInt
    of: SafeInt


@dataclass(frozen=True)
class Printed:
    """In counted calls."""

    lines: SafeInt = 0
    characters: SafeInt = 0
    line: SafeInt | None = None


@dataclass(frozen=True)
class Timing:
    """Of calls."""

    median_s: Seconds
    mean_s: Seconds
    worst_s: Seconds
    worst: CallIndex


@dataclass(frozen=True)
class SandboxResult(JsonRecord):
    """What the sandbox found.

    Attributes:
        problems: Worlds and races that cannot be loaded.
        values: The samples last; None if it failed or was not made.
        returned: Calls by type.
        discount: Weight of a reward that comes one step later.
        counted: Samples, or all without samples.
        random: Differs when the same calls are repeated.
        memory: Differs with another order of episodes.
        finished: Whether the function has been tried.
    """

    VERSION = 2
    """Written, so that no other file is taken for one."""

    problems: list[Problem] = field(default_factory=list)
    values: list[list[float | None]] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)
    returned: dict[str, SafeInt] = field(default_factory=dict)
    discount: float = 1.0
    line: SafeInt | None = None
    timing: Timing | None = None
    calls: SafeInt = 0
    counted: SafeInt = 0
    effects: list[Effect] = field(default_factory=list)
    printed: Printed = Printed()
    random: Difference | None = None
    memory: Difference | None = None
    shared: SharedState | None = None
    finished: bool = True

    def write(self, folder: Path) -> None:
        unfinished = folder / f"{_RESULT_FILE}.part"
        unfinished.write_bytes(self.encode())
        unfinished.rename(folder / _RESULT_FILE)

    @staticmethod
    def read(folder: Path) -> "SandboxResult | None":
        """None if not written; RecordError if overwritten."""
        try:
            return SandboxResult.decode((folder / _RESULT_FILE).read_bytes())
        except FileNotFoundError:
            return None


def write_course(course: Course, folder: Path) -> None:
    text = json.dumps(course, default=vars)  # `asdict` would copy every number
    (folder / _COURSE_FILE).write_text(text, "utf-8")


def read_course(folder: Path) -> Course | None:
    """None if not written; RecordError if overwritten."""
    try:
        return decode_json(Course, (folder / _COURSE_FILE).read_bytes())
    except FileNotFoundError:
        return None


SANDBOX = "drcli.rewards.sandbox.sandbox_process"
SERVES = "-"
"""In place of a folder."""

_PATIENCE_S = 280.0
"""The file is loaded four times."""

_POLL_S = 0.05


class SandboxServer:
    """A process that keeps the calls of a request, and divides itself for each text to try.

    To start Python, load the simulation and read the calls takes longer than to make them.
    """

    def __init__(self, request: SandboxRequest, directory: Path) -> None:
        self.request = request
        arguments = [SERVES, str(os.getpid())]
        self._process = _started(arguments, directory, subprocess.PIPE)
        self._tell(request.encode())

    def is_for(self, request: SandboxRequest) -> bool:
        """Whether it runs and keeps the calls of this request."""
        return self._process.poll() is None and self.request == request

    def begin(self, folder: Path, *, grid_only: bool) -> "_Attempt":
        """Try the text in a folder."""
        self._tell(json.dumps([str(folder), grid_only]).encode())
        return _Attempt(self._process)

    def _tell(self, line: bytes) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # its end is noticed by the reader
            self._process.stdin.write(line + b"\n")
            self._process.stdin.flush()

    def close(self) -> None:
        with contextlib.suppress(BrokenPipeError), self._process:  # what is unsent stays unsent
            self._process.kill()  # its copies end with it


class _Attempt:
    """The copy of a server that tries one text, with methods as of `subprocess.Popen`."""

    def __init__(self, server: subprocess.Popen[bytes]) -> None:
        assert server.stdout is not None
        self._told = FileIO(server.stdout.fileno(), closefd=False)  # `select` sees no buffer
        self._pid: int | None = None
        self._code: int | None = None

    def wait(self, timeout: float | None = None) -> int:
        while self._code is None:
            if not select.select([self._told], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired(SANDBOX, timeout or 0.0)
            self._read()
        return self._code

    def terminate(self) -> None:
        if self._pid is None:
            self._read()
        if self._code is None and self._pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._pid, signal.SIGTERM)

    def _read(self) -> None:
        line = self._told.readline()
        if self._pid is None and line:
            self._pid = int(line)
        else:
            self._code = int(line or 1)  # nothing: the server has ended


def _started(
    arguments: list[str], directory: Path, stream: int = subprocess.DEVNULL
) -> subprocess.Popen[bytes]:
    if secret_environment.all_secrets():
        secret_environment.hide_process()
    plain, _ = secret_environment.split(os.environ)
    return subprocess.Popen(
        # -P: files of the working folder must not be taken for modules of that name.
        [sys.executable, "-P", "-m", "drcli.base.start_module", SANDBOX, *arguments],
        cwd=directory,
        env={**PROCESS_TUNING, **plain, **LOG_ENCODING},
        stdin=stream,
        stdout=stream,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # signals that it sends to its group reach only itself
    )


class Sandbox:
    """A context manager that ends it and all that it has started.

    `course` is there with the result if it was asked to drive and could.
    """

    def __init__(
        self,
        request: SandboxRequest,
        content: bytes | None,
        directory: Path,
        server: SandboxServer | None = None,
        *,
        grid_only: bool = False,
    ) -> None:
        """`grid_only`: a server makes only the calls of the last sequence."""
        self.course: Course | None = None
        self._request = request
        self._scratch = tempfile.TemporaryDirectory(prefix="dr-reward-")
        self._folder = Path(self._scratch.name)
        # A training uses a copy too: a function finds the same files next to it.
        self._copy = self._folder / REWARD_FUNCTION_FILE
        if content is not None:
            self._copy.write_bytes(content)
        self._process: ChildProcess | _Attempt
        if server is not None:
            self._process = server.begin(self._folder, grid_only=grid_only)
            return
        request.write(self._folder)
        arguments = [str(self._folder), str(os.getpid())]
        if early := early_process.taken(SANDBOX):
            self._process = early.give(Order(SANDBOX, arguments, os.devnull, {}), b"")
        else:
            self._process = _started(arguments, directory)

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
            self.course = read_course(self._folder)
            result = SandboxResult.read(self._folder)
        except RecordError as why:
            what = f"The reward function has overwritten the result of the sandbox: {why}."
            return SandboxResult(failures=[Failure("ends", what)], values=self._no_values())
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
        values = self._no_values()
        return SandboxResult(problems=result.problems, failures=[failure], values=values)

    def _no_values(self) -> list[list[float | None]]:
        sequences = self._request.sequences if self.course is None else self.course.sequences
        return [[None] * len(calls) for calls in sequences]
