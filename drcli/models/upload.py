"""Copies one checkpoint of a model, with all that belongs to it, to where it can be used alone."""

from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field, replace

from drcli.config.settings import Settings
from drcli.exchange.checkpoint import CheckpointName
from drcli.modelfiles.params_yaml import training_parameters
from drcli.models.checkpoint_choice import (
    CheckpointGone,
    Choice,
    Chosen,
    Item,
    choose,
    read_checkpoint,
)
from drcli.models.checkpoint_files import SHAPING, read_model_files, refuse_incomplete
from drcli.models.delivery import POINTERS, Delivery, TransferReport
from drcli.models.repair_model import look_after
from drcli.models.transfer_buckets import (
    COPY_PATIENCE_S,
    PLAN_PATIENCE_S,
    checked_prefix,
    refuse_nesting,
    refuse_overlap,
    refuse_training,
    target_bucket,
)
from drcli.store import keys
from drcli.store.best_checkpoint import read_scores
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectMissing, Watch
from drcli.store.connect import open_bucket

Progress = Callable[[str, int], AbstractContextManager[Watch]]
"""Shows a bar while its context lasts: takes what is done and how many bytes there are."""

_PICKS = 5
"""How often another checkpoint is chosen because a running training has deleted the last one."""


@dataclass(frozen=True)
class UploadOptions:
    """What the command line adds to the settings.

    Attributes:
        choice: Which checkpoint.
        prefix: Another model than that of the settings; the target is called the same then.
        to: Another prefix at the target.
        local: Stay in our own bucket.
        wipe: Delete what an earlier upload left in the target's `model/`.
        dry_run: Write nothing.
    """

    choice: Choice = "last"
    prefix: str | None = None
    to: str | None = None
    local: bool = False
    wipe: bool = False
    dry_run: bool = False


@dataclass(frozen=True)
class PlannedUpload:
    """An upload that can be made.

    Attributes:
        chosen: The checkpoint as it was found.
    """

    options: UploadOptions
    chosen: Chosen
    source: str
    target: str
    source_url: str
    target_url: str


@dataclass(frozen=True, kw_only=True)
class UploadReport(TransferReport):
    """What was done.

    Attributes:
        choice: last, best, or the number that was asked for.
        metric: How the checkpoint was evaluated; None where it was not.
        older: Checkpoints of earlier uploads that still lie there.
        older_bytes: Their size.
    """

    choice: str
    metric: float | None
    older: list[str] = field(default_factory=list)
    older_bytes: int = 0


def plan_upload(settings: Settings, options: UploadOptions) -> PlannedUpload:
    """Choose the checkpoint and check both ends; nothing is copied yet.

    Raises:
        DrError: The first thing that is wrong.
    """
    source = checked_prefix(options.prefix, "-p") if options.prefix else settings.model_prefix
    target = source if options.prefix else settings.upload_s3_prefix
    if options.to:
        target = checked_prefix(options.to, "--to")
    there = target_bucket(
        settings.transfer,
        local=options.local,
        patience_s=PLAN_PATIENCE_S,
        otherwise="or upload into the local bucket with -L",
    )
    here = open_bucket(settings.storage, patience_s=PLAN_PATIENCE_S)
    look_after(settings.model, here, source, may_write=not options.dry_run)
    refuse_incomplete(settings.model, here, source)
    chosen = choose(here, source, options.choice)
    there.list(keys.model_folder(target))  # a target that cannot be reached ends it here
    refuse_overlap((here, source), (there, target), flag="--to", may_write=not options.dry_run)
    if options.local:
        refuse_nesting(there, target, settings.custom_files_prefix, flag="--to")
    refuse_training(there, target)
    places = (f"s3://{here.name}/{source}", f"s3://{there.name}/{target}")
    return PlannedUpload(options, chosen, source, target, *places)


