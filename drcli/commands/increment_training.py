"""`dr increment-training`."""

from typing import Annotated

import typer

from drcli.commands.folder import settings, working_folder
from drcli.commands.increment import announce, finish
from drcli.commands.options import AsJson, Delimiter, Force


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
    from drcli import asking, console, views
    from drcli.runs.increment import make_increment, plan_increment

    loaded, folder = settings(), working_folder()
    planned = plan_increment(loaded, folder, prefix=prefix, delimiter=delimiter, wiping=wipe)
    step = planned.step
    announce(step.file, step.before, step.after)
    asking.agree("Are you sure?", yes=force)
    if step.wipes:
        asking.agree(f"Delete everything at s3://{step.bucket}/{step.after}?", yes=force)
    make_increment(planned, loaded, folder)
    console.emit(step, views.increment(step), as_json=as_json)
    finish(step.file, step.backup, ("dr-start-training", "train the new model"))
