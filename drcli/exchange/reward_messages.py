"""What travels between a worker and the process that calls its reward functions.

The worker's own messages are in `marshal`, the fastest encoding that Python has. The answers come
from a process that runs a racer's code, so they are numbers and JSON, which is checked.
"""

import marshal
import struct
from array import array
from dataclasses import dataclass, field
from typing import Any

from drcli.base.json_record import JsonRecord, RecordError

MOST_BYTES = 1 << 28
"""Of a message."""

_COUNT = struct.Struct("<I")


@dataclass(frozen=True)
class Load(JsonRecord):
    """The first message: the file, and for how many cars to load it."""

    file: str
    cars: int


@dataclass(frozen=True)
class Calls:
    """Calls to make.

    Attributes:
        cars: The car of each.
        params: The parameters of each, without its waypoints.
        deadline_s: How long one may take.
        waypoints: By `is_reversed`, as far as they were not told before.
    """

    cars: list[int]
    params: list[dict[str, Any]]
    deadline_s: float
    waypoints: dict[bool, list[Any]]

    def encode(self) -> bytes:
        """The message."""
        return marshal.dumps((self.cars, self.params, self.deadline_s, self.waypoints))

    @staticmethod
    def decode(data: bytes) -> "Calls":
        """Read a message of the worker."""
        return Calls(*marshal.loads(data))


@dataclass(frozen=True)
class CallFailure(JsonRecord):
    """The failure of a call, or of loading the file; `RewardError` says what the fields mean.

    Attributes:
        call: Number of the call in the message.
        params: The parameters of that call, as JSON.
        cause: Name of the exception behind it; empty without one.
        out_of_memory: Whether memory was short.
    """

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
    """What came of a message.

    Attributes:
        rewards: Of each call.
        seconds: How long each took.
        failures: Those that failed, in their order.
        free: What the process may still reach, once it has loaded the file.
        pid: Its number, then.
    """

    rewards: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    failures: list[CallFailure] = field(default_factory=list)
    free: list[str] = field(default_factory=list)
    pid: int | None = None

    def encode(self) -> bytes:
        """The message."""
        numbers = array("d", self.rewards + self.seconds).tobytes()
        told = self.failures or self.pid
        facts = _Facts(self.failures, self.free, self.pid).encode() if told else b""
        return _COUNT.pack(len(self.rewards)) + numbers + facts

    @staticmethod
    def decode(data: bytes, calls: int) -> "Answer":
        """Read the answer to so many calls.

        Raises:
            RecordError: The racer's code has written it, or has damaged it.
        """
        numbers = array("d")
        end = _COUNT.size + 2 * calls * numbers.itemsize
        if len(data) < end or _COUNT.unpack_from(data)[0] != calls:
            raise RecordError("the answer of the process of the reward function is damaged")
        numbers.frombytes(data[_COUNT.size : end])
        found = numbers.tolist()
        facts = _Facts.decode(data[end:]) if len(data) > end else _Facts()
        return Answer(found[:calls], found[calls:], facts.failures, facts.free, facts.pid)
