"""What refuses a start before files and bucket are read."""

import os
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from drcli.base.errors import (
    BudgetUsedUp,
    DrError,
    Problem,
    ProblemsError,
    SettingsError,
    StorageError,
)
from drcli.bucket.bucket import TEST_FOLDER, Bucket
from drcli.bucket.s3_errors import AccessRefused
from drcli.config.run_config import PretrainedConfig
from drcli.config.settings import Settings
from drcli.metrics.open_sinks import check_figures
from drcli.model import keys, lease
from drcli.model.checkpoints import CheckpointsLost
from drcli.model.files.network_shape import Design
from drcli.model.model_prefix import KIND_WORDS, ModelListing
from drcli.model.model_store import ModelStore
from drcli.model.repair import load_unless_lost
from drcli.records.run_record import RunRecord, run_folder
from drcli.records.training_record import budget_of
from drcli.transfer import minio_folder, pretrained
from drcli.transfer.pretrained import Transfer
from drcli.workers.ray_extra import has_cluster, require_ray


@dataclass(frozen=True)
class StartRule:
    """One thing that must hold; its check raises DrError.

    Attributes:
        key: The setting of its problem; empty if the check names the place.
        of_machine: Not for one that trains elsewhere.
    """

    rule: str
    key: str
    check: Callable[[Settings], None]
    of_machine: bool = True


def refuse_second_run(run_id: int, folder: Path) -> None:
    """Return if no training of this number is alive here.

    Raises:
        ModelInUse: One is.
    """
    record = RunRecord.read(folder)
    if record is not None and record.alive:
        raise lease.ModelInUse(
            f"Run {run_id} is training s3://{record.bucket}/{record.prefix} already "
            f"(process {record.pid}).",
            remedy="Stop it with `dr-stop-training`, or give this one another DR_RUN_ID and "
            "another DR_LOCAL_S3_MODEL_PREFIX.",
        )


def _trainable(settings: Settings) -> None:
    if settings.untrainable is not None and not settings.curriculum_file:
        raise ProblemsError([settings.untrainable])


def _free_run(settings: Settings) -> None:
    refuse_second_run(settings.run_id, run_folder(settings.directory, settings.run_id))


def _within_budget(settings: Settings) -> None:
    budget = budget_of(settings.directory, settings.run.unattended, time.time())
    if budget.used_up is not None:
        raise BudgetUsedUp(budget.used_up, remedy=budget.remedy)


def _on_ray(settings: Settings) -> None:
    if settings.launcher == "ray":
        require_ray()


def _in_cluster(settings: Settings) -> None:
    wanted = settings.ray_trainer
    if settings.launcher == "ray" and wanted in ("cluster", "gpu") and not has_cluster(settings):
        raise SettingsError(
            f"DR_RAY_TRAINER={wanted} in system.env: there is no cluster for the trainer, because "
            "Ray starts on this machine alone.",
            remedy="Write its address into DR_RAY_ADDRESS, or set DR_RAY_TRAINER=auto.",
        )


def _writes_logs(settings: Settings) -> None:
    folder = settings.directory / "data" / "logs"
    place = next(place for place in (folder, *folder.parents) if place.exists())
    if not (place.is_dir() and os.access(place, os.W_OK | os.X_OK)):
        what = f"{place}: logs cannot be written there."
        remedy = f"Check that you can write to {folder}, or move it."
        raise ProblemsError([Problem("V-50", "error", str(place), None, what, remedy)])


RULES = (
    StartRule("V-07", "DR_RACE_TYPE", _trainable, of_machine=False),
    StartRule("V-13", "DR_RUN_ID", _free_run),
    StartRule("V-12", "DR_DAILY_BUDGET_HOURS", _within_budget),
    StartRule("V-12", "DR_TENSORBOARD", lambda settings: check_figures(settings.run.figures)),
    StartRule("V-12", "DR_LAUNCHER", _on_ray),
    StartRule("V-12", "DR_RAY_TRAINER", _in_cluster),
    StartRule("V-50", "", _writes_logs),
)


def refuse_start(settings: Settings) -> None:
    """Raise the DrError of the first rule that does not hold."""
    for each in RULES:
        each.check(settings)


