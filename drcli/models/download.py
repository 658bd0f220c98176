"""Fetches a whole model from another bucket into our own."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from drcli.base import notices
from drcli.config.settings import Settings
from drcli.models.checkpoint_files import SHAPING
from drcli.models.copy_custom_files import write_file
from drcli.models.copy_objects import Fetcher, Source, check_weights, list_whole
from drcli.models.delivery import POINTERS, Delivery, TransferReport
from drcli.models.repair_model import look_after
from drcli.models.transfer_buckets import (
    COPY_PATIENCE_S,
    PLAN_PATIENCE_S,
    checked_prefix,
    parse_url,
    refuse_nesting,
    refuse_overlap,
    refuse_training,
    source_bucket,
)
from drcli.models.upload import Progress
from drcli.store import keys
from drcli.store.bucket import Bucket, Listing
from drcli.store.connect import open_bucket
from drcli.store.endpoint import UPLOADS, SettingNames
from drcli.store.repair import Model, readable_scores


@dataclass(frozen=True)
class DownloadOptions:
    """What the command line says.

    Attributes:
        url: The model, as an s3:// address.
        prefix: What to call it in our bucket.
        local: The address is one on our own server.
        wipe: Delete what is at the prefix and does not belong to the model.
        dry_run: Write nothing.
        custom_files: Copy the racer's three files into the folder for them as well.
    """

    url: str
    prefix: str
    local: bool = False
    wipe: bool = False
    dry_run: bool = False
    custom_files: bool = False


@dataclass(frozen=True)
class PlannedDownload:
    """A download that can be made.

    Attributes:
        used: How many objects lie at the target.
    """

    options: DownloadOptions
    source_url: str
    target_url: str
    objects: int
    size_bytes: int
    used: int


@dataclass(frozen=True)
class DownloadReport(TransferReport):
    """What was done.

    Attributes:
        strays: Names of objects at the target that do not belong to the model.
        custom_files: The racer's own files that were written, by path.
    """

    strays: list[str] = field(default_factory=list)
    custom_files: list[str] = field(default_factory=list)


def plan_download(settings: Settings, options: DownloadOptions) -> PlannedDownload:
    """Check both ends; nothing is copied yet.

    Raises:
        DrError: The first thing that is wrong.
    """
    options = replace(options, prefix=checked_prefix(options.prefix, "-t"))
    source = _source(settings, options, patience_s=PLAN_PATIENCE_S)
    listed = list_whole(source)
    here = open_bucket(settings.storage, patience_s=PLAN_PATIENCE_S)
    ends = (source.bucket, source.prefix), (here, options.prefix)
    refuse_overlap(*ends, flag="-t", may_write=not options.dry_run)
    refuse_nesting(here, options.prefix, settings.custom_files_prefix, flag="-t")
    refuse_training(here, options.prefix)
    return PlannedDownload(
        options=options,
        source_url=source.url,
        target_url=f"s3://{here.name}/{options.prefix}",
        objects=len(listed),
        size_bytes=sum(info.size_bytes for info in listed),
        used=len(here.list(keys.folder(options.prefix))),
    )


def download(planned: PlannedDownload, settings: Settings, progress: Progress) -> DownloadReport:
    """Make the download. Until it is complete the copy has no index, so that it cannot be used.

    Nothing is touched before the source was found whole.

    Raises:
        DrError: It failed; the next download fetches only what is missing.
    """
    options = planned.options
    source = _source(settings, options, patience_s=COPY_PATIENCE_S)
    here = open_bucket(settings.storage, patience_s=COPY_PATIENCE_S)
    listed = list_whole(source)
    delivery = Delivery(here, options.prefix, lambda more: None)
    report = DownloadReport(
        planned.source_url,
        planned.target_url,
        _last(source.bucket, source.prefix),
        dry_run=options.dry_run,
    )
    if options.dry_run:
        return _rehearsed(report, delivery, source, listed, options)
    if planned.used:
        notices.show(f"Checking the weights of {source.url} ...")
        check_weights(source)
    with progress("Downloading model", sum(info.size_bytes for info in listed)) as watch:
        delivery.withdraw()
        fetcher = Fetcher(source, here, options.prefix, watch)
        delivery.send(fetcher.fetch(delivery, listed))
        delivery.confirm((*SHAPING, *POINTERS))
    look_after(settings.model, here, options.prefix)
    kept = [*delivery.copied, *delivery.unchanged]
    if options.wipe:
        delivery.sweep("", kept)
    return replace(
        delivery.told(report),
        checkpoint=_last(here, options.prefix),
        strays=[] if options.wipe else delivery.strays("", kept),
        custom_files=_write_custom_files(here, settings.custom_files_dir, options),
    )


def _rehearsed(
    report: DownloadReport,
    delivery: Delivery,
    source: Source,
    listed: Listing,
    options: DownloadOptions,
) -> DownloadReport:
    """What a download would do."""
    names = {info.key.removeprefix(keys.folder(source.prefix)): info for info in listed}
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
    """The model that the address names.

    Raises:
        DrError: It is not an address, or its server is unknown.
    """
    name, prefix = parse_url(options.url)
    bucket = source_bucket(settings.transfer, name, local=options.local, patience_s=patience_s)
    command = "dr-list-models" if options.local else "dr-list-models --upload"
    if name != (settings.bucket if options.local else settings.upload_s3_bucket):
        names = SettingNames() if options.local else UPLOADS
        command = f"{names.bucket}={name} {command}"
    return Source(bucket, prefix, command)


def _last(bucket: Bucket, prefix: str) -> str:
    scores, _ = readable_scores(Model(bucket, prefix, keys.metrics_prefix(prefix)))
    return "" if scores is None else scores.last_checkpoint.name


def _write_custom_files(bucket: Bucket, folder: Path, options: DownloadOptions) -> list[str]:
    """Give the racer the three files that the model was made of."""
    if not options.custom_files:
        return []
    origins = {
        keys.REWARD_FUNCTION_FILE: keys.reward_function(options.prefix),
        keys.HYPERPARAMETERS_FILE: keys.hyperparameters(options.prefix),
        keys.MODEL_METADATA_FILE: keys.model_metadata(options.prefix),
    }
    written = {folder / name: bucket.get(key) for name, key in origins.items()}
    return [str(path) for path, data in written.items() if write_file(path, data)]
