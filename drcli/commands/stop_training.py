"""`dr stop-training`."""

from drcli.commands.folder import settings, working_folder


def stop_training() -> None:
    """Stop the running training.

    Everything learned so far is in the bucket; dr-start-training --resume goes on with it.
    Harmless when nothing runs.

    Example: dr-stop-training
    """
    from drcli import console
    from drcli.runs.training import is_running, stop

    loaded, folder = settings(), working_folder()
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
