"""`dr evaluate`, which the reference calls `dr-start-evaluation`."""

from typing import Annotated

import typer

from drcli.commands.folder import settings, working_folder


def evaluate(
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Only the result.")] = False,
    clone: Annotated[
        bool, typer.Option("-c", "--clone", help="Evaluate a copy at <prefix>-E.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON object on the last line of stdout.")
    ] = False,
) -> None:
    """Drive evaluation laps with the model and report them.

    DR_EVAL_CHECKPOINT chooses the best or the last checkpoint, the other DR_EVAL_ settings say how
    it is driven. The model is not changed, so it may still be training.

    Example: dr-evaluate --json
    """
    from drcli import console, views
    from drcli.runs import evaluation

    report = evaluation.evaluate(
        settings(),
        clone=clone,
        directory=working_folder(),
        on_progress=(lambda text: None) if quiet else console.say,
    )
    console.emit(report, views.evaluation(report), as_json=as_json)
    if not quiet:
        console.suggest(
            [
                ("dr-logs evaluation -a", "every step of it"),
                ("dr-start-training --resume", "go on training"),
                ("dr-status", "how the training went"),
            ]
        )
