"""`dr history`."""

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from drcli.base.replaceable import refuse_replacing
from drcli.cli import candidates, console, prompts
from drcli.cli.options import AsJson, DryRun, Force, Replace
from drcli.cli.views import training_history_view
from drcli.cli.working_folder import settings

if TYPE_CHECKING:
    from drcli.models.training_filter import Condition
    from drcli.models.training_list import KnownTrainings
    from drcli.store.bucket import Bucket

app = typer.Typer(
    help="List, compare and export all trainings, also those of deleted models.\n\n"
    "Every training leaves a record in the bucket. `dr-history` alone lists them. A training is "
    "named by its id or the beginning of it, or by its model: MODEL is its newest training, "
    "MODEL~1 the one before.\n\nExample: dr-history --world reinvent_base --sort lap",
)

Order = Literal["began", "lap", "progress", "score", "iterations", "hours", "cost", "model"]

_Training = Annotated[
    str,
    typer.Argument(
        metavar="TRAINING",
        help="Id of a training, or MODEL, or MODEL~1 for the one before.",
        autocompletion=candidates.model_prefixes,
    ),
]
_Since = Annotated[
    str | None,
    typer.Option("--since", metavar="WHEN", help="Begun since a date, or an age such as 7d."),
]
_Until = Annotated[
    str | None,
    typer.Option("--until", metavar="WHEN", help="Begun before a date, or an age such as 12h."),
]


@app.command("list")
def list_trainings(
    pattern: Annotated[
        str,
        typer.Argument(
            metavar="PATTERN",
            help="Part of a model's name, or a whole name with * and ?.",
            autocompletion=candidates.model_prefixes,
        ),
    ] = "",
    world: Annotated[
        str | None,
        typer.Option(
            "--world",
            metavar="TRACK",
            help="Only on this track; * and ? are allowed.",
            autocompletion=candidates.worlds,
        ),
    ] = None,
    state: Annotated[
        str | None,
        typer.Option(
            "--state", metavar="STATES", help="Only these, such as finished or failed,lost."
        ),
    ] = None,
    since: _Since = None,
    until: _Until = None,
    where: Annotated[
        list[str] | None,
        typer.Option(
            "--where",
            metavar="TEST",
            help="Only if a value passes a test, such as 'lr<0.001' or DR_RACE_TYPE=TIME_TRIAL.",
        ),
    ] = None,
    sort: Annotated[
        Order,
        typer.Option("--sort", help="Order; the newest, the largest and the best come last."),
    ] = "began",
    limit: Annotated[
        int, typer.Option("-n", "--limit", min=0, metavar="N", help="Only the last N; 0 for all.")
    ] = 0,
    csv: Annotated[
        Path | None,
        typer.Option("--csv", metavar="FILE", help="Write a CSV table; - for standard output."),
    ] = None,
    force: Replace = False,
    as_json: AsJson = False,
) -> None:
    """List trainings, the newest last.

    Example: dr-history list --world reinvent_base --where "best_lap_s<12" --sort lap
    """
    from drcli.models import training_filter
    from drcli.models.training_choice import chosen

    if csv is not None and str(csv) != "-":
        refuse_replacing(csv, force=force)
    now = datetime.now(UTC)
    conditions: list[Condition] = []
    if pattern:
        conditions.append(training_filter.of_model(pattern))
    if state is not None:
        conditions.append(training_filter.in_state(state))
    if since is not None:
        conditions.append(training_filter.began("--since", since, now, after=True))
    if until is not None:
        conditions.append(training_filter.began("--until", until, now, after=False))
    _, known = _known()
    if world is not None:
        conditions.append(training_filter.where(f"world={world}", ["world"]))
    if where:
        names = _names(known)
        conditions += [training_filter.where(text, names) for text in where]
    found = chosen(known, conditions, sort, limit)
    if csv is not None:
        from drcli.models.training_table import csv_table

        _write(csv, csv_table(known, found.trainings))
        if str(csv) == "-":
            return
    console.emit(found, training_history_view.trainings(found), as_json=as_json)


