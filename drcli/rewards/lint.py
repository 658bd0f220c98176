"""What is wrong with a reward function, and what will surprise its author."""

import ast
import warnings
from collections.abc import Iterator

from drcli.base.problems import Problem, Severity, closest
from drcli.checks.first_step import idle_conditions
from drcli.checks.sandbox.sandbox_records import (
    REMEDIES,
    Difference,
    EffectKind,
    Failure,
    FailureKind,
)
from drcli.rewards.course import TriedReward
from drcli.rewards.loopholes import loopholes

SIMULATION_STEP_S = 0.25e-3
"""What the simulation itself takes for a step of one car, about: 4,200 steps/s were measured. A
function that takes as long is called slow."""

_SLOW_CALL_S = 1.0
"""A call that takes longer is near the limit of 5 s on a busy machine."""

_CHATTY = 0.1
"""Printed lines per call that make a flood."""

_DIGITS, _ALL_DIGITS = 4, 17
"""Digits of a reward that are shown, and those that tell any two numbers apart."""

_TRAINING_STEPS = 1_000_000
"""What long trainings suffer from is told for so many steps."""

_RULES: dict[FailureKind, str] = {
    "load": "loads",
    "signature": "loads",
    "raises": "works",
    "type": "type",
    "range": "range",
    "endless": "time",
    "ends": "process",
    "crashes": "process",
    "replaces": "replaces",
}

_FATAL = {"load", "signature", "endless", "ends", "crashes"}
"""After these failures there are too few values to judge what it pays for."""

_EFFECTS: dict[EffectKind, tuple[str, Severity, str, str]] = {
    "writes": (
        "files",
        "error",
        "writes or removes files",
        "Remove it: cars and workers would write at the same time. The trace of the training lists "
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
        "Put the numbers into the file itself: trainings work on a copy of this one file, and "
        "other machines have no other.",
    ),
}
"""Rule, severity, words and remedy for each kind of effect."""


def problems_of(tried: TriedReward) -> list[Problem]:
    """Everything worth telling, errors first."""
    found = [
        *_failures(tried),
        *_effects(tried),
        *_habits(tried),
        *_names(tried),
        *_memory(tried),
        *_speed(tried),
    ]
    if not any(failure.kind in _FATAL for failure in tried.result.failures):
        found += [_warning(tried, *loophole) for loophole in loopholes(tried)]
    return sorted(found, key=lambda problem: problem.severity != "error")


def named_parameters(text: bytes) -> set[str]:
    """All words in quotes in a reward function, among them the parameters that it reads."""
    return {
        node.value
        for node in ast.walk(_parsed(text))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }


def unknown_parameters(text: bytes, known: set[str]) -> dict[str, int]:
    """Names that a reward function asks its argument for and that are not parameters, with a line.

    Args:
        text: The file.
        known: The parameters there are.
    """
    tree = _parsed(text)
    arguments = {
        function.args.args[0].arg
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef)
        and function.name == "reward_function"
        and function.args.args
    }
    own: set[str] = set()
    asked: dict[str, int] = {}
    for node in ast.walk(tree):
        match node:
            case ast.Subscript(value=ast.Name(id=name), slice=ast.Constant(value=str(key))):
                if name in arguments and not isinstance(node.ctx, ast.Load):
                    own.add(key)
                elif name in arguments:
                    asked.setdefault(key, node.lineno)
            case ast.Call(
                func=ast.Attribute(value=ast.Name(id=name), attr="get"),
                args=[ast.Constant(value=str(key)), *_],
            ) if name in arguments:
                asked.setdefault(key, node.lineno)
    return {key: line for key, line in asked.items() if key not in known | own}


def _parsed(text: bytes) -> ast.Module:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return ast.parse(text)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return ast.Module([], [])


def _failures(tried: TriedReward) -> Iterator[Problem]:
    for failure in tried.result.failures:
        message = failure.sentence() + _first(tried, failure)
        remedy = _missing_module(tried, failure) or REMEDIES[failure.kind]
        line = failure.line or None
        yield Problem(_RULES[failure.kind], "error", tried.name, line, message, remedy)


def _first(tried: TriedReward, failure: Failure) -> str:
    if failure.first is None:
        return ""
    often = f", {failure.times:,} of {tried.result.calls:,} calls" if failure.times > 1 else ""
    return f" First: {tried.course.describe(failure.first)}{often}."


