"""What a training has come to, from its curve, scores and evaluations."""

import json
import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

from drcli.base.json_record import RecordError
from drcli.base.problems import ProblemsError
from drcli.config.settings import catalogue
from drcli.exchange.checkpoint import CheckpointName
from drcli.exchange.episode_metrics import is_clean
from drcli.exchange.frozen_curriculum import FrozenCurriculum
from drcli.exchange.iteration import IterationRecord
from drcli.exchange.race_recording import RaceRecording
from drcli.exchange.scores import Scores
from drcli.exchange.training_record import RecordedStart, TrainingRecord, TrainingResults
from drcli.modelfiles.curriculum_file import CurriculumFile
from drcli.store import keys
from drcli.store.bucket import ObjectInfo, ObjectMissing
from drcli.store.history import HistoryReader
from drcli.store.repair import Model, readable_history, readable_scores
from drcli.store.training_records import at_once

_EVALUATION = re.compile(r"evaluation-\d{14}\.json")

MOST_EVALUATIONS = 100
DR_WORLD_NAME = "DR_WORLD_NAME"

STAMP_DIGITS = 14


def read_results(
    model: Model, record: TrainingRecord, reader: HistoryReader | None = None
) -> TrainingResults:
    """Skips evaluations in the record; raises StorageError."""
    history, _ = readable_history(model, reader)
    scores, _ = readable_scores(model)
    folder = keys.evaluation_metrics_folder(model.metrics_prefix)
    evaluations = evaluations_by_folder(model.bucket.list(folder)).get(folder, [])
    known = record.results
    results = replace(
        results_of(history, scores, on_track(record, history, _worlds_of_stages(model, record))),
        evaluations=known.evaluations,
        trials=known.trials,
        best_trial_lap_s=known.best_trial_lap_s,
        clean_trial_lap_s=known.clean_trial_lap_s,
    )
    if any(DR_WORLD_NAME in own for own in record.newest.worker_settings):
        results = replace(results, best_training_lap_s=None)  # driven on several tracks
    return with_evaluations(results, model, evaluations)


def results_of(
    history: Sequence[IterationRecord],
    scores: Scores | None,
    comparable: Collection[int],
) -> TrainingResults:
    """Without stand-alone evaluations; `comparable` iterations drove its track."""
    last = history[-1] if history else None
    on_it = [record for record in history if record.iteration in comparable]
    driven = [record.best_lap_s for record in on_it if record.best_lap_s is not None]
    progress = [
        sum(record.evaluation_progress) / len(record.evaluation_progress)
        for record in on_it
        if record.evaluation_progress
    ]
    sampled = [laps for record in on_it if (laps := record.all_laps) is not None]
    fastest = [laps.fastest_s for laps in sampled if laps.fastest_s is not None]
    return TrainingResults(
        iterations=len(history),
        episodes=sum(record.episodes for record in history),
        steps=0 if last is None else last.total_steps,
        elapsed_s=0.0 if last is None else last.elapsed_s,
        mean_reward=None if last is None else last.mean_reward,
        mean_progress=None if last is None else last.mean_progress,
        full_laps=sum(record.full_laps for record in history),
        evaluated_laps=sum(laps.clean for r in history if (laps := r.all_laps) is not None),
        best_lap_s=min(fastest, default=None),
        best_training_lap_s=min(driven, default=None),
        best_progress=max(progress, default=None),
        best_checkpoint=None if scores is None else scores.best_checkpoint.name,
        best_score=None if scores is None else scores.best_checkpoint.avg_eval_metric,
        last_checkpoint=None if scores is None else scores.last_checkpoint.name,
    )


def on_track(
    record: TrainingRecord,
    history: Sequence[IterationRecord],
    worlds_of_stages: Mapping[str, str] | None = None,
) -> set[int]:
    """Iterations on the track of the record.

    A training may be resumed on another, and stages have their own.
    """
    starts = record.starts
    worlds = [_world(start) or record.world for start in starts]
    if not record.world or set(worlds) <= {record.world}:
        begins: list[tuple[int, str]] = [(0, record.world)]
    else:
        begins = [
            (0 if name is None else name.number, world)
            for name, world in zip(map(_resumed, starts), worlds, strict=True)
        ]
        if any(start.resumes is None for start in starts[1:]):
            begins = [(0, "")]  # nobody recorded where the other track began
    found = set()
    for each in history:
        world = next((world for first, world in reversed(begins) if each.iteration >= first), "")
        if each.world:
            world = each.world
        elif each.stage:
            world = (worlds_of_stages or {}).get(each.stage, "")
        if world == record.world or not record.world:
            found.add(each.iteration)
    return found