@app.command()
def show(
    training: _Training,
    save: Annotated[
        Path | None,
        typer.Option("--save", metavar="FOLDER", help="Write the files of the training there."),
    ] = None,
    force: Replace = False,
    as_json: AsJson = False,
) -> None:
    """Show all that was recorded of a training.

    Example: dr-history show team/model-1 --save old-files
    """
    from drcli.models.training_details import details_of

    bucket, known = _known()
    found = details_of(bucket, known, training, save=save, force=force)
    console.emit(found, training_history_view.details(found), as_json=as_json)


@app.command()
def compare(
    before: _Training,
    after: Annotated[
        str,
        typer.Argument(
            metavar="OTHER",
            help="The training to compare with it.",
            autocompletion=candidates.model_prefixes,
        ),
    ],
    as_json: AsJson = False,
) -> None:
    """Compare two trainings: settings, files, machine, and what they came to.

    Example: dr-history compare team/model-1 team/model-2
    """
    from drcli.models.training_comparison import compare as compare_trainings
    from drcli.models.training_details import compared

    bucket, known = _known()
    one, other = (compared(bucket, known, name) for name in (before, after))
    found = compare_trainings(one, other)
    console.emit(found, training_history_view.comparison(found), as_json=as_json)


@app.command()
def tree(
    training: Annotated[
        str | None,
        typer.Argument(
            metavar="TRAINING",
            help="Only the family of this training: an id, or a model.",
            autocompletion=candidates.model_prefixes,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Show which training began with whose weights, and what each has changed.

    Example: dr-history tree team/model-2
    """
    from drcli.models.family_tree import family_tree

    _, known = _known()
    found = family_tree(known, None if training is None else known.find(training))
    console.emit(found, training_history_view.tree(found), as_json=as_json)


@app.command()
def forget(
    trainings: Annotated[
        list[str], typer.Argument(metavar="TRAINING...", help="Ids of trainings, or models.")
    ],
    force: Force = False,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Delete the records of trainings, with the copies of their files; models stay.

    Example: dr-history forget 3f9a01c2
    """
    from drcli.models import training_details
    from drcli.models.training_entry import entry_of
    from drcli.store.connect import COMMAND_PATIENCE_S, open_bucket

    bucket = open_bucket(settings().storage, patience_s=COMMAND_PATIENCE_S)
    known = _read(bucket)
    records = training_details.plan_forgetting(known, trainings)
    entries = [entry_of(record, exists=record.id in known.existing) for record in records]
    found = training_details.ForgottenTrainings(bucket.name, entries, dry_run)
    if not dry_run:
        console.err.print(training_history_view.forgotten(found))
        prompts.agree("Delete these records? It cannot be undone.", yes=force)
        training_details.forget(bucket, records)
    console.emit(found, training_history_view.forgotten(found), as_json=as_json)


def _known() -> "tuple[Bucket, KnownTrainings]":
    from drcli.base.errors import Absent
    from drcli.store.connect import open_running_bucket

    loaded = settings()
    bucket = open_running_bucket(loaded.storage)
    if bucket is None:
        raise Absent(
            f"s3://{loaded.bucket} has no trainings yet, or its local server does not run.",
            remedy="Start a training with `dr-start-training`.",
        )
    return bucket, _read(bucket)


def _read(bucket: "Bucket") -> "KnownTrainings":
    from drcli.models.training_list import known_trainings

    with console.waiting(f"Reading s3://{bucket.name} ...", only_live=True):
        known = known_trainings(bucket)
    console.warn(*known.damaged)
    return known


def _names(known: "KnownTrainings") -> list[str]:
    from dataclasses import fields

    from drcli.config.settings import catalogue
    from drcli.modelfiles.hyperparameters import KEYS
    from drcli.models.training_entry import TrainingEntry

    named = {name for record in known.records for name in record.hyperparameters}
    return [*(each.name for each in fields(TrainingEntry)), *sorted({*named, *KEYS}), *catalogue()]


def _write(target: Path, text: str) -> None:
    from drcli.base.atomic_file import rewrite

    if str(target) == "-":
        console.write(text)
        return
    rewrite(target, text.encode())
    console.say(f"Wrote {target}.")
