"""What the sandbox is asked to do and what it found; both travel as JSON files."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from drcli.base.json_record import Misfit, built, parsed, written
from drcli.base.problems import Problem
from drcli.config.settings import RaceConfig

FAULTS_FILE = "faults.txt"
"""What Python writes when it ends the process: stacks, or the traceback of an exception."""

FailureKind = Literal[
    "load", "signature", "raises", "type", "range", "endless", "ends", "crashes", "replaces"
]
EffectKind = Literal["writes", "reads", "network", "process"]

REMEDIES: dict[FailureKind, str] = {
    "load": "Correct the file, and check it again.",
    "signature": "Write `def reward_function(params):` with a `return` on every path.",
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
        name: What the author calls the file of the reward function.
        sequences: Parameters of calls in the order in which to make them, without the waypoints.
        waypoints: The waypoints by `is_reversed`. Shape (2, n, 2).
        repeated: How many of the sequences, from the first, are played more than once, to see what
            the function remembers; 0 plays everything once.
        races: Load the tracks and races of these workers, and add a sequence for each.
        call_s: How long one call may take, seconds.
        load_s: How long loading the file may take, seconds.
    """

    name: str
    sequences: list[list[dict[str, Any]]] = field(default_factory=list)
    waypoints: list[list[list[float]]] = field(default_factory=list)
    repeated: int = 0
    races: list[RaceConfig] | None = None
    call_s: float = 5.0
    load_s: float = 60.0

    def write(self, folder: Path) -> None:
        """Leave it for the process."""
        (folder / _REQUEST_FILE).write_text(json.dumps(vars(self), default=written), "utf-8")

    @staticmethod
    def read(folder: Path) -> "SandboxRequest":
        """The request in a folder."""
        return built(SandboxRequest, parsed((folder / _REQUEST_FILE).read_bytes()))


@dataclass(frozen=True)
class Place:
    """One call: the number of its sequence and its number in that, both from 0."""

    sequence: int
    index: int


@dataclass(frozen=True)
class Failure:
    """Something that ends a training.

    Attributes:
        kind: What went wrong.
        reason: Such as "KeyError: 'sped'"; a whole sentence where no call was made.
        line: Line in the racer's file, where known.
        source: The text of that line, or nothing.
        params: The parameters of the first such call, in short form.
        missing: The module that cannot be imported, if that is the reason.
        first: The first call that fails like this; None where it is not known.
        times: How many calls fail like this.
    """

    kind: FailureKind
    reason: str
    line: int | None = None
    source: str = ""
    params: str = ""
    missing: str = ""
    first: Place | None = None
    times: int = 1

    def sentence(self, state: str = "") -> str:
        """What went wrong, with the line that did it; a wrong value is not the fault of a line.

        Args:
            state: In which state the car was, such as "on the start line".
        """
        failed = f"The reward function failed{f' {state}' if state else ''}: {self.reason}."
        text = failed if self.params else self.reason
        if not self.source or self.kind in ("type", "range"):
            return text
        return f"{text} The line is `{self.source}`."


@dataclass(frozen=True)
class Effect:
    """Something that a line does beside returning a number: with which file, address or program."""

    kind: EffectKind
    what: str
    line: int
    times: int


@dataclass(frozen=True)
class Difference:
    """Calls that returned something else in another pass: the first one, and how many of how many.

    A value is None where the call failed.
    """

    place: Place
    value: float | None
    other: float | None
    times: int
    of: int


@dataclass(frozen=True)
class Printed:
    """What went to stdout and stderr in the first pass; `line` printed first, where known."""

    lines: int = 0
    characters: int = 0
    line: int | None = None


@dataclass(frozen=True)
class Timing:
    """How long calls took in seconds, and which one took longest."""

    median_s: float
    mean_s: float
    worst_s: float
    worst: Place


@dataclass(frozen=True)
class Growth:
    """A global that held so many things before a pass of so many calls, and more after it."""

    name: str
    before: int
    after: int
    calls: int


@dataclass(frozen=True)
class SandboxResult:
    """What the sandbox found.

    Attributes:
        problems: Worlds and races that cannot be loaded.
        values: What each call returned; None where it failed or was not made.
        failures: What ends a training.
        returned: How many calls returned which type.
        line: Line of `def reward_function`, where known.
        timing: How long calls took; None where none was made.
        calls: How many calls were made of those asked for.
        effects: What it does beside returning a number.
        printed: What it printed.
        growing: Globals that grow for ever.
        random: A call that paid something else when the same calls were repeated.
        memory: A call that paid something else when the episodes came in another order.
        finished: False as long as nothing but the worlds has been tried.
    """

    problems: list[Problem] = field(default_factory=list)
    values: list[list[float | None]] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)
    returned: dict[str, int] = field(default_factory=dict)
    line: int | None = None
    timing: Timing | None = None
    calls: int = 0
    effects: list[Effect] = field(default_factory=list)
    printed: Printed = Printed()
    growing: list[Growth] = field(default_factory=list)
    random: Difference | None = None
    memory: Difference | None = None
    finished: bool = True

    def write(self, folder: Path) -> None:
        """Leave it for the parent, in one step."""
        unfinished = folder / f"{_RESULT_FILE}.part"
        unfinished.write_text(json.dumps({"version": _VERSION, **asdict(self)}), "utf-8")
        unfinished.rename(folder / _RESULT_FILE)

    @staticmethod
    def read(folder: Path) -> "SandboxResult | None":
        """What the process has written; None where it did not come to that.

        Raises:
            Misfit: It is something else, as when the racer's code has overwritten it.
        """
        try:
            record = parsed((folder / _RESULT_FILE).read_bytes())
        except FileNotFoundError:
            return None
        result = built(SandboxResult, record)
        if record.get("version") != _VERSION:
            raise Misfit(f"its version is {record.get('version')} instead of {_VERSION}")
        return result
