"""`dr status` and `dr summary`."""

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

from drcli.base.errors import WorkerDied
from drcli.base.installation import lazy_imports
from drcli.cli import follow_training, terminal, training_display
from drcli.cli.show import show
from drcli.cli.working_folder import settings

if TYPE_CHECKING:
    from drcli.config.settings import Settings

with lazy_imports():
    from drcli.run import status as run_status
    from drcli.run import summary as run_summary


_Verbose = Annotated[bool, typer.Option("-v", "--verbose", help="Show more numbers.")]


def attach(verbose: _Verbose = False) -> None:
    """Show the live display of the running training again.

    Works in every shell, and on every machine that reaches the bucket of the training. Ctrl-C
    leaves the display and the training continues. Like dr-start-training, exits with the training,
    with the same code; away from a terminal, prints a line for each iteration from now on.

    Example: dr-attach
    """
    status(follow=True, verbose=verbose)


def status(
    follow: Annotated[
        bool,
        typer.Option("-f", "--follow", help="Show the live display until it ends (dr-attach)."),
    ] = False,
    verbose: Annotated[
        bool, typer.Option("-v", "--verbose", help="With -f: more numbers.")
    ] = False,
) -> None:
    """Show whether the training is running and how well the car drives.

    Also tells of a training of this model on another machine. Exits 5 when a worker has died, so
    that a script can react.

    Example: dr-status --json
    """
    show_status(settings(), follow=follow, verbose=verbose)


def show_status(
    loaded: "Settings",
    *,
    follow: bool,
    verbose: bool,
    commands: list[tuple[str, str]] | None = None,
    options: Mapping[str, str | None] | None = None,
    before_any: str = "",
) -> None:
    """Show the training of these settings.

    `commands` are what to do next, with these `options`, if not the usual ones. `before_any` is
    said of a training that another machine is to start, until it does.

    Raises:
        WorkerDied: A worker is dead.
    """
    config = loaded.run
    report = run_status.inspect(config, anywhere=True)
    if report.state == "none":
        report = replace(report, elsewhere=report.elsewhere or before_any)
    if follow and not follow_training.is_over(report):
        display = follow_training.suitable(config, verbose=verbose)
        raise typer.Exit(follow_training.follow(config, display, loaded.model_prefix))
    if follow and not report.unreachable:
        terminal.say("No training is running.")
    report = replace(report, notes=run_status.notes_of_run(config, report))
    terminal.warn(*report.damaged)
    terminal.emit(report, training_display.run(report))
    if commands is None:
        commands = training_display.next_commands(report)
    terminal.suggest(commands, model=report.prefix, usual=loaded.model_prefix, options=options)
    if report.state == "lost" or report.dead:
        raise WorkerDied(
            report.message or f"Dead: {', '.join(report.dead)}.",
            remedy=report.remedy
            or f"Read the reason with `dr-logs {(report.dead or ['trainer'])[0]}`.",
        )


def summary() -> None:
    """Show settings, bucket, runs and machine on one page.

    Lists what runs in this folder under every DR_RUN_ID. Starts no server, and waits at most two
    seconds for the bucket.

    Example: dr-summary
    """
    show(run_summary.summarize(settings()))
