"""Says why a process started in the background is not there."""

from pathlib import Path

from drcli.base.errors import DrError, WorkerDied
from drcli.base.installation import installation_error
from drcli.runs.text_tail import text_tail

READY_TIMEOUT_S = 60.0
_TAIL_BYTES = 4000

_LONGEST_LINE = 300


def log_bytes(log: Path) -> int:
    try:
        return log.stat().st_size
    except OSError:
        return 0


def failed_start(what: str, code: int | None, log: Path, earlier_bytes: int) -> DrError:
    """The error of a process that exited (`code`), or was not ready in time (None).

    `earlier_bytes` of its log are from before the start.
    """
    if code is None:
        return WorkerDied(
            f"{what} did not start: it was not ready within {READY_TIMEOUT_S:g} seconds.",
            remedy=f"Try again when the machine is less busy. Its log is {log}.",
        )
    return installation_error() or WorkerDied(
        f"{what} did not start: its process exited (exit code {code}). "
        f"The last line of its log is: {_last_line(log, earlier_bytes)}",
        remedy=f"Read the reason in {log}.",
    )


def _last_line(log: Path, earlier_bytes: int) -> str:
    try:
        # A log that got shorter was begun anew.
        if log.stat().st_size == earlier_bytes:
            return "(nothing)"
        lines = [line for line in text_tail(log, _TAIL_BYTES).splitlines() if line.strip()]
    except OSError:
        return "(nothing)"
    return lines[-1].strip()[:_LONGEST_LINE] if lines else "(nothing)"
