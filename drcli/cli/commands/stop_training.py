"""`dr stop-training`."""

from drcli.cli.options import AsJson
from drcli.cli.working_folder import settings, working_folder

AFTERWARDS = [
    ("dr-start-training --resume", "go on training"),
    ("dr-evaluate", "see how the best checkpoint drives"),
    ("dr-status", "how the training went"),
]
AFTER_NOTHING = [("dr-start-training -w", "start again")]
"""What somebody may want to do after a stop, the second before the first checkpoint."""


def stop_training(as_json: AsJson = False) -> None:
    """Stop the running training.

    Everything learned so far is in the bucket; dr-start-training --resume goes on with it.
    Harmless when nothing runs.

    Example: dr-stop-training
    """
    from drcli.base.errors import SettingsError, WorkerDied
    from drcli.cli import console
    from drcli.runs.stopping import (
        Stopped,
        StopReport,
        is_running,
        stop,
        stop_the_only_training,
    )

    folder = working_folder()
    try:
        loaded = settings()
    except SettingsError:
        # What is broken now was right at the start, and must not keep a training alive.
        stopped = stop_the_only_training(folder)
        if stopped is None:
            raise
        said = f"Stopped the training of {stopped.model}, whatever the settings say now."
        console.emit(StopReport([stopped]), said, as_json=as_json)
        return
    if not is_running(loaded.run):
        console.emit(StopReport(), "No training is running.", as_json=as_json)
        return
    with console.waiting("Stopping the training; its workers are leaving ..."):
        report = stop(loaded.run)
    model = f"s3://{report.bucket}/{report.prefix}"
    if is_running(loaded.run):
        raise WorkerDied(
            f"The training of {model} (process {report.pid}) is still leaving.",
            remedy="Stop it at once with `dr-stop-training`, a second time.",
        )
    newest = (
        f"its last checkpoint is {report.last.name}" if report.last else "it had learned nothing"
    )
    stopped = Stopped("training", report.run_id, model, report.pid or 0)
    console.emit(
        StopReport([stopped]), f"Stopped the training of {model}; {newest}.", as_json=as_json
    )
    console.suggest(AFTERWARDS if report.last else AFTER_NOTHING)
