"""`dr start-training`."""

from typing import Annotated

import typer

from drcli.commands.folder import settings, working_folder


def start_training(
    wipe: Annotated[
        bool, typer.Option("-w", "--wipe", help="Delete what lies under the model prefix.")
    ] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with what lies under the model prefix.")
    ] = False,
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Return at once.")] = False,
    verbose: Annotated[
        bool, typer.Option("-v", "--verbose", help="Show each iteration's numbers as lines.")
    ] = False,
    follow_trainer: Annotated[
        bool, typer.Option("-s", help="Follow the trainer's log instead of the display.")
    ] = False,
    follow_worker: Annotated[
        bool, typer.Option("-r", help="Follow the simulation worker's log instead.")
    ] = False,
    foreground: Annotated[
        bool, typer.Option("--foreground", help="Stay the process that runs the training.")
    ] = False,
    max_minutes: Annotated[
        float | None, typer.Option("--max-minutes", min=0.01, help="Finish after that time.")
    ] = None,
    until_laps: Annotated[
        int | None,
        typer.Option(
            "--until-laps",
            min=1,
            help="Finish once a checkpoint completes all its evaluation laps, at least so many.",
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option("--seed", min=0, help="Repeat a training exactly.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON object on the last line of stdout.")
    ] = False,
) -> None:
    """Train the model that run.env describes.

    Your reward_function.py, hyperparameters.json and model_metadata.json are taken from
    custom_files/, else from the bucket; without any of your own, shipped examples are used.
    Everything is checked before anything starts. On a terminal a live display follows; Ctrl-C
    leaves it and the training goes on.

    Example: dr-start-training --until-laps 3
    """
    from drcli import console, views
    from drcli.commands import watching
    from drcli.runs import training
    from drcli.runs.status import inspect

    loaded, folder = settings(), working_folder()
    options = training.StartOptions(wipe, resume, max_minutes, until_laps, seed)
    plan = training.prepare(loaded, options, folder)
    for warning in plan.warnings:
        console.warn(warning)
    if not quiet:
        console.say(views.start_text(plan))

    if foreground:
        with watching.lines(loaded, folder):
            code = training.supervise(plan)
    else:
        training.launch(plan)
        if quiet:
            console.say(f"Training of s3://{loaded.bucket}/{loaded.model_prefix} started.")
            return
        console.suggest("Next:", watching.NEXT)
        if follow_trainer or follow_worker:
            watching.log(loaded, folder, "trainer" if follow_trainer else "sim-0")
            return
        ended = watching.until_the_end(
            loaded, folder, live=console.is_live() and not verbose and not as_json
        )
        if ended is None:
            console.say("Detached; the training goes on.")
            return
        code = ended
    report = inspect(loaded, folder)
    if as_json:
        console.emit(report, "", as_json=True)
    if report.state == "failed":
        console.fail(report.message, report.remedy)
    else:
        console.say(views.end_text(report))
    raise typer.Exit(code)
