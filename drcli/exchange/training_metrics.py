"""`TrainingMetrics.json`: one record for each episode that a simulation worker drove.

The format is the reference simulator's, and analysis tools read it. `iteration` is ours.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from drcli.base.json_record import JsonRecord, Misfit, parsed
from drcli.exchange.trace import STATUS_LABELS, Episode, Phase, TracedEpisode

FILE_VERSION = 2.0
"""Version of the file's format. Source: the reference simulator."""


@dataclass(frozen=True)
class EpisodeMetrics(JsonRecord):
    """One episode. Times are milliseconds of the simulation clock.

    Attributes:
        episode: Number of the (last) training episode, from 1.
        trial: Number of the (last) training episode within the iteration, from 1.
        episode_status: How it ended, in the words of `STATUS_LABELS`.
        iteration: In which it was driven; None in files of version 0.1.0.
    """

    reward_score: int
    metric_time: int
    start_time: int
    elapsed_time_in_milliseconds: int
    episode: int
    trial: int
    phase: Phase
    completion_percentage: int
    episode_status: str
    iteration: int | None = None

    @staticmethod
    def of(
        driven: Episode | TracedEpisode, *, iteration: int, episode: int, trial: int
    ) -> "EpisodeMetrics":
        """The record of an episode that was driven in some iteration."""
        start_ms = round(driven.clock_s * 1000)
        end_ms = round((driven.clock_s + driven.duration_s) * 1000)
        return EpisodeMetrics(
            reward_score=round(driven.reward),
            metric_time=end_ms,
            start_time=start_ms,
            elapsed_time_in_milliseconds=end_ms - start_ms,
            episode=episode,
            trial=trial,
            phase=driven.phase,
            completion_percentage=completion_percentage(driven.progress),
            episode_status=STATUS_LABELS[driven.status],
            iteration=iteration,
        )

    def to_json(self) -> dict[str, Any]:
        """The record as JSON, without an iteration that is unknown."""
        fields = super().to_json()
        if self.iteration is None:
            del fields["iteration"]
        return fields


def completion_percentage(progress: float) -> int:
    """Progress as metrics files have it."""
    return min(100, max(0, int(progress)))


def encode_metrics(records: Sequence[EpisodeMetrics], best_model_metric: str) -> bytes:
    """The file of one worker.

    Args:
        records: Of its episodes.
        best_model_metric: DR_TRAIN_BEST_MODEL_METRIC.
    """
    listed = [record.to_json() for record in records]
    file = {"metrics": listed, "version": FILE_VERSION, "best_model_metric": best_model_metric}
    return json.dumps(file).encode()


def decode_metrics(data: bytes) -> list[EpisodeMetrics]:
    """The records of a file.

    Raises:
        Misfit: The bytes are something else.
    """
    file = parsed(data)
    if not isinstance(file, dict) or not isinstance(file.get("metrics"), list):
        raise Misfit("it has no list of 'metrics'")
    if file.get("version", FILE_VERSION) != FILE_VERSION:
        raise Misfit(f"its version is {str(file['version'])[:20]}, not {FILE_VERSION}")
    return [EpisodeMetrics.from_json(record) for record in file["metrics"]]


def most_episodes(records: Sequence[EpisodeMetrics]) -> int:
    """With how many episodes an iteration the episodes of a file are numbered, at least."""
    most = max((r.trial for r in records), default=0)
    later = ((r.episode - r.trial, r.iteration) for r in records if r.iteration)
    return max([most, *(numbered // iteration for numbered, iteration in later)])
