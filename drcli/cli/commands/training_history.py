"""`dr history`."""

from dataclasses import fields
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.console import Group, RenderableType
from rich.text import Text

from drcli.base.errors import Absent
from drcli.base.files import refuse_replacing, rewrite
from drcli.base.installation import lazy_imports
from drcli.base.report import printable
from drcli.cli import completion, prompts, terminal
from drcli.cli.options import DryRun, Force, Replace
from drcli.cli.show import drawn, indented
from drcli.cli.show import show as present
from drcli.cli.working_folder import settings

if TYPE_CHECKING:
    from drcli.bucket.bucket import Bucket
    from drcli.transfer.family_tree import FamilyMember, FamilyTree
    from drcli.transfer.training_list import Condition, KnownTrainings

with lazy_imports():
    from drcli.bucket import connect
    from drcli.config import settings as config_settings
    from drcli.model.files import hyperparameters
    from drcli.transfer import family_tree, training_details, training_list


# Shows the history of trainings.


_MOST_INDENT = 16


def show_tree(found: "FamilyTree") -> RenderableType:
    if not found.members:
        return Text(f"There is no training in s3://{found.bucket} yet.")
    parts: list[RenderableType] = [Text(f"s3://{found.bucket}", style="bold")]
    for member in found.members:
        indent = min(2 * member.depth, _MOST_INDENT)
        parts.append(indented(_member(member), indent) if indent else _member(member))
        if member.changes:
            parts.append(indented(Text(printable("; ".join(member.changes)), "dim"), indent + 4))
    return Group(*parts)


def _member(member: "FamilyMember") -> Text:
    name = Text(printable(member.model), style="bold" if member.asked else "")
    if member.training is None:
        what = "no training here has made it" if member.exists else "not in this bucket"
        return name.append(f" ({what})", "dim")
    each = member.training
    words = [each.id, each.began_at[:10] or "-", printable(each.world)]
    words.append(f"best lap {each.best_lap_s:.2f} s" if each.best_lap_s is not None else "")
    if not words[-1] and each.best_progress is not None:
        words[-1] = f"progress {each.best_progress:.0f} %"
    words += [each.state, "" if member.exists else "gone"]
    if member.weights:
        words.append(f"from checkpoint {member.weights.partition('_')[0]}")
    return name.append(f"  {', '.join(word for word in words if word)}", "dim")


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
        autocompletion=completion.model_prefixes,
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
            autocompletion=completion.model_prefixes,
        ),
    ] = "",
    world: Annotated[
        str | None,
        typer.Option(
            "--world",
            metavar="TRACK",
            help="Only on this track; * and ? are allowed.",
            autocompletion=completion.worlds,
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
) -> None:
    """List trainings, the newest last.

    Example: dr-history list --world reinvent_base --where "best_lap_s<12" --sort lap
    """
    if csv is not None and str(csv) != "-":
        refuse_replacing(csv, force=force)
    now = datetime.now(UTC)
    conditions: list[Condition] = []
    if pattern:
        conditions.append(training_list.of_model(pattern))
    if state is not None:
        conditions.append(training_list.in_state(state))
    if since is not None:
        conditions.append(training_list.began("--since", since, now, after=True))
    if until is not None:
        conditions.append(training_list.began("--until", until, now, after=False))
    _, known = _known()
    if world is not None:
        conditions.append(training_list.where(f"world={world}", ["world"]))
    if where:
        names = _names(known)
        conditions += [training_list.where(text, names) for text in where]
    found = training_list.chosen(known, conditions, sort, limit)
    if csv is not None:
        _write(csv, training_list.csv_table(known, found.trainings))
        if str(csv) == "-":
            return
    present(found)


@app.command()
def show(
    training: _Training,
    save: Annotated[
        Path | None,
        typer.Option("--save", metavar="FOLDER", help="Write the files of the training there."),
    ] = None,
    force: Replace = False,
) -> None:
    """Show all that was recorded of a training.

    Example: dr-history show team/model-1 --save old-files
    """
    bucket, known = _known()
    present(training_details.details_of(bucket, known, training, save=save, force=force))


@app.command()
def compare(
    before: _Training,
    after: Annotated[
        str,
        typer.Argument(
            metavar="OTHER",
            help="The training to compare with it.",
            autocompletion=completion.model_prefixes,
        ),
    ],
) -> None:
    """Compare two trainings: settings, files, machine, and what they came to.

    Example: dr-history compare team/model-1 team/model-2
    """
    bucket, known = _known()
    one, other = (training_details.compared(bucket, known, name) for name in (before, after))
    present(training_details.compare(one, other))


@app.command()
def tree(
    training: Annotated[
        str | None,
        typer.Argument(
            metavar="TRAINING",
            help="Only the family of this training: an id, or a model.",
            autocompletion=completion.model_prefixes,
        ),
    ] = None,
) -> None:
    """Show which training began with whose weights, and what each has changed.

    Example: dr-history tree team/model-2
    """
    _, known = _known()
    found = family_tree.family_tree(known, None if training is None else known.find(training))
    terminal.emit(found, show_tree(found))


@app.command()
def forget(
    trainings: Annotated[
        list[str], typer.Argument(metavar="TRAINING...", help="Ids of trainings, or models.")
    ],
    force: Force = False,
    dry_run: DryRun = False,
) -> None:
    """Delete the records of trainings, with the copies of their files; models stay.

    Example: dr-history forget 3f9a01c2
    """
    bucket = connect.open_bucket(settings().storage, patience_s=connect.COMMAND_PATIENCE_S)
    known = _read(bucket)
    records = training_details.plan_forgetting(known, trainings)
    entries = [
        training_list.entry_of(record, exists=record.id in known.existing) for record in records
    ]
    found = training_details.ForgottenTrainings(bucket.name, entries, dry_run)
    if not dry_run:
        terminal.err.print(drawn(found))
        prompts.agree("Delete these records? It cannot be undone.", yes=force)
        training_details.forget(bucket, records)
    present(found)


def _known() -> "tuple[Bucket, KnownTrainings]":
    loaded = settings()
    bucket = connect.open_running_bucket(loaded.storage)
    if bucket is None:
        raise Absent(
            f"s3://{loaded.bucket} has no trainings yet, or its local server does not run.",
            remedy="Start a training with `dr-start-training`.",
        )
    return bucket, _read(bucket)


def _read(bucket: "Bucket") -> "KnownTrainings":
    with terminal.waiting(f"Reading s3://{bucket.name} ...", only_live=True):
        known = training_list.known_trainings(bucket)
    terminal.warn(*known.damaged)
    return known


def _names(known: "KnownTrainings") -> list[str]:
    named = {name for record in known.records for name in record.hyperparameters}
    return [
        *(each.name for each in fields(training_list.TrainingEntry)),
        *sorted({*named, *hyperparameters.KEYS}),
        *config_settings.catalogue(),
    ]


def _write(target: Path, text: str) -> None:
    if str(target) == "-":
        terminal.write(text)
        return
    rewrite(target, text.encode())
    terminal.say(f"Wrote {target}.")
