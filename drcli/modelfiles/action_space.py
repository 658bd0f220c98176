"""What a car may do: a list of actions or ranges of them, as model_metadata.json states it."""

from typing import Any

from pydantic import BaseModel, ConfigDict

from drcli.base.problems import Finding, closest, shown
from drcli.modelfiles.json_file import JsonFile, as_written

STEERING_DEG = (-30.0, 30.0)
"""What the car's front wheels can do; requests beyond it are cut. Source: the reference car."""
SPEED_MPS = (0.1, 4.0)
"""What the car's speed is cut to. Source: the reference car."""
MANY_ACTIONS = 30
"""More discrete actions than this learn slowly; the DeepRacer console allows no more."""

Pair = tuple[float, float]
"""Steering in degrees, positive to the left, and speed in m/s."""

_EXAMPLE = '{"steering_angle": 15, "speed": 1.0}'


class ActionSpace(BaseModel):
    """The actions of a model.

    Attributes:
        values: The discrete actions, in the order of the policy's outputs; empty if continuous.
        low: Least steering and speed; None if discrete.
        high: Greatest steering and speed; None if discrete.
    """

    model_config = ConfigDict(frozen=True)

    values: tuple[Pair, ...] = ()
    low: Pair | None = None
    high: Pair | None = None

    @property
    def continuous(self) -> bool:
        """Whether any steering and speed between `low` and `high` is an action."""
        return self.low is not None

    @property
    def num_actions(self) -> int:
        """Number of discrete actions, or of continuous quantities: steering and speed."""
        return 2 if self.continuous else len(self.values)


