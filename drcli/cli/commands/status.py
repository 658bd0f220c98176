"""`dr status`."""

from drcli.cli.options import AsJson
from drcli.cli.working_folder import settings


def status(as_json: AsJson = False) -> None:
    """Show whether a training is alive and how far the car gets.

    Exits 5 when a worker is dead, so that a script can wait on it.

    Example: dr-status --json
    """
    from drcli.base.errors import WorkerDied
    from drcli.cli import console
    from drcli.cli.views import training_view
    from drcli.runs.status import inspect

    report = inspect(settings().run)
    for sentence in report.damaged:
        console.warn(sentence)
    console.emit(report, training_view.run(report), as_json=as_json)
    if report.state == "lost" or report.dead:
        raise WorkerDied(
            report.message or f"Dead: {', '.join(report.dead)}.",
            remedy=report.remedy
            or f"Read the reason with `dr-logs {(report.dead or ['trainer'])[0]}`.",
        )
