"""`dr stop-evaluation`."""

from drcli.cli.options import AsJson
from drcli.cli.working_folder import settings, working_folder


def stop_evaluation(as_json: AsJson = False) -> None:
    """End a running evaluation of this DR_RUN_ID, whichever shell started it.

    It leaves within a second, with exit code 143 there and no results. Harmless when none runs.

    Example: dr-stop-evaluation
    """
    from drcli.cli import console
    from drcli.cli.views import everyday
    from drcli.runs.stopping import StopReport, stop_evaluations

    stopped = stop_evaluations(working_folder(), settings().run_id)
    report = StopReport(stopped)
    console.emit(report, everyday.stopped_evaluations(report), as_json=as_json)
