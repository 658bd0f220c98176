"""`dr stop-training`."""

from drcli.commands.folder import settings, working_folder


def stop_training() -> None:
    """Stop the running training.

    Everything learned so far is in the bucket; dr-start-training --resume goes on with it.
    Harmless when nothing runs.

    Example: dr-stop-training
    """
    from drcli import console
    from drcli.errors import SettingsError
    from drcli.runs.stopping import stop_the_only_training
    from drcli.runs.training import is_running, stop

    folder = working_folder()
    try:
        loaded = settings()
    except SettingsError:
        # What is broken now was right at the start, and must not keep a training alive.
        stopped = stop_the_only_training(folder)
        if stopped is None:
            raise
        console.say(f"Stopped the training of {stopped.model}, whatever the settings say now.")
        return
    if not is_running(loaded, folder):
        console.say("No training is running.")
        return
    report = stop(loaded, directory=folder)
    model = f"s3://{report.bucket}/{report.prefix}"
    if is_running(loaded, folder):
        console.say(
            f"The training of {model} (process {report.pid}) is still leaving. "
            "`dr-stop-training` again stops it at once."
        )
        return
    newest = f"; its last checkpoint is {report.last.name}" if report.last else ""
    console.say(f"Stopped the training of {model}{newest}.")
    console.suggest(
        [
            ("dr-start-training --resume", "go on training"),
            ("dr-evaluate", "see how the best checkpoint drives"),
            ("dr-status", "how the training went"),
        ]
    )
