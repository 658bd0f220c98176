"""Fetches a whole model from another bucket into our own."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from drcli.config import Settings
from drcli.runs.inputs import custom_files_folder
from drcli.store import keys
from drcli.store.bucket import Bucket
from drcli.store.connect import open_bucket
from drcli.store.scores import read_scores
from drcli.transfer.custom_files import write_file
from drcli.transfer.delivery import Delivery
from drcli.transfer.fetching import Fetcher, list_model
from drcli.transfer.places import (
    COPY_PATIENCE_S,
    PLAN_PATIENCE_S,
    checked_prefix,
    parse_url,
    refuse_nesting,
    refuse_overlap,
    refuse_training,
    source_bucket,
)
from drcli.transfer.upload import Progress


@dataclass(frozen=True)
class DownloadOptions:
    """What the command line says.

    Attributes:
        url: The model, as an s3:// address.
        prefix: What to call it in our bucket.
        local: The address is one on our own server.
        wipe: Delete what lies at the prefix and is no part of the model.
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
        options: As they were given, the prefix without a slash at its end.
        source_bucket: Where the model lies.
        source: Its prefix there.
        source_url: Both.
        target_url: Bucket and prefix of the copy.
        objects: How many there are to copy.
        size_bytes: Of all of them.
        used: How many objects lie at the target.
    """

    options: DownloadOptions
    source_bucket: str
    source: str
    source_url: str
    target_url: str
    objects: int
    size_bytes: int
    used: int


@dataclass(frozen=True)
class DownloadReport:
    """What was done.

    Attributes:
        source: The model, as an s3:// address.
        target: The copy, the same.
        checkpoint: Name of its last checkpoint.
        copied: Names of the objects that were fetched, below the target.
        copied_bytes: Their size.
        unchanged: Names of those that were there already.
        deleted: Names of those that -w deleted.
        strays: Names of those that lie there and are no part of the model.
        custom_files: The racer's own files that were written, by path.
        dry_run: Whether nothing of this was really done.
    """

    source: str
    target: str
    checkpoint: str
    copied: list[str] = field(default_factory=list)
    copied_bytes: int = 0
    unchanged: list[str] = field(default_factory=list)
    deleted: list[str] = field(default_factory=list)
    strays: list[str] = field(default_factory=list)
    custom_files: list[str] = field(default_factory=list)
    dry_run: bool = False


def plan_download(settings: Settings, directory: Path, options: DownloadOptions) -> PlannedDownload:
    """Check both ends; nothing is copied yet.

    Raises:
        DrError: The first thing that is wrong.
    """
    name, source = parse_url(options.url)
    options = replace(options, prefix=checked_prefix(options.prefix, "-t"))
    there = source_bucket(
        settings, directory, name, local=options.local, patience_s=PLAN_PATIENCE_S
    )
    listed = list_model(there, source)
    here = open_bucket(settings, directory, patience_s=PLAN_PATIENCE_S)
    refuse_overlap((there, source), (here, options.prefix), may_write=not options.dry_run)
    refuse_nesting(here, options.prefix, settings)
    refuse_training(here, options.prefix)
    return PlannedDownload(
        options=options,
        source_bucket=name,
        source=source,
        source_url=f"s3://{name}/{source}",
        target_url=f"s3://{here.name}/{options.prefix}",
        objects=len(listed),
        size_bytes=sum(info.size_bytes for info in listed),
        used=len(here.list(keys.folder(options.prefix))),
    )


def download(
    planned: PlannedDownload, settings: Settings, directory: Path, progress: Progress
) -> DownloadReport:
    """Make the download. While it lasts the copy has no index, so that nobody drives half of it.

    Raises:
        DrError: It could not be finished; making it again fetches what is missing.
    """
    options = planned.options
    there = source_bucket(
        settings, directory, planned.source_bucket, local=options.local, patience_s=COPY_PATIENCE_S
    )
    here = open_bucket(settings, directory, patience_s=COPY_PATIENCE_S)
    listed = list_model(there, planned.source)
    report = DownloadReport(
        planned.source_url,
        planned.target_url,
        _last(there, planned.source),
        dry_run=options.dry_run,
    )
    if options.dry_run:
        names = [info.key.removeprefix(keys.folder(planned.source)) for info in listed]
        return replace(report, copied=names, copied_bytes=sum(o.size_bytes for o in listed))
    with progress("Downloading model", sum(info.size_bytes for info in listed)) as watch:
        delivery = Delivery(here, options.prefix, lambda more: None)
        delivery.withdraw()
        fetcher = Fetcher(there, planned.source, here, options.prefix, watch)
        delivery.send(fetcher.fetch(delivery, listed))
    kept = [*delivery.copied, *delivery.unchanged]
    if options.wipe:
        delivery.sweep("", kept)
    return replace(
        report,
        checkpoint=_last(here, options.prefix),
        copied=delivery.copied,
        copied_bytes=delivery.copied_bytes,
        unchanged=delivery.unchanged,
        deleted=delivery.deleted,
        strays=[] if options.wipe else delivery.strays("", kept),
        custom_files=_write_custom_files(here, settings, directory, options),
    )


def _last(bucket: Bucket, prefix: str) -> str:
    scores = read_scores(bucket, prefix)
    return "" if scores is None else scores.last_checkpoint.name


def _write_custom_files(
    bucket: Bucket, settings: Settings, directory: Path, options: DownloadOptions
) -> list[str]:
    """Give the racer the three files that the model was made of."""
    if not options.custom_files:
        return []
    folder = custom_files_folder(settings, directory)
    origins = {
        keys.REWARD_FUNCTION_FILE: keys.reward_function(options.prefix),
        keys.HYPERPARAMETERS_FILE: keys.hyperparameters(options.prefix),
        keys.MODEL_METADATA_FILE: keys.model_metadata(options.prefix),
    }
    written = {folder / name: bucket.get(key) for name, key in origins.items()}
    return [str(path) for path, data in written.items() if write_file(path, data)]
