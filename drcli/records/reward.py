"""What a worker counts of a failing reward function."""

import marshal
import struct
from array import array
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

from drcli.base.json_record import JsonRecord, Pid, RecordError, SafeInt

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
    line: SafeInt | None = None
    source: str = ""
    params: str = ""
    count: SafeInt = 1
    first_iteration: SafeInt = 0
    last_iteration: SafeInt = 0

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

    calls: SafeInt = 0
    failed: SafeInt = 0
    discarded: SafeInt = 0
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

    worker: SafeInt
    iteration: SafeInt = -1
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


# What travels between a worker and the process that calls its reward functions.
#
# The worker sends `marshal`, Python's fastest encoding. Answers come from a racer's code, so they
# are numbers and checked JSON.


MOST_BYTES = 1 << 28
_COUNT = struct.Struct("<I")


@dataclass(frozen=True)
class Load(JsonRecord):
    file: str
    cars: SafeInt


@dataclass(frozen=True)
class Calls:
    """`deadline_s` is for one call; `waypoints`, by `is_reversed`, only if not told before."""

    cars: list[int]
    params: list[dict[str, Any]]
    deadline_s: float
    waypoints: dict[bool, list[Any]]

    def encode(self) -> bytes:
        return marshal.dumps((self.cars, self.params, self.deadline_s, self.waypoints))

    @staticmethod
    def decode(data: bytes) -> "Calls":
        return Calls(*marshal.loads(data))


@dataclass(frozen=True)
class CallFailure(JsonRecord):
    """The failure of a call, or of loading the file; fields as in `RewardError`."""

    call: SafeInt
    message: str
    kind: str
    reason: str
    file: str | None
    line: SafeInt | None
    source: str
    params: str
    cause: str
    out_of_memory: bool


@dataclass(frozen=True)
class _Facts(JsonRecord):
    failures: list[CallFailure] = field(default_factory=list)
    free: list[str] = field(default_factory=list)
    pid: Pid | None = None


@dataclass(frozen=True)
class RewardResponse:
    """`free` is what the process may still reach, once it has loaded the file."""

    rewards: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    failures: list[CallFailure] = field(default_factory=list)
    free: list[str] = field(default_factory=list)
    pid: int | None = None

    def encode(self) -> bytes:
        numbers = array("d", self.rewards + self.seconds).tobytes()
        told = self.failures or self.pid
        facts = _Facts(self.failures, self.free, self.pid).encode() if told else b""
        return _COUNT.pack(len(self.rewards)) + numbers + facts

    @staticmethod
    def decode(data: bytes, calls: int) -> "RewardResponse":
        """RecordError if the racer's code wrote or damaged it."""
        numbers = array("d")
        end = _COUNT.size + 2 * calls * numbers.itemsize
        if len(data) < end or _COUNT.unpack_from(data)[0] != calls:
            raise RecordError("the answer of the process of the reward function is damaged")
        numbers.frombytes(data[_COUNT.size : end])
        found = numbers.tolist()
        facts = _Facts.decode(data[end:]) if len(data) > end else _Facts()
        return RewardResponse(found[:calls], found[calls:], facts.failures, facts.free, facts.pid)
