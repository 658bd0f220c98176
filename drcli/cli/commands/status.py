"""`dr status` and `dr summary`."""

from dataclasses import replace

from drcli.base.errors import WorkerDied
from drcli.base.installation import lazy_imports
from drcli.cli import terminal, training_display
from drcli.cli.show import show
from drcli.cli.working_folder import settings

with lazy_imports():
    from drcli.run import status as run_status
    from drcli.run import summary as run_summary


def status() -> None:
    """Show whether the training is running and how well the car drives.

    Exits 5 when a worker has died, so that a script can react.

    Example: dr-status --json
    """
    loaded = settings()
    config = loaded.run
    report = run_status.inspect(config)
    report = replace(report, notes=run_status.notes_of_run(config, report))
    terminal.warn(*report.damaged)
    terminal.emit(report, training_display.run(report))
    if commands := training_display.next_commands(report, loaded.model_prefix):
        terminal.suggest(commands)
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
