"""Makes the record of a training, from its start or its model."""

import hashlib
import json
import math
import re
import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

import yaml

from drcli.base.errors import DrError, ProblemsError
from drcli.base.json_record import RecordError
from drcli.bucket.bucket import Bucket, ObjectDamaged, ObjectInfo, ObjectMissing, ObjectNewer
from drcli.config.fields import hidden
from drcli.config.settings import Settings, catalogue
from drcli.model import keys
from drcli.model.files.curriculum_file import CurriculumFile
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.history import HistoryReader
from drcli.model.model_store import ModelStore
from drcli.model.reconstruct import readable_history, readable_scores
from drcli.model.run_metadata import read_start
from drcli.model.training_records import (
    add_files,
    at_once,
    known_outcome,
    read_files,
    read_spending,
    read_training,
    read_trainings,
    with_end,
    with_spending,
    write_training,
)
from drcli.records.checkpoint import CheckpointName
from drcli.records.episode_metrics import is_clean
from drcli.records.evaluation_task import RaceRecording
from drcli.records.iteration import IterationRecord
from drcli.records.scores import Scores
from drcli.records.stage import FrozenCurriculum
from drcli.records.training_record import (
    MOST_STARTS,
    RecordedStart,
    RunOutcome,
    TrainingRecord,
    TrainingResults,
    TrainingStart,
)

# The files of a training in its record, and what they say.


CURRICULUM_FILE = "curriculum.json"


