"""Downloads a whole model from another bucket, even while a training changes it there."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace

from drcli.base import notices
from drcli.base.errors import SettingsError, StorageError
from drcli.base.json_record import RecordError
from drcli.config.settings import Settings
from drcli.exchange.checkpoint import decode_pointer
from drcli.exchange.scores import Scores
from drcli.modelfiles.params_yaml import moved_training_parameters
from drcli.models.checkpoint_choice import missing_parts
from drcli.models.checkpoint_files import (
    HYPERPARAMETERS,
    METADATA,
    PARAMETERS_FILE,
    SHAPING,
    Item,
    import_command,
    needs_import,
)
from drcli.models.copy_custom_files import write_own_files
from drcli.models.put_model import POINTERS, Delivery, Progress, TransferReport
from drcli.models.repair_model import repair_or_warn
from drcli.models.transfer_buckets import (
    COPY_PATIENCE_S,
    checked_prefix,
    parse_url,
    refuse_nesting,
    refuse_overlap,
    refuse_training,
    source_bucket,
)
from drcli.store import keys
from drcli.store.bucket import Bucket, Listing, ObjectDamaged, ObjectMissing, Watch
from drcli.store.checkpoints import CheckpointStore
from drcli.store.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.store.endpoint import UPLOADS, SettingNames
from drcli.store.reconstruct import readable_records, reconstruct_scores
from drcli.store.repair import Model, readable_scores
from drcli.store.write_probe import prove_writing

TRANSIENT = ("model/.ready", "model/.lock", "model/.finished", "ip/ip.json", "ip/done")
"""Signals of a training that runs elsewhere; a copy of them would mislead the next one here."""

_SNAPSHOTS = 5
"""How often a model is listed again because a running training has changed it."""


@dataclass(frozen=True)
class DownloadOptions:
    """Options of the command: `url` names the model, `prefix` is its name in our bucket."""

    url: str
    prefix: str
    local: bool = False
    wipe: bool = False
    dry_run: bool = False
    custom_files: bool = False


@dataclass(frozen=True)
class PlannedDownload:
    """A download that passed all checks.

    Attributes:
        used: How many objects are at the target.
        import_command: Makes the model usable here, if it is one of the reference simulator's;
            else empty.
    """

    options: DownloadOptions
    source_url: str
    target_url: str
    used: int
    import_command: str = ""


@dataclass(frozen=True)
class DownloadReport(TransferReport):
    """The result of `dr-download-model`.

    Attributes:
        strays: Names of objects at the target that are not part of the model.
        custom_files: The racer's own files that were written, by path.
    """

    strays: list[str] = field(default_factory=list)
    custom_files: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Source:
    """A model to download, and the command that lists the models of its bucket."""

    bucket: Bucket
    prefix: str
    listing: str
    local: bool = False

    @property
    def import_command(self) -> str:
        """The command that makes it a model here, if it is one of the reference simulator's."""
        return import_command(self.url, local=self.local)

    @property
    def folder(self) -> str:
        """The common beginning of all keys of the model."""
        return keys.folder(self.prefix)

    @property
    def url(self) -> str:
        """Bucket and prefix."""
        return f"s3://{self.bucket.name}/{self.prefix}"


def plan_download(settings: Settings, options: DownloadOptions) -> PlannedDownload:
    """Check both ends; nothing is copied yet.

    Raises:
        DrError: The first thing that is wrong.
    """
    options = replace(options, prefix=checked_prefix(options.prefix, "-t"))
    source = _source(settings, options, patience_s=COMMAND_PATIENCE_S)
    listed = _list_whole(source)
    here = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    ends = (source.bucket, source.prefix), (here, options.prefix)
    refuse_overlap(*ends, flag="-t", may_write=not options.dry_run)
    refuse_nesting(here, options.prefix, settings.custom_files_prefix, flag="-t")
    refuse_training(here, options.prefix)
    used = len(here.list(keys.folder(options.prefix)))
    if not options.dry_run:
        prove_writing(here, options.prefix, deletes=True)  # pointers there are deleted first
    return PlannedDownload(
        options=options,
        source_url=source.url,
        target_url=f"s3://{here.name}/{options.prefix}",
        used=used,
        import_command=source.import_command if needs_import(listed) else "",
    )