def start_problems(settings: Settings, *, here: bool) -> Iterator[Problem]:
    """Without `here`, of the rules for any machine."""
    for each in RULES:
        if each.of_machine and not here:
            continue
        try:
            each.check(settings)
        except ProblemsError as error:
            yield from error.problems
        except DrError as error:
            place = settings.place(each.key)
            yield Problem(each.rule, "error", *place, str(error), error.remedy, each.key)


# Checks the bucket: it works, is free, and has the old model.


LARGEST_SKEW_S = 300.0
"""Servers refuse requests from 15 minutes on."""


def review_prefix(listed: ModelListing) -> list[Problem]:
    """V-09: the prefix of the new model is empty."""
    if not listed.objects:
        return []
    model, kind = listed.model.url, listed.kind
    try:
        load_unless_lost(listed)
    except CheckpointsLost as lost:
        return [Problem("V-09", "error", model, None, str(lost), lost.remedy)]
    what = f"Selected path {model} exists. It holds {KIND_WORDS[kind]}. Exiting."
    remedy = "Choose another DR_LOCAL_S3_MODEL_PREFIX in run.env; -w would delete what is there."
    if kind in ("drcli", "tensorflow"):
        remedy = f"Continue that training with `dr-start-training --resume`. {remedy}"
    return [Problem("V-09", "error", model, None, what, remedy)]


def review_owner(store: ModelStore) -> list[Problem]:
    """V-13: no other run trains this model."""
    try:
        lease.refuse_other_owner(store)
    except SettingsError as error:
        model = store.url
        return [Problem("V-13", "error", model, None, str(error), error.remedy)]
    return []


def review_minio_folder(settings: Settings, bucket: Bucket) -> Iterator[Problem]:
    """V-15: no models are left where MinIO kept them."""
    models = minio_folder.unread_models(settings.storage, settings.directory, bucket)
    if models:
        yield Problem("V-15", "warning", "", None, *minio_folder.told_unread(models, bucket))


def review_pretrained(
    config: PretrainedConfig, bucket: Bucket, new: str, design: Design | None, *, wiping: bool
) -> tuple[Transfer | None, list[Problem]]:
    """V-10 and V-35: the model to start from exists, is complete, and fits."""
    try:
        transfer = pretrained.find(config, bucket, new, design, wiping=wiping)
    except ProblemsError as error:
        return None, list(error.problems)
    return transfer, [] if transfer is None else transfer.warnings


def probe(model: ModelStore) -> list[Problem]:
    """V-50: objects can be written, read, listed and deleted; returns a warning about the clock.

    Tried among the model's records: keys may be limited to its folders.

    Raises:
        StorageError: They cannot.
    """
    folder = f"{keys.run_folder(model.prefix)}{TEST_FOLDER}-{uuid.uuid4().hex}/"
    key, content = f"{folder}object", b"probe"
    try:
        model.bucket.put(key, content)
        try:
            came_back = model.bucket.get(key) == content
            written = [item for item in model.bucket.list(folder) if item.key == key]
        finally:
            model.bucket.delete([key])
    except AccessRefused as error:
        needed = (
            keys.folder(model.prefix),
            keys.run_folder(model.prefix),
            keys.rollouts_folder(model.prefix),
        )
        raise error.below(needed) from error
    if not (came_back and written) or model.bucket.exists(key):
        raise StorageError(
            f"The bucket {model.bucket.name} does not correctly return, list or delete objects.",
            remedy="Use another S3 server; this one could lose a model.",
        )
    skew_s = time.time() - written[0].modified.timestamp()
    if abs(skew_s) <= LARGEST_SKEW_S:
        return []
    what = (
        f"The clock of this machine is {abs(skew_s) / 60:.0f} minutes "
        f"{'ahead of' if skew_s > 0 else 'behind'} the server's."
    )
    remedy = (
        "Set the clock, as with `sudo timedatectl set-ntp true`; servers refuse requests if the "
        "clocks differ by 15 minutes."
    )
    return [Problem("V-50", "warning", model.bucket.name, None, what, remedy)]
