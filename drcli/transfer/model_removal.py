"""Deletes models with all their objects, logs, records and reports."""

import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from drcli.base import errors
from drcli.base.errors import SettingsError, StorageError
from drcli.base.report import Col, View, bold, counted, size_text, table
from drcli.bucket.bucket import Bucket, ObjectDamaged, ObjectNewer
from drcli.bucket.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.config.settings import Settings
from drcli.metrics.open_sinks import event_folder, tensorboard_folder
from drcli.model import keys, lease
from drcli.model.model_list import fits
from drcli.model.model_store import ModelStore
from drcli.model.run_metadata import read_start
from drcli.model.traces import ModelTraces, models_in, traces_of
from drcli.model.training_records import forget_training, trainings_of
from drcli.records.run_record import RunRecord, log_file, running_evaluations
from drcli.transfer.record_training import settle
from drcli.transfer.report_place import report_file, report_folder

BATCH = 500
"""Between two requests, the lock of the model is renewed."""

_METRICS = "DR_LOCAL_S3_METRICS_PREFIX"

_LOGGED = ("sim-0", "trainer", "reward-0")


@dataclass(frozen=True)
class RemovedModel:
    """A model that is or would be deleted."""

    prefix: Annotated[str, "Its name.", Col("model")]
    checkpoints: Annotated[int, "How many it has.", Col("ckpts")]
    objects: Annotated[
        int,
        "Its objects in the bucket: checkpoints, metrics, traces, logs, rollouts, records.",
        Col("objects"),
    ]
    size_bytes: Annotated[int, "Their size.", Col("size", size_text)]
    modified: Annotated[
        str,
        "When the newest of them was written, ISO 8601; empty without any.",
        Col("modified", lambda text: text[:10]),
    ]
    files: Annotated[
        list[str], "Its logs, event files, records and report on this machine, by path."
    ]
    files_bytes: Annotated[
        int, "Their size.", Col("local files", lambda size: size_text(size) if size else "-")
    ]
    warning: Annotated[str, "What speaks against it; empty if nothing does."] = ""


@dataclass(frozen=True)
class RemovalReport:
    """The result of `dr-delete-model`."""

    bucket: Annotated[str, "Name of the bucket."]
    models: Annotated[list[RemovedModel], "What was deleted."]
    dry_run: Annotated[bool, "Whether nothing was deleted."]
    size_bytes: Annotated[int, "Of all objects."]
    records: Annotated[
        int, "Records of trainings of these models; they stay unless `forgotten`."
    ] = 0
    forgotten: Annotated[bool, "Whether these records were deleted, too."] = False

    def view(self, *, planned: bool) -> View:
        size, what = size_text(self.size_bytes), counted(self.records, "record")
        if planned:
            also = (
                f"Also {what} in dr-history."
                if self.forgotten
                else f"{what} in dr-history will stay."
            )
            order = ("prefix", "checkpoints", "objects", "size_bytes", "files_bytes", "modified")
            return [
                bold(f"s3://{self.bucket}"),
                table(self.models, *order),
                f"{counted(len(self.models), 'model')}, {size} in the bucket.",
                self.records and also,
            ]
        files = sum(len(model.files) for model in self.models)
        local = f" and {counted(files, 'local file')}" if files else ""
        objects = counted(sum(model.objects for model in self.models), "object")
        return [
            f"Deleted {', '.join(model.prefix for model in self.models)}: {objects}, {size}{local}."
        ]


@dataclass(frozen=True)
class PlannedRemoval:
    report: RemovalReport
    traces: tuple[ModelTraces, ...]


