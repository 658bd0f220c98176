"""Shows one training, gives its files back, and forgets trainings."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from drcli.base.atomic_file import rewrite
from drcli.base.errors import SettingsError
from drcli.base.private_files import make_folder
from drcli.base.replaceable import refuse_existing
from drcli.exchange.training_record import TrainingRecord
from drcli.models.recorded_files import texts_of
from drcli.models.training_comparison import Compared
from drcli.models.training_entry import TrainingEntry, entry_of
from drcli.models.training_list import KnownTrainings
from drcli.store import keys, lease
from drcli.store.bucket import Bucket
from drcli.store.training_records import forget_training


@dataclass(frozen=True)
class TrainingDetails:
    """One training.

    Attributes:
        training: In short.
        record: Everything that was recorded.
        files: Names of its files whose texts were kept.
        saved: Files on this machine that they were written to.
        damaged: A sentence for each record of the bucket that cannot be read.
    """

    training: TrainingEntry
    record: TrainingRecord
    files: list[str] = field(default_factory=list)
    saved: list[str] = field(default_factory=list)
    damaged: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class ForgottenTrainings:
    """The result of `dr-history forget`.

    Attributes:
        bucket: Its name.
        trainings: Those whose records were deleted.
        dry_run: Whether nothing was deleted.
    """

    bucket: str
    trainings: list[TrainingEntry]
    dry_run: bool


def details_of(
    bucket: Bucket,
    known: KnownTrainings,
    name: str,
    *,
    save: Path | None = None,
    force: bool = False,
) -> TrainingDetails:
    """Everything about a training; its files are written to `save`.

    Raises:
        SettingsError: There is none, or a file exists without `force`.
    """
    record = known.find(name)
    texts = {file: text for file, text in texts_of(bucket, record).items() if text is not None}
    saved = [] if save is None else _saved(save, texts, name, force=force)
    entry = entry_of(record, exists=record.id in known.existing)
    return TrainingDetails(entry, record, sorted(texts), saved, list(known.damaged))


def compared(bucket: Bucket, known: KnownTrainings, name: str) -> Compared:
    """Raises SettingsError if there is no such training."""
    record = known.find(name)
    entry = entry_of(record, exists=record.id in known.existing)
    return Compared(record, entry, texts_of(bucket, record))


def plan_forgetting(known: KnownTrainings, names: Sequence[str]) -> list[TrainingRecord]:
    """SettingsError if one is missing, running, or without record."""
    found: dict[str, TrainingRecord] = {}
    for name in names:
        record = known.find(name)
        if record.state == "running":
            raise SettingsError(
                f"The training {record.id} of {record.prefix} is running.",
                remedy="Forget it when it has ended, or stop it with `dr-stop-training`.",
            )
        if record.derived:
            raise SettingsError(
                f"The training {record.id} of {record.prefix} has no record; what is known about "
                "it is in the model.",
                remedy=f"Delete the model with `dr-delete-model {record.prefix} --forget`.",
            )
        found[record.id] = record
    return list(found.values())


def forget(bucket: Bucket, records: Sequence[TrainingRecord]) -> None:
    """SettingsError if somebody has begun to train."""
    for record in records:
        if record.gone_at is None:
            lease.refuse_other_owner(bucket, record.prefix)
        forget_training(bucket, record.prefix, record.id)


def _saved(folder: Path, texts: dict[str, str], name: str, *, force: bool) -> list[str]:
    if not texts:
        raise SettingsError(
            f"The files of the training {name} were not kept.",
            remedy=f"Look for {keys.REWARD_FUNCTION_FILE} in copies of the model.",
        )
    for file in texts:
        refuse_existing(folder / file, force=force)
    try:
        make_folder(folder)
        for file, text in texts.items():
            rewrite(folder / file, text.encode())
    except OSError as error:
        raise SettingsError(
            f"{folder}: the files cannot be written there ({error.strerror or error}).",
            remedy="Name another folder with --save.",
        ) from error
    return [str(folder / file) for file in texts]
