"""Metrics of one stand-alone evaluation: a record for each trial, as analysis tools read them."""

import json
from collections.abc import Sequence
from dataclasses import dataclass

from drcli.base.json_record import JsonRecord, Misfit, parsed
from drcli.exchange.trace import STATUS_LABELS, Episode
from drcli.exchange.training_metrics import completion_percentage

REPORT_FILE = "evaluation.json"
"""In the folder of an evaluation: what the evaluator tells `dr-evaluate`."""


@dataclass(frozen=True)
class TrialMetrics(JsonRecord):
    """One trial, or one lap of a continuous race. Times are milliseconds of the simulation clock.

    The counts are violations, and `reset_count` says how many of them put the car back.
    """

    completion_percentage: int
    metric_time: int
    start_time: int
    elapsed_time_in_milliseconds: int
    episode_status: str
    crash_count: int
    immobilized_count: int
    off_track_count: int
    reversed_count: int
    reset_count: int
    trial: int

    @staticmethod
    def of(episode: Episode) -> "TrialMetrics":
        """The record of a trial or lap."""
        start_ms = round((episode.clock_s + episode.begin_s) * 1000)
        elapsed_ms = round(episode.duration_s * 1000)
        completed = episode.progress >= 100.0
        status = [row.status for row in episode.rows]
        crashes, immobilized = status.count("crashed"), status.count("immobilized")
        off_track, reversed_ = status.count("off_track"), status.count("reversed")
        # The violation that ended a trial for good did not put the car back.
        ended_by_violation = episode.rows[-1].done and not completed
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
        )


def encode_metrics_file(trials: Sequence[TrialMetrics]) -> bytes:
    """The metrics file of one racer."""
    return json.dumps({"metrics": [trial.to_json() for trial in trials]}).encode()


def encode_report(racers: Sequence[Sequence[TrialMetrics]]) -> bytes:
    """The trials of each racer, for `dr-evaluate`."""
    return json.dumps([[trial.to_json() for trial in trials] for trials in racers]).encode()


def decode_report(data: bytes) -> list[list[TrialMetrics]]:
    """The trials of each racer.

    Raises:
        Misfit: The bytes are something else.
    """
    racers = parsed(data)
    if not isinstance(racers, list) or not all(isinstance(trials, list) for trials in racers):
        raise Misfit("it is not a list of trials for each racer")
    return [[TrialMetrics.from_json(trial) for trial in trials] for trials in racers]
