"""Finds errors of a reward function, and what will surprise its author."""

import ast
from collections.abc import Iterator

from drcli.base.problems import Problem, Severity, closest
from drcli.checks.sandbox.sandbox_records import (
    REMEDIES,
    Difference,
    EffectKind,
    Failure,
    FailureKind,
)
from drcli.checks.step_conditions import idle_conditions, parsed
from drcli.rewards.course import TriedReward
from drcli.rewards.loopholes import loopholes

SIMULATION_STEP_S = 0.25e-3
"""About the time of a simulation step of one car: 4,200 steps/s were measured. A function that
takes as long is called slow."""

_SLOW_CALL_S = 1.0
"""A longer call is near the limit of 5 s on a busy machine."""

_CHATTY = 0.1
"""Printed lines per call that are too many."""

_DIGITS, _ALL_DIGITS = 4, 17
"""Digits of a reward that are shown, and how many distinguish any two numbers."""

_TRAINING_STEPS = 1_000_000
"""Steps of a long training."""

_RULES: dict[FailureKind, str] = {
    "load": "loads",
    "signature": "loads",
    "undefined": "works",
    "raises": "works",
    "type": "type",
    "range": "range",
    "endless": "time",
    "ends": "process",
    "crashes": "process",
    "replaces": "replaces",
}

_FATAL = {"load", "signature", "endless", "ends", "crashes"}
"""After these failures there are too few values to find loopholes."""

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
        "Put the numbers into the file itself: trainings use a copy of this one file, and other "
        "machines have no other.",
    ),
}
"""Rule, severity, words and remedy for each kind of effect."""


def problems_of(tried: TriedReward) -> list[Problem]:
    """All problems of a reward function, errors first."""
    found = [
        *_failures(tried),
        *_effects(tried),
        *_prints(tried),
        *_names(tried),
        *_memory(tried),
        *_speed(tried),
    ]
    if not any(failure.kind in _FATAL for failure in tried.result.failures):
        found += loopholes(tried)
    return sorted(found, key=lambda problem: problem.severity != "error")


def named_parameters(text: bytes) -> set[str]:
    """All words in quotes in a reward function, among them the parameters that it reads."""
    return {
        node.value
        for node in ast.walk(parsed(text))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }


def unknown_parameters(text: bytes, known: set[str]) -> dict[str, int]:
    """Names that a reward function looks up in its argument but that are not known, with a line."""
    tree = parsed(text)
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


def _failures(tried: TriedReward) -> Iterator[Problem]:
    for failure in tried.result.failures:
        rule, message = _RULES[failure.kind], failure.sentence()
        if failure.first is not None:
            times, calls = failure.times, tried.result.calls
            often = f", {times:,} of {calls:,} calls" if times > 1 else ""
            message += f" First: {tried.course.describe(failure.first)}{often}."
        elif failure.kind == "undefined":
            rule = "loads"
        remedy = _missing_module(tried, failure) or REMEDIES[failure.kind]
        yield Problem(rule, "error", tried.name, failure.line, message, remedy)


def _missing_module(tried: TriedReward, failure: Failure) -> str:
    """The remedy for a module that cannot be imported; empty without one."""
    module = failure.missing.partition(".")[0]
    if not module:
        return ""
    if module in (tried.file.stem, "reward_function"):
        return "Remove the import: everything that the file defines is already there."
    if tried.file.with_name(f"{module}.py").exists() or tried.file.with_name(module).is_dir():
        return (
            f"Put what you need of {module} into {tried.file.name}: a training uses only this file."
        )
    return (
        f"Install the package where trainings run, as with `pip install {module}`, or do without."
    )


def _effects(tried: TriedReward) -> Iterator[Problem]:
    for kind, (rule, severity, words, remedy) in _EFFECTS.items():
        for line in sorted({effect.line for effect in tried.result.effects if effect.kind == kind}):
            done = [e for e in tried.result.effects if e.kind == kind and e.line == line]
            times = _counted(sum(effect.times for effect in done), "time")
            what = f": {done[0].what}" if done[0].what else ""
            message = f"It {words}{what} ({times} in {_counted(tried.result.calls, 'call')})."
            yield Problem(rule, severity, tried.name, line, message, remedy)


def _prints(tried: TriedReward) -> Iterator[Problem]:
    printed, calls = tried.result.printed, max(tried.result.calls, 1)
    if printed.lines > _CHATTY * calls:
        megabytes = printed.characters / calls * _TRAINING_STEPS / 1e6
        yield tried.warning(
            "prints",
            f"It prints {printed.lines / calls:,.1f} lines per call: {megabytes:,.0f} MB in a "
            "million steps, into the log of the worker.",
            "Print only now and then, such as at the end of a lap.",
            printed.line,
        )


def _names(tried: TriedReward) -> Iterator[Problem]:
    """Conditions on steps that never come, and names that are not parameters."""
    for idle in idle_conditions(parsed(tried.text)):
        yield tried.warning("first-step", idle.message, idle.remedy, idle.line)
    known = {*tried.course.drive.trips[0].calls[0], "waypoints"}
    for name, line in unknown_parameters(tried.text, known).items():
        likely = closest(name, known)
        remedy = f"Did you mean `{likely}`?" if likely else "See docs/reward-functions.md."
        what = f"It reads `{name}`, which is not a parameter."
        yield tried.warning("parameters", what, remedy, line)


def _memory(tried: TriedReward) -> Iterator[Problem]:
    random, memory = tried.result.random, tried.result.memory
    if random is not None:
        yield tried.warning(
            "random",
            f"The reward changes when the same drive is repeated: {_both(tried, random, 'and')}.",
            "Remove random numbers and clocks: the car also learns from noise in the reward.",
        )
    if memory is not None:
        yield tried.warning(
            "memory",
            "For the same parameters the reward depends on earlier calls: "
            f"{_both(tried, memory, 'or')}. It remembers something from earlier episodes.",
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
        yield tried.warning(
            "costly",
            f"A call takes {timing.mean_s * 1e3:,.4g} ms, more than the simulation of the step "
            f"itself: a million steps take {timing.mean_s * _TRAINING_STEPS / 60:,.0f} minutes "
            f"longer.{cut}",
            "If something is the same in every step, compute it once, outside the function.",
        )
    if timing.worst_s > _SLOW_CALL_S:
        yield tried.warning(
            "costly-call",
            f"One call takes {timing.worst_s:.1f} s ({tried.course.describe(timing.worst)}); a "
            "call of 5 s ends a training.",
            "Move slow preparations out of the function, to the top of the file.",
        )


def _both(tried: TriedReward, difference: Difference, word: str) -> str:
    """Both values, with enough digits to distinguish them, and the place."""
    values, digits = (difference.value, difference.other), _DIGITS
    while True:
        one, other = ("a failure" if value is None else f"{value:.{digits}g}" for value in values)
        if one != other or digits == _ALL_DIGITS:
            break
        digits += 1
    often = f"{difference.times:,} of {difference.of:,} calls"
    return f"{one} {word} {other} ({tried.course.describe(difference.place)}; {often})"


def _counted(count: int, thing: str) -> str:
    return f"{count:,} {thing}{'s' * (count != 1)}"
