"""Metrics files of training and evaluation: one record for each episode or trial.

Formats of the reference simulator; `iteration` is ours.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from drcli.base.json_record import JsonRecord, SafeInt, decode_json
from drcli.records.iteration import is_clean_lap
from drcli.records.trace import STATUS_LABELS, STEP_S, VIOLATIONS, Episode, Phase, TracedEpisode

FILE_VERSION = 2.0
REPORT_FILE = "evaluation.json"
"""For `dr-evaluate`."""


class _Metrics(JsonRecord):
    def to_json(self) -> dict[str, Any]:
        """As in metrics files: 12, not 12.0."""
        return {
            name: int(value) if isinstance(value, float) and value.is_integer() else value
            for name, value in super().to_json().items()
            if value is not None
        }


@dataclass(frozen=True)
class EpisodeMetrics(_Metrics):
    """One episode in `TrainingMetrics.json`. Times: milliseconds of simulation.

    We write whole numbers, but read fractions of other tools.

    Attributes:
        episode: Number of the (last) training episode, from 1.
        trial: The same within the iteration.
        episode_status: As in `STATUS_LABELS`.
    """

    reward_score: float
    metric_time: float
    start_time: float
    elapsed_time_in_milliseconds: float
    episode: SafeInt
    trial: SafeInt
    phase: Phase
    completion_percentage: float
    episode_status: str
    iteration: SafeInt | None = None
    stage: str | None = None

    @staticmethod
    def of(
        driven: Episode | TracedEpisode, *, iteration: int, episode: int, trial: int
    ) -> "EpisodeMetrics":
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


def completion_percentage(progress: float) -> int:
    return min(100, max(0, int(progress)))


METRICS_HEAD = b'{"metrics": ['
SEPARATOR = b", "


def metrics_end(best_model_metric: str) -> bytes:
    end = {"version": FILE_VERSION, "best_model_metric": best_model_metric}
    return b"], " + json.dumps(end).encode().removeprefix(b"{")


def encode_records(records: Iterable[EpisodeMetrics]) -> bytes:
    return SEPARATOR.join(json.dumps(record.to_json()).encode() for record in records)


def encode_metrics(records: Iterable[EpisodeMetrics], best_model_metric: str) -> bytes:
    return METRICS_HEAD + encode_records(records) + metrics_end(best_model_metric)


def decode_metrics(data: bytes) -> list[EpisodeMetrics]:
    """`TrainingMetrics.json` of any version; RecordError if damaged."""
    return decode_json(_EpisodeFile, data).metrics


@dataclass(frozen=True)
class _EpisodeFile:
    metrics: list[EpisodeMetrics]


def most_episodes(records: Sequence[EpisodeMetrics]) -> int:
    most = max((r.trial for r in records), default=0)
    later = ((r.episode - r.trial, r.iteration) for r in records if r.iteration)
    return max([most, *(numbered // iteration for numbered, iteration in later)])


@dataclass(frozen=True)
class TrialMetrics(_Metrics):
    """One trial, or lap of a continuous race. Times: milliseconds of simulation.

    The counts are violations; `reset_count` of them put the car back. Keys from
    `penalty_in_milliseconds` on are ours.

    Attributes:
        start_position: Fraction of the centre line.
        start_offset_m: To the left.
        start_angle_deg: To the left.
    """

    completion_percentage: float
    metric_time: float
    start_time: float
    elapsed_time_in_milliseconds: float
    episode_status: str
    crash_count: SafeInt
    immobilized_count: SafeInt
    off_track_count: SafeInt
    reversed_count: SafeInt
    reset_count: SafeInt
    trial: SafeInt
    penalty_in_milliseconds: float | None = None
    start_position: float | None = None
    start_offset_m: float | None = None
    start_angle_deg: float | None = None
    end_waypoint: SafeInt | None = None

    @staticmethod
    def of(episode: Episode) -> "TrialMetrics":
        start_ms = round((episode.clock_s + episode.begin_s) * 1000)
        elapsed_ms = round(episode.duration_s * 1000)
        completed = episode.progress >= 100.0
        status = [row.status for row in episode.rows]
        crashes, immobilized = status.count("crashed"), status.count("immobilized")
        off_track, reversed_ = status.count("off_track"), status.count("reversed")
        # The violation that ended the trial did not put the car back.
        ended_by_violation = episode.rows[-1].done and episode.status in VIOLATIONS
        return TrialMetrics(
            completion_percentage=completion_percentage(episode.progress),
            metric_time=start_ms + elapsed_ms,
            start_time=start_ms,
            elapsed_time_in_milliseconds=elapsed_ms,
            episode_status=STATUS_LABELS["lap_complete" if completed else episode.status],
            crash_count=crashes,
            immobilized_count=immobilized,
            off_track_count=off_track,
            reversed_count=reversed_,
            reset_count=crashes + immobilized + off_track + reversed_ - ended_by_violation,
            trial=episode.number + 1,
            penalty_in_milliseconds=round(1000 * STEP_S * status.count("pause")),
            end_waypoint=episode.rows[-1].closest_waypoint,
        )

    @property
    def clean(self) -> bool:
        return is_clean(vars(self), finished=self.episode_status == STATUS_LABELS["lap_complete"])


def is_clean(trial: Mapping[str, Any], *, finished: bool) -> bool:
    return is_clean_lap(finished, *(trial.get(key) for key in _FAULTS))


_FAULTS = (
    "reset_count",
    "off_track_count",
    "crash_count",
    "immobilized_count",
    "reversed_count",
    "penalty_in_milliseconds",
)


def decode_metrics_file(data: bytes) -> list[TrialMetrics]:
    return decode_json(_TrialFile, data).metrics


@dataclass(frozen=True)
class _TrialFile:
    metrics: list[TrialMetrics]


def encode_metrics_file(trials: Sequence[TrialMetrics]) -> bytes:
    return json.dumps({"metrics": [trial.to_json() for trial in trials]}).encode()


@dataclass(frozen=True)
class EvaluationTrials(JsonRecord):
    racers: list[list[TrialMetrics]]
    notes: list[str]
