"""Prepares training a model further under a new name: edits run.env."""

from dataclasses import dataclass

from drcli.base.errors import SettingsError
from drcli.config.loading import load_settings
from drcli.config.run_env import RunEnvEdit, plan_edit, raised, refuse_stronger_values, written
from drcli.config.settings import Settings, StorageConfig
from drcli.exchange.run_record import run_folder
from drcli.exchange.training_start import Pretrained
from drcli.models.pretrained import read_weights
from drcli.models.repair_model import look_after
from drcli.runs.plan import COMMAND_PATIENCE_S, refuse_second_run
from drcli.store import lease
from drcli.store.connect import open_bucket
from drcli.store.model_prefix import contains, is_used, wipe

MODEL = "DR_LOCAL_S3_MODEL_PREFIX"
METRICS = "DR_LOCAL_S3_METRICS_PREFIX"
PRETRAINED = "DR_LOCAL_S3_PRETRAINED"
PRETRAINED_PREFIX = "DR_LOCAL_S3_PRETRAINED_PREFIX"


@dataclass(frozen=True)
class Increment:
    """A step from one model to the next.

    Attributes:
        file: The run.env that is edited.
        backup: Copy of it as it was before.
        bucket: Name of the bucket.
        before: Prefix of the model to continue from.
        after: Prefix of the new model.
        pretrained: The weights that the new model will begin with, as they are now.
        wipes: Whether there is something at the new prefix, to be deleted.
    """

    file: str
    backup: str
    bucket: str
    before: str
    after: str
    pretrained: Pretrained
    wipes: bool


@dataclass(frozen=True)
class PlannedIncrement:
    """An increment that can be made."""

    step: Increment
    edit: RunEnvEdit


def plan_increment(
    settings: Settings,
    *,
    prefix: str | None = None,
    delimiter: str | None = None,
    wiping: bool = False,
) -> PlannedIncrement:
    """Check everything and work out the edit; nothing is changed yet.

    Args:
        settings: As they are before.
        prefix: Name of the new model; the present one with its number raised if left out.
        delimiter: What must stand before that number; anything but a digit if left out.
        wiping: Whether what lies at the new prefix may be deleted.

    Raises:
        DrError: The first thing that is wrong.
    """
    refuse_second_run(settings.run_id, run_folder(settings.directory, settings.run_id))
    refuse_stronger_values(settings, (MODEL, PRETRAINED, PRETRAINED_PREFIX))
    before = settings.model_prefix
    if prefix is not None:
        text = after = prefix
    else:
        text, after = raised(written(settings, MODEL) or before, before, delimiter)
    _refuse_nested(before, after)
    _refuse_left_behind(settings, after)

    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    look_after(settings.model, bucket, before)
    checkpoint, place = settings.pretrained_checkpoint, settings.place(MODEL)
    pretrained, _ = read_weights(bucket, before, checkpoint, MODEL, place)
    used = is_used(bucket, after)
    if used and not wiping:
        raise SettingsError(
            f"There is a model at s3://{bucket.name}/{after} already.",
            remedy="Name the new model with -p, or delete that one with -w.",
        )
    if used:
        lease.refuse_other_owner(bucket, after)
    values = {PRETRAINED: "True", PRETRAINED_PREFIX: before, MODEL: text}
    edit = plan_edit(settings, values)
    file, backup = str(edit.path), str(edit.backup)
    step = Increment(file, backup, bucket.name, before, after, pretrained, used)
    return PlannedIncrement(step, edit)


def make_increment(planned: PlannedIncrement, storage: StorageConfig) -> None:
    """Delete what is to be wiped, keep a copy of the file, and replace it in one step.

    Raises:
        SettingsError: The file was changed since it was looked at, or cannot be written.
        StorageError: The bucket could not be wiped; the file is as it was.
    """
    planned.edit.check()
    if planned.step.wipes:
        wipe(open_bucket(storage, patience_s=COMMAND_PATIENCE_S), planned.step.after)
    planned.edit.make()


def _refuse_nested(before: str, after: str) -> None:
    if contains(before, after) or contains(after, before):
        how = "the same model as" if before == after else "nested with"
        raise SettingsError(
            f"{after} would be {how} {before}; wiping one would delete the other.",
            remedy="Choose another name with -p.",
        )


def _refuse_left_behind(settings: Settings, after: str) -> None:
    """Load the settings as they will be: nothing in them may be wrong or name the old model."""
    before = settings.model_prefix
    edited = {MODEL: after, PRETRAINED: "True", PRETRAINED_PREFIX: before}
    metrics = load_settings(settings.directory, flags=edited).metrics_prefix
    if contains(before, metrics):
        raise SettingsError(
            f"{settings.source(METRICS)}: {METRICS}={metrics} would keep the new model's metrics "
            f"with those of {before}.",
            remedy=f"Write {METRICS}=${MODEL}/metrics.",
        )
