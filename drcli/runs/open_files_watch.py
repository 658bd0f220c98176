"""Names a worker that opens more and more files."""

from collections.abc import Callable

from drcli.base.system_calls import soft_limit
from drcli.runs.duty import Duty, RunningTraining
from drcli.runs.outcome import Outcome
from drcli.runs.seen_pulses import SeenPulses
from drcli.runs.warnings_board import WarningsBoard

MOST_OPEN = 0.7


def open_files_limit() -> int:
    """0 for any number."""
    return soft_limit("open_files") or 0


class OpenFilesWatch(Duty):
    name = "open files watch"

    def __init__(
        self,
        pulses: SeenPulses,
        board: WarningsBoard,
        limit: Callable[[], int] = open_files_limit,
    ) -> None:
        self._pulses = pulses
        self._board = board
        self._limit = limit()
        self._named: set[int] = set()

    def start(self, run: RunningTraining) -> None:
        self._run = run
        self._board.begin(run.journal)

    def check(self) -> Outcome | None:
        for child in self._run.children:
            seen = self._pulses.of(child.name)
            subject = f"open files of {child.name}"
            if seen is None or seen.record is None:
                continue
            if seen.record.open_files <= MOST_OPEN * self._limit or self._limit <= 0:
                self._board.clear(subject)
            elif seen.pid not in self._named:
                self._named.add(seen.pid)
                self._board.warn(
                    subject,
                    f"{child.name} has {seen.record.open_files:,} open files and may have "
                    f"{self._limit:,}. A reward function that opens a file at each step and does "
                    "not close it does this.",
                    worker=child.name,
                )
        return None
