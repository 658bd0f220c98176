"""How a run ends: exit code, sentence, and how long the rest may take."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from drcli.records.run_record import State

INTERRUPTED = 75
"""EX_TEMPFAIL of sysexits.h invites to try again."""

CTRL_C, TERMINATED = 130, 143
HOW_TO_GO_ON = "Continue with `dr-start-training --resume-or-start`, here or on another machine."
STAYS = (
    "DR_CONTINUE_ON_SPOT_INTERRUPTION is False, so it stays stopped. "
    "Continue with `dr-start-training --resume`."
)


@dataclass(frozen=True)
class Outcome:
    """How a run ended; `save_within_s` is None without hurry.

    `stays_ended`: only an explicit `--resume` continues it. `complete`: only work at the end
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
        if self.code == 0 or self.complete:
            return "finished"
        if self.code == INTERRUPTED:
            return "interrupted"
        return "stopped" if self.code in (CTRL_C, TERMINATED) else "failed"


def interrupted(message: str, save_within_s: float, *, continues: bool) -> Outcome:
    """The machine goes away; `continues`: DR_CONTINUE_ON_SPOT_INTERRUPTION."""
    return Outcome(
        INTERRUPTED,
        message,
        HOW_TO_GO_ON if continues else STAYS,
        save_within_s=save_within_s,
        stays_ended=not continues,
    )


@dataclass(frozen=True)
class Ending:
    """The end of a run, for duties.

    Attributes:
        deadline_s: On the monotonic clock.
        hurried: A second signal came: only what takes no time is done.
        only: All that is to be done: what an earlier start has left over.
    """

    outcome: Outcome
    deadline_s: float | None
    hurried: Callable[[], bool]
    only: tuple[str, ...] = ()

    def left_s(self, share: float = 1.0) -> float:
        if self.hurried():
            return 0.0
        if self.deadline_s is None:
            return float("inf")
        return max(0.0, share * (self.deadline_s - time.monotonic()))
