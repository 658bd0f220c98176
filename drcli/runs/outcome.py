"""How a run ends: its exit code, its sentence, and how long the rest may take."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from drcli.exchange.run_record import State

INTERRUPTED = 75
"""Exit code of a run that was interrupted and can be resumed. Source: EX_TEMPFAIL of sysexits.h,
which invites the caller to try again."""

CTRL_C, TERMINATED = 130, 143
"""Exit codes after Ctrl-C and after SIGTERM."""


@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    Attributes:
        save_within_s: How long its process may still run: the machine goes away, or a scheduler
            kills it. None if there is no hurry.
    """

    code: int
    message: str
    remedy: str = ""
    save_within_s: float | None = None

    @property
    def state(self) -> State:
        """The state of the run from then on."""
        if self.code == 0:
            return "finished"
        if self.code == INTERRUPTED:
            return "interrupted"
        return "stopped" if self.code in (CTRL_C, TERMINATED) else "failed"


@dataclass(frozen=True)
class Ending:
    """The end of a run, for the duties that still have something to do.

    Attributes:
        outcome: How the run ends.
        deadline_s: When all of it must be over, on the monotonic clock; None for no limit.
        hurried: Whether a second signal came: then only what takes no time is done.
    """

    outcome: Outcome
    deadline_s: float | None
    hurried: Callable[[], bool]

    def left_s(self, share: float = 1.0) -> float:
        """Seconds that are left, or this share of them; infinite without a limit."""
        if self.hurried():
            return 0.0
        if self.deadline_s is None:
            return float("inf")
        return max(0.0, share * (self.deadline_s - time.monotonic()))
