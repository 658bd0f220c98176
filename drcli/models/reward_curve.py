"""The reward graph of a training."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from drcli.config.bucket_config import ModelConfig
from drcli.exchange.checkpoint import CheckpointName
from drcli.exchange.episode_metrics import EpisodeMetrics
from drcli.exchange.iteration import IterationRecord
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing
from drcli.store.repair import Model, read_all_metrics, readable_history, readable_scores

MOST_EPISODES = 4_000
"""Of more, every second one is left out, or two of three ..."""

_METRICS = re.compile(r"TrainingMetrics(_\d+)?\.json")


@dataclass(frozen=True)
class CurvePoint:
    iteration: int
    reward: float | None
    progress: float | None
    evaluation_reward: float | None
    evaluation_progress: float | None
    evaluation_laps: int
    entropy: float | None
    evaluation_episodes: int = 0


@dataclass(frozen=True)
class EpisodePoint:
    iteration: int
    evaluation: bool
    reward: float
    progress: float


@dataclass(frozen=True)
class RewardCurve:
    iterations: list[CurvePoint]
    episodes: list[EpisodePoint]
    all_episodes: int
    best_iteration: int | None
    damaged: list[str] = field(default_factory=list)


def read_reward_curve(config: ModelConfig, bucket: Bucket, prefix: str) -> RewardCurve:
    """Reconstructs damaged records; raises StorageError."""
    model = Model.of(config, bucket, prefix)
    history, damaged = readable_history(model)
    scores, worse = readable_scores(model)
    damaged += worse
    records: list[EpisodeMetrics] = []
    for key in _metrics_keys(bucket, model.metrics_prefix):
        try:
            records += read_all_metrics(bucket, key)
        except ObjectMissing:
            continue
        except ObjectDamaged as error:
            damaged.append(str(error))
    numbered = [record for record in records if record.iteration is not None]
    numbered.sort(key=lambda record: (record.iteration or 0, record.episode))
    driven: dict[int, list[float]] = {}
    for record in numbered:
        if record.phase == "evaluation":
            driven.setdefault(record.iteration or 0, []).append(record.reward_score)
    best = None
    if scores is not None:
        name = CheckpointName.parse(scores.best_checkpoint.name)
        best = None if name is None else name.number
    every = max(1, math.ceil(len(numbered) / MOST_EPISODES))
    return RewardCurve(
        [_point(record, driven.get(record.iteration, [])) for record in history],
        [_episode(record) for record in numbered[::every]],
        len(records),
        best,
        damaged,
    )


def _metrics_keys(bucket: Bucket, metrics_prefix: str) -> list[str]:
    folder = metrics_prefix.rstrip("/") + "/"
    names = {info.key.removeprefix(folder).partition(".part-")[0] for info in bucket.list(folder)}
    return sorted(folder + name for name in names if _METRICS.fullmatch(name))


def _point(record: IterationRecord, rewards: Sequence[float]) -> CurvePoint:
    return CurvePoint(
        record.iteration,
        record.mean_reward,
        record.mean_progress,
        _mean(rewards),
        _mean(record.evaluation_progress),
        len(record.evaluation_lap_s),
        record.entropy,
        len(record.evaluation_progress),
    )


def _episode(record: EpisodeMetrics) -> EpisodePoint:
    return EpisodePoint(
        record.iteration or 0,
        record.phase == "evaluation",
        record.reward_score,
        record.completion_percentage,
    )


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None
