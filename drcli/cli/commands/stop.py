"""`dr stop-training`, `dr stop-evaluation` and `dr stop-all`."""

from dataclasses import replace

from drcli.base.errors import SettingsError, WorkerDied
from drcli.base.installation import lazy_imports
from drcli.cli import terminal
from drcli.cli.show import show
from drcli.cli.working_folder import settings, working_folder

with lazy_imports():
    from drcli.run import seen_in_bucket, stopping
    from drcli.web import viewer_process

AFTERWARDS = [
    ("dr-start-training --resume", "continue training"),
    ("dr-evaluate --checkpoint best", "drive laps with the best checkpoint"),
    ("dr-status", "show how the training went"),
]
AFTER_NOTHING = [("dr-start-training -w", "start again")]


def stop_training() -> None:
    """Stop the running training.

    What was learned so far stays in the bucket; dr-start-training --resume continues it, and
    --resume-or-start leaves it stopped. Also ends starts that wait for the end of a training
    elsewhere. Does nothing when no training is running. Exits 3 if another folder or machine trains
    the model: only that one can stop it.

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
        terminal.emit(stopping.StopReport([stopped]), said)
        return
    waiting = stopping.stop_waiting(loaded.directory, loaded.run_id)
    if not stopping.is_running(loaded.run):
        elsewhere = "" if waiting else seen_in_bucket.trained_elsewhere(loaded.run)
        if elsewhere:
            raise SettingsError(
                f"Nothing was stopped: {elsewhere}",
                remedy="Run `dr-stop-training` on that machine, in the folder that started it.",
            )
        show(stopping.StopReport(waiting), none="No training is running.")
        return
    with terminal.waiting("Stopping the training; waiting for its workers to exit ..."):
        report = stopping.stop(loaded.run)
    model = f"s3://{report.bucket}/{report.prefix}"
    if stopping.is_running(loaded.run):
        raise WorkerDied(
            f"The training of {model} (process {report.pid}) is still stopping.",
            remedy="Run `dr-stop-training` again to stop it at once.",
        )
    stopped = stopping.Stopped("training", report.run_id, model, report.pid or 0)
    last = report.last
    if last is not None:
        newest = f"its last checkpoint is {last.name}"
    elif report.unreachable:  # so it may well have one
        newest = f"whether it has a checkpoint is unknown: {report.unreachable.rstrip('.')}"
    else:
        newest = "it has no checkpoint yet"
    said = f"Stopped the training of {model}; {newest}."
    terminal.emit(stopping.StopReport([stopped, *waiting]), said)
    steps = AFTERWARDS if last or report.unreachable else AFTER_NOTHING
    terminal.suggest(steps, model=report.prefix, usual=loaded.model_prefix)


def stop_evaluation() -> None:
    """Stop the running evaluations of this DR_RUN_ID, whichever shell started them.

    They end within a second with exit code 143 and without results. Does nothing when none is
    running.

    Example: dr-stop-evaluation
    """
    report = stopping.StopReport(stopping.stop_evaluations(working_folder(), settings().run_id))
    show(report, none="No evaluation is running.")


def stop_all() -> None:
    """Stop everything that was started in this folder.

    Stops the console, the trainings and evaluations of every DR_RUN_ID, and the folder's local S3
    server. What was learned so far stays in the bucket. Does nothing when nothing is running.

    Example: dr-stop-all
    """
    folder = working_folder()
    if not (folder / "data").exists():  # nothing was ever started here
        settings()  # raises an error in a folder that is no working folder
    with terminal.waiting("Stopping everything that was started in this folder ..."):
        viewer = viewer_process.stop_viewer(
            folder
        )  # first: an open page would start the S3 server again
        report = stopping.stop_all(folder, lambda: settings().storage)
        report = replace(report, viewer=viewer is not None)
    show(report)
