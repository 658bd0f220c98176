"""What travels between a worker and the process that calls its reward functions.

The worker sends `marshal`, Python's fastest encoding. Answers come from a racer's code, so they are
numbers and checked JSON.
"""

import marshal
import struct
from array import array
from dataclasses import dataclass, field
from typing import Any

from drcli.base.json_record import JsonRecord, RecordError

MOST_BYTES = 1 << 28
_COUNT = struct.Struct("<I")


@dataclass(frozen=True)
class Load(JsonRecord):
    file: str
    cars: int


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

    call: int
    message: str
    kind: str
    reason: str
    file: str | None
    line: int | None
    source: str
    params: str
    cause: str
    out_of_memory: bool


@dataclass(frozen=True)
class _Facts(JsonRecord):
    failures: list[CallFailure] = field(default_factory=list)
    free: list[str] = field(default_factory=list)
    pid: int | None = None


@dataclass(frozen=True)
class Answer:
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
    def decode(data: bytes, calls: int) -> "Answer":
        """RecordError if the racer's code wrote or damaged it."""
        numbers = array("d")
        end = _COUNT.size + 2 * calls * numbers.itemsize
        if len(data) < end or _COUNT.unpack_from(data)[0] != calls:
            raise RecordError("the answer of the process of the reward function is damaged")
        numbers.frombytes(data[_COUNT.size : end])
        found = numbers.tolist()
        facts = _Facts.decode(data[end:]) if len(data) > end else _Facts()
        return Answer(found[:calls], found[calls:], facts.failures, facts.free, facts.pid)
