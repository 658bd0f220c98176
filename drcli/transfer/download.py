"""Downloads a model from another bucket, even during a training there."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

from drcli.base import errors
from drcli.base.report import View, counted
from drcli.bucket.bucket import Listing, ObjectMissing, Watch
from drcli.bucket.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.bucket.endpoint import UPLOADS, SettingNames
from drcli.config.settings import Settings
from drcli.model import keys
from drcli.model.checkpoint_choice import missing_parts
from drcli.model.checkpoint_list import PARAMETERS_FILE, SHAPING, Item
from drcli.model.checkpoints import CheckpointStore
from drcli.model.files.params_yaml import moved_training_parameters
from drcli.model.model_store import ModelStore
from drcli.model.reconstruct import readable_scores
from drcli.model.repair import repair_unless_trained
from drcli.model.write_probe import prove_writing
from drcli.transfer.copy_custom_files import write_own_files
from drcli.transfer.download_source import (
    SNAPSHOTS,
    Source,
    check_checkpoint,
    check_weights,
    incomplete,
    list_model,
    list_whole,
    named,
    read_pointers,
)
from drcli.transfer.files_as_bucket import source_on_disk
from drcli.transfer.find_checkpoint import open_source
from drcli.transfer.put_model import POINTERS, Delivery, Progress, TransferReport, replay_bytes
from drcli.transfer.transfer_buckets import (
    COPY_PATIENCE_S,
    checked_prefix,
    parse_url,
    refuse_nesting,
    refuse_overlap,
    refuse_training,
    source_bucket,
)


@dataclass(frozen=True)
class DownloadOptions:
    """`url` may be a local path; `prefix` is the name in our bucket."""

    url: str
    prefix: str
    local: bool = False
    wipe: bool = False
    dry_run: bool = False
    custom_files: bool = False


@dataclass(frozen=True)
class PlannedDownload:
    options: DownloadOptions
    source_url: str
    target_url: str
    used: int


@dataclass(frozen=True)
class DownloadReport(TransferReport):
    """The result of `dr-download-model`."""

    strays: Annotated[
        list[str], "Names of objects at the target that are not part of the model."
    ] = field(default_factory=list)
    custom_files: Annotated[list[str], "The racer's own files that were written, by path."] = field(
        default_factory=list
    )

    def view(self) -> View:
        verb = "would be deleted" if self.dry_run else "deleted"
        deleted, strays = counted(len(self.deleted), "file"), counted(len(self.strays), "file")
        return [
            f"{'Would download' if self.dry_run else 'Downloaded'} {self.copied_text()}",
            not self.checkpoint and "It has no checkpoint yet, so it cannot drive.",
            self.deleted and f"Not part of it and {verb}: {deleted}.",
            self.strays and f"Not part of it: {strays} at the target; -w deletes them.",
            self.replay_text(),
            *(f"Wrote {path}" for path in self.custom_files),
        ]


def plan_download(settings: Settings, options: DownloadOptions) -> PlannedDownload:
    """Check both ends; raises DrError."""
    options = replace(options, prefix=checked_prefix(options.prefix, "-t"))
    source = _source(settings, options, patience_s=COMMAND_PATIENCE_S)
    list_whole(source)
    here = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    model = ModelStore(here, options.prefix)
    ends = (source.bucket, source.prefix), (here, options.prefix)
    refuse_overlap(*ends, flag="-t", may_write=not options.dry_run)
    refuse_nesting(model, settings.custom_files_prefix, flag="-t")
    refuse_training(model)
    used = len(here.list(keys.folder(options.prefix)))
    if not options.dry_run:
        prove_writing(model, deletes=True)  # pointers there are deleted first
    return PlannedDownload(
        options=options,
        source_url=source.url,
        target_url=f"s3://{here.name}/{options.prefix}",
        used=used,
    )


def download(planned: PlannedDownload, settings: Settings, progress: Progress) -> DownloadReport:
    """Make the download, once the source is complete.

    The index comes last, so nobody uses an incomplete copy.

    Raises:
        DrError: It failed; the next one fetches only the rest.
    """
    options = planned.options
    source = _source(settings, options, patience_s=COPY_PATIENCE_S)
    store = ModelStore(source.bucket, source.prefix)
    here = open_bucket(settings.storage, patience_s=COPY_PATIENCE_S)
    model = ModelStore.of(settings.model, here, options.prefix)
    listed = list_whole(source)
    delivery = Delivery(model, lambda more: None)
    report = DownloadReport(
        planned.source_url,
        planned.target_url,
        _last(store),
        dry_run=options.dry_run,
        replay_bytes=replay_bytes(store),
    )
    if options.dry_run:
        return _rehearsed(report, delivery, source, listed, options)
    if planned.used or source.file:
        errors.show(f"Checking the weights of {source.url} ...")
        check_weights(source)
    with progress("Downloading model", sum(info.size_bytes for info in listed)) as watch:
        delivery.withdraw()
        delivery.send(_fetch(source, delivery, listed, watch))
        delivery.confirm((*SHAPING, *POINTERS))
    repair_unless_trained(model)
    kept = [*delivery.copied, *delivery.unchanged]
    if options.wipe:
        delivery.delete_strays("", kept)
    return replace(
        delivery.complete(report),
        checkpoint=_last(model),
        strays=[] if options.wipe else delivery.strays("", kept),
        custom_files=write_own_files(model, settings.custom_files_dir)
        if options.custom_files
        else [],
    )


def _rehearsed(
    report: DownloadReport,
    delivery: Delivery,
    source: Source,
    listed: Listing,
    options: DownloadOptions,
) -> DownloadReport:
    names = {info.key.removeprefix(source.folder): info for info in listed}
    new = {name: info for name, info in names.items() if not delivery.has(name, info)}
    others = delivery.strays("", names)
    return replace(
        report,
        copied=list(new),
        copied_bytes=sum(info.size_bytes for info in new.values()),
        unchanged=delivery.unchanged,
        deleted=others if options.wipe else [],
        strays=[] if options.wipe else others,
    )


def _source(settings: Settings, options: DownloadOptions, *, patience_s: float) -> Source:
    if options.url and Path(options.url).expanduser().exists():
        return source_on_disk(open_source(settings.transfer, options.url, local=False))
    name, prefix = parse_url(options.url)
    bucket = source_bucket(settings.transfer, name, local=options.local, patience_s=patience_s)
    command = "dr-list-models" if options.local else "dr-list-models --upload"
    if name != (settings.bucket if options.local else settings.upload_s3_bucket):
        names = SettingNames() if options.local else UPLOADS
        command = f"{names.bucket}={name} {command}"
    return Source(bucket, prefix, command, options.local)


def _last(model: ModelStore) -> str:
    scores, _ = readable_scores(ModelStore(model.bucket, model.prefix))
    return "" if scores is None else scores.last_checkpoint.name


def _fetch(source: Source, delivery: Delivery, listed: Listing, watch: Watch) -> list[Item]:
    """Deliver everything but the pointers, which it returns.

    A training at the source deletes and writes checkpoints, so this repeats until the pointers name
    only delivered ones.

    Raises:
        StorageError: One stays incomplete.
    """
    missing: list[str] = []
    for _ in range(SNAPSHOTS):
        delivery.send(_items(source, delivery, listed, watch))
        pointers = read_pointers(source)
        missing = _missing(source, delivery, pointers)
        if not missing:
            return pointers
        done = {*delivery.copied, *delivery.unchanged}
        listed = [
            info for info in list_model(source) if info.key.removeprefix(source.folder) not in done
        ]
    raise incomplete(source, missing[0])


def _items(source: Source, delivery: Delivery, listed: Listing, watch: Watch) -> Iterator[Item]:
    for info in listed:
        name = info.key.removeprefix(source.folder)
        if name in POINTERS:
            continue
        if delivery.has(name, info):
            watch(info.size_bytes)
            continue
        try:
            data = source.bucket.get(info.key, watch=watch)
        except ObjectMissing:
            continue
        if name == PARAMETERS_FILE:
            with suppress(ValueError):  # nothing of ours reads a damaged one: copy it as it is
                data = moved_training_parameters(data, delivery.bucket.name, delivery.prefix)
        yield Item(name, data)


def _missing(source: Source, delivery: Delivery, pointers: list[Item]) -> list[str]:
    here, prefix = delivery.bucket, delivery.prefix
    listed = here.list(keys.model_folder(prefix))
    missing: list[str] = []
    for name in sorted(named(pointers, source)):
        missing += missing_parts(listed, prefix, name)
        record = keys.checkpoint_record(prefix, name)
        if not missing and any(info.key == record for info in listed):
            check_checkpoint(CheckpointStore(ModelStore(here, prefix)), name, source)
    return missing
