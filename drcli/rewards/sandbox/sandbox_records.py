"""The sandbox's request and result, as JSON files."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from drcli.base.json_record import RecordError, from_json, json_default, parse_json
from drcli.base.problems import Problem
from drcli.config.run_config import RaceConfig

FAULTS_FILE = "faults.txt"
"""Of Python when it ends the process."""

FailureKind = Literal[
    "load",
    "signature",
    "undefined",
    "raises",
    "type",
    "range",
    "endless",
    "ends",
    "crashes",
    "replaces",
]
EffectKind = Literal["writes", "reads", "network", "process"]

REMEDIES: dict[FailureKind, str] = {
    "load": "Correct the file, and check it again.",
    "signature": "Write `def reward_function(params):` with a `return` on every path.",
    "undefined": "Correct the name, or give it a value before that line.",
    "raises": "Correct that line: a training ends where it fails.",
    "type": "Return a number on every path, as in `return float(reward)`: a path without `return` "
    "gives None.",
    "range": "Return a finite number between -100000 and 100000; guard divisions and logarithms.",
    "endless": "Look for a loop that does not end, or an operation that takes too long: a call may "
    "take 5 s.",
    "ends": "Remove what ends the process, such as os._exit() or os.kill().",
    "crashes": "Remove the call into the library that crashes.",
    "replaces": "Give your own function another name.",
}

_REQUEST_FILE, _RESULT_FILE = "request.json", "result.json"
_VERSION = 1


@dataclass(frozen=True)
class SandboxRequest:
    """What to try.

    Attributes:
        sequences: Parameters without the waypoints.
        waypoints: By `is_reversed`. Shape (2, n, 2).
        repeated: Sequences that are called again.
        races: Their samples come first.
    """

    name: str
    sequences: list[list[dict[str, Any]]] = field(default_factory=list)
    waypoints: list[list[list[float]]] = field(default_factory=list)
    repeated: int = 0
    races: list[RaceConfig] | None = None
    call_s: float = 5.0
    load_s: float = 60.0

    def write(self, folder: Path) -> None:
        (folder / _REQUEST_FILE).write_text(json.dumps(vars(self), default=json_default), "utf-8")

    @staticmethod
    def read(folder: Path) -> "SandboxRequest":
        return from_json(SandboxRequest, parse_json((folder / _REQUEST_FILE).read_bytes()))


@dataclass(frozen=True)
class CallIndex:
    """Numbers of the sequence and in it, from 0."""

    sequence: int
    index: int


@dataclass(frozen=True)
class Failure:
    """Something that ends a training.

    Attributes:
        reason: Such as "KeyError: 'sped'".
        state: "on the start line (step 2, 0.0 % of the lap)".
        params: Those that the file reads.
        missing: The module that cannot be imported.
        times: Of the `SandboxResult.counted` calls.
        unusual: Only rare states fail like this.
    """

    kind: FailureKind
    reason: str
    line: int | None = None
    source: str = ""
    state: str = ""
    params: str = ""
    missing: str = ""
    times: int = 0
    unusual: bool = False

    @property
    def sentence(self) -> str:
        failed = f"The reward function failed {self.state}: {self.reason}."
        text = failed if self.state else self.reason
        if not self.source or self.kind in ("type", "range"):  # not the fault of one line
            return text
        return f"{text}\nThe line is `{self.source}`."


@dataclass(frozen=True)
class Effect:
    """Of a line."""

    kind: EffectKind
    what: str
    line: int
    times: int


@dataclass(frozen=True)
class Difference:
    """`times` of `of` calls returned something else in another pass, first at `place`."""

    place: CallIndex
    value: float | None
    other: float | None
    times: int
    of: int


@dataclass(frozen=True)
class SharedState:
    """`times` of `of` rewards of a car are others beside a second car.

    `names` are what the file sets elsewhere, such as `math.last`.
    """

    names: list[str]
    times: int
    of: int


@dataclass(frozen=True)
class Printed:
    """In counted calls."""

    lines: int = 0
    characters: int = 0
    line: int | None = None


@dataclass(frozen=True)
class Timing:
    """Of calls."""

    median_s: float
    mean_s: float
    worst_s: float
    worst: CallIndex


@dataclass(frozen=True)
class SandboxResult:
    """What the sandbox found.

    Attributes:
        problems: Worlds and races that cannot be loaded.
        values: The samples last; None if it failed or was not made.
        returned: Calls by type.
        counted: Samples, or all without samples.
        random: Differs when the same calls are repeated.
        memory: Differs with another order of episodes.
        finished: Whether the function has been tried.
    """

    problems: list[Problem] = field(default_factory=list)
    values: list[list[float | None]] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)
    returned: dict[str, int] = field(default_factory=dict)
    line: int | None = None
    timing: Timing | None = None
    calls: int = 0
    counted: int = 0
    effects: list[Effect] = field(default_factory=list)
    printed: Printed = Printed()
    random: Difference | None = None
    memory: Difference | None = None
    shared: SharedState | None = None
    finished: bool = True

    def write(self, folder: Path) -> None:
        unfinished = folder / f"{_RESULT_FILE}.part"
        unfinished.write_text(json.dumps({"version": _VERSION, **asdict(self)}), "utf-8")
        unfinished.rename(folder / _RESULT_FILE)

    @staticmethod
    def read(folder: Path) -> "SandboxResult | None":
        """None if not written; RecordError if overwritten."""
        try:
            record = parse_json((folder / _RESULT_FILE).read_bytes())
        except FileNotFoundError:
            return None
        result = from_json(SandboxResult, record)
        if record.get("version") != _VERSION:
            raise RecordError(f"its version is {record.get('version')} instead of {_VERSION}")
        return result
