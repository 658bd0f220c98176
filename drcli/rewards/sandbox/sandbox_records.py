"""The sandbox's request and result; both travel as JSON files."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from drcli.base.json_record import RecordError, from_json, json_default, parse_json
from drcli.base.problems import Problem
from drcli.config.run_config import RaceConfig

FAULTS_FILE = "faults.txt"
"""Output of Python when it ends the process: stacks, or the traceback of an exception."""

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
        name: The author's name for the file of the reward function.
        sequences: Parameters of calls, in order, without the waypoints.
        waypoints: By `is_reversed`. Shape (2, n, 2).
        repeated: How many of the first sequences are called again, to see what the function
            remembers.
        races: Load the tracks and races of these workers, and before the sequences try the
            samples of each (`sample_calls`).
        call_s: Longest time of one call.
        load_s: Longest time of loading the file.
    """

    name: str
    sequences: list[list[dict[str, Any]]] = field(default_factory=list)
    waypoints: list[list[list[float]]] = field(default_factory=list)
    repeated: int = 0
    races: list[RaceConfig] | None = None
    call_s: float = 5.0
    load_s: float = 60.0

    def write(self, folder: Path) -> None:
        """Write it for the sandbox process."""
        (folder / _REQUEST_FILE).write_text(json.dumps(vars(self), default=json_default), "utf-8")

    @staticmethod
    def read(folder: Path) -> "SandboxRequest":
        """The request in a folder."""
        return from_json(SandboxRequest, parse_json((folder / _REQUEST_FILE).read_bytes()))


@dataclass(frozen=True)
class CallIndex:
    """One call: the number of its sequence and its number in that, both from 0."""

    sequence: int
    index: int


@dataclass(frozen=True)
class Failure:
    """Something that ends a training.

    Attributes:
        kind: What went wrong.
        reason: Such as "KeyError: 'sped'"; a whole sentence if no call was made.
        line: Line in the racer's file, if known.
        source: The text of that line.
        state: State of the car in the first such call, such as "on the start line (step 2, 0.0 % of
            the lap)"; empty if no call was made.
        params: The parameters of that call which the file reads, in short form.
        missing: The module that cannot be imported, if that is the reason.
        times: How many of the `SandboxResult.counted` calls fail like this.
        unusual: Whether only states that few trainings meet fail like this.
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
        """The failure in words."""
        failed = f"The reward function failed {self.state}: {self.reason}."
        text = failed if self.state else self.reason
        if not self.source or self.kind in ("type", "range"):  # not the fault of one line
            return text
        return f"{text}\nThe line is `{self.source}`."


@dataclass(frozen=True)
class Effect:
    """A side effect of a line; `what` is the file, address or program."""

    kind: EffectKind
    what: str
    line: int
    times: int


@dataclass(frozen=True)
class Difference:
    """`times` of `of` calls returned something else in another pass, first the one at `place`.

    A value is None if the call failed.
    """

    place: CallIndex
    value: float | None
    other: float | None
    times: int
    of: int


@dataclass(frozen=True)
class SharedState:
    """`times` of `of` rewards of a car are others if a second car drives at the same time.

    `names` are what the file sets outside of itself, such as `math.last`, if that can be told.
    """

    names: list[str]
    times: int
    of: int


@dataclass(frozen=True)
class Printed:
    """Output to stdout and stderr in the counted calls; `line` printed first, if known."""

    lines: int = 0
    characters: int = 0
    line: int | None = None


@dataclass(frozen=True)
class Timing:
    """Duration of the calls, and which call took longest."""

    median_s: float
    mean_s: float
    worst_s: float
    worst: CallIndex


@dataclass(frozen=True)
class SandboxResult:
    """What the sandbox found.

    Attributes:
        problems: Worlds and races that cannot be loaded.
        values: The value of each call, those of the samples last; None if it failed or was not
            made.
        failures: Everything that ends a training.
        returned: How many calls returned which type.
        line: Line of `def reward_function`, if known.
        timing: Duration of the calls of the sequences, else of the samples; None without any.
        calls: How many calls were made.
        counted: How many of them were samples, or all without samples: failures and lines are
            counted among these, so that they do not depend on the sequences.
        effects: Side effects.
        printed: Output.
        random: A call that returned something else when the same calls were repeated.
        memory: A call that returned something else when the episodes came in another order.
        shared: What cars would share that drive at the same time.
        finished: False until the reward function has been tried.
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
        """Write it for the parent, in one step."""
        unfinished = folder / f"{_RESULT_FILE}.part"
        unfinished.write_text(json.dumps({"version": _VERSION, **asdict(self)}), "utf-8")
        unfinished.rename(folder / _RESULT_FILE)

    @staticmethod
    def read(folder: Path) -> "SandboxResult | None":
        """The result in a folder; None if the process has not written it.

        Raises:
            RecordError: The racer's code has overwritten it.
        """
        try:
            record = parse_json((folder / _RESULT_FILE).read_bytes())
        except FileNotFoundError:
            return None
        result = from_json(SandboxResult, record)
        if record.get("version") != _VERSION:
            raise RecordError(f"its version is {record.get('version')} instead of {_VERSION}")
        return result
