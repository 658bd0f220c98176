"""Gives the next upload another name, in run.env."""

from dataclasses import dataclass

from drcli.base.errors import SettingsError
from drcli.config.loading import load_settings
from drcli.config.run_env import RunEnvEdit, plan_edit, raised, written
from drcli.config.settings import Settings, catalogue
from drcli.models.transfer_buckets import (
    COPY_PATIENCE_S,
    refuse_overlap,
    refuse_training,
    target_bucket,
)
from drcli.store import keys
from drcli.store.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.store.model_prefix import contains
from drcli.store.write_probe import prove_writing

PREFIX = "DR_UPLOAD_S3_PREFIX"


@dataclass(frozen=True)
class UploadIncrement:
    """The change from one upload to the next.

    Attributes:
        file: The run.env that is edited.
        backup: Copy of the file from before the change.
        before: Prefix of the last upload.
        after: Prefix of the next one.
        wiped: Number of objects there that will be deleted.
    """

    file: str
    backup: str
    before: str
    after: str
    wiped: int = 0


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
    text = written(settings, PREFIX) or (
        default if settings.source(PREFIX) == "default" else before
    )
    text, after = (prefix, prefix) if prefix is not None else raised(text, before, delimiter)
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
    refuse_training(there, prefix)
    if contains(prefix, settings.model_prefix) or contains(settings.model_prefix, prefix):
        here = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
        refuse_overlap((here, settings.model_prefix), (there, prefix), flag="-p", may_write=True)
    found = len(there.list(keys.folder(prefix)))
    if found:
        prove_writing(there, prefix, deletes=True)
    return found
