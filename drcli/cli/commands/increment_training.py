"""`dr increment-training`."""

import shlex
from typing import Annotated

import typer

from drcli.cli import candidates, console, prompts
from drcli.cli.options import AsJson, Delimiter, Force
from drcli.cli.views import training_view
from drcli.cli.working_folder import settings


def increment_training(
    force: Force = False,
    wipe: Annotated[
        bool, typer.Option("-w", "--wipe", help="Delete everything under the new model prefix.")
    ] = False,
    prefix: Annotated[
        str | None,
        typer.Option(
            "-p",
            "--prefix",
            metavar="PREFIX",
            help="Name of the new model.",
            autocompletion=candidates.model_prefixes,
        ),
    ] = None,
    delimiter: Delimiter = None,
    as_json: AsJson = False,
) -> None:
    """Make the next training start a new model from this model's weights.

    Changes run.env and keeps a copy as run.env.bak: the current model becomes the pretrained one,
    and the number at the end of its name goes up by one. A name without a number gets -1.

    Example: dr-increment-training -f
    """
    from drcli.runs.increment import make_increment, plan_increment

    loaded = settings()
    planned = plan_increment(loaded, prefix=prefix, delimiter=delimiter, wiping=wipe)
    step = planned.step
    console.say(f"Configuration file {step.file} will be updated.")
    console.say(f"Incrementing model from {step.before} to {step.after}")
    prompts.agree("Are you sure?", yes=force)
    if step.wipes:
        prompts.agree(f"Delete everything at s3://{step.bucket}/{step.after}?", yes=force)
    make_increment(planned, loaded.storage)
    console.emit(step, training_view.increment(step), as_json=as_json)
    console.say("Done.")
    undo = shlex.join(["cp", str(step.backup), str(step.file)])
    console.suggest([("dr-start-training", "train the new model"), (undo, "undo this change")])
