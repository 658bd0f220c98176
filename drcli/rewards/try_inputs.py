"""Tries inputs before a start."""

from dataclasses import replace
from pathlib import Path
from threading import Event

from drcli.base import installation
from drcli.base.errors import Problem
from drcli.config.run_config import DriveConfig, RunConfig
from drcli.config.track_names import (
    WORLD_LISTS,
    is_installed,
    list_problems,
    races_on,
    world_list,
)
from drcli.model.files.custom_files import InputFile
from drcli.rewards.lint import problems_of
from drcli.rewards.reward_rules import Source
from drcli.rewards.sandbox.run_sandbox import Sandbox, SandboxRequest

MOST_OF_A_LIST = 3
"""Tracks on which a function is tried; each takes its time."""


def try_inputs(
    run: RunConfig,
    directory: Path,
    source: Source | None,
    given_up: Event,
    metadata: InputFile | None = None,
) -> list[Problem]:
    """Load the worlds of all workers and try the function, if any, in the sandbox.

    There, drivers drive with the actions of `metadata`.

    Raises:
        NotAvailable: A library is missing, too old or broken.
    """
    if lacking := installation.unmet():
        raise lacking.error()
    request = SandboxRequest(
        "" if source is None else source.name,
        races=races_of(run),
        drives=source is not None,
        metadata=text_of(metadata),
    )
    with Sandbox(request, None if source is None else source.data, directory) as sandbox:
        result = sandbox.result(given_up)
    found = [as_given(problem, run) for problem in result.problems] + list_problems(run.races)
    if source is not None and not given_up.is_set():
        found += problems_of(source, result, directory, tolerated_share(run))
    return found


def text_of(file: InputFile | None) -> str:
    """Without what cannot be read, which other checks tell."""
    return "" if file is None else file.data.decode("utf-8", "replace")


def races_of(run: RunConfig) -> list[DriveConfig]:
    lists = [races_on(run.race(), name) for name in WORLD_LISTS]
    few = [each for races in lists for each in races[:MOST_OF_A_LIST] if is_installed(each)]
    return [*run.races, *few]


def tolerated_share(run: RunConfig) -> float:
    """Share of failing calls up to which a training goes on; 0 if it must not begin with any.

    By default they are corrected now. With DR_REWARD_ON_ERROR=count it begins unless all fail: the
    calls of a check are no measure of those of a training.
    """
    counts = run.given.get("DR_REWARD_ON_ERROR") == "count"
    return run.train.reward_max_error_share if counts else 0.0


def as_given(problem: Problem, run: RunConfig) -> Problem:
    race, place = run.race(), (problem.file, problem.line)
    for name in WORLD_LISTS:
        if world_list(race, name) and place == tuple(race.place(name)):
            text = problem.message.replace("DR_WORLD_NAME", name)
            return replace(problem, message=text, key=name)
    return problem
