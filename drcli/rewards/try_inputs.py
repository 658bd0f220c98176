"""Tries inputs before a start."""

from dataclasses import replace
from pathlib import Path
from threading import Event

from drcli.base import installation
from drcli.base.errors import Problem
from drcli.config.run_config import DriveConfig, RunConfig
from drcli.rewards.lint import problems_of
from drcli.rewards.reward_rules import Source
from drcli.rewards.sandbox.run_sandbox import Sandbox, SandboxRequest


def try_inputs(
    run: RunConfig, directory: Path, source: Source | None, given_up: Event
) -> list[Problem]:
    """Load the worlds of all workers and try the function, if any, in the sandbox.

    Raises:
        NotAvailable: A library is missing, too old or broken.
    """
    if lacking := installation.unmet():
        raise lacking.error()
    request = SandboxRequest("" if source is None else source.name, races=races_of(run))
    with Sandbox(request, None if source is None else source.data, directory) as sandbox:
        result = sandbox.result(given_up)
    found = [as_given(problem, run) for problem in result.problems]
    if source is not None and not given_up.is_set():
        found += problems_of(source, result, directory, tolerated_share(run))
    return found


def races_of(run: RunConfig) -> list[DriveConfig]:
    second = run.second_race(run.race())
    return [*run.races, *([] if second is None else [second])]


def tolerated_share(run: RunConfig) -> float:
    """Share of failing calls up to which a training begins.

    By default 0: those of a check can be corrected now.
    """
    counts = run.given.get("DR_REWARD_ON_ERROR") == "count"
    return run.train.reward_max_error_share if counts else 0.0


def as_given(problem: Problem, run: RunConfig) -> Problem:
    place, name = run.eval_world_place, "DR_TRAIN_EVAL_WORLD"
    if not run.train.train_eval_world or (problem.file, problem.line) != tuple(place):
        return problem
    text = problem.message.replace("DR_WORLD_NAME", name)
    return replace(problem, message=text, key=name)