def _resumed(start: RecordedStart) -> CheckpointName | None:
    return None if start.resumes is None else CheckpointName.parse(start.resumes)


def _world(start: RecordedStart) -> str | None:
    """It is recorded only if not the default."""
    if start.settings is None:
        return None
    return str(start.settings.get(DR_WORLD_NAME, catalogue()[DR_WORLD_NAME].default))


def _worlds_of_stages(model: Model, record: TrainingRecord) -> dict[str, str]:
    if not record.stages:
        return {}
    with suppress(ObjectMissing, RecordError, ProblemsError):
        frozen = FrozenCurriculum.decode(model.bucket.get(keys.curriculum(model.prefix)))
        file = CurriculumFile.from_bytes(frozen.text.encode(), frozen.name)
        return {stage.name: stage.world or record.world for stage in file.stages}
    return {}


def evaluations_by_folder(listed: Iterable[ObjectInfo]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for info in listed:
        folder, slash, name = info.key.rpartition("/")
        if _EVALUATION.fullmatch(name):
            found.setdefault(folder + slash, []).append(info.key)
    return {folder: sorted(evaluations) for folder, evaluations in found.items()}


def with_evaluations(
    results: TrainingResults, model: Model, evaluations: Sequence[str]
) -> TrainingResults:
    """Leaves out what cannot be read: nothing else depends on it."""
    fresh = list(evaluations[results.read_evaluations :])[-MOST_EVALUATIONS:]
    read = at_once(lambda key: _trials(model, key), fresh)
    known = results
    if known.clean_trial_lap_s is None:  # counted by an earlier version, and now again
        known = replace(known, trials=0, best_trial_lap_s=None)
    laps = [lap_s for each in read for lap_s in each.lap_s]
    if known.best_trial_lap_s is not None:
        laps.append(known.best_trial_lap_s)
    clean = dict(known.clean_trial_lap_s or {})
    for each in read:
        if each.clean_lap_s is not None:
            clean[each.world] = min(each.clean_lap_s, clean.get(each.world, math.inf))
    return replace(
        results,
        evaluations=max(results.evaluations, len(evaluations)),
        trials=max(results.trials, known.trials + sum(each.trials for each in read)),
        best_trial_lap_s=min(laps, default=results.best_trial_lap_s),
        clean_trial_lap_s=clean,
    )


@dataclass(frozen=True)
class _Trials:
    trials: int = 0
    lap_s: Sequence[float] = ()
    clean_lap_s: float | None = None
    world: str = ""


def _trials(model: Model, key: str) -> _Trials:
    with suppress(ObjectMissing, ValueError):
        file: Any = json.loads(model.bucket.get(key))
        metrics = file.get("metrics") if isinstance(file, dict) else None
        trials = [trial for trial in metrics or [] if isinstance(trial, dict)]
        finished = [(trial, lap_s) for trial in trials if (lap_s := _lap_s(trial)) is not None]
        clean = min((s for trial, s in finished if is_clean(trial, finished=True)), default=None)
        world = "" if clean is None else _world_of(model, key)
        return _Trials(len(trials), [lap_s for _, lap_s in finished], clean, world)
    return _Trials()


def _world_of(model: Model, key: str) -> str:
    stamp = key.removesuffix(".json")[-STAMP_DIGITS:]
    with suppress(ObjectMissing, RecordError):
        trace = keys.evaluation_trace(model.prefix, stamp)
        return RaceRecording.decode(model.bucket.get(keys.recording_of(trace))).world
    return ""


def _lap_s(trial: dict[str, Any]) -> float | None:
    elapsed = trial.get("elapsed_time_in_milliseconds")
    if trial.get("episode_status") != "Lap complete" or not isinstance(elapsed, int | float):
        return None
    return float(elapsed) / 1000.0 if elapsed > 0 else None
