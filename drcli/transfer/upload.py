"""Uploads a checkpoint with all files that belong to it."""

import re
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated

from drcli.base import errors
from drcli.base.errors import BadValue, SettingsError
from drcli.base.report import View, counted, size_text
from drcli.bucket.bucket import Bucket, ObjectMissing, readable_record
from drcli.bucket.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.config.editing import RunEnvEdit, plan_edit, raised
from drcli.config.loading import load_settings
from drcli.config.settings import Settings, catalogue
from drcli.config.value_types import CheckpointChoice, retention_rules, without_slashes
from drcli.convert.car_rules import END
from drcli.model import keys
from drcli.model.checkpoint_choice import (
    CheckpointGone,
    Chosen,
    ModelCheckpoints,
    take_choice,
)
from drcli.model.checkpoint_list import (
    SHAPING,
    Item,
    read_checkpoint,
    read_model_files,
    refuse_incomplete,
)
from drcli.model.checkpoints import CheckpointStore
from drcli.model.files.params_yaml import training_parameters
from drcli.model.model_prefix import contains
from drcli.model.model_store import ModelStore
from drcli.model.repair import repair_unless_trained
from drcli.model.write_probe import prove_writing
from drcli.records.checkpoint import CheckpointName, CheckpointRecord
from drcli.transfer.put_model import POINTERS, Delivery, Progress, TransferReport, replay_bytes
from drcli.transfer.transfer_buckets import (
    COPY_PATIENCE_S,
    checked_prefix,
    refuse_nesting,
    refuse_overlap,
    refuse_training,
    target_bucket,
)

# Gives the next upload another name, in run.env.


PREFIX = "DR_UPLOAD_S3_PREFIX"


@dataclass(frozen=True)
class UploadIncrement:
    """The change from one upload to the next."""

    file: Annotated[str, "The run.env that is edited."]
    backup: Annotated[str, "Copy of the file from before the change."]
    before: Annotated[str, "Prefix of the last upload."]
    after: Annotated[str, "Prefix of the next one."]
    wiped: Annotated[int, "Number of objects there that will be deleted."] = 0

    def __str__(self) -> str:
        wiped = f" {counted(self.wiped, 'file')} deleted there." if self.wiped else ""
        return f"The next upload goes to {self.after}.{wiped}"


@dataclass(frozen=True)
class PlannedUploadIncrement:
    step: UploadIncrement
    edit: RunEnvEdit
    settings: Settings


def plan_upload_increment(
    settings: Settings,
    *,
    prefix: str | None = None,
    delimiter: str | None = None,
    wiping: bool = False,
) -> PlannedUploadIncrement:
    """Prepare the edit; nothing is changed yet. Raises DrError.

    Without `prefix`, raises the number at the end of the present one, after `delimiter`.
    """
    before = settings.upload_s3_prefix
    default = catalogue()[PREFIX].default_text
    text = settings.written.get(PREFIX) or (
        default if settings.source(PREFIX) == "default" else before
    )
    plain = None if prefix is None else without_slashes(prefix)
    text, after = (plain, plain) if plain is not None else raised(text, before, delimiter)
    if before == after:
        raise SettingsError(f"{PREFIX} is already {after}.", remedy="Choose another name with -p.")
    edit = plan_edit(settings, {PREFIX: text})
    changed = load_settings(settings.directory, flags={PREFIX: after})
    wiped = _count(changed) if wiping else 0
    step = UploadIncrement(str(edit.path), str(edit.backup), before, after, wiped)
    return PlannedUploadIncrement(step, edit, changed)


def make_upload_increment(planned: PlannedUploadIncrement) -> None:
    """Delete what is at the new prefix if asked to, then edit the file.

    Raises:
        SettingsError: The file has changed, or cannot be written.
        StorageError: Deleting failed; the file is as it was.
    """
    planned.edit.check()
    if planned.step.wiped:
        transfer = planned.settings.transfer
        bucket = target_bucket(transfer, local=False, patience_s=COPY_PATIENCE_S)
        folder = keys.folder(planned.step.after)
        bucket.delete([info.key for info in bucket.list(folder)])
    planned.edit.make()


def _count(settings: Settings) -> int:
    there = target_bucket(settings.transfer, local=False, patience_s=COMMAND_PATIENCE_S)
    prefix = settings.upload_s3_prefix
    model = ModelStore(there, prefix)
    refuse_training(model)
    if contains(prefix, settings.model_prefix) or contains(settings.model_prefix, prefix):
        here = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
        refuse_overlap((here, settings.model_prefix), (there, prefix), flag="-p", may_write=True)
    found = len(there.list(keys.folder(prefix)))
    if found:
        prove_writing(model, deletes=True)
    return found


