"""Uploads a checkpoint with all files that belong to it."""

from dataclasses import dataclass, field, replace

from drcli.config.checkpoint_words import CheckpointChoice
from drcli.config.settings import Settings
from drcli.exchange.checkpoint import CheckpointName
from drcli.modelfiles.params_yaml import training_parameters
from drcli.models.checkpoint_choice import CheckpointGone, Chosen, find_choice, take_choice
from drcli.models.checkpoint_files import (
    SHAPING,
    Item,
    known_best,
    read_checkpoint,
    read_model_files,
    refuse_incomplete,
)
from drcli.models.put_model import POINTERS, Delivery, Progress, TransferReport, replay_bytes
from drcli.models.repair_model import repair_or_warn
from drcli.models.transfer_buckets import (
    COPY_PATIENCE_S,
    checked_prefix,
    refuse_nesting,
    refuse_overlap,
    refuse_training,
    target_bucket,
)
from drcli.models.upload_retention import Retention, delete_surplus_checkpoints
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing
from drcli.store.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.store.repair import Model
from drcli.store.write_probe import prove_writing

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
    """The result of `dr-upload-model`.

    Attributes:
        choice: last, best, the word of a milestone, or the requested number.
        metric: Mean score of the checkpoint's evaluation; None without one.
        older: Checkpoints of earlier uploads that are still there.
        older_bytes: Their size.
    """

    choice: str
    metric: float | None
    older: list[str] = field(default_factory=list)
    older_bytes: int = 0


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
    repair_or_warn(settings.model, here, source, may_write=not options.dry_run)
    refuse_incomplete(settings.model, here, source)
    chosen = take_choice(Model.of(settings.model, here, source), options.choice)
    there.list(keys.model_folder(target))  # fails here if the target cannot be reached
    refuse_overlap((here, source), (there, target), flag="--to", may_write=not options.dry_run)
    if options.local:
        refuse_nesting(there, target, settings.custom_files_prefix, flag="--to")
    refuse_training(there, target)
    if not options.dry_run:
        prove_writing(there, target, deletes=options.wipe or retention.is_active)
    places = (f"s3://{here.name}/{source}", f"s3://{there.name}/{target}")
    return PlannedUpload(options, retention, chosen, source, target, *places)


def upload(planned: PlannedUpload, settings: Settings, progress: Progress) -> UploadReport:
    """Raises DrError; the target then has its old checkpoint, or none."""
    options = planned.options
    here = open_bucket(settings.storage, patience_s=COPY_PATIENCE_S)
    there = target_bucket(settings.transfer, local=options.local, patience_s=COPY_PATIENCE_S)
    chosen, checkpoint = _read_chosen(here, planned)
    place = (there.name, planned.target)
    described = training_parameters(settings)
    shared = read_model_files(settings.model, here, planned.source, chosen.name, place, described)
    report = UploadReport(
        source=planned.source_url,
        target=planned.target_url,
        choice=str(options.choice),
        checkpoint=chosen.name,
        metric=chosen.score.avg_eval_metric,
        dry_run=options.dry_run,
        replay_bytes=replay_bytes(here, planned.source),
    )
    if options.dry_run:
        return _rehearsed(
            report, there, planned, [*checkpoint, *shared], known_best(here, planned.source)
        )
    total = sum(len(item.data) for item in (*checkpoint, *shared))
    with progress("Uploading model", total) as watch:
        delivery = Delivery(there, planned.target, watch)
        # Data first and pointers last: the target has a usable model for as long as possible.
        if delivery.is_named(chosen.name) and any(map(delivery.differs, checkpoint)):
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
            best = known_best(here, planned.source)
            delivery.deleted += delete_surplus_checkpoints(delivery, planned.retention, best)
    older, older_bytes = _older(there, planned.target, chosen.name)
    return replace(delivery.complete(report), older=older, older_bytes=older_bytes)


def _read_chosen(here: Bucket, planned: PlannedUpload) -> tuple[Chosen, list[Item]]:
    chosen = planned.chosen
    for attempt in range(_PICKS):
        try:
            return chosen, read_checkpoint(here, planned.source, chosen)
        except ObjectMissing as e:
            if attempt == _PICKS - 1 or isinstance(planned.options.choice, int):
                raise CheckpointGone(
                    f"No model files found. Files possibly deleted. Try again. {e}",
                    remedy="Run the command again, or choose another checkpoint.",
                ) from e
            model = Model(here, planned.source, keys.metrics_prefix(planned.source))
            chosen = find_choice(model, planned.options.choice)
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
    delivery = Delivery(there, planned.target, lambda more: None)
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
