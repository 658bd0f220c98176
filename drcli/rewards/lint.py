"""Words for the sandbox's findings."""

from collections.abc import Iterator
from pathlib import Path

from drcli.base.errors import Problem, Severity
from drcli.rewards.reward_rules import Source, likely_parameter, review_source
from drcli.rewards.sandbox.run_sandbox import (
    REMEDIES,
    EffectKind,
    Failure,
    FailureKind,
    SandboxResult,
)
from drcli.workers.reward_failures import cure_of

SIMULATION_STEP_S = 0.25e-3
"""Of one car: 4,200 steps/s were measured."""

_SLOW_CALL_S = 1.0
_CHATTY = 0.1
_TRAINING_STEPS = 1_000_000
_RULES: dict[FailureKind, str] = {
    "load": "V-02",
    "signature": "V-20",
    "type": "V-20",
    "range": "V-20",
    "undefined": "V-22",
}
_COUNTED: tuple[FailureKind, ...] = ("raises", "undefined", "type", "range")
_MOST_NAMES = 5

_CONFINED = (
    "Do without: a reward function reads packages and the working folder, but no settings and "
    "hidden files, writes to the working folder and temporary files, and has no network "
    "(`dr docs reward-functions`)."
)
_FLOATS = {"float", "numpy.float64"}

_EFFECTS: dict[EffectKind, tuple[str, str]] = {
    "writes": (
        "writes or removes files",
        "Remove it: cars and workers would write at the same time. The trace of the training lists "
        "each step with its reward.",
    ),
    "network": ("uses the network", "Remove it: every step of the training would wait for it."),
    "process": ("starts processes", "Remove it: a training would start them again and again."),
    "reads": (
        "reads files",
        "Put the numbers into the file itself: trainings use a copy of this one file, and other "
        "machines have no other.",
    ),
}


def problems_of(
    source: Source, result: SandboxResult, directory: Path, tolerated: float = 0.0
) -> list[Problem]:
    """What ends a training, and what is odd; `tolerated`: see `tolerated_share`."""
    failures = result.failures
    undefined = {_name_in(each.reason) for each in failures if each.kind == "undefined"}
    return [
        *review_source(source, {_parameter(source, each) for each in failures} | undefined),
        *_failures(source, result, directory, tolerated),
        *_conversions(source, result),
        *_effects(source, result),
        *_shared(source, result),
        *_prints(source, result),
        *_speed(source, result),
    ]


def _failures(
    source: Source, result: SandboxResult, directory: Path, tolerated: float
) -> Iterator[Problem]:
    failed = sum(each.times for each in result.failures if each.kind in _COUNTED)
    counts = tolerated > 0.0 and failed < result.counted
    for failure in result.failures:
        counted = counts and failure.kind in _COUNTED
        severity: Severity = "warning" if counted or failure.unusual else "error"
        rule, message = _RULES.get(failure.kind, "V-21"), failure.sentence
        if failure.params:
            message += f"\nThe parameters that it reads were {failure.params}."
        if failure.times and failure.kind in _COUNTED:
            message += f"\n{failure.times:,} of {result.counted:,} calls fail like this."
        if failure.unusual:
            message += "\nIt does so only in states that few trainings meet."
        if counted:
            message += "\nA training counts such calls and goes on (DR_REWARD_ON_ERROR)"
            if failed > tolerated * result.counted:
                message += (
                    f", but ends when more than {100.0 * tolerated:g} % of them fail "
                    "(DR_REWARD_MAX_ERROR_SHARE)"
                )
            message += "."
        elif tolerated > 0.0 and severity == "error" and failure.kind in _COUNTED:
            message += "\nNo call gives a reward, so a training would learn nothing."
        remedy = _missing_module(source, failure, directory) or cure_of(
            failure.reason, failure.missing, failure.source
        )
        remedy = remedy or REMEDIES[failure.kind]
        if failure.reason.startswith("PermissionError"):
            remedy = _CONFINED
        if name := _parameter(source, failure):
            message += f"\n`{name}` is not a parameter."
            remedy = likely_parameter(name)
        yield source.problem(rule, failure.line, message, remedy, severity)


