"""What the commands say that stop a process in the background."""

from dataclasses import dataclass

from drcli.cli import console


@dataclass(frozen=True)
class StoppedProcess:
    """What a command did that stops a process in the background.

    Attributes:
        stopped: Whether it ran.
        pid: Its number; it has ended. Null if it did not run.
    """

    stopped: bool
    pid: int | None


def show_stopped(what: str, pid: int | None, *, none: str, as_json: bool) -> None:
    """Say that a process has been stopped.

    Args:
        what: Its name within a sentence, such as "the console".
        pid: Its number; None if it did not run.
        none: What is said then.
        as_json: Whether it is printed as JSON.
    """
    said = none if pid is None else f"Stopped {what} (process {pid})."
    console.emit(StoppedProcess(pid is not None, pid), said, as_json=as_json)
