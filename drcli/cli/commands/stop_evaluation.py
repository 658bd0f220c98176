"""`dr stop-evaluation`."""

from drcli.cli import console
from drcli.cli.options import AsJson
from drcli.cli.views import summary_view
from drcli.cli.working_folder import settings, working_folder
from drcli.runs import stopping


def stop_evaluation(as_json: AsJson = False) -> None:
    """Stop the running evaluations of this DR_RUN_ID, whichever shell started them.

    They end within a second with exit code 143 and without results. Does nothing when none is
    running.

    Example: dr-stop-evaluation
    """
    stopped = stopping.stop_evaluations(working_folder(), settings().run_id)
    report = stopping.StopReport(stopped)
    console.emit(report, summary_view.stopped_evaluations(report), as_json=as_json)
