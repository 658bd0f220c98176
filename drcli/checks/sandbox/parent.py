"""Has a reward function called along a drive in a process of its own, and gets the statement."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drcli.base.errors import SettingsError
from drcli.checks.first_step import idle_conditions
from drcli.checks.sandbox.statement import (
    FAULTS_FILE,
    HANGS,
    ORDER_FILE,
    STATEMENT_FILE,
    Failure,
    Order,
    Statement,
)
from drcli.config import secret_environment

_MODULE = "drcli.checks.sandbox.reward_process"
_PATIENCE_S = 200.0
"""Longest hearing: loading the file three times, which may take a minute each."""


@dataclass(frozen=True)
class Questions:
    """What reward functions are asked.

    Attributes:
        sequences: Parameters of calls in order, without the waypoints.
        repeated: How many of the sequences, from the first, are played more than once.
        waypoints: The waypoints by `is_reversed`.
    """

    sequences: Sequence[Sequence[Mapping[str, Any]]]
    repeated: int
    waypoints: Mapping[bool, Sequence[tuple[float, float]]]


class Hearing:
    """A hearing that has begun.

    Args:
        file: The racer's file.
        questions: What to ask.
        directory: Working folder of the process, that of the racer as in a training.

    Raises:
        SettingsError: The file cannot be read.
    """

    def __init__(self, file: Path, questions: Questions, directory: Path) -> None:
        self._file = file
        self._questions = questions
        try:
            self._content = file.read_bytes()
        except OSError as error:
            raise SettingsError(
                f"{file}: the reward function cannot be read: {error.strerror}.",
                remedy="Name a file that is there, such as custom_files/reward_function.py.",
            ) from None
        self._folder = tempfile.TemporaryDirectory(prefix="dr-reward-")
        folder = Path(self._folder.name)
        # A training works on a copy too: a function finds the same beside its file.
        self._copy = folder / "reward_function.py"
        self._copy.write_bytes(self._content)
        order = Order(
            file=str(self._copy),
            sequences=[[dict(call) for call in calls] for calls in questions.sequences],
            repeated=questions.repeated,
            waypoints={way: list(points) for way, points in questions.waypoints.items()},
        )
        (folder / ORDER_FILE).write_text(order.model_dump_json(), "utf-8")
        if secret_environment.all_secrets():
            secret_environment.hide_process()
        self._process = subprocess.Popen(
            # -P: files of the working folder must not be taken for modules of that name.
            [sys.executable, "-P", "-m", _MODULE, str(folder)],
            cwd=directory,
            # As in a training, where printing any letter is fine.
            env={
                **secret_environment.split(os.environ)[0],
                "PYTHONIOENCODING": "utf-8:backslashreplace",
            },
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def statement(self) -> Statement:
        """Wait for what it has to say."""
        code: int | None = None
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = self._process.wait(_PATIENCE_S)
        written = Path(self._folder.name) / STATEMENT_FILE
        if written.is_file():
            statement = Statement.model_validate_json(written.read_text("utf-8"))
        else:
            statement = self._ended(code)
        return statement.model_copy(
            update={
                "failures": [self._renamed(failure) for failure in statement.failures],
                "idle": idle_conditions(self._content),
            }
        )

    def close(self) -> None:
        """End it, and whatever the racer's code has started. Closing twice does nothing more."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._folder.cleanup()

    def _ended(self, code: int | None) -> Statement:
        """What is known of a function that ended the process it was called in."""
        faults = Path(self._folder.name) / FAULTS_FILE
        trace = faults.read_text("utf-8", "replace") if faults.is_file() else ""
        # Python's own fault handler writes ASCII alone.
        name = str(self._copy).encode("ascii", "backslashreplace").decode()
        found = re.search(rf'"{re.escape(name)}", line (\d+)', trace)
        line = int(found.group(1)) if found else None
        if code is None or trace.startswith(HANGS):
            kind, what = "endless", "a call never returns and cannot be interrupted"
        elif "Fatal Python error" in trace:
            kind, what = "crashes", f"a call crashes Python ({_reason(code)})"
        elif code == -signal.SIGKILL:
            kind, what = "ends", "a call ends the whole process, or has the system end it (SIGKILL)"
        else:
            kind, what = "ends", f"a call ends the whole process ({_reason(code)})"
        values: list[list[float | None]] = [
            [None] * len(calls) for calls in self._questions.sequences
        ]
        failure = Failure.model_validate(
            {
                "kind": kind,
                "what": f"The reward function fails: {what}.",
                "line": line,
                "source": self._source(line),
                "first": None,
                "times": 1,
            }
        )
        return Statement(values=values, failures=[failure])

    def _source(self, line: int | None) -> str:
        lines = self._copy.read_text("utf-8", "replace").splitlines()
        return lines[line - 1].strip() if line and line <= len(lines) else ""

    def _renamed(self, failure: Failure) -> Failure:
        """The same without the place, which is told apart, and without a name nobody knows."""
        what = failure.what
        for place in (f" in {self._copy}, line {failure.line},", f" in {self._copy}"):
            what = what.replace(place, "")
        what = what.replace(str(self._copy), self._file.name).replace("?.", "?")
        remedy = self._remedy(failure.missing.partition(".")[0])
        return failure.model_copy(update={"what": what, "remedy": remedy})

    def _remedy(self, module: str) -> str:
        """What to do about a module that is not there; nothing where all are."""
        folder = self._file.parent
        if not module:
            return ""
        if module == self._file.stem or module == self._copy.stem:
            return "Remove the import: all that the file defines is there already."
        if (folder / f"{module}.py").exists() or (folder / module).is_dir():
            return f"Put what you need of {module} into {self._file.name}: trainings have no more."
        return (
            "Install the package that brings it where trainings run, as with `pip install "
            f"{module}`, or do without."
        )


def _reason(code: int) -> str:
    """Why a process ended."""
    return signal.Signals(-code).name if code < 0 else f"exit code {code}"
