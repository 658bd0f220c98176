"""`dr stop-all`."""

from drcli.cli.options import AsJson
from drcli.cli.working_folder import settings, working_folder


def stop_all(as_json: AsJson = False) -> None:
    """Stop everything that was started in this folder.

    Trainings and evaluations of every DR_RUN_ID end, then the folder's local S3 server. Everything
    learned so far is in the bucket, and objects stay. Nothing else on the machine is touched.
    Harmless when nothing runs.

    Example: dr-stop-all
    """
    from drcli.cli import console
    from drcli.cli.views import everyday
    from drcli.runs.stopping import stop_all as stop_everything

    with console.waiting("Stopping everything that was started in this folder ..."):
        report = stop_everything(working_folder(), lambda: settings().storage)
    console.emit(report, everyday.stopped(report), as_json=as_json)
