"""What is wrong with a reward function, and what will surprise its author."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from drcli.base.problems import closest
from drcli.checks.sandbox.statement import Difference, EffectKind, Failure, FailureKind
from drcli.rewards.loopholes import worth_remarks
from drcli.rewards.trial import Trial

SIMULATION_STEP_S = 0.25e-3
"""What the simulation itself takes for a step of one car, about: 4,200 steps/s were measured."""

_SLOW_SHARE = 1.0
"""A function that takes as long as the simulation itself is called slow."""

_SLOW_CALL_S = 1.0
"""A call that takes longer is near the limit of 5 s on a busy machine."""

_CHATTY = 0.1
"""Lines a call that make a flood."""

_DIGITS, _ALL_DIGITS = 4, 17
"""Digits of a reward that are shown, and those that tell any two numbers apart."""

_TRAINING_STEPS = 1_000_000
"""What is told of long trainings, is told for so many steps."""


@dataclass(frozen=True)
class Remark:
    """Something about a reward function.

    Attributes:
        rule: Name of the rule.
        severity: "error" for what ends a training or does harm, else "warning".
        where: File, and line where there is one.
        message: What is the matter, one sentence or two.
        remedy: What to do about it, starting with a verb.
    """

    rule: str
    severity: Literal["error", "warning"]
    where: str
    message: str
    remedy: str


def remarks(trial: Trial) -> list[Remark]:
    """All that is to be said, errors first."""
    found = [*_failures(trial), *_effects(trial), *_habits(trial), *_speed(trial)]
    if not any(failure.kind in _FATAL for failure in trial.statement.failures):
        found += [
            Remark(rule, "warning", trial.name, message, remedy)
            for rule, message, remedy in worth_remarks(trial)
        ]
    return sorted(found, key=lambda remark: remark.severity != "error")


_RULES: dict[FailureKind, tuple[str, str]] = {
    "load": ("loads", "Correct the file, and check it again."),
    "raises": ("works", "Correct that; a training ends where it fails."),
    "returns": (
        "type",
        "Return a number on every path, as in `return float(reward)`: a path without `return` "
        "gives None.",
    ),
    "range": (
        "range",
        "Return a finite number between -100000 and 100000; guard divisions and logarithms.",
    ),
    "endless": ("time", "Look for a loop that does not end: a call may take 5 s."),
    "ends": ("process", "Remove what ends the process, such as os._exit() or os.kill()."),
    "crashes": ("process", "Remove the call into the library that fails there."),
}
"""Rule and remedy for each kind of failure."""

_FATAL: tuple[FailureKind, ...] = ("load", "endless", "ends", "crashes")
"""After these there are too few values to judge what it pays for."""


def _failures(trial: Trial) -> Iterator[Remark]:
    for failure in trial.statement.failures:
        rule, remedy = _RULES[failure.kind]
        message = failure.sentence + _first(trial, failure)
        yield Remark(rule, "error", _where(trial, failure.line), message, failure.remedy or remedy)


def _first(trial: Trial, failure: Failure) -> str:
    if failure.first is None:
        return ""
    often = f", {failure.times:,} of {trial.statement.made:,} calls" if failure.times > 1 else ""
    return f" First: {trial.describe(failure.first)}{often}."


_EFFECTS: dict[EffectKind, tuple[str, Literal["error", "warning"], str, str]] = {
    "writes": (
        "files",
        "error",
        "writes or removes files",
        "Remove it: cars and workers would write at the same time. The trace of the training has "
        "each step with its reward.",
    ),
    "network": (
        "network",
        "error",
        "uses the network",
        "Remove it: every step of the training would wait for it.",
    ),
    "process": (
        "processes",
        "error",
        "starts processes",
        "Remove it: a training would start them again and again.",
    ),
    "reads": (
        "reads",
        "warning",
        "reads files",
        "Write the numbers into the file itself: trainings work on a copy of this one file, and "
        "other machines have no other.",
    ),
    "thread": (
        "threads",
        "warning",
        "starts threads",
        "Remove it: they take the processor from the simulation and live on.",
    ),
    "waits": ("waits", "warning", "waits", "Remove it: every step of the training would wait."),
}
"""Rule, severity, words and remedy for each kind of effect."""


def _effects(trial: Trial) -> Iterator[Remark]:
    for kind, (rule, severity, words, remedy) in _EFFECTS.items():
        lines = sorted({effect.line for effect in trial.statement.effects if effect.kind == kind})
        for line in lines:
            done = [e for e in trial.statement.effects if e.kind == kind and e.line == line]
            times = sum(effect.times for effect in done)
            what = f": {done[0].what}" if done[0].what else ""
            yield Remark(
                rule,
                severity,
                _where(trial, line),
                f"It {words}{what} ({_counted(times, 'time')} in "
                f"{_counted(trial.statement.made, 'call')}).",
                remedy,
            )


def _habits(trial: Trial) -> Iterator[Remark]:
    """What it prints, remembers, changes and looks for."""
    statement = trial.statement
    printed, made = statement.printed, max(statement.made, 1)
    if printed.lines > _CHATTY * made:
        megabytes = printed.characters / made * _TRAINING_STEPS / 1e6
        yield Remark(
            "prints",
            "warning",
            _where(trial, printed.line),
            f"It prints {printed.lines / made:,.1f} lines a call: {megabytes:,.0f} MB in a million "
            "steps, into the log of the worker.",
            "Print now and then only, such as at the end of a lap.",
        )
    for growing in statement.growing:
        more = (growing.after - growing.before) / growing.calls
        yield Remark(
            "globals",
            "warning",
            trial.name,
            f"`{growing.name}` grows from call to call, by {more:.2g} each, and is never emptied: "
            "a long training runs out of memory.",
            'Empty it when an episode begins (`params["steps"] <= 2`), or keep the last few only.',
        )
    if statement.replaced:
        yield Remark(
            "replaces",
            "error",
            trial.name,
            f"It puts something else in place of {', '.join(statement.replaced)}. The simulation "
            "and other packages use that too.",
            "Give your own function another name.",
        )
    if statement.changed:
        yield Remark(
            "changes-params",
            "warning",
            trial.name,
            f"It changes its parameters ({', '.join(sorted(statement.changed))}). The simulation "
            "does not mind, for each call gets a fresh copy.",
            "Work on a copy, to be safe elsewhere.",
        )
    for idle in statement.idle:
        where = _where(trial, idle.line)
        yield Remark("first-step", "warning", where, idle.message, idle.remedy)
    yield from _memory(trial)
    for name, line in statement.unknown.items():
        likely = closest(name, [*trial.course.drive.trips[0].calls[0], "waypoints"])
        yield Remark(
            "parameters",
            "warning",
            _where(trial, line),
            f"It asks for `{name}`, which is no parameter.",
            f"Did you mean `{likely}`?" if likely else "See docs/reward-functions.md for all.",
        )


def _memory(trial: Trial) -> Iterator[Remark]:
    random, memory = trial.statement.random, trial.statement.memory
    if random is not None:
        yield Remark(
            "random",
            "warning",
            trial.name,
            f"The same drive gets a different reward when repeated: "
            f"{_both(random, 'and')} ({trial.describe(random.place)}; {random.times:,} of "
            f"{random.of:,} calls).",
            "Remove random numbers and clocks: noise in the reward is learned from like any other.",
        )
    if memory is not None:
        yield Remark(
            "memory",
            "warning",
            trial.name,
            f"The same parameters are paid by what was called before: "
            f"{_both(memory, 'or')} ({trial.describe(memory.place)}; {memory.times:,} of "
            f"{memory.of:,} calls). What it remembers outlives the episode.",
            'Forget it when an episode begins (`params["steps"] <= 2`), or do without.',
        )


def _speed(trial: Trial) -> Iterator[Remark]:
    timing = trial.statement.timing
    if timing is None:
        return
    if timing.mean_s > _SLOW_SHARE * SIMULATION_STEP_S:
        made, size = trial.statement.made, trial.course.size
        verb = "was" if made == 1 else "were"
        cut = f" Only {made:,} of {_counted(size, 'call')} {verb} made." if made < size else ""
        yield Remark(
            "costly",
            "warning",
            trial.name,
            f"A call takes {timing.mean_s * 1e3:,.4g} ms, more than the simulation of the step "
            f"itself: a million steps take {timing.mean_s * _TRAINING_STEPS / 60:,.0f} minutes "
            f"longer.{cut}",
            "Work out once, outside the function, what does not change from step to step.",
        )
    if timing.worst_s > _SLOW_CALL_S:
        yield Remark(
            "costly-call",
            "warning",
            trial.name,
            f"One call takes {timing.worst_s:.1f} s ({trial.describe(timing.worst)}); one of 5 s "
            "ends a training.",
            "Move slow preparations out of the function, to the top of the file.",
        )


def _both(difference: Difference, word: str) -> str:
    """Both values, with as many digits as it takes to tell them apart."""
    values = (difference.value, difference.other)
    digits = range(_DIGITS, _ALL_DIGITS + 1)
    told = ([_paid(value, count) for value in values] for count in digits)
    one, other = next((pair for pair in told if pair[0] != pair[1]), map(repr, values))
    return f"{one} {word} {other}"


def _paid(value: float | None, digits: int) -> str:
    return "a failure" if value is None else f"{value:.{digits}g}"


def _counted(count: int, thing: str) -> str:
    return f"{count:,} {thing}{'s' * (count != 1)}"


def _where(trial: Trial, line: int | None) -> str:
    return f"{trial.name} line {line}" if line else trial.name