def upload(planned: PlannedUpload, settings: Settings, progress: Progress) -> UploadReport:
    """Make the upload.

    Raises:
        DrError: It failed; the target then has its old checkpoint, or none.
    """
    options = planned.options
    here = open_bucket(settings.storage, patience_s=COPY_PATIENCE_S)
    there = target_bucket(settings.transfer, local=options.local, patience_s=COPY_PATIENCE_S)
    chosen, checkpoint = _read_chosen(here, planned)
    place = (there.name, planned.target)
    described = training_parameters(settings)
    shared = read_model_files(settings.model, here, planned.source, place, described)
    report = UploadReport(
        source=planned.source_url,
        target=planned.target_url,
        choice=str(options.choice),
        checkpoint=chosen.name,
        metric=chosen.score.avg_eval_metric,
        dry_run=options.dry_run,
    )
    if options.dry_run:
        return _rehearsed(report, there, planned, [*checkpoint, *shared])
    total = sum(len(item.data) for item in (*checkpoint, *shared))
    with progress("Uploading model", total) as watch:
        delivery = Delivery(there, planned.target, watch)
        _deliver(delivery, there, planned, chosen, checkpoint, shared)
    older, older_bytes = _older(there, planned.target, chosen.name)
    return replace(delivery.told(report), older=older, older_bytes=older_bytes)


def _deliver(
    delivery: Delivery,
    there: Bucket,
    planned: PlannedUpload,
    chosen: Chosen,
    checkpoint: list[Item],
    shared: list[Item],
) -> None:
    """Send data first and pointers last, so that the target stays usable as long as possible."""
    if chosen.name in _named(there, planned.target) and any(map(delivery.differs, checkpoint)):
        delivery.withdraw()  # another model's checkpoint of the same name: one of them must go
    shaping = [item for item in shared if item.name in SHAPING]
    delivery.send(checkpoint)
    if any(map(delivery.differs, shaping)):
        delivery.withdraw()  # the checkpoint there cannot be read with what comes now
    delivery.send(shared)
    delivery.publish(chosen.score)
    if planned.options.wipe:
        delivery.sweep("model/", kept=())
    delivery.settle(chosen.score, [*checkpoint, *shaping])


def _read_chosen(here: Bucket, planned: PlannedUpload) -> tuple[Chosen, list[Item]]:
    """The checkpoint; a running training may delete it while it is read."""
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
            chosen = choose(here, planned.source, planned.options.choice)
    raise AssertionError("the last attempt returns or raises")


def _rehearsed(
    report: UploadReport, there: Bucket, planned: PlannedUpload, items: list[Item]
) -> UploadReport:
    """What an upload would do."""
    delivery = Delivery(there, planned.target, lambda more: None)
    copied = [item for item in items if not delivery.holds(item)]
    names = [item.name for item in items]
    strays = delivery.strays("model/", names) if planned.options.wipe else []
    return replace(
        report,
        copied=[*(item.name for item in copied), *POINTERS],
        copied_bytes=sum(len(item.data) for item in copied),
        unchanged=[item.name for item in items if item not in copied],
        deleted=strays,
    )


def _named(there: Bucket, prefix: str) -> set[str]:
    """Checkpoints that the pointers of the target name."""
    names = set()
    with suppress(ObjectMissing):
        names.add(there.get(keys.coach_checkpoint(prefix)).decode(errors="replace").strip())
    try:
        scores = read_scores(there, prefix)
    except ObjectDamaged:
        return names
    if scores is None:
        return names
    return names | {scores.best_checkpoint.name, scores.last_checkpoint.name}


def _older(there: Bucket, prefix: str, name: str) -> tuple[list[str], int]:
    """Checkpoints beside the one just uploaded, oldest first, and their size."""
    sizes: dict[CheckpointName, int] = {}
    for info in there.list(keys.model_folder(prefix)):
        found = keys.checkpoint_of(prefix, info.key)
        if found is not None and str(found) != name:
            sizes[found] = sizes.get(found, 0) + info.size_bytes
    return [str(found) for found in sorted(sizes)], sum(sizes.values())
