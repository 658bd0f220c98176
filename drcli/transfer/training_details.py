"""Shows one training, gives its files back, and forgets trainings."""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drcli.base.errors import SettingsError
from drcli.base.files import make_folder, refuse_existing, rewrite
from drcli.bucket.bucket import Bucket
from drcli.model import keys, lease
from drcli.model.model_store import ModelStore
from drcli.model.training_records import forget_training
from drcli.records.training_record import TrainingRecord
from drcli.transfer.record_training import texts_of
from drcli.transfer.training_list import KnownTrainings, TrainingEntry, entry_of, settings_of

# Compares two trainings: inputs, machine, results.


NOT_COMPARED = ("DR_RUN_ID", "DR_LOCAL_S3_MODEL_PREFIX", "DR_LOCAL_S3_METRICS_PREFIX")
"""These say which training it is, not how it trains."""

_RESULTS = (
    "world",
    "state",
    "iterations",
    "episodes",
    "steps",
    "elapsed_s",
    "hours",
    "usd",
    "best_lap_s",
    "best_training_lap_s",
    "best_progress",
    "best_checkpoint",
    "best_score",
    "mean_reward",
    "mean_progress",
)

_CONTEXT = 2


@dataclass(frozen=True)
class Difference:
    """A value of two trainings.

    Attributes:
        name: What it is.
        before: Its value in the first training; None if it is not there.
        after: Its value in the second.
    """

    name: str
    before: Any
    after: Any


@dataclass(frozen=True)
class FileDifference:
    """A file of a training that differs.

    Attributes:
        name: Of the file.
        diff: Lines of a unified diff; empty if a text was not kept.
    """

    name: str
    diff: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class TrainingComparison:
    """Two trainings side by side.

    Attributes:
        before: The first.
        after: The second.
        results: What they came to, equal values included.
        settings: Settings that differ, with the values of defaults.
        worker_settings: The same for files of other workers, such as `worker-2.env DR_...`.
        hyperparameters: Those that differ.
        model: Differences of algorithm, actions, network and sensors.
        start: Differences of the weights that they began with.
        versions: Of Python and packages.
        machine: Processor, cores and others.
        files: Files that differ, except hyperparameters.json.
    """

    before: TrainingEntry
    after: TrainingEntry
    results: list[Difference]
    settings: list[Difference]
    worker_settings: list[Difference]
    hyperparameters: list[Difference]
    model: list[Difference]
    start: list[Difference]
    versions: list[Difference]
    machine: list[Difference]
    files: list[FileDifference]


@dataclass(frozen=True)
class Compared:
    record: TrainingRecord
    entry: TrainingEntry
    texts: Mapping[str, str | None]


def compare(one: Compared, other: Compared) -> TrainingComparison:
    a, b = one.record, other.record
    return TrainingComparison(
        one.entry,
        other.entry,
        [
            Difference(name, getattr(one.entry, name), getattr(other.entry, name))
            for name in _RESULTS
        ],
        setting_differences(a, b),
        differences(_by_worker(a), _by_worker(b)),
        differences(a.hyperparameters, b.hyperparameters),
        differences(_model_of(a), _model_of(b)),
        differences(_weights_of(a), _weights_of(b)),
        differences(_versions_of(a), _versions_of(b)),
        differences(a.newest.machine, b.newest.machine),
        _files(one, other),
    )


def setting_differences(a: TrainingRecord, b: TrainingRecord) -> list[Difference]:
    """None if those of one are unknown."""
    if a.newest.settings is None or b.newest.settings is None:
        return []
    found = differences(settings_of(a), settings_of(b))
    return [each for each in found if each.name not in NOT_COMPARED]


def differences(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[Difference]:
    names = sorted({*before, *after})
    return [
        Difference(name, before.get(name), after.get(name))
        for name in names
        if before.get(name) != after.get(name)
    ]


def changed_files(a: TrainingRecord, b: TrainingRecord) -> list[str]:
    one, other = a.newest.files, b.newest.files
    return [name for name in one if name in other and one[name] != other[name]]


def _by_worker(record: TrainingRecord) -> dict[str, Any]:
    return {
        f"worker-{number}.env {name}": value
        for number, settings in enumerate(record.newest.worker_settings, start=2)
        for name, value in settings.items()
    }


def _model_of(record: TrainingRecord) -> dict[str, Any]:
    return {
        "algorithm": record.algorithm,
        "action_space": record.action_space,
        "network": record.network,
        "sensors": ", ".join(record.sensors),
        "stages": record.stages,
    }


def _weights_of(record: TrainingRecord) -> dict[str, Any]:
    parent = record.parent
    return {
        "pretrained model": None if parent is None else parent.prefix,
        "pretrained checkpoint": None if parent is None else parent.name,
        "seed": record.newest.seed,
    }


def _versions_of(record: TrainingRecord) -> dict[str, Any]:
    git = {
        f"git {name.replace('_', ' ')}": f"{state.commit[:12]}{' + changes' if state.dirty else ''}"
        for name, state in record.newest.git.items()
        if state is not None
    }
    return {**record.newest.versions, **git}


def _files(one: Compared, other: Compared) -> list[FileDifference]:
    found = []
    for name in sorted({*one.record.newest.files, *other.record.newest.files}):
        same = one.record.newest.files.get(name) == other.record.newest.files.get(name)
        if same or name == keys.HYPERPARAMETERS_FILE:
            continue
        a, b = one.texts.get(name), other.texts.get(name)
        lines: list[str] = []
        if a is not None and b is not None:
            titles = f"{one.entry.model} {name}", f"{other.entry.model} {name}"
            lines = list(
                difflib.unified_diff(
                    a.splitlines(), b.splitlines(), *titles, lineterm="", n=_CONTEXT
                )
            )
        found.append(FileDifference(name, lines))
    return found


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
            lease.refuse_other_owner(ModelStore(bucket, record.prefix))
        forget_training(ModelStore(bucket, record.prefix), record.id)


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