def fingerprint(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def texts_of(bucket: Bucket, record: TrainingRecord) -> dict[str, str | None]:
    model = ModelStore(bucket, record.prefix)
    kept = dict(read_files(model, record.id))
    if record.derived:
        kept = {fingerprint(text): text for text in files_of(model).values()}
    return {name: kept.get(sha256) for name, sha256 in record.newest.files.items()}


def files_of(model: ModelStore, known: Mapping[str, str] = {}) -> dict[str, str]:
    """What is `known` is not read."""
    places = {
        keys.REWARD_FUNCTION_FILE: keys.reward_function(model.prefix),
        keys.HYPERPARAMETERS_FILE: keys.hyperparameters(model.prefix),
        keys.MODEL_METADATA_FILE: keys.model_metadata(model.prefix),
        CURRICULUM_FILE: keys.curriculum(model.prefix),
    }
    found = {}
    for name, key in places.items():
        with suppress(ObjectMissing):
            text = known.get(name)
            found[name] = text or model.bucket.get(key).decode("utf-8-sig", "replace")
    return found


def described_by(texts: Mapping[str, str]) -> dict[str, Any]:
    """Damaged files determine no fields."""
    # Imported here: they load pydantic, which a list of trainings does without.

    found: dict[str, Any] = {}
    with suppress(DrError, KeyError):
        metadata = ModelMetadata.from_bytes(texts[keys.MODEL_METADATA_FILE].encode())
        actions = metadata.action_space
        kind = metadata.action_space_type
        found |= {
            "algorithm": metadata.training_algorithm,
            "action_space": kind if actions.continuous else f"{kind}, {len(actions.values)}",
            "network": metadata.neural_network,
            "sensors": metadata.sensor,
        }
    with suppress(DrError, KeyError, ValueError):
        text = texts[keys.HYPERPARAMETERS_FILE]
        Hyperparameters.from_bytes(text.encode())
        found["hyperparameters"] = json.loads(text)
    with suppress(KeyError, ValueError, TypeError, AttributeError):
        frozen = json.loads(texts[CURRICULUM_FILE])
        found["stages"] = _count_stages(frozen["text"])
    return found


def _count_stages(text: str) -> int:
    with suppress(yaml.YAMLError):
        read = yaml.safe_load(text)
        stages = read.get("stages") if isinstance(read, dict) else read
        return len(stages) if isinstance(stages, list) else 1
    return 1


def of_parameter_file(model: ModelStore) -> dict[str, Any]:
    """World and race of a model of another program, or our first version."""
    for name in ("training_params.yaml", "training_params_1.yaml"):
        with suppress(ObjectMissing, yaml.YAMLError, UnicodeDecodeError):
            read = yaml.safe_load(
                model.bucket.get(keys.parameter_file(model.prefix, name)).decode()
            )
            if isinstance(read, dict) and isinstance(read.get("WORLD_NAME"), str):
                return {
                    "world": read["WORLD_NAME"],
                    "race_type": str(read.get("RACE_TYPE", "")),
                }
    return {}


# What a training has come to, from its curve, scores and evaluations.


_EVALUATION = re.compile(r"evaluation-\d{14}\.json")

MOST_EVALUATIONS = 100
DR_WORLD_NAME = "DR_WORLD_NAME"

STAMP_DIGITS = 14


def read_results(
    model: ModelStore, record: TrainingRecord, reader: HistoryReader | None = None
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
            for start, world in zip(starts, worlds, strict=True)
            for name in [CheckpointName.parse(start.resumes or "")]
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


def _world(start: RecordedStart) -> str | None:
    """It is recorded only if not the default."""
    if start.settings is None:
        return None
    return str(start.settings.get(DR_WORLD_NAME, catalogue()[DR_WORLD_NAME].default))


def _worlds_of_stages(model: ModelStore, record: TrainingRecord) -> dict[str, str]:
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
    results: TrainingResults, model: ModelStore, evaluations: Sequence[str]
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


def _trials(model: ModelStore, key: str) -> _Trials:
    with suppress(ObjectMissing, ValueError):
        file: Any = json.loads(model.bucket.get(key))
        metrics = file.get("metrics") if isinstance(file, dict) else None
        trials = [trial for trial in metrics or [] if isinstance(trial, dict)]
        finished = [(trial, lap_s) for trial in trials if (lap_s := _lap_s(trial)) is not None]
        clean = min((s for trial, s in finished if is_clean(trial, finished=True)), default=None)
        world = "" if clean is None else _world_of(model, key)
        return _Trials(len(trials), [lap_s for _, lap_s in finished], clean, world)
    return _Trials()


def _world_of(model: ModelStore, key: str) -> str:
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


_DEFAULT = {"world": "DR_WORLD_NAME", "race_type": "DR_RACE_TYPE", "workers": "DR_WORKERS"}
_PREFIX = "DR_LOCAL_S3_MODEL_PREFIX"
_METRIC = "DR_TRAIN_BEST_MODEL_METRIC"
_METRICS_PREFIX = "DR_LOCAL_S3_METRICS_PREFIX"


@dataclass(frozen=True)
class NewStart:
    settings: Settings
    start: TrainingStart
    outcome: RunOutcome
    resumes: str | None
    previous: RunOutcome | None
    inputs: Mapping[str, str]


def training_id(prefix: str, start: TrainingStart | None) -> str:
    """A copy of a model has another one."""
    if start is not None and start.training and origin_of(prefix, start) == prefix:
        return start.training
    first = "" if start is None else start.training or (start.earlier or [start])[0].started_at
    return hashlib.sha256(f"{prefix}\n{first}".encode()).hexdigest()[:8]


def origin_of(prefix: str, start: TrainingStart) -> str:
    """Another model if this one is a copy."""
    return str(_setting(start.settings, _PREFIX) or prefix)


def record_start(model: ModelStore, new: NewStart, known: TrainingRecord | None) -> TrainingRecord:
    """Once the files are in place; StorageError if refused."""
    settings = new.settings
    texts = files_of(model, new.inputs)
    own = RecordedStart(
        session=new.outcome.session,
        host=new.outcome.host,
        started_at=new.outcome.started_at,
        state="running",
        resumes=new.resumes,
        seed=new.start.seed,
        settings=new.start.settings,
        worker_settings=_worker_settings(settings),
        versions=new.start.versions,
        git=new.start.git,
        machine=new.start.machine,
        files={name: fingerprint(text) for name, text in texts.items()},
    )
    record = known or TrainingRecord(
        new.start.training, model.prefix, began_at=new.outcome.began_at or new.outcome.started_at
    )
    record = with_end(record, new.previous)
    record = replace(
        record,
        state="running",
        message="",
        ended_at=None,
        starts=_few((*record.starts, own)),
        number_of_starts=record.number_of_starts + 1,
        world=settings.world_name,
        race_type=settings.race_type,
        workers=settings.workers,
        metric=settings.train_best_model_metric,
        description=settings.model_description or record.description,
        derived=False,
        gone_at=None,
        updated_at=time.time(),
        **described_by(texts),
    )
    if new.resumes is None and new.start.pretrained is not None:
        record = replace(record, parent=new.start.pretrained)
        record = replace(record, parent_training=_parent_training(model.bucket, record))
    add_files(model, record.id, {fingerprint(text): text for text in texts.values()})
    write_training(model.bucket, record)
    return record


def known_training(model: ModelStore, start: TrainingStart | None) -> TrainingRecord:
    """The record, worked out if none can be read."""
    with suppress(ObjectDamaged, ObjectNewer):
        found = read_training(model, training_id(model.prefix, start))
        if found is not None:
            return found
    return derived_training(model, start)


def derived_training(model: ModelStore, start: TrainingStart | None = None) -> TrainingRecord:
    """What a model's objects say; raises StorageError."""
    prefix = model.prefix
    if start is None:
        with suppress(ObjectDamaged, ObjectNewer):
            start = read_start(model)
    outcome = known_outcome(model)
    texts = files_of(model)
    settings = None if start is None else start.settings
    known = [] if start is None else [*start.earlier, start]
    starts = tuple(map(_start_of, known))
    if starts:
        files = {name: fingerprint(text) for name, text in texts.items()}
        starts = (*starts[:-1], replace(starts[-1], files=files))
    record = TrainingRecord(
        training_id(prefix, start),
        prefix,
        began_at=starts[0].started_at if starts else (outcome.began_at if outcome else 0.0),
        starts=_few(starts),
        number_of_starts=len(starts),
        parent=None if start is None else start.pretrained,
        metric=_setting(settings, _METRIC) or "",
        derived=True,
        **described_by(texts),
        **{
            field: _setting(settings, name)
            for field, name in _DEFAULT.items()
            if settings is not None
        },
    )
    if not record.world:
        record = replace(record, **of_parameter_file(model))
    record = replace(record, results=read_results(model_of(record, model.bucket, model), record))
    return with_spending(with_end(record, outcome), read_spending(model))


def with_results(
    record: TrainingRecord, model: ModelStore, reader: HistoryReader | None = None
) -> TrainingRecord:
    results = read_results(model_of(record, model.bucket, model), record, reader)
    return replace(record, results=results, updated_at=time.time())


def model_of(record: TrainingRecord, bucket: Bucket, model: ModelStore | None = None) -> ModelStore:
    prefix = record.prefix
    model = model or ModelStore(
        bucket, prefix, keys.metrics_prefix(prefix), record.metric or "progress"
    )
    metrics = (record.newest.settings or {}).get(_METRICS_PREFIX)
    if isinstance(metrics, str) and keys.is_valid_prefix(metrics):
        return replace(model, metrics_prefix=metrics)
    return model


def settle(model: ModelStore, *, gone: bool) -> None:
    """Complete or make the record of an untrained model, before it is `gone`.

    Raises:
        StorageError: The bucket does not answer or refuses it.
    """
    bucket, prefix = model.bucket, model.prefix
    start = None
    with suppress(ObjectMissing, RecordError):  # nobody writes it now: once is enough
        start = TrainingStart.decode(bucket.get(keys.training_start(prefix)))
    records, _ = read_trainings(bucket, prefix)
    left = [record for record in records if record.gone_at is None]
    if start is None and not left:
        return  # an import, or a copy: nothing was trained here
    current = training_id(prefix, start)
    own = next((record for record in left if record.id == current), None)
    if own is None and start is not None:
        own = derived_training(model, start)
        texts = files_of(model).values()
        add_files(model, own.id, {fingerprint(text): text for text in texts})
    now = time.time()
    for record in [*(each for each in left if each is not own), *([own] if own else [])]:
        done = record
        if record is own:
            done = with_end(with_results(record, model), known_outcome(model))
            done = with_spending(done, read_spending(model))
        write_training(bucket, replace(done, gone_at=now if gone else None, updated_at=now))


def _few(starts: tuple[RecordedStart, ...]) -> tuple[RecordedStart, ...]:
    if len(starts) <= MOST_STARTS:
        return starts
    return (starts[0], *starts[1 - MOST_STARTS :])


def _start_of(start: TrainingStart) -> RecordedStart:
    started_at = 0.0
    with suppress(ValueError, OverflowError):
        started_at = datetime.fromisoformat(start.started_at).timestamp()
    return RecordedStart(
        started_at=started_at,
        seed=start.seed,
        settings=start.settings,
        versions=start.versions,
        git=start.git,
        machine=start.machine,
    )


def _setting(settings: Mapping[str, Any] | None, name: str) -> Any:
    """A start records only what differs from defaults."""
    return None if settings is None else settings.get(name, catalogue()[name].default)


def _worker_settings(settings: Settings) -> list[dict[str, Any]]:
    found = []
    for worker, override in enumerate(settings.overrides, start=1):
        own, known = settings.for_worker(worker), catalogue()
        texts = {
            name: known[name].text(getattr(own, known[name].field))
            for name in override.sources
            if name in known
        }
        found.append({name: hidden(name, text) for name, text in texts.items()})
    return found


def _parent_training(bucket: Bucket, record: TrainingRecord) -> str:
    assert record.parent is not None
    prefix = record.parent.prefix
    with suppress(ObjectDamaged, ObjectNewer):
        start = read_start(ModelStore(bucket, prefix))
        if start is not None:
            return training_id(prefix, start)
    return ""
