"""Writes the log lines that log-guru and other tools search for, word for word.

`drcli.base.log.plain` writes them, without time and level.
"""

import json
from collections.abc import Sequence

from drcli.config.run_config import DriveConfig
from drcli.learn.update_result import Stats
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.records.trace import Episode, log_lines

EVALUATION_END = "## agent: Finished evaluation phase. Success rate = 0.0, Avg Total Reward = "
"""Before the reward. The rate is always 0.0 in the reference, and log-guru only knows that. A line
of our own tells the true one.
"""

OWN_LINE = ""
"""Ends a line that a reward function may have left unfinished."""


def start_lines(
    prefix: str,
    race: DriveConfig,
    metadata: ModelMetadata,
    hyperparameters: Hyperparameters,
    job_type: str,
) -> str:
    parameters = {
        "JOB_TYPE": job_type,
        "RACE_TYPE": race.race_type,
        "WORLD_NAME": race.world_name,
    }
    file = "training_params.yaml" if job_type == "TRAINING" else "evaluation_params.yaml"
    kind = metadata.action_space_type
    return "\n".join(
        [
            f"[s3] Successfully downloaded yaml file from s3 key {prefix}/{file} "
            f"to local ./custom_files/{file}.",
            str(parameters),
            *(f" * /{name}: {value}" for name, value in parameters.items()),
            f"Sensor list {list(metadata.sensor)}, network {metadata.neural_network}, "
            f"simapp_version {float(metadata.version)}, "
            f"training_algorithm {metadata.training_algorithm}, action_space_type {kind} "
            "lidar_config {}",
            f"Action space from file: {_action_space(metadata)}",
            "Using the following hyper-parameters",
            hyperparameters.canonical_json(),
        ]
    )


def training_lines(
    episodes: Sequence[Episode],
    worker: int,
    total_steps: int,
    iteration: int,
    wall_clock: float,
) -> str:
    """The training episodes of an iteration.

    log-guru stops at an episode number that it has seen, so none must be printed again.
    `total_steps` is before the iteration; `wall_clock` Unix seconds.
    """
    lines = [OWN_LINE]
    for episode in episodes:
        total_steps += episode.steps
        lines += [
            log_lines(episode, wall_clock),
            f"Training> Name=main_level/agent, Worker={worker}, Episode={episode.number + 1}, "
            f"Total reward={episode.reward:.2f}, Steps={total_steps}, "
            f"Training iteration={iteration}",
        ]
    return "\n".join(lines)


def evaluation_lines(
    episodes: Sequence[Episode], worker: int, last_episode: int, total_steps: int, iteration: int
) -> str:
    """One checkpoint's evaluation, with which log-guru begins an iteration.

    `last_episode` and `total_steps` count the training so far; `iteration` is the checkpoint's.
    """
    lines = [OWN_LINE, "## agent: Starting evaluation phase"]
    for episode in episodes:
        lines += [
            f"Testing> Name=main_level/agent, Worker={worker}, Episode={last_episode}, "
            f"Total reward={episode.reward:.2f}, Steps={total_steps}, "
            f"Training iteration={iteration}",
            f"{EVALUATION_END}{episode.reward:.2f}",
        ]
    done = sum(episode.completed for episode in episodes)
    lines.append(
        f"## agent: {done} of {len(episodes)} evaluation episodes completed the lap: success rate "
        f"{done / len(episodes):.2f}. The 0.0 above is part of the format that log-guru reads."
    )
    progress = [float(episode.progress) for episode in episodes]
    mean = sum(progress) / len(progress)
    lines += [
        f"[BestModelSelection] Number of evaluations: {len(progress)} "
        f"Evaluation episode progress: {progress}",
        f"[BestModelSelection] Evaluation episode progress mean: {mean}",
    ]
    return "\n".join(lines)


def epoch_line(stats: Stats) -> str:
    """One epoch of an update, as in the reference."""
    end = ", training epoch={0.epoch}, learning_rate={0.learning_rate}"
    return (stats.line + end).format(stats)


def _action_space(metadata: ModelMetadata) -> object:
    """In our order: log-guru stops at another."""
    space = json.loads(metadata.action_space_json)
    if isinstance(space, dict):
        return space
    return [{name: action[name] for name in ("steering_angle", "speed")} for action in space]
