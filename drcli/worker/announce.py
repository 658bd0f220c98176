"""Log lines that log-guru and other readers of the reference's logs look for, word for word."""

import json

from drcli.config import Settings
from drcli.hyperparameters import Hyperparameters
from drcli.model_metadata import ModelMetadata
from drcli.worker.trace import Episode


def start_lines(
    settings: Settings, metadata: ModelMetadata, hyperparameters: Hyperparameters, job_type: str
) -> str:
    """What a simulation log says before its first step."""
    prefix = settings.model_prefix
    parameters = {
        "JOB_TYPE": job_type,
        "RACE_TYPE": settings.race_type,
        "WORLD_NAME": settings.world_name,
    }
    file = "training_params.yaml" if job_type == "TRAINING" else "evaluation_params.yaml"
    space = json.loads(metadata.action_space_json)
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
            f"Action space from file: {space}",
            "Using the following hyper-parameters",
            hyperparameters.canonical_json(),
        ]
    )


def training_line(episode: Episode, worker: int, total_steps: int, iteration: int) -> str:
    """The end of a training episode."""
    return (
        f"Training> Name=main_level/agent, Worker={worker}, Episode={episode.number + 1}, "
        f"Total reward={episode.reward:.2f}, Steps={total_steps}, Training iteration={iteration}"
    )


def evaluation_lines(
    episodes: list[Episode], worker: int, last_episode: int, total_steps: int, iteration: int
) -> str:
    """The evaluation of one checkpoint during training."""
    lines = ["## agent: Starting evaluation phase"]
    share = sum(episode.completed for episode in episodes) / len(episodes)
    for episode in episodes:
        lines += [
            f"Testing> Name=main_level/agent, Worker={worker}, Episode={last_episode}, "
            f"Total reward={episode.reward:.2f}, Steps={total_steps}, "
            f"Training iteration={iteration}",
            f"## agent: Finished evaluation phase. Success rate = {share}, "
            f"Avg Total Reward = {episode.reward:.2f}",
        ]
    progress = [float(episode.progress) for episode in episodes]
    mean = sum(progress) / len(progress)
    lines += [
        f"[BestModelSelection] Number of evaluations: {len(progress)} "
        f"Evaluation episode progress: {progress}",
        f"[BestModelSelection] Evaluation episode progress mean: {mean}",
    ]
    return "\n".join(lines)


def epoch_line(surrogate: float, kl: float, entropy: float, epoch: int, lr: float) -> str:
    """One pass of the update over the rollouts, in the trainer's log."""
    return (
        f"Policy training> Surrogate loss={surrogate}, KL divergence={kl}, Entropy={entropy}, "
        f"training epoch={epoch}, learning_rate={lr}"
    )
