"""Lists a bucket's trainings, recorded or not."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from drcli.base.errors import SettingsError
from drcli.exchange.training_record import TrainingRecord
from drcli.models.record_training import (
    derived_training,
    model_of,
    origin_of,
    with_results,
)
from drcli.models.run_metadata import read_start
from drcli.models.training_end import ended_elsewhere
from drcli.models.training_entry import TrainingEntry, entry_of
from drcli.models.training_results import evaluations_by_folder, with_evaluations
from drcli.store import keys, lease
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectNewer
from drcli.store.model_traces import models_in
from drcli.store.repair import Model
from drcli.store.training_records import at_once, read_trainings

MOST_EVALUATIONS = 1000
"""At a time, of all models: each is a request."""

LEAST_ID, FULL_ID = 4, 8
"""Digits of an id that name a training, and all of them."""


@dataclass(frozen=True)
class TrainingList:
    """The trainings of a bucket.

    Attributes:
        bucket: Its name.
        trainings: The chosen ones, in the chosen order.
        total: How many trainings there are.
        damaged: A sentence for each record that cannot be read.
    """

    bucket: str
    trainings: list[TrainingEntry]
    total: int
    damaged: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class KnownTrainings:
    """All trainings by start; `existing` are ids whose model is still there."""

    bucket: str
    records: tuple[TrainingRecord, ...] = ()
    existing: frozenset[str] = frozenset()
    models: frozenset[str] = frozenset()
    damaged: tuple[str, ...] = ()

    def entries(self) -> list[TrainingEntry]:
        return [entry_of(record, exists=record.id in self.existing) for record in self.records]

    def find(self, name: str) -> TrainingRecord:
        """By id or its beginning, or by model for its newest training, with ~1 for the one before.

        A name that is both means the model, unless it is a whole id.

        Raises:
            SettingsError: None or several have this name.
        """
        prefix, _, back = name.rstrip("/").partition("~")
        of_model = [record for record in self.records if record.prefix == prefix]
        digits = name.casefold()
        # A model may be called `cafe`: its name comes before the beginning of an id.
        shortest = FULL_ID if of_model else LEAST_ID
        if len(digits) >= shortest and not set(digits) - set("0123456789abcdef"):
            found = [record for record in self.records if record.id.startswith(digits)]
            if len(found) == 1:
                return found[0]
            if len(found) > 1:
                raise SettingsError(
                    f"{name} is the beginning of {len(found)} trainings: "
                    f"{', '.join(record.id for record in found[:5])}.",
                    remedy="Write more digits.",
                )
        count = int(back) if back.isdecimal() and len(back) < 6 else 0
        if not of_model or (back and not back.isdecimal()):
            raise SettingsError(
                f"There is no training {name} in s3://{self.bucket}.",
                remedy="`dr-history` lists all trainings.",
            )
        if count >= len(of_model):
            how_many = "one training" if len(of_model) == 1 else f"{len(of_model)} trainings"
            raise SettingsError(
                f"There is no training {name}: {prefix} has {how_many}.",
                remedy=f"`dr-history {prefix}` lists them.",
            )
        return of_model[-1 - count]


def known_trainings(bucket: Bucket) -> KnownTrainings:
    listed = bucket.list("")
    present = {info.key for info in listed}
    models = models_in(listed)
    records, damaged = read_trainings(bucket)
    left = {record.prefix for record in records if record.gone_at is None}
    trained = [p for p in models if p not in left and keys.training_start(p) in present]

    recorded = {(record.prefix, record.id) for record in records}

    def derive(prefix: str) -> TrainingRecord | None:
        try:
            start = read_start(bucket, prefix)
            origin = prefix if start is None else origin_of(prefix, start)
            if start is not None and origin != prefix and (origin, start.training) in recorded:
                return None  # a copy
            return derived_training(Model(bucket, prefix, keys.metrics_prefix(prefix)), start)
        except (ObjectDamaged, ObjectNewer) as error:
            damaged.append(f"{error} {error.remedy}")
            return None

    records += [record for record in at_once(derive, sorted(trained)) if record is not None]
    evaluations = evaluations_by_folder(listed)
    if surplus := _surplus(records, bucket, evaluations):
        damaged.append(
            f"{len(surplus):,} older results of dr-evaluate were not read, only the newest "
            f"{MOST_EVALUATIONS:,} of those that no record contains yet."
        )
        evaluations = {
            folder: [key for key in found if key not in surplus]
            for folder, found in evaluations.items()
        }
    records = at_once(lambda record: _as_it_is_now(bucket, evaluations, record), records)
    records.sort(key=lambda record: (record.began_at, record.prefix, record.id))
    # Only the newest training of a model can be the one whose model is there.
    newest = {record.prefix: record for record in records if record.gone_at is None}
    return KnownTrainings(
        bucket.name,
        tuple(records),
        frozenset(record.id for record in newest.values() if record.prefix in models),
        frozenset(models),
        tuple(damaged),
    )


def _surplus(
    records: Sequence[TrainingRecord], bucket: Bucket, evaluations: Mapping[str, Sequence[str]]
) -> set[str]:
    fresh: list[str] = []
    for record in records:
        if record.gone_at is None:
            folder = keys.evaluation_metrics_folder(model_of(record, bucket).metrics_prefix)
            fresh += evaluations.get(folder, [])[record.results.read_evaluations :]
    fresh.sort(key=lambda key: key.rpartition("/")[2])
    return set(fresh[:-MOST_EVALUATIONS])


def _as_it_is_now(
    bucket: Bucket, evaluations: Mapping[str, Sequence[str]], record: TrainingRecord
) -> TrainingRecord:
    if record.gone_at is not None:
        return ended_elsewhere(bucket, record) if record.state == "running" else record
    model = model_of(record, bucket)
    if record.state == "running":
        if lease.live_holder(bucket, record.prefix) is None:
            record = ended_elsewhere(bucket, record)
        return with_results(record, model)
    found = evaluations.get(keys.evaluation_metrics_folder(model.metrics_prefix), [])
    return replace(record, results=with_evaluations(record.results, model, found))