def download(planned: PlannedDownload, settings: Settings, progress: Progress) -> DownloadReport:
    """Make the download, once the source was found complete.

    The copy has no index until everything is there, so nobody can use an incomplete one.

    Raises:
        DrError: It failed; the next download fetches only what is missing.
    """
    options = planned.options
    source = _source(settings, options, patience_s=COPY_PATIENCE_S)
    here = open_bucket(settings.storage, patience_s=COPY_PATIENCE_S)
    listed = _list_whole(source)
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
        _check_weights(source)
    with progress("Downloading model", sum(info.size_bytes for info in listed)) as watch:
        delivery.withdraw()
        delivery.send(_fetch(source, delivery, listed, watch))
        delivery.confirm((*SHAPING, *POINTERS))
    repair_or_warn(settings.model, here, options.prefix)
    kept = [*delivery.copied, *delivery.unchanged]
    if options.wipe:
        delivery.delete_strays("", kept)
    return replace(
        delivery.complete(report),
        checkpoint=_last(here, options.prefix),
        strays=[] if options.wipe else delivery.strays("", kept),
        custom_files=write_own_files(here, options.prefix, settings.custom_files_dir)
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
    """The report of a dry run."""
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
    """The model at the address of the options."""
    name, prefix = parse_url(options.url)
    bucket = source_bucket(settings.transfer, name, local=options.local, patience_s=patience_s)
    command = "dr-list-models" if options.local else "dr-list-models --upload"
    if name != (settings.bucket if options.local else settings.upload_s3_bucket):
        names = SettingNames() if options.local else UPLOADS
        command = f"{names.bucket}={name} {command}"
    return Source(bucket, prefix, command, options.local)


def _last(bucket: Bucket, prefix: str) -> str:
    scores, _ = readable_scores(Model(bucket, prefix, keys.metrics_prefix(prefix)))
    return "" if scores is None else scores.last_checkpoint.name


def _list_model(source: Source) -> Listing:
    """List all objects of a model.

    Raises:
        SettingsError: It does not exist, or lacks one of the racer's files.
    """
    listed = [
        info
        for info in source.bucket.list(source.folder)
        if info.key.removeprefix(source.folder) not in TRANSIENT and not info.key.endswith("/")
    ]
    sizes = {info.key.removeprefix(source.folder): info.size_bytes for info in listed}
    wrong = [
        f"{name} is {'empty' if name in sizes else 'missing'}"
        for name in (keys.REWARD_FUNCTION_FILE, HYPERPARAMETERS, METADATA)
        if not sizes.get(name) and not (name in sizes and _is_in_checkpoints(source, name))
    ]
    if wrong:
        why = ", ".join(wrong) if listed else "There is nothing"
        remedy = f"Correct the address after -s; `{source.listing}` lists all models there."
        if needs_import(listed):
            remedy = (
                "It is a model of the reference simulator: make it one here with "
                f"`{source.import_command}`, which can do without these files."
            )
        raise SettingsError(
            f"Meta-data files are not found. Source model {source.url} not valid. Exiting. {why}.",
            remedy=remedy,
        )
    return listed


def _is_in_checkpoints(source: Source, name: str) -> bool:
    """Whether a checkpoint has a copy of a file, which can replace an empty one."""
    records = readable_records(source.bucket, source.prefix)
    file = name.rpartition("/")[2]
    return any(file in record.counters.inputs for record in records)


def _list_whole(source: Source) -> Listing:
    """List a model once its pointers name only complete checkpoints.

    A training that runs there may delete a checkpoint between two looks. It writes the pointers
    last, so they are read first.

    Raises:
        StorageError: A pointer is damaged, or names a checkpoint that stays incomplete.
    """
    missing: list[str] = []
    for _ in range(_SNAPSHOTS):
        names = _named(_pointers(source), source)
        listed = _list_model(source)
        missing = [key for n in sorted(names) for key in missing_parts(listed, source.prefix, n)]
        if not missing:
            return listed
    raise _incomplete(source, missing[0])


def _check_weights(source: Source) -> None:
    """Read the checkpoints that the pointers name, before the model at the target is given up.

    Raises:
        ObjectDamaged: One of them is damaged.
    """
    store = CheckpointStore(source.bucket, source.prefix)
    for name in sorted(_named(_pointers(source), source)):
        # A training that runs there may just have deleted it; the download looks again.
        with suppress(ObjectMissing):
            _check_checkpoint(store, name, source)


def _fetch(source: Source, delivery: Delivery, listed: Listing, watch: Watch) -> list[Item]:
    """Deliver everything except the pointers.

    A training that runs at the source deletes old checkpoints and writes new ones. So this skips
    deleted objects and fetches new ones, until the pointers name only delivered checkpoints.

    Returns:
        The pointers.

    Raises:
        StorageError: They name a checkpoint that stays incomplete.
    """
    missing: list[str] = []
    for _ in range(_SNAPSHOTS):
        delivery.send(_items(source, delivery, listed, watch))
        pointers = _pointers(source)
        missing = _missing(source, delivery, pointers)
        if not missing:
            return pointers
        done = {*delivery.copied, *delivery.unchanged}
        listed = [
            info for info in _list_model(source) if info.key.removeprefix(source.folder) not in done
        ]
    raise _incomplete(source, missing[0])


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
    """Keys of missing files of the checkpoints that the pointers name.

    Raises:
        ObjectDamaged: A complete checkpoint is damaged.
    """
    here, prefix = delivery.bucket, delivery.prefix
    listed = here.list(keys.model_folder(prefix))
    missing: list[str] = []
    for name in sorted(_named(pointers, source)):
        missing += missing_parts(listed, prefix, name)
        record = keys.checkpoint_record(prefix, name)
        if not missing and any(info.key == record for info in listed):
            _check_checkpoint(CheckpointStore(here, prefix), name, source)
    return missing


def _check_checkpoint(store: CheckpointStore, name: str, source: Source) -> None:
    try:
        store.record(name)
    except ObjectDamaged as e:
        notices.warn(f"{e} The copy gets another one, reconstructed from the weights.")
        return
    try:
        store.load(name)
    except ObjectDamaged as e:
        raise ObjectDamaged(
            f"Checkpoint {name} of {source.url} is damaged there. {e}",
            remedy="Restore it there, or fetch another model.",
        ) from e


def _pointers(source: Source) -> list[Item]:
    """The pointers that exist; a damaged one is reconstructed from the checkpoints."""
    found = []
    for name in POINTERS:
        if not source.bucket.exists(source.folder + name):
            continue
        item = Item(name, source.bucket.get(source.folder + name))
        try:
            _named([item], source)
        except ObjectDamaged as error:
            scores = reconstruct_scores(source.bucket, source.prefix, "progress")
            if scores is None:
                raise
            notices.warn(f"{error} The copy gets another one, reconstructed from the checkpoints.")
            is_index = name.endswith(".json")
            item = Item(name, scores.encode() if is_index else scores.last_checkpoint.name.encode())
        found.append(item)
    return found


def _incomplete(source: Source, missing: str) -> StorageError:
    return StorageError(
        f"The checkpoint at {source.url} is incomplete: {missing} is missing.",
        remedy="If it is being trained, run the command again; otherwise fetch another model.",
    )


def _named(pointers: list[Item], source: Source) -> set[str]:
    """Checkpoints that the pointers name."""
    names = set()
    for item in pointers:
        try:
            if item.name.endswith(".json"):
                scores = Scores.decode(item.data)
                names |= {scores.best_checkpoint.name, scores.last_checkpoint.name}
            else:
                names.add(str(decode_pointer(item.data)))
        except RecordError as e:
            raise ObjectDamaged(
                f"{source.url}/{item.name} is damaged: {e}.",
                remedy="Restore it from a copy, or fetch another model.",
            ) from e
    return names
