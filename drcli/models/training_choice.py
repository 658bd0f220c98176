"""Chooses and sorts trainings for a list."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from drcli.exchange.training_record import TrainingRecord
from drcli.models.training_entry import TrainingEntry, settings_of
from drcli.models.training_list import KnownTrainings, TrainingList


def values_of(record: TrainingRecord, entry: TrainingEntry) -> Mapping[str, Any]:
    return {**settings_of(record), **record.hyperparameters, **vars(entry)}


def chosen(
    known: KnownTrainings,
    conditions: Sequence[Callable[[Mapping[str, Any]], bool]],
    sort: str = "began",
    limit: int = 0,
) -> TrainingList:
    """Sorted so that the best, newest or largest come last; `limit` keeps the last."""

    def fits(record: TrainingRecord, entry: TrainingEntry) -> bool:
        values = values_of(record, entry) if conditions else {}
        return all(condition(values) for condition in conditions)

    pairs = zip(known.records, known.entries(), strict=True)
    found = ordered([entry for record, entry in pairs if fits(record, entry)], sort)
    return TrainingList(
        known.bucket, found[-limit:] if limit else found, len(known.records), list(known.damaged)
    )


ORDERS: Mapping[str, Callable[[TrainingEntry], Any]] = {
    "began": lambda entry: entry.began_at or None,
    "lap": lambda entry: None if entry.best_lap_s is None else -entry.best_lap_s,
    "progress": lambda entry: entry.best_progress,
    "score": lambda entry: entry.best_score,
    "iterations": lambda entry: entry.iterations,
    "hours": lambda entry: entry.hours,
    "cost": lambda entry: entry.usd,
    "model": lambda entry: entry.model,
}
"""Missing values come first."""


def ordered(entries: Iterable[TrainingEntry], sort: str) -> list[TrainingEntry]:
    key = ORDERS[sort]
    known = [(key(entry), entry) for entry in entries]
    without = [entry for value, entry in known if value is None]
    with_value = [pair for pair in known if pair[0] is not None]
    return without + [entry for _, entry in sorted(with_value, key=lambda pair: pair[0])]
