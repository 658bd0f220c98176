"""`dr stop-evaluation`."""

from typing import Annotated

import typer

from drcli.commands.folder import settings, working_folder


def stop_evaluation(
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON object on the last line of stdout.")
    ] = False,
) -> None:
    """End a running evaluation of this DR_RUN_ID, whichever shell started it.

    It leaves within a second, with exit code 143 there and no results. Harmless when none runs.

    Example: dr-stop-evaluation
    """
    from drcli import console, views_everyday
    from drcli.runs.stopping import StopReport, stop_evaluations

    stopped = stop_evaluations(working_folder(), settings().run_id)
    report = StopReport(stopped)
    console.emit(report, views_everyday.stopped_evaluations(report), as_json=as_json)
