"""`dr stop-all`."""

from drcli.cli import console
from drcli.cli.options import AsJson
from drcli.cli.views import summary_view
from drcli.cli.working_folder import settings, working_folder
from drcli.runs import stopping


def stop_all(as_json: AsJson = False) -> None:
    """Stop everything that was started in this folder.

    Stops the trainings and evaluations of every DR_RUN_ID, then the folder's local S3 server. What
    was learned so far stays in the bucket. Does nothing when nothing is running.

    Example: dr-stop-all
    """
    with console.waiting("Stopping everything that was started in this folder ..."):
        report = stopping.stop_all(working_folder(), lambda: settings().storage)
    console.emit(report, summary_view.stopped(report), as_json=as_json)
