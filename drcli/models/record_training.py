"""Makes the record of a training, from its start or its model."""

import hashlib
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any

from drcli.base.json_record import RecordError
from drcli.config.setting_problems import hidden
from drcli.config.settings import Settings, catalogue
from drcli.exchange.run_outcome import RunOutcome
from drcli.exchange.training_record import (
    MOST_STARTS,
    RecordedStart,
    TrainingRecord,
)
from drcli.exchange.training_start import TrainingStart
from drcli.models.recorded_files import described_by, files_of, fingerprint, of_parameter_file
from drcli.models.run_metadata import read_start
from drcli.models.training_end import known_outcome, with_end
from drcli.models.training_results import read_results
from drcli.models.training_spending import read_spending, with_spending
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing, ObjectNewer
from drcli.store.history import HistoryReader
from drcli.store.repair import Model
from drcli.store.training_records import (
    add_files,
    read_training,
    read_trainings,
    write_training,
)

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
    inputs: Mapping[str, str] = field(default_factory=dict)


def training_id(prefix: str, start: TrainingStart | None) -> str:
    """A copy of a model has another one."""
    if start is not None and start.training and origin_of(prefix, start) == prefix:
        return start.training
    first = "" if start is None else start.training or (start.earlier or [start])[0].started_at
    return hashlib.sha256(f"{prefix}\n{first}".encode()).hexdigest()[:8]


def origin_of(prefix: str, start: TrainingStart) -> str:
    """Another model if this one is a copy."""
    return str(_setting(start.settings, _PREFIX) or prefix)


def record_start(bucket: Bucket, new: NewStart, known: TrainingRecord | None) -> TrainingRecord:
    """Once the files are in place; StorageError if refused."""
    settings, prefix = new.settings, new.settings.model_prefix
    texts = files_of(bucket, prefix)
    texts |= {name: text for name, text in new.inputs.items() if name in texts}
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
        new.start.training, prefix, began_at=new.outcome.began_at or new.outcome.started_at
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
        record = replace(record, parent_training=_parent_training(bucket, record))
    add_files(bucket, prefix, record.id, {fingerprint(text): text for text in texts.values()})
    write_training(bucket, record)
    return record


def known_training(bucket: Bucket, model: Model, start: TrainingStart | None) -> TrainingRecord:
    """The record, worked out if none can be read."""
    with suppress(ObjectDamaged, ObjectNewer):
        found = read_training(bucket, model.prefix, training_id(model.prefix, start))
        if found is not None:
            return found
    return derived_training(model, start)


def derived_training(model: Model, start: TrainingStart | None = None) -> TrainingRecord:
    """What a model's objects say; raises StorageError."""
    bucket, prefix = model.bucket, model.prefix
    if start is None:
        with suppress(ObjectDamaged, ObjectNewer):
            start = read_start(bucket, prefix)
    outcome = known_outcome(bucket, prefix)
    texts = files_of(bucket, prefix)
    settings = None if start is None else start.settings
    starts = tuple(_start_of(each) for each in _all_starts(start))
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
        record = replace(record, **of_parameter_file(bucket, prefix))
    record = replace(record, results=read_results(model_of(record, bucket, model), record))
    return with_spending(with_end(record, outcome), read_spending(bucket, prefix))


def with_results(
    record: TrainingRecord, model: Model, reader: HistoryReader | None = None
) -> TrainingRecord:
    results = read_results(model_of(record, model.bucket, model), record, reader)
    return replace(record, results=results, updated_at=time.time())


def model_of(record: TrainingRecord, bucket: Bucket, model: Model | None = None) -> Model:
    prefix = record.prefix
    model = model or Model(bucket, prefix, keys.metrics_prefix(prefix), record.metric or "progress")
    metrics = (record.newest.settings or {}).get(_METRICS_PREFIX)
    if isinstance(metrics, str) and keys.is_valid_prefix(metrics):
        return replace(model, metrics_prefix=metrics)
    return model


def settle(model: Model, *, gone: bool) -> None:
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
        texts = files_of(bucket, prefix).values()
        add_files(bucket, prefix, own.id, {fingerprint(text): text for text in texts})
    now = time.time()
    for record in [*(each for each in left if each is not own), *([own] if own else [])]:
        done = record
        if record is own:
            done = with_end(with_results(record, model), known_outcome(bucket, prefix))
            done = with_spending(done, read_spending(bucket, prefix))
        write_training(bucket, replace(done, gone_at=now if gone else None, updated_at=now))


def _few(starts: tuple[RecordedStart, ...]) -> tuple[RecordedStart, ...]:
    if len(starts) <= MOST_STARTS:
        return starts
    return (starts[0], *starts[1 - MOST_STARTS :])


def _all_starts(start: TrainingStart | None) -> list[TrainingStart]:
    return [] if start is None else [*start.earlier, start]


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
        start = read_start(bucket, prefix)
        if start is not None:
            return training_id(prefix, start)
    return ""
