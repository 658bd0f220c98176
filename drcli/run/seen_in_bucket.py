"""What the bucket alone tells about a run elsewhere."""

import math
from dataclasses import dataclass, field

from drcli.base.errors import StorageError
from drcli.base.json_record import RecordError
from drcli.bucket.bucket import Bucket, ObjectMissing
from drcli.bucket.connect import open_running_bucket
from drcli.config.run_config import RunConfig
from drcli.config.settings import Settings
from drcli.model import keys
from drcli.model.lease import live_holder
from drcli.model.model_store import ModelStore
from drcli.model.training_state import read_outcome
from drcli.records.run_record import ActivityRecord, RunRecord, run_folder
from drcli.records.trace import TraceRow, read_rows

MOST_LINES = 24
MOST_POINTS = 160


@dataclass(frozen=True)
class SeenRun:
    model: ModelStore | None
    prefix: str
    world: str
    alive: bool


def seen_run(settings: Settings, run_id: int) -> SeenRun:
    """A run that was started here; otherwise the model of the settings.

    Raises:
        StorageError: The bucket cannot be opened.
    """
    record = RunRecord.read(run_folder(settings.directory, run_id))
    storage = settings.storage
    if record is not None:
        storage = record.storage_at_start(storage, settings.directory)
    prefix = settings.model_prefix if record is None else record.prefix
    bucket = open_running_bucket(storage)
    model = None if bucket is None else ModelStore.of(settings.model, bucket, prefix)
    world = settings.world_name if record is None else record.world
    return SeenRun(model, prefix, world, record is not None and record.alive)


def ended_elsewhere(config: RunConfig, bucket: Bucket) -> RunRecord | None:
    """None if it has not; StorageError if the record is damaged."""
    outcome = read_outcome(ModelStore(bucket, config.model.prefix))
    if outcome is None or not outcome.ended:
        return None
    return RunRecord(
        run_id=config.run_id,
        session=outcome.session,
        bucket=bucket.name,
        prefix=config.model.prefix,
        world=config.race().world_name,
        state=outcome.state,
        pid=0,
        pid_started=0.0,
        started_at=outcome.started_at,
        ended_at=outcome.ended_at,
        exit_code=outcome.code,
        message=f"On {outcome.host}: {outcome.message}" if outcome.host else outcome.message,
        remedy=outcome.remedy,
    )


def trained_by(store: ModelStore) -> str:
    """A sentence that says who trains a model now; empty if nobody does."""
    held = live_holder(store)
    if held is None:
        return ""
    model = store.url
    return f"{model} is being trained by {held.owner}, last heard from {held.age_s:.0f} s ago."


def trained_elsewhere(config: RunConfig) -> str:
    """As `trained_by`, of the model of the settings; empty if the bucket does not answer."""
    try:
        bucket = open_running_bucket(config.storage)
        return "" if bucket is None else trained_by(ModelStore(bucket, config.model.prefix))
    except StorageError:
        return ""


@dataclass(frozen=True)
class DistantWorker:
    name: str
    activity: str
    since: float
    host: str


@dataclass(frozen=True)
class DistantRun:
    prefix: str
    world: str
    host: str | None = None
    heard_s: float | None = None
    session: str = ""
    started_at: float = 0.0
    workers: list[DistantWorker] = field(default_factory=list)


def distant_run(run: SeenRun) -> DistantRun:
    nobody = DistantRun(run.prefix, run.world)
    if run.alive or run.model is None:
        return nobody
    bucket = run.model.bucket
    held = live_holder(ModelStore(bucket, run.prefix))
    if held is None:
        return nobody
    workers = []
    folder = keys.status_folder(run.prefix)
    for info in bucket.list(folder):
        name = info.key.removeprefix(folder).removesuffix(".json")
        try:
            does = ActivityRecord.decode(bucket.get(info.key))
        except (ObjectMissing, RecordError):
            continue  # just replaced, or damaged: the next look finds it
        workers.append(DistantWorker(name, does.activity, does.since, does.host))
    workers.sort(key=lambda worker: (worker.name != "trainer", len(worker.name), worker.name))
    outcome = read_outcome(run.model)
    begun = outcome is not None and outcome.session == held.session
    return DistantRun(
        run.prefix,
        run.world,
        held.host,
        max(0.0, held.age_s),
        held.session,
        outcome.started_at if outcome is not None and begun else 0.0,
        workers,
    )


@dataclass(frozen=True)
class LapLine:
    """Metres, rounded to centimetres."""

    x: list[float]
    y: list[float]
    progress: float
    status: str


def read_lap_lines(model: ModelStore, iteration: int, worker: int) -> list[LapLine]:
    for key in keys.training_traces(model.prefix, iteration, worker):
        try:
            return lap_lines(model.bucket.get(key))
        except ObjectMissing:
            continue
    return []


def lap_lines(data: bytes) -> list[LapLine]:
    episodes: dict[int, list[TraceRow]] = {}
    for row in read_rows(data).rows:
        if math.isfinite(row.x + row.y + row.progress):
            episodes.setdefault(row.episode, []).append(row)
    return [_line(rows) for rows in list(episodes.values())[-MOST_LINES:] if len(rows) > 1]


def _line(rows: list[TraceRow]) -> LapLine:
    every = max(1, math.ceil(len(rows) / MOST_POINTS))
    kept = rows[::every] + ([rows[-1]] if (len(rows) - 1) % every else [])
    return LapLine(
        [round(row.x, 2) for row in kept],
        [round(row.y, 2) for row in kept],
        rows[-1].progress,
        rows[-1].status,
    )
