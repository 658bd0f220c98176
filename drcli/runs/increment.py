"""Prepares training a model further under a new name: edits run.env."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from drcli.base import notices
from drcli.base.errors import SettingsError
from drcli.checks.start_rules import refuse_second_run
from drcli.config.bucket_config import StorageConfig
from drcli.config.checkpoint_words import parse_checkpoint
from drcli.config.run_env import RunEnvEdit, plan_edit, raised, refuse_stronger_values, written
from drcli.config.settings import Settings
from drcli.exchange.run_record import run_folder
from drcli.exchange.training_start import Pretrained
from drcli.models.pretrained import read_weights, sentence_of
from drcli.models.repair_model import repair_or_warn
from drcli.runs.increment_overrides import (
    CHECKPOINT,
    DESCRIPTION,
    NO_OVERRIDES,
    Overrides,
    changed_files,
    changed_settings,
    check_settings,
    write_files,
)
from drcli.store import lease
from drcli.store.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.store.model_prefix import contains, is_used, wipe

MODEL = "DR_LOCAL_S3_MODEL_PREFIX"
METRICS = "DR_LOCAL_S3_METRICS_PREFIX"
PRETRAINED = "DR_LOCAL_S3_PRETRAINED"
PRETRAINED_PREFIX = "DR_LOCAL_S3_PRETRAINED_PREFIX"


@dataclass(frozen=True)
class Increment:
    """The change from one model to the next.

    Attributes:
        file: The run.env that is edited.
        backup: Copy of the file from before the change.
        bucket: Name of the bucket.
        before: Prefix of the model to continue from.
        after: Prefix of the new model.
        pretrained: The current state of the weights that the new model will start with.
        wipes: Whether there are objects under the new prefix, which will be deleted.
        settings: What else changes in the file, by DR_ name.
        files: Paths of the racer's own files that change; each old one is kept as NAME.bak.
    """

    file: str
    backup: str
    bucket: str
    before: str
    after: str
    pretrained: Pretrained
    wipes: bool
    settings: dict[str, str] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class PlannedIncrement:
    step: Increment
    edit: RunEnvEdit
    settings: Settings
    files: Mapping[str, bytes]


def plan_increment(
    settings: Settings,
    *,
    prefix: str | None = None,
    delimiter: str | None = None,
    wiping: bool = False,
    overrides: Overrides = NO_OVERRIDES,
) -> PlannedIncrement:
    """Check everything and prepare the edit; nothing is changed yet.

    Without a `prefix`, this raises the number at the end of the present one, after `delimiter`.

    Raises:
        DrError: The first thing that is wrong.
    """
    refuse_second_run(settings.run_id, run_folder(settings.directory, settings.run_id))
    refuse_stronger_values(settings, (MODEL, PRETRAINED, PRETRAINED_PREFIX))
    before = settings.model_prefix
    now = written(settings, MODEL) or before
    text, after = (prefix, prefix) if prefix is not None else raised(now, before, delimiter)
    _refuse_nested(before, after)
    described = written(settings, DESCRIPTION) or ""
    others = changed_settings(overrides, (MODEL, METRICS, PRETRAINED, PRETRAINED_PREFIX), described)
    refuse_stronger_values(settings, others)
    _refuse_left_behind(settings, after, others)

    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    repair_or_warn(settings.model, bucket, before)
    checkpoint = parse_checkpoint(others.get(CHECKPOINT, settings.pretrained_checkpoint))
    place = settings.place(MODEL)
    pretrained, _ = read_weights(bucket, before, checkpoint, MODEL, place)
    notices.show(sentence_of(bucket, pretrained))
    files = changed_files(settings, overrides, bucket, pretrained.name)
    used = is_used(bucket, after)
    if used and not wiping:
        raise SettingsError(
            f"s3://{bucket.name}/{after} already contains a model.",
            remedy="Choose another name with -p; -w would delete that model.",
        )
    if used:
        lease.refuse_other_owner(bucket, after)
    values = {PRETRAINED: "True", PRETRAINED_PREFIX: before, MODEL: text}
    edit = plan_edit(settings, values, others)
    file, backup = str(edit.path), str(edit.backup)
    paths = [str(settings.custom_files_dir / name) for name in files]
    step = Increment(file, backup, bucket.name, before, after, pretrained, used, others, paths)
    return PlannedIncrement(step, edit, settings, files)


def make_increment(planned: PlannedIncrement, storage: StorageConfig) -> Increment:
    """Wipe the new prefix if asked to, then edit the files, run.env last.

    Raises:
        SettingsError: The file has changed since the check, or cannot be written.
        StorageError: The bucket could not be wiped; the file is as it was.
    """
    planned.edit.check()
    if planned.step.wipes:
        wipe(open_bucket(storage, patience_s=COMMAND_PATIENCE_S), planned.step.after)
    files = write_files(planned.settings, planned.files)
    planned.edit.make()
    return replace(planned.step, files=files)


def _refuse_nested(before: str, after: str) -> None:
    if contains(before, after) or contains(after, before):
        how = "the same model as" if before == after else "nested with"
        raise SettingsError(
            f"{after} would be {how} {before}; wiping one would delete the other.",
            remedy="Choose another name with -p.",
        )


def _refuse_left_behind(settings: Settings, after: str, others: Mapping[str, str]) -> None:
    before = settings.model_prefix
    edited = {MODEL: after, PRETRAINED: "True", PRETRAINED_PREFIX: before, **others}
    metrics = check_settings(settings, edited).metrics_prefix
    if contains(before, metrics):
        raise SettingsError(
            f"{settings.source(METRICS)}: {METRICS}={metrics} would store the metrics of the "
            f"new model together with those of {before}.",
            remedy=f"Write {METRICS}=${MODEL}/metrics.",
        )
