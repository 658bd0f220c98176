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

HOW_TO_GO_ON = "Continue with `dr-start-training --resume-or-start`, here or on another machine."
STAYS = (
    "DR_CONTINUE_ON_SPOT_INTERRUPTION is False, so it stays stopped. "
    "Continue with `dr-start-training --resume`."
)


@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    Attributes:
        save_within_s: How long its process may still run: the machine goes away, or a scheduler
            kills it. None if there is no hurry.
        stays_ended: Whether only an explicit `--resume` continues the run.
        complete: Whether the training is complete although the code is not 0: work at its end
            failed.
    """

    code: int
    message: str
    remedy: str = ""
    save_within_s: float | None = None
    stays_ended: bool = False
    complete: bool = False

    @property
    def state(self) -> State:
        """The state of the run from then on."""
        if self.code == 0 or self.complete:
            return "finished"
        if self.code == INTERRUPTED:
            return "interrupted"
        return "stopped" if self.code in (CTRL_C, TERMINATED) else "failed"


def interrupted(message: str, save_within_s: float, *, continues: bool) -> Outcome:
    """The outcome of a run whose machine goes away.

    Args:
        message: A sentence.
        save_within_s: How long its process may still run.
        continues: DR_CONTINUE_ON_SPOT_INTERRUPTION.
    """
    return Outcome(
        INTERRUPTED,
        message,
        HOW_TO_GO_ON if continues else STAYS,
        save_within_s=save_within_s,
        stays_ended=not continues,
    )


@dataclass(frozen=True)
class Ending:
    """The end of a run, for the duties that still have something to do.

    Attributes:
        outcome: How the run ends.
        deadline_s: When the duties must be over, on the monotonic clock; None for no limit.
        hurried: Whether a second signal came: then only what takes no time is done.
        only: If not empty, an earlier start has ended the training and could not do this part of
            the work at its end: nothing else is to be done.
    """

    outcome: Outcome
    deadline_s: float | None
    hurried: Callable[[], bool]
    only: tuple[str, ...] = ()

    def left_s(self, share: float = 1.0) -> float:
        """Seconds that are left, or this share of them; infinite without a limit."""
        if self.hurried():
            return 0.0
        if self.deadline_s is None:
            return float("inf")
        return max(0.0, share * (self.deadline_s - time.monotonic()))