# Which uploaded checkpoints and car archives stay, and which are deleted.
#
# Deletes only what this program wrote, and never what the pointers name.


_GRAPH = re.compile(r"model_(\d+)\.pb")


@dataclass(frozen=True)
class Retention:
    """`rules` are `last`, `last-N`, `best`, `every-N`; none: keep all."""

    rules: tuple[str, ...] = ()
    max_bytes: int = 0

    @staticmethod
    def of(keep: str, max_mb: int) -> "Retention":
        try:
            return Retention(retention_rules(keep), max_mb * 1_000_000)
        except BadValue as error:
            raise SettingsError(f"--keep '{keep}' {error}.", remedy=error.remedy) from error

    @property
    def is_active(self) -> bool:
        return bool(self.rules) or self.max_bytes > 0


KEEP_ALL = Retention()


def surplus(
    sizes: Mapping[CheckpointName, int],
    retention: Retention,
    best: CheckpointName | None,
    pinned: Collection[CheckpointName],
) -> list[CheckpointName]:
    """What does not stay, oldest first; `pinned` ones always stay.

    `every-N` keeps the first of 0 to N-1, of N to 2N-1 ...: what it keeps once, it keeps always.
    The size limit deletes the oldest first, the best last.
    """
    everything = sorted(sizes)
    stay = set(everything) if not retention.rules else _kept(everything, retention.rules, best)
    stay |= set(pinned) & set(everything)
    if retention.max_bytes:
        first_to_go = sorted(stay - set(pinned), key=lambda name: (name == best, name))
        for name in first_to_go:
            if sum(sizes[each] for each in stay) <= retention.max_bytes:
                break
            stay.discard(name)
    return [name for name in everything if name not in stay]


def delete_surplus_checkpoints(
    delivery: Delivery, retention: Retention, best: str | None, *, dry_run: bool = False
) -> list[str]:
    model = ModelStore(delivery.bucket, delivery.prefix)
    objects, sizes = _own_checkpoints(model)
    named = map(CheckpointName.parse, delivery.named())
    pinned = {name for name in named if name is not None}
    doomed = surplus(sizes, retention, CheckpointName.parse(best or ""), pinned)
    return _delete(model, doomed, objects, sizes, retention, dry_run=dry_run)


def delete_surplus_archives(
    model: ModelStore,
    plain: Collection[str],
    retention: Retention,
    best: str | None,
    newest: int,
    *,
    dry_run: bool = False,
) -> list[str]:
    """Of `NAME-chkN.tar.gz`; `plain` names and `newest` always stay."""
    names = "|".join(re.escape(name.removesuffix(END)) for name in plain)
    pattern = re.compile(rf"(?:{names})-chk(\d{{1,9}}){re.escape(END)}")
    folder = keys.folder(model.prefix)
    archives: defaultdict[CheckpointName, list[str]] = defaultdict(list)
    sizes: Counter[CheckpointName] = Counter()
    for info in model.bucket.list(folder):
        found = pattern.fullmatch(info.key.removeprefix(folder))
        if found is not None:
            name = CheckpointName(int(found[1]), 0)
            archives[name].append(info.key)
            sizes[name] += info.size_bytes
    parsed = CheckpointName.parse(best or "")
    best_archive = None if parsed is None else CheckpointName(parsed.number, 0)
    doomed = surplus(sizes, retention, best_archive, [CheckpointName(newest, 0)])
    return _delete(model, doomed, archives, sizes, retention, dry_run=dry_run)


def _delete(
    model: ModelStore,
    doomed: Collection[CheckpointName],
    objects: Mapping[CheckpointName, Sequence[str]],
    sizes: Mapping[CheckpointName, int],
    retention: Retention,
    *,
    dry_run: bool,
) -> list[str]:
    left = sum(sizes.values()) - sum(sizes[name] for name in doomed)
    if retention.max_bytes and left > retention.max_bytes:
        errors.warn(
            f"What must stay at {model.url} takes {left / 1e6:,.0f} MB, more than the limit of "
            f"{retention.max_bytes / 1e6:,.0f} MB (DR_UPLOAD_MAX_MB)."
        )
    deleted = [key for name in doomed for key in objects[name]]
    if not dry_run:
        model.bucket.delete(deleted)
    return [key.removeprefix(keys.folder(model.prefix)) for key in deleted]


