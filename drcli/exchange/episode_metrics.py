"""Metrics files of training and evaluation: one record for each episode or trial.

The formats are the reference simulator's, and analysis tools read them. `iteration` is ours.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from drcli.base.json_record import JsonRecord, RecordError, parse_json
from drcli.exchange.laps import is_clean_lap
from drcli.exchange.trace import (
    STATUS_LABELS,
    STEP_S,
    VIOLATIONS,
    Episode,
    Phase,
    TracedEpisode,
)

FILE_VERSION = 2.0
"""Of TrainingMetrics.json. Source: the reference simulator."""

REPORT_FILE = "evaluation.json"
"""In the folder of an evaluation: its trials, which `dr-evaluate` reads."""


@dataclass(frozen=True)
class EpisodeMetrics(JsonRecord):
    """One episode in `TrainingMetrics.json`. Times are milliseconds of the simulation clock.

    We write whole numbers, but read fractions too: other tools write them.

    Attributes:
        episode: Number of the (last) training episode, from 1.
        trial: Number of the (last) training episode within the iteration, from 1.
        episode_status: How it ended, in the words of `STATUS_LABELS`.
        iteration: None in files of version 0.1.0.
        stage: Stage of the training; None without a curriculum.
    """

    reward_score: float
    metric_time: float
    start_time: float
    elapsed_time_in_milliseconds: float
    episode: int
    trial: int
    phase: Phase
    completion_percentage: float
    episode_status: str
    iteration: int | None = None
    stage: str | None = None

    @staticmethod
    def of(
        driven: Episode | TracedEpisode, *, iteration: int, episode: int, trial: int
    ) -> "EpisodeMetrics":
        """The record of an episode."""
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
        """The record as a JSON object, without an unknown iteration or stage."""
        fields = _whole_as_int(super().to_json())
        if self.iteration is None:
            del fields["iteration"]
        if self.stage is None:
            del fields["stage"]
        return fields


def _whole_as_int(fields: dict[str, Any]) -> dict[str, Any]:
    """Numbers as metrics files have them: 12, not 12.0 as Python reads it into a float."""
    return {
        name: int(value) if isinstance(value, float) and value.is_integer() else value
        for name, value in fields.items()
    }


def completion_percentage(progress: float) -> int:
    """Progress as metrics files have it."""
    return min(100, max(0, int(progress)))


METRICS_HEAD = b'{"metrics": ['
"""What is before the records in `TrainingMetrics.json`."""

SEPARATOR = b", "
"""Between two records."""


def metrics_end(best_model_metric: str) -> bytes:
    """What follows the records; the metric is DR_TRAIN_BEST_MODEL_METRIC."""
    end = {"version": FILE_VERSION, "best_model_metric": best_model_metric}
    return b"], " + json.dumps(end).encode().removeprefix(b"{")


def encode_records(records: Iterable[EpisodeMetrics]) -> bytes:
    """Some records as they are in the file."""
    return SEPARATOR.join(json.dumps(record.to_json()).encode() for record in records)


def encode_metrics(records: Iterable[EpisodeMetrics], best_model_metric: str) -> bytes:
    """`TrainingMetrics.json` of one worker; the metric is DR_TRAIN_BEST_MODEL_METRIC."""
    return METRICS_HEAD + encode_records(records) + metrics_end(best_model_metric)


def decode_metrics(data: bytes) -> list[EpisodeMetrics]:
    """The records in `TrainingMetrics.json` of any version; RecordError if one cannot be read."""
    file = parse_json(data)
    if not isinstance(file, dict) or not isinstance(file.get("metrics"), list):
        raise RecordError("it has no list of 'metrics'")
    return [EpisodeMetrics.from_json(record) for record in file["metrics"]]


def most_episodes(records: Sequence[EpisodeMetrics]) -> int:
    """The least number of episodes in an iteration that fits the numbers of these episodes."""
    most = max((r.trial for r in records), default=0)
    later = ((r.episode - r.trial, r.iteration) for r in records if r.iteration)
    return max([most, *(numbered // iteration for numbered, iteration in later)])


@dataclass(frozen=True)
class TrialMetrics(JsonRecord):
    """One trial, or one lap of a continuous race. Times are milliseconds of the simulation clock.

    The counts are violations, and `reset_count` says how many of them put the car back. The keys
    from `penalty_in_milliseconds` on are ours; they are None in files of others and of version
    0.1.0, and where they are not known.

    Attributes:
        penalty_in_milliseconds: Waiting for penalties to end, which the elapsed time contains.
        start_position: Where on the lap it began, as a fraction of the centre line.
        start_offset_m: How far to the left of the centre line it began.
        start_angle_deg: How far the car was turned to the left.
        end_waypoint: Index of the waypoint closest to its end.
    """

    completion_percentage: float
    metric_time: float
    start_time: float
    elapsed_time_in_milliseconds: float
    episode_status: str
    crash_count: int
    immobilized_count: int
    off_track_count: int
    reversed_count: int
    reset_count: int
    trial: int
    penalty_in_milliseconds: float | None = None
    start_position: float | None = None
    start_offset_m: float | None = None
    start_angle_deg: float | None = None
    end_waypoint: int | None = None

    @staticmethod
    def of(episode: Episode) -> "TrialMetrics":
        """The record of a trial or lap."""
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
        """Whether it is a clean lap."""
        return is_clean(vars(self), finished=self.episode_status == STATUS_LABELS["lap_complete"])

    def to_json(self) -> dict[str, Any]:
        """The record as a JSON object, without what is not known."""
        fields = _whole_as_int(super().to_json())
        return {name: value for name, value in fields.items() if value is not None}


def is_clean(trial: Mapping[str, Any], *, finished: bool) -> bool:
    """Whether a lap of a metrics file, maybe of another program, is a clean one."""
    return is_clean_lap(finished, *(trial.get(key) for key in _FAULTS))


_FAULTS = (
    "reset_count",
    "off_track_count",
    "crash_count",
    "immobilized_count",
    "reversed_count",
    "penalty_in_milliseconds",
)


def encode_metrics_file(trials: Sequence[TrialMetrics]) -> bytes:
    """The metrics file of one racer."""
    return json.dumps({"metrics": [trial.to_json() for trial in trials]}).encode()


@dataclass(frozen=True)
class EvaluationTrials(JsonRecord):
    """What an evaluation worker reports to `dr-evaluate`.

    Attributes:
        racers: The trials of each racer.
        notes: Sentences about what was driven otherwise than asked.
    """

    racers: list[list[TrialMetrics]]
    notes: list[str]
