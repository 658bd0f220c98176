"""Output of the commands that stop a process in the background."""

from dataclasses import dataclass
from typing import Annotated

from drcli.cli import terminal


@dataclass(frozen=True)
class StoppedProcess:
    """What a command did that stops a process in the background."""

    stopped: Annotated[bool, "Whether it ran."]
    pid: Annotated[int | None, "Its number; it has ended. Null if it did not run."]


def show_stopped(what: str, pid: int | None, *, none: str) -> None:
    said = none if pid is None else f"Stopped {what} (process {pid})."
    terminal.emit(StoppedProcess(pid is not None, pid), said)
