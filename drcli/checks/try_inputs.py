"""Tries a racer's inputs before a start: do the worlds load, does the reward function work?"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from threading import Event

from drcli.base.problems import Problem
from drcli.checks.sandbox.run_sandbox import Sandbox
from drcli.checks.sandbox.sandbox_records import (
    REMEDIES,
    FailureKind,
    SandboxRequest,
    SandboxResult,
)
from drcli.config.run_config import RaceConfig
from drcli.modelfiles.custom_files import InputFile

STATES = ("on the start line", "on the road", "after half a lap", "off the track", "at the finish")
"""The first calls of each sequence of `sample_calls`."""

_RULES: dict[FailureKind, str] = {
    "load": "V-02",
    "signature": "V-20",
    "type": "V-20",
    "range": "V-20",
    "undefined": "V-22",
}
"""All other failures break V-21."""

_COUNTED: tuple[FailureKind, ...] = ("raises", "undefined", "type", "range")
"""After these a training goes on with DR_REWARD_ON_ERROR=count."""

_FLOATS = {"float", "numpy.float64"}


def try_inputs(
    races: Sequence[RaceConfig],
    directory: Path,
    reward: InputFile | None,
    given_up: Event,
    tolerated: float = 0.0,
) -> list[Problem]:
    """Load the worlds of all workers and try the reward function on them, in the sandbox.

    Without a reward function, only the worlds are loaded. When `given_up` is set, the sandbox ends
    and finds nothing. `tolerated` is as in `problems_of`.
    """
    request = request_of(races, reward)
    with Sandbox(request, None if reward is None else reward.data, directory) as sandbox:
        return list(problems_of(sandbox.result(given_up), request.name, tolerated))


def request_of(races: Sequence[RaceConfig], reward: InputFile | None) -> SandboxRequest:
    """The request to the sandbox before a start."""
    return SandboxRequest(reward.origin if reward is not None else "", races=list(races))


def problems_of(result: SandboxResult, name: str, tolerated: float = 0.0) -> Iterator[Problem]:
    """The problems with the worlds and the reward function, whose author calls its file `name`.

    Calls that raise or return no reward are warnings if a training goes on after them and not more
    than the share `tolerated` of the calls failed.
    """
    yield from result.problems
    failed = sum(each.times for each in result.failures if each.kind in _COUNTED)
    counts = 0 < failed <= tolerated * result.calls
    for failure in result.failures:
        index = failure.first.index if failure.first is not None else len(STATES)
        message = failure.sentence(STATES[index] if index < len(STATES) else "")
        if failure.params:
            message += f"\n  params = {failure.params}"
        rule, remedy = _RULES.get(failure.kind, "V-21"), REMEDIES[failure.kind]
        if counts and failure.kind in _COUNTED:
            message += f"\n  {failed} of {result.calls} calls failed; a training counts them."
            yield Problem(rule, "warning", name, failure.line, message, remedy)
            continue
        yield Problem(rule, "error", name, failure.line, message, remedy)
    others = sorted(set(result.returned) - _FLOATS)
    if others and not result.failures:
        what = f"It returned {' and '.join(others)}, which is converted to float."
        remedy = "End it with `return float(reward)`."
        yield Problem("V-20", "warning", name, result.line, what, remedy)
