"""`dr increment-training`."""

from typing import Annotated

import typer

from drcli.cli.increment_dialog import announce, finish
from drcli.cli.options import AsJson, Delimiter, Force
from drcli.cli.working_folder import settings


def increment_training(
    force: Force = False,
    wipe: Annotated[
        bool, typer.Option("-w", "--wipe", help="Delete what lies under the new model prefix.")
    ] = False,
    prefix: Annotated[
        str | None, typer.Option("-p", "--prefix", help="Name of the new model.")
    ] = None,
    delimiter: Delimiter = None,
    as_json: AsJson = False,
) -> None:
    """Make the next training go on from this model's weights, under a new name.

    Edits run.env, of which a copy stays as run.env.bak: the present model becomes the pretrained
    one and the number at the end of its prefix is raised. A name without a number gets -1.

    Example: dr-increment-training -f
    """
    from drcli.cli import console, prompts
    from drcli.cli.views import training_view
    from drcli.runs.increment import make_increment, plan_increment

    loaded = settings()
    planned = plan_increment(loaded, prefix=prefix, delimiter=delimiter, wiping=wipe)
    step = planned.step
    announce(step.file, step.before, step.after)
    prompts.agree("Are you sure?", yes=force)
    if step.wipes:
        prompts.agree(f"Delete everything at s3://{step.bucket}/{step.after}?", yes=force)
    make_increment(planned, loaded.storage)
    console.emit(step, training_view.increment(step), as_json=as_json)
    finish(step.file, step.backup, ("dr-start-training", "train the new model"))