class ActionSpaceReader:
    """Checks the action space of a file; what is noticed is added to the two lists.

    Args:
        file: The file.
        findings: What is wrong.
        notes: What is legal but odd.
    """

    def __init__(self, file: JsonFile, findings: list[Finding], notes: list[Finding]) -> None:
        self._file = file
        self._findings = findings
        self._notes = notes

    def discrete(self, written: Any) -> ActionSpace:
        """A list of actions."""
        if not isinstance(written, list):
            remedy = f"Write a list such as [{_EXAMPLE}]"
            if isinstance(written, dict):
                remedy += ', or add "action_space_type": "continuous"'
            self._reject(("action_space",), written, "is no list of actions", f"{remedy}.")
            return ActionSpace()
        if not written:
            self._reject(
                ("action_space",), written, "holds no action", f"Add actions such as {_EXAMPLE}."
            )
        values = [self._action(number, entry) for number, entry in enumerate(written)]
        self._check_indices(written)
        first: dict[Pair, int] = {}
        for number, pair in enumerate(values):
            if pair is not None and first.setdefault(pair, number) != number:
                self._note(
                    ("action_space", number),
                    f"action {number} repeats action {first[pair]}",
                    "Remove one of them: it costs learning and adds nothing.",
                )
        if len(values) > MANY_ACTIONS:
            self._note(
                ("action_space",),
                f"{len(values)} actions learn slowly",
                f"Keep {MANY_ACTIONS} at most, or use ranges.",
            )
        return ActionSpace(values=tuple(pair for pair in values if pair is not None))

    def continuous(self, written: Any) -> ActionSpace:
        """Ranges of steering and speed."""
        example = '{"steering_angle": {"low": -30, "high": 30}, "speed": {"low": 1, "high": 2}}'
        if not isinstance(written, dict):
            self._reject(
                ("action_space",),
                written,
                "is no pair of ranges",
                f'Write {example}, or "action_space_type": "discrete" for a list of actions.',
            )
            return ActionSpace()
        self._report_keys(("action_space",), written, ("steering_angle", "speed"))
        steering = self._range("steering_angle", written, STEERING_DEG)
        speed = self._range("speed", written, SPEED_MPS)
        if steering is None or speed is None:
            return ActionSpace()
        return ActionSpace(low=(steering[0], speed[0]), high=(steering[1], speed[1]))

    def _action(self, number: int, entry: Any) -> Pair | None:
        path = ("action_space", number)
        if not isinstance(entry, dict):
            self._reject(path, entry, "is no action", f"Write actions such as {_EXAMPLE}.")
            return None
        self._report_keys(path, entry, ("steering_angle", "speed", "index"))
        steering = self._number((*path, "steering_angle"), entry, STEERING_DEG)
        speed = self._number((*path, "speed"), entry, SPEED_MPS)
        return None if steering is None or speed is None else (steering, speed)

    def _range(self, key: str, written: dict[str, Any], usual: Pair) -> Pair | None:
        path = ("action_space", key)
        limits = written.get(key)
        if not isinstance(limits, dict):
            remedy = f'Write "{key}": {{"low": {usual[0]:g}, "high": {usual[1]:g}}}.'
            problem = "is no range" if key in written else "is missing"
            self._reject(path, limits, problem, remedy)
            return None
        self._report_keys(path, limits, ("low", "high"))
        low = self._number((*path, "low"), limits, usual)
        high = self._number((*path, "high"), limits, usual)
        if low is None or high is None:
            return None
        if low >= high:
            remedy = f"Write a low below the high; for a single {key} use discrete actions."
            self._reject(path, limits, "has a low that is not below its high", remedy)
            return None
        return low, high

    def _number(
        self, path: tuple[str | int, ...], holder: dict[str, Any], usual: Pair
    ) -> float | None:
        key = str(path[-1])
        number = holder.get(key)
        remedy = f'Write a number without quotes, as in "{key}": 1.0.'
        if key not in holder:
            meant = closest(key, holder)
            rename = f'Rename "{shown(meant)}" to "{key}".' if meant is not None else remedy
            self._reject(path, None, "is missing", rename)
            return None
        if isinstance(number, bool) or not isinstance(number, int | float):
            self._reject(path, number, "is no number", remedy)
            return None
        if abs(number) > 1000:
            self._reject(path, number, "is far too large", remedy)
            return None
        if not usual[0] <= number <= usual[1]:
            self._note(
                path,
                f"{_dotted(path)}={number} is beyond what the car does, {usual}",
                f"Write a number from {usual[0]:g} to {usual[1]:g}; others are cut to that.",
            )
        return float(number)

    def _check_indices(self, written: list[Any]) -> None:
        """Position counts, so an index must agree; all of them in another order are only odd."""
        found = [entry.get("index") for entry in written if isinstance(entry, dict)]
        numbers = [n for n in found if isinstance(n, int) and not isinstance(n, bool)]
        whole = sorted(numbers) == list(range(len(written)))
        if whole and numbers != sorted(numbers):
            self._note(
                ("action_space",),
                "the indices of action_space are in another order than its actions, and the order "
                "counts",
                "Remove them all, or put the actions into the order of their indices.",
            )
        if whole:
            return
        for number, entry in enumerate(written):
            if not isinstance(entry, dict) or "index" not in entry:
                continue
            index = entry["index"]
            if isinstance(index, bool) or index != number:
                self._reject(
                    ("action_space", number, "index"),
                    index,
                    f"stands at position {number}",
                    f'Write "index": {number} there, counting from 0, or remove them all.',
                )

    def _report_keys(
        self, path: tuple[str | int, ...], holder: dict[str, Any], known: tuple[str, ...]
    ) -> None:
        for key in holder:
            if key not in known:
                what = f"{_dotted((*path, shown(key)))} has no meaning"
                self._note((*path, key), what, "Keep or remove it.")

    def _reject(self, path: tuple[str | int, ...], written: Any, problem: str, remedy: str) -> None:
        value = "" if problem == "is missing" else f"={as_written(written)}"
        what = f"{_dotted(path)}{value} {problem}"
        self._findings.append(Finding(self._file.where(*path), what, remedy))

    def _note(self, path: tuple[str | int, ...], what: str, remedy: str) -> None:
        self._notes.append(Finding(self._file.where(*path), what, remedy))


def _dotted(path: tuple[str | int, ...]) -> str:
    """A path as people write it: `action_space[2].speed`."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return text.removeprefix(".")
