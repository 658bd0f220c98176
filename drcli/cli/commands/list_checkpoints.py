"""`dr list-checkpoints`."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Group, RenderableType
from rich.filesize import decimal
from rich.text import Text

from drcli.base.installation import lazy_imports
from drcli.cli import console
from drcli.cli.options import models_argument
from drcli.cli.views.layout import Rows, counted
from drcli.cli.working_folder import settings
from drcli.model.model_store import ModelStore

if TYPE_CHECKING:
    from drcli.model.checkpoint_list import CheckpointList, ListedCheckpoint, MilestoneEntry

with lazy_imports():
    from drcli.model import checkpoint_list
    from drcli.transfer import transfer_buckets

# Shows checkpoints and milestones.


def checkpoints(found: "CheckpointList") -> RenderableType:
    rows = [
        (
            str(each.number),
            _meaning(each),
            f"{each.laps} of {each.episodes}" if each.episodes else "-",
            "-" if each.progress is None else f"{each.progress:.1f} %",
            "-" if each.median_s is None else f"{each.median_s:.2f} s",
            "-" if each.best_lap_s is None else f"{each.best_lap_s:.2f} s",
            decimal(each.size_bytes),
        )
        for each in found.checkpoints
    ]
    names = ("checkpoint", "is", "clean laps", "progress", "median", "best lap", "size")
    parts: list[RenderableType] = [
        Text(found.model, style="bold"),
        Rows(names, rows, left=("is",)),
        Text(f"{counted(len(rows), 'checkpoint')}, {decimal(found.size_bytes)}."),
    ]
    if any(each.untaught for each in found.checkpoints):
        parts.append(Text("untaught: until there only the teacher has learned (docs/teacher.md)."))
    parts += [Text(line) for line in milestone_lines(found.milestones) if "deleted" in line]
    if found.not_reached:
        parts.append(Text(f"Not reached: {', '.join(found.not_reached)}."))
    problems = (f"{each.number}: {each.problem}" for each in found.checkpoints if each.problem)
    parts += [Text(f"Checkpoint {line}", style="bold yellow") for line in problems]
    return Group(*parts)


def milestone_lines(milestones: "Iterable[MilestoneEntry]") -> list[str]:
    return [
        f"{entry.word}: checkpoint {entry.checkpoint.partition('_')[0]}, "
        f"{entry.laps} of {counted(entry.episodes, 'lap')} clean, best {entry.best_lap_s:.2f} s"
        f"{'' if entry.kept else ' (deleted)'}"
        for entry in milestones
    ]


def _meaning(each: "ListedCheckpoint") -> str:
    words = [*each.words, *(["every n-th"] if each.every else [])]
    words += ["TensorFlow"] if each.form == "tensorflow" else []
    words += ["untaught"] if each.untaught else []
    return ", ".join(words) or "-"


def list_checkpoints(
    model: Annotated[
        str | None,
        models_argument("MODEL", "Prefix of a model; that of run.env if left out."),
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Read all weights, and report damaged ones.")
    ] = False,
) -> None:
    """List the checkpoints of a model, with the laps of their evaluations during the training.

    Numbers and words of the list are what --checkpoint takes. A training keeps the newest four, the
    best, the milestones, and every n-th if you want (DR_TRAIN_KEEP_EVERY).

    Example: dr-list-checkpoints team/model-1
    """
    loaded = settings()
    prefix = loaded.model_prefix if model is None else model.rstrip("/")
    bucket = transfer_buckets.bucket_to_look_at(loaded.transfer, upload=False)
    with console.waiting(f"Reading s3://{bucket.name}/{prefix} ..."):
        found = checkpoint_list.list_checkpoints(
            ModelStore.of(loaded.model, bucket, prefix), check=check
        )
    console.warn(*found.damaged)
    console.emit(found, checkpoints(found))
