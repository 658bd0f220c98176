"""Trainings as a CSV table."""

import csv
import io
from collections.abc import Collection
from dataclasses import fields

from drcli.models.training_entry import TrainingEntry
from drcli.models.training_list import KnownTrainings


def csv_table(known: KnownTrainings, chosen: Collection[TrainingEntry]) -> str:
    """With each hyperparameter and each setting that was given."""
    records = {record.id: record for record in known.records}
    found = [records[entry.id] for entry in chosen]
    parameters = sorted({name for record in found for name in record.hyperparameters})
    settings = sorted({name for record in found for name in record.newest.settings or {}})
    names = [each.name for each in fields(TrainingEntry)]
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow([*names, *parameters, *settings])
    for entry, record in zip(chosen, found, strict=True):
        given = record.newest.settings or {}
        cells = [getattr(entry, name) for name in names]
        cells += [record.hyperparameters.get(name) for name in parameters]
        cells += [given.get(name) for name in settings]
        table.writerow(["" if cell is None else cell for cell in cells])
    return text.getvalue()
