"""`dr tidy`."""

from typing import Annotated

import typer

from drcli.base.installation import lazy_imports
from drcli.cli import prompts, terminal
from drcli.cli.options import DryRun, Force, KeepModels, models_argument
from drcli.cli.show import drawn, show
from drcli.cli.working_folder import settings

with lazy_imports():
    from drcli.transfer import tidy as transfer_tidy

_DAY_S = 86_400.0


def tidy(
    models: Annotated[
        list[str] | None,
        models_argument("MODEL...", "Only in these models: prefixes, or patterns with * and ?."),
    ] = None,
    only: Annotated[
        str | None,
        typer.Option(
            "--only",
            metavar="KINDS",
            help="Some of remains, damaged, rollouts, traces, checkpoints, logs.",
        ),
    ] = None,
    checkpoints: Annotated[
        str,
        typer.Option(
            "--checkpoints",
            metavar="RULES",
            help="Delete all checkpoints but these, such as last-2,best,milestones,every-50.",
        ),
    ] = "",
    keep: KeepModels = None,
    older_than: Annotated[
        float,
        typer.Option("--older-than", metavar="DAYS", min=0, help="Only what is older than this."),
    ] = 0.0,
    force: Force = False,
    dry_run: DryRun = False,
) -> None:
    """Delete what is left over in the bucket, and free its space.

    Without options: what remains of models that were not deleted or started completely (unless it
    is younger than an hour), damaged objects that a repair has set aside, and recorded episodes
    that no training needs any more. The traces of trainings, checkpoints, and local logs of deleted
    models go only if --only or --checkpoints says so. The best and the last checkpoint always stay.

    Shows first what would go and how large it is, and asks. Models that are being trained on any
    machine, or evaluated on this one, are left alone.

    Example: dr-tidy "team/*" --checkpoints milestones,every-100 --dry-run
    """
    kinds = transfer_tidy.read_kinds(only, checkpoints)
    loaded = settings()
    options = transfer_tidy.TidyOptions(
        models or (), keep or (), kinds, checkpoints, older_than * _DAY_S, dry_run
    )
    with terminal.waiting(f"Reading s3://{loaded.bucket} ..."):
        report = transfer_tidy.find_surplus(loaded, options)
    if report.items and not dry_run:
        terminal.err.print(drawn(report, planned=True))
        prompts.agree("Delete all of this? It cannot be undone.", yes=force)
        with terminal.waiting("Deleting ..."):
            report = transfer_tidy.tidy(report, loaded)
    show(report, planned=dry_run)
