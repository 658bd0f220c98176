"""Tries a racer's inputs before a start: do the worlds load, does the reward work on them?"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from threading import Event

from drcli.base.problems import Problem
from drcli.checks.sandbox.run_sandbox import Sandbox
from drcli.checks.sandbox.sandbox_records import (
    REMEDIES,
    Failure,
    FailureKind,
    SandboxRequest,
    SandboxResult,
)
from drcli.config.settings import RaceConfig
from drcli.modelfiles.custom_files import InputFile

STATES = ("on the start line", "on the road", "after half a lap", "off the track", "at the finish")
"""The first calls of each sequence of `sample_calls`."""

_RULES: dict[FailureKind, str] = {
    "load": "V-02",
    "signature": "V-20",
    "type": "V-20",
    "range": "V-20",
}
"""Rules that failures break; all others break V-21."""

_FLOATS = {"float", "numpy.float64"}


def try_inputs(
    races: Sequence[RaceConfig], directory: Path, reward: InputFile | None, given_up: Event
) -> list[Problem]:
    """Load the worlds of all workers and try the reward function on them.

    The launcher itself never imports a racer's code.

    Args:
        races: What the workers are going to drive.
        directory: The racer's working folder.
        reward: The reward function; None loads the worlds only.
        given_up: Once set, the sandbox is ended, and nothing is found.
    """
    request = request_of(races, reward)
    with Sandbox(request, None if reward is None else reward.data, directory) as sandbox:
        return list(problems_of(sandbox.result(given_up), request.name))


def request_of(races: Sequence[RaceConfig], reward: InputFile | None) -> SandboxRequest:
    """What the sandbox is asked to do before a start."""
    return SandboxRequest(reward.origin if reward is not None else "", races=list(races))


def problems_of(result: SandboxResult, name: str) -> Iterator[Problem]:
    """What keeps a training from starting, and values that are not floats.

    Args:
        result: What the sandbox found.
        name: What the author calls the file of the reward function.
    """
    yield from result.problems
    for failure in result.failures:
        rule = _RULES.get(failure.kind, "V-21")
        line = failure.line or None
        yield Problem(rule, "error", name, line, _message(failure), REMEDIES[failure.kind])
    others = sorted(set(result.returned) - _FLOATS)
    if others and not result.failures:
        yield Problem(
            "V-20",
            "warning",
            name,
            result.line or None,
            f"It returned {' and '.join(others)}, which is converted to float.",
            "End it with `return float(reward)`.",
        )


def _message(failure: Failure) -> str:
    index = failure.first.index if failure.first is not None else len(STATES)
    text = failure.sentence(STATES[index] if index < len(STATES) else "")
    return f"{text}\n  params = {failure.params}" if failure.params else text
