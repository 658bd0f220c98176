"""What a training has come to, from its learning curve, its scores and its evaluations."""

import json
import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

from drcli.exchange.iteration import IterationRecord
from drcli.exchange.scores import Scores
from drcli.exchange.training_record import TrainingResults
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectInfo, ObjectMissing
from drcli.store.history import HistoryReader
from drcli.store.repair import Model, readable_history, readable_scores
from drcli.store.training_records import at_once

_EVALUATION = re.compile(r"evaluation-\d{14}\.json")

MOST_EVALUATIONS = 100
"""Newest stand-alone evaluations that are read at a time."""

NOTHING_YET = TrainingResults()


def read_results(
    model: Model,
    reader: HistoryReader | None = None,
    known: TrainingResults = NOTHING_YET,
) -> TrainingResults:
    """What a training has come to; damaged objects are reconstructed as far as possible.

    Evaluations that are `known` are not read again.

    Raises:
        StorageError: The bucket does not answer.
    """
    history, _ = readable_history(model, reader)
    scores, _ = readable_scores(model)
    folder = keys.evaluation_metrics_folder(model.metrics_prefix)
    evaluations = evaluations_by_folder(model.bucket.list(folder)).get(folder, [])
    results = replace(
        results_of(history, scores),
        evaluations=known.evaluations,
        trials=known.trials,
        best_trial_lap_s=known.best_trial_lap_s,
    )
    return with_evaluations(results, model.bucket, evaluations)


def results_of(history: Sequence[IterationRecord], scores: Scores | None) -> TrainingResults:
    """The results, without stand-alone evaluations.

    Args:
        history: All iterations, oldest first.
        scores: Of the best and the newest checkpoint; None if unknown.
    """
    last = history[-1] if history else None
    evaluated = [lap for record in history for lap in record.evaluation_lap_s]
    driven = [record.best_lap_s for record in history if record.best_lap_s is not None]
    progress = [
        sum(record.evaluation_progress) / len(record.evaluation_progress)
        for record in history
        if record.evaluation_progress
    ]
    return TrainingResults(
        iterations=len(history),
        episodes=sum(record.episodes for record in history),
        steps=0 if last is None else last.total_steps,
        elapsed_s=0.0 if last is None else last.elapsed_s,
        mean_reward=None if last is None else last.mean_reward,
        mean_progress=None if last is None else last.mean_progress,
        full_laps=sum(record.full_laps for record in history),
        evaluated_laps=len(evaluated),
        best_lap_s=min(evaluated, default=None),
        best_training_lap_s=min(driven, default=None),
        best_progress=max(progress, default=None),
        best_checkpoint=None if scores is None else scores.best_checkpoint.name,
        best_score=None if scores is None else scores.best_checkpoint.avg_eval_metric,
        last_checkpoint=None if scores is None else scores.last_checkpoint.name,
    )


def evaluations_by_folder(listed: Iterable[ObjectInfo]) -> dict[str, list[str]]:
    """Keys of the stand-alone evaluations in a listing by their folder, oldest first."""
    found: dict[str, list[str]] = {}
    for info in listed:
        folder, slash, name = info.key.rpartition("/")
        if _EVALUATION.fullmatch(name):
            found.setdefault(folder + slash, []).append(info.key)
    return {folder: sorted(evaluations) for folder, evaluations in found.items()}


def with_evaluations(
    results: TrainingResults, bucket: Bucket, evaluations: Sequence[str]
) -> TrainingResults:
    """The results with those evaluations that they do not have yet.

    What cannot be read is left out: nothing but these numbers depends on it.
    """
    fresh = list(evaluations[results.evaluations :])[-MOST_EVALUATIONS:]
    read = at_once(lambda key: _trials(bucket, key), fresh)
    laps = [lap for trials in read for lap in trials if lap is not None]
    if results.best_trial_lap_s is not None:
        laps.append(results.best_trial_lap_s)
    return replace(
        results,
        evaluations=max(results.evaluations, len(evaluations)),
        trials=results.trials + sum(map(len, read)),
        best_trial_lap_s=min(laps, default=None),
    )


def _trials(bucket: Bucket, key: str) -> list[float | None]:
    with suppress(ObjectMissing, ValueError):
        file: Any = json.loads(bucket.get(key))
        metrics = file.get("metrics") if isinstance(file, dict) else None
        return [_lap_s(trial) for trial in metrics or [] if isinstance(trial, dict)]
    return []


def _lap_s(trial: dict[str, Any]) -> float | None:
    elapsed = trial.get("elapsed_time_in_milliseconds")
    if trial.get("episode_status") != "Lap complete" or not isinstance(elapsed, int | float):
        return None
    return float(elapsed) / 1000.0 if elapsed > 0 else None