def _missing_module(tried: TriedReward, failure: Failure) -> str:
    """What to do about a module that cannot be imported; nothing where all can."""
    module = failure.missing.partition(".")[0]
    if not module:
        return ""
    if module in (tried.file.stem, "reward_function"):
        return "Remove the import: all that the file defines is there already."
    if tried.file.with_name(f"{module}.py").exists() or tried.file.with_name(module).is_dir():
        return (
            f"Put what you need of {module} into {tried.file.name}: a training takes this one file."
        )
    return (
        f"Install the package where trainings run, as with `pip install {module}`, or do without."
    )


def _effects(tried: TriedReward) -> Iterator[Problem]:
    for kind, (rule, severity, words, remedy) in _EFFECTS.items():
        for line in sorted({effect.line for effect in tried.result.effects if effect.kind == kind}):
            done = [e for e in tried.result.effects if e.kind == kind and e.line == line]
            times = sum(effect.times for effect in done)
            what = f": {done[0].what}" if done[0].what else ""
            yield Problem(
                rule,
                severity,
                tried.name,
                line or None,
                f"It {words}{what} ({_counted(times, 'time')} in "
                f"{_counted(tried.result.calls, 'call')}).",
                remedy,
            )


def _habits(tried: TriedReward) -> Iterator[Problem]:
    """What it prints, and what it collects."""
    printed, calls = tried.result.printed, max(tried.result.calls, 1)
    if printed.lines > _CHATTY * calls:
        megabytes = printed.characters / calls * _TRAINING_STEPS / 1e6
        yield _warning(
            tried,
            "prints",
            f"It prints {printed.lines / calls:,.1f} lines per call: {megabytes:,.0f} MB in a "
            "million steps, into the log of the worker.",
            "Print only now and then, such as at the end of a lap.",
            printed.line,
        )
    for growing in tried.result.growing:
        more = (growing.after - growing.before) / growing.calls
        yield _warning(
            tried,
            "globals",
            f"`{growing.name}` grows with every call, by {more:.2g} values, and is never emptied: "
            "a long training runs out of memory.",
            'Empty it when an episode begins (`params["steps"] <= 2`), or keep only the last few '
            "values.",
        )


def _names(tried: TriedReward) -> Iterator[Problem]:
    """Conditions on steps that never come, and names that are not parameters."""
    for idle in idle_conditions(tried.text):
        yield _warning(tried, "first-step", idle.message, idle.remedy, idle.line)
    known = {*tried.course.drive.trips[0].calls[0], "waypoints"}
    for name, line in unknown_parameters(tried.text, known).items():
        likely = closest(name, known)
        yield _warning(
            tried,
            "parameters",
            f"It asks for `{name}`, which is not a parameter.",
            f"Did you mean `{likely}`?" if likely else "docs/reward-functions.md lists them all.",
            line,
        )


def _memory(tried: TriedReward) -> Iterator[Problem]:
    random, memory = tried.result.random, tried.result.memory
    if random is not None:
        yield _warning(
            tried,
            "random",
            "The reward changes when the same drive is repeated: "
            f"{_both(random, 'and')} ({tried.course.describe(random.place)}; {random.times:,} of "
            f"{random.of:,} calls).",
            "Remove random numbers and clocks: the car also learns from noise in the reward.",
        )
    if memory is not None:
        yield _warning(
            tried,
            "memory",
            "For the same parameters the reward depends on earlier calls: "
            f"{_both(memory, 'or')} ({tried.course.describe(memory.place)}; {memory.times:,} of "
            f"{memory.of:,} calls). What it remembers outlives the episode.",
            'Reset it when an episode begins (`params["steps"] <= 2`), or do without it.',
        )


def _speed(tried: TriedReward) -> Iterator[Problem]:
    timing = tried.result.timing
    if timing is None:
        return
    if timing.mean_s > SIMULATION_STEP_S:
        calls, size = tried.result.calls, tried.course.size
        verb = "was" if calls == 1 else "were"
        cut = f" Only {calls:,} of {_counted(size, 'call')} {verb} made." if calls < size else ""
        yield _warning(
            tried,
            "costly",
            f"A call takes {timing.mean_s * 1e3:,.4g} ms, more than the simulation of the step "
            f"itself: a million steps take {timing.mean_s * _TRAINING_STEPS / 60:,.0f} minutes "
            f"longer.{cut}",
            "Compute what does not change from step to step once, outside the function.",
        )
    if timing.worst_s > _SLOW_CALL_S:
        yield _warning(
            tried,
            "costly-call",
            f"One call takes {timing.worst_s:.1f} s ({tried.course.describe(timing.worst)}); a "
            "call of 5 s ends a training.",
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


def _warning(
    tried: TriedReward, rule: str, message: str, remedy: str, line: int | None = None
) -> Problem:
    return Problem(rule, "warning", tried.name, line or None, message, remedy)
