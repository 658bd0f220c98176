"""The trainings of a sweep: all combinations, or a random choice."""

import itertools
import math
import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import PurePath

from drcli.base.errors import refuse
from drcli.sweeps.sweep_file import MOST_TRIALS, Choices, Span, SweepFile, Vary

Value = str | int | float

_ATTEMPTS = 100
"""Draws before combinations count as used up."""

_DIGITS = 4
"""So that tables show drawn numbers whole."""


@dataclass(frozen=True)
class Trial:
    """One training of a sweep.

    Attributes:
        reward_function: Path beside the sweep's file; empty for the racer's own.
        hyperparameters: That differ from hyperparameters.json.
        settings: That differ from run.env.
        varied: By a short name.
    """

    name: str
    reward_function: str = ""
    model_metadata: str = ""
    hyperparameters: Mapping[str, Value] = field(default_factory=dict)
    settings: Mapping[str, str] = field(default_factory=dict)
    varied: Mapping[str, str] = field(default_factory=dict)

    @property
    def text(self) -> str:
        return ", ".join(f"{name}={value}" for name, value in self.varied.items())


def trials_of(sweep: SweepFile) -> list[Trial]:
    """Always in the same order.

    Raises:
        ProblemsError: There are too many, or too few.
    """
    plan = sweep.plan
    axes = _axes(plan.vary)
    if plan.search == "grid":
        count = math.prod(len(values) for values in axes.values() if not isinstance(values, Span))
        if count > MOST_TRIALS:
            what = f"vary has {count:,} combinations; at most {MOST_TRIALS} are trained."
            remedy = "Leave some values out, or draw some with search: random and trials: 20."
            refuse([sweep.problem(("vary",), what, remedy)])
        lists = [values for values in axes.values() if not isinstance(values, Span)]
        chosen = list(itertools.product(*lists))
    else:
        chosen = _drawn(sweep, list(axes.values()))
    digits = max(2, len(str(len(chosen))))
    return [
        _trial(sweep, f"{sweep.name}-{number:0{digits}}", axes, values)
        for number, values in enumerate(chosen, 1)
    ]


Axis = tuple[str, str]
"""Section and key of the file."""


def _axes(vary: Vary) -> dict[Axis, Choices]:
    found: dict[Axis, Choices] = {}
    for section in ("reward_function", "model_metadata"):
        if files := getattr(vary, section):
            found[section, ""] = files
    for section in ("settings", "hyperparameters"):
        for key, choices in getattr(vary, section).items():
            found[section, key] = choices
    if vary.seed:
        found["seed", ""] = list(vary.seed)
    return found


def _drawn(sweep: SweepFile, axes: Sequence[Choices]) -> list[tuple[Value, ...]]:
    plan = sweep.plan
    wanted = plan.trials or 0
    chance = random.Random(plan.seed)
    found: dict[tuple[Value, ...], None] = {}
    for _ in range(wanted * _ATTEMPTS):
        found[tuple(_draw(chance, choices) for choices in axes)] = None
        if len(found) == wanted:
            return list(found)
    what = f"trials={wanted}, but vary has only about {len(found)} different combinations."
    refuse([sweep.problem(("trials",), what, "Lower it, or write search: grid without trials.")])
    return []


def _draw(chance: random.Random, choices: Choices) -> Value:
    if not isinstance(choices, Span):
        return chance.choice(choices)
    if isinstance(choices.low, int) and isinstance(choices.high, int) and not choices.log:
        return chance.randint(choices.low, choices.high)
    if choices.log:
        drawn = math.exp(chance.uniform(math.log(choices.low), math.log(choices.high)))
    else:
        drawn = chance.uniform(choices.low, choices.high)
    if isinstance(choices.low, int) and isinstance(choices.high, int):
        return round(drawn)
    return rounded(drawn)


def rounded(number: float) -> float:
    return float(f"{number:.{_DIGITS}g}")


def _trial(
    sweep: SweepFile, name: str, axes: Mapping[Axis, Choices], values: Sequence[Value]
) -> Trial:
    fixed = {key: written(value) for key, value in sweep.plan.settings.items()}
    chosen = dict(zip(axes, values, strict=True))
    settings = {key: written(v) for (section, key), v in chosen.items() if section == "settings"}
    if ("seed", "") in chosen:
        settings["DR_TRAIN_SEED"] = str(chosen["seed", ""])
    return Trial(
        name,
        reward_function=str(chosen.get(("reward_function", ""), "")),
        model_metadata=str(chosen.get(("model_metadata", ""), "")),
        hyperparameters={
            k: v for (section, k), v in chosen.items() if section == "hyperparameters"
        },
        settings={**fixed, **settings},
        varied=dict(_described(axes, chosen)),
    )


def _described(
    axes: Mapping[Axis, Choices], chosen: Mapping[Axis, Value]
) -> Iterator[tuple[str, str]]:
    for (section, key), choices in axes.items():
        value = chosen[section, key]
        if isinstance(choices, Span) or key or section == "seed":
            if isinstance(choices, Span) or len(choices) > 1:
                yield key or section, written(value)
        elif len(choices) > 1:
            stems = [PurePath(str(each)).stem for each in choices]
            stem = PurePath(str(value)).stem
            yield section, stem if stems.count(stem) == 1 else str(value)


def written(value: Value | bool) -> str:
    return str(value)