def _kept(
    names: list[CheckpointName], rules: tuple[str, ...], best: CheckpointName | None
) -> set[CheckpointName]:
    stay: set[CheckpointName] = set()
    for rule in rules:
        kind, _, number = rule.partition("-")
        if kind == "last":
            stay |= set(names[-int(number or 1) :])
        elif kind == "best":
            stay |= {best} & set(names) if best is not None else set()
        else:
            first: dict[int, CheckpointName] = {}
            for name in names:
                first.setdefault(name.number // int(number), name)
            stay |= set(first.values())
    return stay


def _own_checkpoints(
    model: ModelStore,
) -> tuple[dict[CheckpointName, list[str]], dict[CheckpointName, int]]:
    listed = model.bucket.list(keys.model_folder(model.prefix))
    objects: dict[CheckpointName, list[str]] = {}
    sizes: dict[CheckpointName, int] = {}
    for info in listed:
        name = keys.checkpoint_of(model.prefix, info.key)
        if name is not None:
            objects.setdefault(name, []).append(info.key)
            sizes[name] = sizes.get(name, 0) + info.size_bytes
    ours = {name for name in objects if _is_ours(model, name, objects[name])}
    numbers = [name.number for name in objects]
    for info in listed:
        found = _GRAPH.fullmatch(info.key.removeprefix(keys.model_folder(model.prefix)))
        if found is None or numbers.count(int(found[1])) != 1:
            continue
        for name in ours:
            if name.number == int(found[1]):
                objects[name].append(info.key)
                sizes[name] += info.size_bytes
    return (
        {name: found for name, found in objects.items() if name in ours},
        {name: size for name, size in sizes.items() if name in ours},
    )


def _is_ours(model: ModelStore, name: CheckpointName, found: list[str]) -> bool:
    record = keys.checkpoint_record(model.prefix, str(name))
    if record not in found or keys.checkpoint_tensors(model.prefix, str(name)) not in found:
        return False
    decode = partial(CheckpointRecord.decode_of, str(name))
    return readable_record(model.bucket, record, decode) is not None


_PICKS = 5
"""A training may delete the last checkpoint."""


@dataclass(frozen=True)
class UploadOptions:
    choice: CheckpointChoice = "last"
    prefix: str | None = None
    to: str | None = None
    local: bool = False
    wipe: bool = False
    dry_run: bool = False
    keep: str | None = None
    max_mb: int | None = None


@dataclass(frozen=True)
class PlannedUpload:
    options: UploadOptions
    retention: Retention
    chosen: Chosen
    source: str
    target: str
    source_url: str
    target_url: str


@dataclass(frozen=True, kw_only=True)
class UploadReport(TransferReport):
    """The result of `dr-upload-model`."""

    choice: Annotated[str, "last, best, the word of a milestone, or the requested number."]
    metric: Annotated[float | None, "Mean score of the checkpoint's evaluation; None without one."]
    older: Annotated[list[str], "Checkpoints of earlier uploads that are still there."] = field(
        default_factory=list
    )
    older_bytes: Annotated[int, "Their size."] = 0

    def view(self) -> View:
        would, deleted = (
            ("Would upload", "would be deleted") if self.dry_run else ("Uploaded", "deleted")
        )
        files, older = counted(len(self.deleted), "file"), size_text(self.older_bytes)
        return [
            f"{would} {self.checkpoint} of {self.copied_text()}",
            self.deleted and f"{files} of earlier uploads {deleted}.",
            self.older
            and f"Older checkpoints are kept: {len(self.older)}, {older}; -w deletes them.",
            self.replay_text(),
        ]


def plan_upload(settings: Settings, options: UploadOptions) -> PlannedUpload:
    """Choose the checkpoint and prove that the target can be written; raises DrError."""
    retention = retention_of(settings, options.keep, options.max_mb)
    source = checked_prefix(options.prefix, "-p") if options.prefix else settings.model_prefix
    target = source if options.prefix else settings.upload_s3_prefix
    if options.to:
        target = checked_prefix(options.to, "--to")
    there = target_bucket(
        settings.transfer,
        local=options.local,
        patience_s=COMMAND_PATIENCE_S,
        otherwise="or upload into the local bucket with -L",
    )
    here = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    model = ModelStore.of(settings.model, here, source)
    if not options.dry_run:
        repair_unless_trained(model)
    refuse_incomplete(settings.model, model)
    chosen = take_choice(model, options.choice)
    there.list(keys.model_folder(target))  # fails here if the target cannot be reached
    refuse_overlap((here, source), (there, target), flag="--to", may_write=not options.dry_run)
    if options.local:
        refuse_nesting(ModelStore(there, target), settings.custom_files_prefix, flag="--to")
    refuse_training(ModelStore(there, target))
    if not options.dry_run:
        prove_writing(ModelStore(there, target), deletes=options.wipe or retention.is_active)
    places = (f"s3://{here.name}/{source}", f"s3://{there.name}/{target}")
    return PlannedUpload(options, retention, chosen, source, target, *places)


def upload(planned: PlannedUpload, settings: Settings, progress: Progress) -> UploadReport:
    """Raises DrError; the target then has its old checkpoint, or none."""
    options = planned.options
    here = open_bucket(settings.storage, patience_s=COPY_PATIENCE_S)
    model = ModelStore(here, planned.source)
    there = target_bucket(settings.transfer, local=options.local, patience_s=COPY_PATIENCE_S)
    chosen, checkpoint = _read_chosen(here, planned)
    place = (there.name, planned.target)
    described = training_parameters(settings)
    shared = read_model_files(settings.model, model, chosen.name, place, described)
    report = UploadReport(
        source=planned.source_url,
        target=planned.target_url,
        choice=str(options.choice),
        checkpoint=chosen.name,
        metric=chosen.score.avg_eval_metric,
        dry_run=options.dry_run,
        replay_bytes=replay_bytes(model),
    )
    if options.dry_run:
        return _rehearsed(
            report,
            there,
            planned,
            [*checkpoint, *shared],
            CheckpointStore(model).best_name(),
        )
    total = sum(len(item.data) for item in (*checkpoint, *shared))
    with progress("Uploading model", total) as watch:
        delivery = Delivery(ModelStore(there, planned.target), watch)
        # Data first and pointers last: the target has a usable model for as long as possible.
        if chosen.name in delivery.named() and any(map(delivery.differs, checkpoint)):
            delivery.withdraw()  # another model has a checkpoint of this name there
        shaping = [item for item in shared if item.name in SHAPING]
        delivery.send(checkpoint)
        if any(map(delivery.differs, shaping)):
            delivery.withdraw()  # the checkpoint there does not fit the files that come now
        delivery.send(shared)
        delivery.publish(chosen.score)
        if options.wipe:
            delivery.delete_strays("model/")
        delivery.repair_crossing(chosen.score, [*checkpoint, *shaping])
        if planned.retention.is_active:
            best = CheckpointStore(model).best_name()
            delivery.deleted += delete_surplus_checkpoints(delivery, planned.retention, best)
    older, older_bytes = _older(there, planned.target, chosen.name)
    return replace(delivery.complete(report), older=older, older_bytes=older_bytes)


def _read_chosen(here: Bucket, planned: PlannedUpload) -> tuple[Chosen, list[Item]]:
    store = ModelStore(here, planned.source)
    chosen = planned.chosen
    for attempt in range(_PICKS):
        try:
            return chosen, read_checkpoint(store, chosen)
        except ObjectMissing as e:
            if attempt == _PICKS - 1 or isinstance(planned.options.choice, int):
                raise CheckpointGone(
                    str(e),
                    remedy="Run the command again, or choose another checkpoint.",
                ) from e
            chosen = ModelCheckpoints.read(store).choose(planned.options.choice)
    raise AssertionError("the last attempt returns or raises")


def retention_of(settings: Settings, keep: str | None, max_mb: int | None) -> Retention:
    """By options, else settings; raises SettingsError."""
    return Retention.of(
        settings.upload_keep if keep is None else keep,
        settings.upload_max_mb if max_mb is None else max_mb,
    )


def _rehearsed(
    report: UploadReport,
    there: Bucket,
    planned: PlannedUpload,
    items: list[Item],
    best: str | None,
) -> UploadReport:
    delivery = Delivery(ModelStore(there, planned.target), lambda more: None)
    copied = [item for item in items if not delivery.holds(item)]
    names = [item.name for item in items]
    strays = delivery.strays("model/", names) if planned.options.wipe else []
    if planned.retention.is_active and not planned.options.wipe:
        strays = delete_surplus_checkpoints(delivery, planned.retention, best, dry_run=True)
    return replace(
        report,
        copied=[*(item.name for item in copied), *POINTERS],
        copied_bytes=sum(len(item.data) for item in copied),
        unchanged=[item.name for item in items if item not in copied],
        deleted=strays,
    )


def _older(there: Bucket, prefix: str, name: str) -> tuple[list[str], int]:
    sizes: dict[CheckpointName, int] = {}
    for info in there.list(keys.model_folder(prefix)):
        found = keys.checkpoint_of(prefix, info.key)
        if found is not None and str(found) != name:
            sizes[found] = sizes.get(found, 0) + info.size_bytes
    return [str(found) for found in sorted(sizes)], sum(sizes.values())