def _parameter(source: Source, failure: Failure) -> str:
    asked = source.unknown_parameters
    return next((name for name in asked if failure.reason == f"KeyError: {name!r}"), "")


def _name_in(reason: str) -> str:
    """Of a NameError, which names no other in quotes."""
    return reason.partition("'")[2].partition("'")[0]


def _missing_module(source: Source, failure: Failure, directory: Path) -> str:
    module, file = failure.missing.partition(".")[0], Path(directory, source.name)
    if not module:
        return ""
    if module in (file.stem, "reward_function"):
        return "Remove the import: everything that the file defines is already there."
    if file.with_name(f"{module}.py").exists() or file.with_name(module).is_dir():
        return f"Put what you need of {module} into {file.name}: a training uses only this file."
    return ""


def _conversions(source: Source, result: SandboxResult) -> Iterator[Problem]:
    others = sorted(set(result.returned) - _FLOATS)
    if others and not result.failures:
        what = f"It returned {' and '.join(others)}, which is converted to float."
        remedy = "End it with `return float(reward)`."
        yield source.problem("V-20", result.line, what, remedy, "warning")


def _effects(source: Source, result: SandboxResult) -> Iterator[Problem]:
    for kind, (words, remedy) in _EFFECTS.items():
        for line in sorted({effect.line for effect in result.effects if effect.kind == kind}):
            done = [e for e in result.effects if e.kind == kind and e.line == line]
            what = f": {done[0].what}" if done[0].what else ""
            often = " in every call" if sum(e.times for e in done) >= result.calls else ""
            yield source.problem("V-25", line, f"It {words}{often}{what}.", remedy, "warning")


def _shared(source: Source, result: SandboxResult) -> Iterator[Problem]:
    shared = result.shared
    if shared is None:
        return
    what = ", ".join(f"`{name}`" for name in shared.names[:_MOST_NAMES])
    what = (
        f"It keeps something outside of the file that all cars share{what and f': {what}'}. "
        f"{shared.times:,} of {shared.of:,} rewards of a car are others if a second car drives "
        "at the same time."
    )
    remedy = "Keep it in a global variable of the file: each car has its own copy of that."
    yield source.problem("V-27", result.line, what, remedy, "warning")


def _prints(source: Source, result: SandboxResult) -> Iterator[Problem]:
    printed, calls = result.printed, max(result.counted, 1)
    if printed.lines > _CHATTY * calls:
        megabytes = printed.characters / calls * _TRAINING_STEPS / 1e6
        what = (
            f"It prints {printed.lines / calls:,.1f} lines per call: {megabytes:,.0f} MB in a "
            "million steps, into the log of the worker."
        )
        remedy = "Print only now and then, such as at the end of a lap."
        yield source.problem("V-25", printed.line, what, remedy, "warning")


def _speed(source: Source, result: SandboxResult) -> Iterator[Problem]:
    timing = result.timing
    if timing is None:
        return
    a_call_s, worst_s = timing.median_s, timing.worst_s  # the first call may prepare something
    if a_call_s > SIMULATION_STEP_S:
        what = (
            f"A call takes {a_call_s * 1e3:,.4g} ms, more than the simulation of the step itself: "
            f"a million steps take {a_call_s * _TRAINING_STEPS / 60:,.0f} minutes longer."
        )
        remedy = "If something is the same in every step, compute it once, outside the function."
        yield source.problem("V-26", result.line, what, remedy, "warning")
    if worst_s > _SLOW_CALL_S:
        what = f"One call takes {worst_s:.1f} s; a call of 5 s ends a training."
        remedy = "Move slow preparations out of the function, to the top of the file."
        yield source.problem("V-26", result.line, what, remedy, "warning")