def plan_removal(
    settings: Settings,
    names: Sequence[str],
    keep: Sequence[str] = (),
    *,
    dry_run: bool = False,
    forget: bool = False,
) -> PlannedRemoval:
    """Find what would go; `names` and `keep` may have `*` and `?`.

    Raises:
        SettingsError: A name fits no model, or a model is being trained or evaluated.
    """
    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    listed = bucket.list("")
    known = models_in(listed)
    chosen: dict[str, None] = {}
    for name in names:
        plain = name.rstrip("/")
        found = [prefix for prefix in sorted(known) if fits(prefix, plain)]
        if (
            not found
            and keys.is_valid_prefix(plain)
            and _has_remains(settings, ModelStore(bucket, plain))
        ):
            found = [plain]
        if not found:
            raise _no_model(bucket, plain, known)
        chosen |= dict.fromkeys(found)
    left = [prefix for prefix in chosen if not any(fits(prefix, each) for each in keep)]
    for prefix in left:
        refuse_busy(settings, ModelStore(bucket, prefix))
    traces = tuple(all_traces(settings, ModelStore(bucket, prefix)) for prefix in left)
    models = [described(settings, bucket.name, each) for each in traces]
    size = sum(model.size_bytes for model in models)
    recorded = [place[0] for info in listed if (place := keys.training_of(info.key)) is not None]
    records = sum(prefix in left for prefix in recorded)
    report = RemovalReport(bucket.name, models, dry_run, size, records, forget)
    return PlannedRemoval(report, traces)


def remove_models(planned: PlannedRemoval, settings: Settings) -> RemovalReport:
    """Delete the models, each with a lock that keeps a training from starting on it.

    Raises:
        SettingsError: Somebody has begun to train one; that one stays as it is.
        StorageError: The bucket does not answer; what is left does not look like a model.
    """
    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    for traces in planned.traces:
        if not planned.report.forgotten:
            _complete_record(settings, ModelStore(bucket, traces.prefix))
        remove_traces(settings, bucket, traces)
        if planned.report.forgotten:
            for training in trainings_of(ModelStore(bucket, traces.prefix)):
                forget_training(ModelStore(bucket, traces.prefix), training)
        for path in map(Path, local_files(settings, bucket.name, traces.prefix)):
            path.unlink(missing_ok=True)
        _remove_empty_folders(settings, traces.prefix)
    return planned.report


def _complete_record(settings: Settings, model: ModelStore) -> None:
    refuse_busy(settings, model)
    try:
        settle(ModelStore.of(settings.model, model.bucket, model.prefix), gone=True)
    except StorageError as error:
        errors.warn(f"The record of {model.prefix} could not be completed: {error}")


def remove_traces(settings: Settings, bucket: Bucket, traces: ModelTraces) -> None:
    session, prefix = secrets.token_hex(6), traces.prefix
    model = ModelStore(bucket, prefix)
    refuse_busy(settings, model)
    lease.take(model, session)
    found = all_traces(settings, model)
    bucket.delete(found.first)
    rest = [info.key for info in found.objects if info.key not in found.first]
    rest = [key for key in rest if key != keys.lease(prefix)]
    for start in range(0, len(rest), BATCH):
        lease.refuse_other_owner(model, session)
        if start:
            lease.take(model, session)
        bucket.delete(rest[start : start + BATCH])
    lease.refuse_other_owner(model, session)
    bucket.delete([keys.lease(prefix)])


def refuse_busy(settings: Settings, model: ModelStore) -> None:
    """Raise SettingsError if a model is trained anywhere, or evaluated here."""
    lease.refuse_other_owner(model)
    for record in running_evaluations(settings.directory):
        if record.bucket == model.bucket.name and model.prefix in (record.prefix, *record.others):
            raise SettingsError(
                f"{model.url} is being evaluated (process {record.pid}).",
                remedy="Wait for its end, or stop it with `dr-stop-evaluation`.",
            )


def all_traces(settings: Settings, model: ModelStore) -> ModelTraces:
    spared = [settings.custom_files_prefix]
    metrics = _metrics_prefix(settings, model)
    return traces_of(model, metrics_prefix=metrics, spared=spared)


def described(settings: Settings, bucket: str, traces: ModelTraces) -> RemovedModel:
    files = local_files(settings, bucket, traces.prefix)
    newest = max((info.modified for info in traces.objects), default=None)
    warnings = []
    if traces.prefix == settings.model_prefix:
        warnings.append("it is the model that run.env names")
    if settings.pretrained and traces.prefix == settings.pretrained_prefix:
        warnings.append("the model that run.env names starts with its weights")
    return RemovedModel(
        traces.prefix,
        traces.checkpoints,
        len(traces.objects),
        traces.size_bytes,
        "" if newest is None else newest.isoformat(timespec="seconds"),
        files,
        sum(Path(file).lstat().st_size for file in files),
        "; ".join(warnings),
    )


