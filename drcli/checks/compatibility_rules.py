"""What trains here but may not elsewhere: on the reference, on the console, on the car."""

import re
from collections.abc import Iterator
from dataclasses import replace
from math import gcd

from drcli.base.problems import Problem, Severity
from drcli.config.settings import Settings
from drcli.modelfiles.hyperparameters import Hyperparameters
from drcli.modelfiles.model_metadata import ModelMetadata

LONGEST_NAME = 64
"""Characters in the name of an imported model. Source: the reference's validation script."""

CONSOLE_SPEED_MPS = (0.5, 4.0)
"""Speeds of ranges of actions there; lists begin at 0.1. Source: the console's limits."""

CONSOLE_ACTIONS = 2
"""Least number of actions in a list there."""

LAP = 1.0
"""What (episodes / workers) x advance has to be, so that every evaluation starts at one place."""

_ROUNDING = 1e-4
"""What a decimal fraction such as 0.0333333 may be off."""

MOST_EPISODES = 100
"""An iteration has no more."""


def review_names(settings: Settings, *, console: bool) -> Iterator[Problem]:
    """V-01: names under which a model may be imported."""
    for setting, prefix in (
        ("DR_LOCAL_S3_MODEL_PREFIX", settings.model_prefix),
        ("DR_UPLOAD_S3_PREFIX", settings.upload_s3_prefix),
    ):
        name = prefix.rpartition("/")[2]
        derived = setting != "DR_LOCAL_S3_MODEL_PREFIX" and setting not in settings.sources
        if derived or (re.fullmatch(r"[A-Za-z0-9-]+", name) and len(name) <= LONGEST_NAME):
            continue
        yield Problem(
            "V-01",
            _severity(console),
            *settings.place(setting),
            f"{setting}={prefix}: a model cannot be imported elsewhere as {name}.",
            f"Use letters, digits and hyphens only, {LONGEST_NAME} at most, behind the last /.",
        )


def review_actions(
    metadata: ModelMetadata,
    parameters: Hyperparameters | None,
    settings: Settings | None,
    where: str,
    *,
    console: bool,
) -> Iterator[Problem]:
    """V-31 to V-34: what the car and the console make of model_metadata.json."""
    space = metadata.action_space
    if space.low is not None and space.high is not None:
        if abs(space.low[0]) > space.high[0]:
            yield Problem(
                "V-31",
                "warning",
                where,
                None,
                f"action_space.steering_angle from {space.low[0]:g} to {space.high[0]:g}: the "
                "physical car cannot steer further to the right than to the left.",
                f'Write "high": {abs(space.low[0]):g}, or a "low" of {-space.high[0]:g} or more.',
            )
        if not CONSOLE_SPEED_MPS[0] <= space.low[1] <= space.high[1] <= CONSOLE_SPEED_MPS[1]:
            yield Problem(
                "V-32",
                "warning",
                where,
                None,
                f"action_space.speed from {space.low[1]:g} to {space.high[1]:g} is outside of what "
                "the console takes.",
                f"Stay within {CONSOLE_SPEED_MPS[0]:g} to {CONSOLE_SPEED_MPS[1]:g} for its sake.",
            )
    elif len(space.values) < CONSOLE_ACTIONS:
        yield Problem(
            "V-32",
            "warning",
            where,
            None,
            "action_space has a single action, and the console takes from 2 to 30.",
            "Add an action.",
        )
    if "DISCRETIZED_SECTOR_LIDAR" in metadata.sensor:
        yield Problem(
            "V-33",
            "warning",
            where,
            None,
            "sensor holds DISCRETIZED_SECTOR_LIDAR, with which the physical car loads no model.",
            "Use SECTOR_LIDAR for a model that shall drive there.",
        )
    if metadata.training_algorithm == "sac" and parameters is not None:
        workers = 1 if settings is None else settings.workers
        yield from _sac(parameters, workers, where, _severity(console))


def as_console(item: Problem) -> Problem:
    """The same where the console counts: actions beyond its limits are refused there."""
    return replace(item, severity="error") if item.rule == "V-32" else item


def review_balance(
    settings: Settings, parameters: Hyperparameters, origin: str
) -> Iterator[Problem]:
    """V-42 and V-45: episodes, workers and starts that go into each other."""
    episodes, workers = parameters.num_episodes_between_training, settings.workers
    advance = settings.train_round_robin_advance_dist
    if workers > episodes:
        return  # an error of its own
    if episodes % workers:
        around = (episodes // workers * workers, (episodes // workers + 1) * workers)
        yield Problem(
            "V-45",
            "warning",
            *settings.place("DR_WORKERS"),
            f"DR_WORKERS={workers} does not divide num_episodes_between_training={episodes} in "
            f"{origin}: some workers drive an episode more than others.",
            f"Write {' or '.join(str(n) for n in around if n <= MOST_EPISODES)} episodes, or "
            f"DR_WORKERS={gcd(episodes, workers)}.",
        )
    lap = episodes / workers * advance
    if settings.train_change_start_position and abs(lap - LAP) > _ROUNDING:
        yield Problem(
            "V-42",
            "warning",
            *settings.place("DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST"),
            f"({episodes} episodes / {workers} workers) x "
            f"DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST={advance:g} is {lap:.4g} and not 1: elsewhere "
            "evaluations would start at another place each time. Here they do not.",
            f"Write DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST={workers / episodes:.6g}"
            f"{_better_episodes(workers, advance)}.",
        )


def _better_episodes(workers: int, advance: float) -> str:
    """The other way out of V-42, where it is a whole number of episodes."""
    episodes = workers / advance if advance else 0.0
    if not 1 <= episodes <= MOST_EPISODES or abs(episodes - round(episodes)) > 1e-6:
        return ""
    return f", or num_episodes_between_training={round(episodes)}"


def _sac(
    parameters: Hyperparameters, workers: int, where: str, severity: Severity
) -> Iterator[Problem]:
    """V-34: sac with several workers or episodes stalls elsewhere; here it does not."""
    for written, value, wanted in (
        ("num_episodes_between_training", parameters.num_episodes_between_training, 1),
        ("DR_WORKERS", workers, 1),
        ("exploration_type", parameters.exploration_type, "additive_noise"),
    ):
        if value != wanted:
            yield Problem(
                "V-34",
                severity,
                where,
                None,
                f"training_algorithm=sac with {written}={value}: it works here, the console and "
                f"the reference take {wanted} only.",
                f"Write {written}={wanted} for a model that shall train there.",
            )


def _severity(console: bool) -> Severity:
    return "error" if console else "warning"
