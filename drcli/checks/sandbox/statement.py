"""What is known of a reward function once it was called along a drive; crosses a process border."""

from typing import Literal

from pydantic import BaseModel, ConfigDict

from drcli.checks.first_step import Idle

ORDER_FILE, STATEMENT_FILE, FAULTS_FILE = "order.json", "statement.json", "faults.txt"
"""In the folder that a witness works in: what to do, what came of it, and Python's last words."""

HANGS = "Timeout"
"""First word of last words about a call that went on and on. Python's own begin with it too."""

FailureKind = Literal["load", "raises", "returns", "range", "endless", "ends", "crashes"]
EffectKind = Literal["writes", "reads", "network", "process", "thread", "waits"]


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True)


class Place(_Frozen):
    """One call.

    Attributes:
        sequence: Number of the sequence of calls, from 0.
        index: Number of the call in it, from 0.
    """

    sequence: int
    index: int


class Failure(_Frozen):
    """A call that ends a training.

    Attributes:
        kind: What went wrong: loading, an exception, the type or the size of the value, a call that
            does not return, one that ends the process, one that crashes it.
        what: One sentence without the place, for people.
        line: Line in the racer's file, where known.
        source: The text of that line, or nothing.
        missing: The module that cannot be imported, if that is the reason.
        remedy: What to do about it, where that is more than its kind tells.
        first: The first call that fails like this; None where it is not known.
        times: How many calls fail like this.
    """

    kind: FailureKind
    what: str
    line: int | None
    source: str
    missing: str = ""
    remedy: str = ""
    first: Place | None = None
    times: int

    @property
    def sentence(self) -> str:
        """What went wrong, with the line that did it; a wrong value is the doing of none."""
        if not self.source or self.kind in ("returns", "range"):
            return self.what
        return f"{self.what} The line is `{self.source}`."


class Effect(_Frozen):
    """Something that a reward function does beside returning a number.

    Attributes:
        kind: What it touches.
        what: Which file, address or program.
        line: Line in the racer's file.
        times: How often; while it is loaded counts too.
    """

    kind: EffectKind
    what: str
    line: int
    times: int


class Difference(_Frozen):
    """The same parameters, and another value.

    Attributes:
        place: The first such call.
        value: What it returned along the drive; None if it failed.
        other: What it returned another time.
        times: How many calls differ.
        of: Of how many.
    """

    place: Place
    value: float | None
    other: float | None
    times: int
    of: int


class Printed(_Frozen):
    """What went to stdout and stderr.

    Attributes:
        lines: Lines.
        characters: Characters.
        line: Line in the racer's file that printed first; None if nothing or a library did.
        calls: In how many calls.
    """

    lines: int
    characters: int
    line: int | None
    calls: int


class Timing(_Frozen):
    """How long calls took, seconds.

    Attributes:
        median_s: The usual one.
        mean_s: What they cost altogether, for each.
        worst_s: The longest.
        worst: Which one that was.
        load_s: Loading the file.
    """

    median_s: float
    mean_s: float
    worst_s: float
    worst: Place
    load_s: float


class Growth(_Frozen):
    """A global that holds more after the same drive was driven once more.

    Attributes:
        name: Of the variable, or of the function that it belongs to.
        before: Things in it after the first drive.
        after: Things in it after the second.
        calls: Calls in between.
    """

    name: str
    before: int
    after: int
    calls: int


class Statement(_Frozen):
    """All of it.

    Attributes:
        values: What each call returned; None where it failed or was not made.
        failures: What ends a training.
        returned: How often which type was returned.
        timing: How long calls took; None where none was made.
        made: How many calls were made of those asked for.
        reads: Parameters that were looked at.
        unknown: Names that were looked for and are no parameters, with the line.
        effects: What it does beside returning a number.
        printed: What it printed.
        growing: Globals that grow for ever.
        replaced: What of Python's own it put something else for, such as `math.sqrt`.
        changed: Parameters that it changed, with how often.
        random: A call that was answered otherwise by a fresh copy on the very same drive.
        memory: A call that was answered otherwise when the episodes came in another order.
        idle: Conditions that wait for a step with which it is never called.
    """

    values: list[list[float | None]]
    failures: list[Failure] = []
    returned: dict[str, int] = {}
    timing: Timing | None = None
    made: int = 0
    reads: list[str] = []
    unknown: dict[str, int | None] = {}
    effects: list[Effect] = []
    printed: Printed = Printed(lines=0, characters=0, line=None, calls=0)
    growing: list[Growth] = []
    replaced: list[str] = []
    changed: dict[str, int] = {}
    random: Difference | None = None
    memory: Difference | None = None
    idle: list[Idle] = []


class Order(_Frozen):
    """What a witness is asked to do.

    Attributes:
        file: The copy of the racer's file.
        sequences: Parameters of calls in the order in which to make them, without the waypoints.
        repeated: How many of the sequences, from the first, are played more than once.
        waypoints: The waypoints by `is_reversed`.
    """

    file: str
    sequences: list[list[dict[str, object]]]
    repeated: int
    waypoints: dict[bool, list[tuple[float, float]]]
