"""`dr stop-training`."""

from drcli.commands.folder import settings, working_folder


def stop_training() -> None:
    """Stop the running training; everything learned so far is in the bucket.

    Harmless when nothing runs. Continue later with `dr-start-training --resume`.

    Example: dr-stop-training
    """
    from drcli import console
    from drcli.runs.training import is_running, stop

    loaded, folder = settings(), working_folder()
    if not is_running(loaded, folder):
        console.say("No training is running.")
        return
    report = stop(loaded, directory=folder)
    console.say(f"Stopped the training of s3://{report.bucket}/{report.prefix}.")
    console.suggest(
        "Next:",
        [
            ("dr-start-training --resume", "go on training"),
            ("dr-evaluate", "see how the best checkpoint drives"),
        ],
    )