def local_files(settings: Settings, bucket: str, prefix: str) -> list[str]:
    """Not of models inside it.

    Only records name the bucket: if a same-named run elsewhere has one, other files stay.
    """
    if not keys.is_valid_prefix(prefix):  # of another program; its `..` would lead out of data/logs
        return []
    found: list[Path] = []
    elsewhere = False
    for folder in settings.directory.glob("data/runs/*"):
        record = RunRecord.read(folder)
        if record is None or record.prefix != prefix:
            continue
        if record.bucket != bucket:
            elsewhere = True
        elif not record.alive:
            found += [path for path in _entries(folder) if path.is_file()]
    if not elsewhere:
        for folder in _local_folders(settings, prefix):
            found += [path for path in _entries(folder) if path.is_file() or path.is_symlink()]
        report = report_file(settings.directory, prefix)
        found += [report] if report.is_file() else []
    return sorted(map(str, found))


def logged_models(settings: Settings) -> set[str]:
    found = set()
    for worker in _LOGGED:
        top = log_file(settings.directory, "", worker).parent
        found |= {path.parent.relative_to(top).as_posix() for path in top.glob("*/**/*.log*")}
    return found


def _local_folders(settings: Settings, prefix: str) -> list[Path]:
    logs = [log_file(settings.directory, prefix, worker).parent for worker in _LOGGED]
    return [*logs, tensorboard_folder(settings.directory, prefix)]


def _remove_empty_folders(settings: Settings, prefix: str) -> None:
    data = settings.directory / "data"
    reports = report_file(settings.directory, prefix).parent
    single = event_folder(settings.directory), report_folder(settings.directory)
    for folder in (*_local_folders(settings, prefix), reports):
        if not folder.is_relative_to(data):  # the name of a model of another program
            continue
        # data/logs/TOOL, data/tensorboard and data/analysis stay.
        fixed = 1 if any(map(folder.is_relative_to, single)) else 2
        while len(folder.relative_to(data).parts) > fixed and folder.is_dir():
            if any(folder.iterdir()):
                break
            folder.rmdir()
            folder = folder.parent


def _entries(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError:
        return []


def _metrics_prefix(settings: Settings, model: ModelStore) -> str | None:
    """None if below the model, or also another's."""
    named = _own_metrics(settings, model)
    if named is None or keys.folder(named).startswith(keys.folder(model.prefix)):
        return None
    if named == settings.metrics_prefix and model.prefix != settings.model_prefix:
        return None
    for other in models_in(model.bucket.list("")):
        if other == model.prefix:
            continue
        is_inside = keys.folder(named).startswith(keys.folder(other))
        if is_inside or _own_metrics(settings, ModelStore(model.bucket, other)) == named:
            return None
    return named


def _own_metrics(settings: Settings, model: ModelStore) -> str | None:
    if model.prefix == settings.model_prefix:
        return settings.metrics_prefix
    try:
        start = read_start(model)
    except (ObjectDamaged, ObjectNewer):
        return None
    named = None if start is None or start.settings is None else start.settings.get(_METRICS)
    return named if isinstance(named, str) and keys.is_valid_prefix(named) else None


def _has_remains(settings: Settings, model: ModelStore) -> bool:
    if local_files(settings, model.bucket.name, model.prefix):
        return True
    objects = all_traces(settings, model).objects
    own = (
        keys.run_folder(model.prefix),
        keys.rollouts_folder(model.prefix),
        keys.journal_folder(model.prefix),
    )
    logs = f"{keys.folder(model.prefix)}logs/"
    return any(info.key.startswith((*own, logs)) for info in objects)


def _no_model(bucket: Bucket, name: str, known: dict[str, bool]) -> SettingsError:
    below = [prefix for prefix in sorted(known) if prefix.startswith(keys.folder(name))]
    if below:
        return SettingsError(
            f"s3://{bucket.name}/{name} is no model, but a folder with {len(below)}: "
            f"{', '.join(below[:5])}{', ...' if len(below) > 5 else ''}.",
            remedy=f"Name them, or all of them with '{name}/*'.",
        )
    return SettingsError(
        f"There is no model {name} in s3://{bucket.name}.",
        remedy="`dr-list-models` lists all models.",
    )
