"""`dr delete-model`."""

from typing import Annotated

import typer

from drcli.base.errors import SettingsError
from drcli.base.installation import lazy_imports
from drcli.cli import prompts, terminal
from drcli.cli.options import DryRun, Force, KeepModels, models_argument
from drcli.cli.show import drawn, show
from drcli.cli.working_folder import settings

with lazy_imports():
    from drcli.transfer import model_removal


def delete_model(
    models: Annotated[
        list[str],
        models_argument("MODEL...", "Prefixes of models, or patterns with * and ?."),
    ],
    keep: KeepModels = None,
    forget: Annotated[
        bool,
        typer.Option("--forget", help="Delete the records of their trainings, too (dr-history)."),
    ] = False,
    force: Force = False,
    dry_run: DryRun = False,
) -> None:
    """Delete models from the bucket, with all their traces.

    Deletes checkpoints, metrics, traces, logs, notes, rollouts, the records of runs and the report
    of dr-start-loganalysis, in the bucket and on this machine. Shows first what would go and how
    large it is, and asks. A model that is being trained on any machine, or evaluated on this one,
    is never deleted. What dr-history shows stays, unless --forget is given, and so do files that
    dr-video, dr-analyze and others wrote elsewhere.

    Example: dr-delete-model "old/*" --keep old/fast --dry-run
    """
    loaded = settings()
    planned = model_removal.plan_removal(loaded, models, keep or (), dry_run=dry_run, forget=forget)
    if not planned.traces:
        raise SettingsError(
            "--keep leaves nothing to delete.", remedy="Leave it out, or name other models."
        )
    for model in planned.report.models:
        if model.warning:
            terminal.warn(f"{model.prefix}: {model.warning}.")
    if not dry_run:
        terminal.err.print(drawn(planned.report, planned=True))
        prompts.agree("Delete all of this? It cannot be undone.", yes=force)
        with terminal.waiting("Deleting ..."):
            model_removal.remove_models(planned, loaded)
    show(planned.report, planned=dry_run)
