"""`dr status` and `dr summary`."""

from dataclasses import replace

from drcli.base.errors import WorkerDied
from drcli.cli import console
from drcli.cli.options import AsJson
from drcli.cli.show import show
from drcli.cli.views import training_view
from drcli.cli.working_folder import settings


def status(as_json: AsJson = False) -> None:
    """Show whether the training is running and how well the car drives.

    Exits 5 when a worker has died, so that a script can react.

    Example: dr-status --json
    """
    from drcli.run.status import inspect, notes_of_run

    loaded = settings()
    config = loaded.run
    report = inspect(config)
    report = replace(report, notes=notes_of_run(config, report))
    console.warn(*report.damaged)
    console.emit(report, training_view.run(report), as_json=as_json)
    if commands := training_view.next_commands(report, loaded.model_prefix):
        console.suggest(commands)
    if report.state == "lost" or report.dead:
        raise WorkerDied(
            report.message or f"Dead: {', '.join(report.dead)}.",
            remedy=report.remedy
            or f"Read the reason with `dr-logs {(report.dead or ['trainer'])[0]}`.",
        )


def summary(as_json: AsJson = False) -> None:
    """Show settings, bucket, runs and machine on one page.

    Lists what runs in this folder under every DR_RUN_ID. Starts no server, and waits at most two
    seconds for the bucket.

    Example: dr-summary
    """
    from drcli.run.summary import summarize

    show(summarize(settings()), as_json=as_json)
