"""What a worker counts of a failing reward function."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from drcli.base.json_record import JsonRecord

MOST_ERRORS = 20


@dataclass(frozen=True)
class RewardErrorEntry:
    """One distinct error of a reward function.

    Attributes:
        kind: As in `drsim.errors.RewardError`; `discard` for an episode declared broken.
        exception: Class of the exception; empty where a value was wrong.
        reason: What went wrong in the first such call, such as "KeyError: 'sped'".
        line: Line in the racer's file, if known.
        source: The text of that line.
        params: The parameters of the first such call, in short form.
        count: How many calls failed like this.
        first_iteration: Iteration of the first such call.
        last_iteration: Iteration of the newest such call.
    """

    kind: str
    exception: str
    reason: str
    line: int | None = None
    source: str = ""
    params: str = ""
    count: int = 1
    first_iteration: int = 0
    last_iteration: int = 0

    @property
    def key(self) -> tuple[str, str, int | None]:
        """Errors that differ in numbers only are the same."""
        return self.kind, self.exception, self.line

    @property
    def text(self) -> str:
        """As in "line 12: KeyError: 'sped'"."""
        return f"line {self.line}: {self.reason}" if self.line else self.reason

    def joined(self, other: "RewardErrorEntry") -> "RewardErrorEntry":
        """With more such calls."""
        return replace(
            self,
            count=self.count + other.count,
            first_iteration=min(self.first_iteration, other.first_iteration),
            last_iteration=max(self.last_iteration, other.last_iteration),
        )


@dataclass(frozen=True)
class RewardCounts:
    """Numbers of some time.

    Attributes:
        calls: Calls of the reward function.
        failed: How many of them failed.
        discarded: Episodes declared broken.
        errors: The distinct errors, with those of discarded episodes, oldest first.
    """

    calls: int = 0
    failed: int = 0
    discarded: int = 0
    errors: list[RewardErrorEntry] = field(default_factory=list)

    def joined(self, other: "RewardCounts") -> "RewardCounts":
        """With later ones."""
        errors = {entry.key: entry for entry in self.errors}
        for entry in other.errors:
            known = errors.get(entry.key)
            if known is not None:
                errors[entry.key] = known.joined(entry)
            elif len(errors) < MOST_ERRORS:
                errors[entry.key] = entry
        return RewardCounts(
            self.calls + other.calls,
            self.failed + other.failed,
            self.discarded + other.discarded,
            list(errors.values()),
        )

    @property
    def share(self) -> float:
        """Of failed calls, 0 to 1."""
        return self.failed / self.calls if self.calls else 0.0

    def failures(self) -> str:
        """How many calls failed, without a full stop."""
        share = f"{100.0 * self.share:.2g} %"
        return (
            f"{self.failed:,} of {self.calls:,} calls of the reward function failed ({share}); "
            "nothing was learned from these steps"
        )


def sum_of(counts: Iterable[RewardCounts]) -> RewardCounts:
    total = RewardCounts()
    for each in counts:
        total = total.joined(each)
    return total


@dataclass(frozen=True)
class RewardErrorRecord(JsonRecord):
    """What one worker has counted; only it writes this.

    The newest iteration (-1 before the first) is separate: after an interruption it is driven and
    counted again.
    """

    worker: int
    iteration: int = -1
    before: RewardCounts = field(default_factory=RewardCounts)
    newest: RewardCounts = field(default_factory=RewardCounts)

    @property
    def total(self) -> RewardCounts:
        return self.before.joined(self.newest)

    def begun(self, iteration: int) -> "RewardErrorRecord":
        """The record at the begin of an iteration; the newest, driven once more, counts once.

        Others, driven again after a rollback, count twice: their calls were other calls.
        """
        before = self.before if iteration == self.iteration else self.total
        return replace(self, iteration=iteration, before=before, newest=RewardCounts())
