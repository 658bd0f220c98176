"""`dr stop-training`."""

from drcli.base.errors import SettingsError, WorkerDied
from drcli.cli import console
from drcli.cli.options import AsJson
from drcli.cli.working_folder import settings, working_folder
from drcli.runs import stopping
from drcli.runs.stopping import Stopped, StopReport

AFTERWARDS = [
    ("dr-start-training --resume", "continue training"),
    ("dr-evaluate", "drive laps with the best checkpoint"),
    ("dr-status", "show how the training went"),
]
AFTER_NOTHING = [("dr-start-training -w", "start again")]
"""What to do after a stop; the second list is for a stop before the first checkpoint."""


def stop_training(as_json: AsJson = False) -> None:
    """Stop the running training.

    What was learned so far stays in the bucket; dr-start-training --resume continues it. Does
    nothing when no training is running.

    Example: dr-stop-training
    """
    folder = working_folder()
    try:
        loaded = settings()
    except SettingsError:
        # Settings that broke after the start must not keep the training from being stopped.
        stopped = stopping.stop_the_only_training(folder)
        if stopped is None:
            raise
        said = f"Stopped the training of {stopped.model}; the settings are broken now."
        console.emit(StopReport([stopped]), said, as_json=as_json)
        return
    if not stopping.is_running(loaded.run):
        console.emit(StopReport(), "No training is running.", as_json=as_json)
        return
    with console.waiting("Stopping the training; waiting for its workers to exit ..."):
        report = stopping.stop(loaded.run)
    model = f"s3://{report.bucket}/{report.prefix}"
    if stopping.is_running(loaded.run):
        raise WorkerDied(
            f"The training of {model} (process {report.pid}) is still stopping.",
            remedy="Run `dr-stop-training` again to stop it at once.",
        )
    newest = (
        f"its last checkpoint is {report.last.name}" if report.last else "it has no checkpoint yet"
    )
    stopped = Stopped("training", report.run_id, model, report.pid or 0)
    console.emit(
        StopReport([stopped]), f"Stopped the training of {model}; {newest}.", as_json=as_json
    )
    console.suggest(AFTERWARDS if report.last else AFTER_NOTHING)
