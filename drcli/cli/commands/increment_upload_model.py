"""`dr increment-upload-model`."""

import shlex
from typing import Annotated

import typer

from drcli.cli import console, prompts
from drcli.cli.options import AsJson, Delimiter, Force
from drcli.cli.views import models_view
from drcli.cli.working_folder import settings
from drcli.models import upload_prefix


def increment_upload_model(
    force: Force = False,
    wipe: Annotated[
        bool,
        typer.Option("-w", "--wipe", help="Delete everything under the new name first."),
    ] = False,
    prefix: Annotated[
        str | None,
        typer.Option("-p", "--prefix", metavar="PREFIX", help="Use this name for the next upload."),
    ] = None,
    delimiter: Delimiter = None,
    as_json: AsJson = False,
) -> None:
    """Give the next upload a new name: raise the number at the end of DR_UPLOAD_S3_PREFIX.

    Changes run.env and keeps a copy as run.env.bak. A name without a number gets -1.

    Example: dr-increment-upload-model -f
    """
    planned = upload_prefix.plan_upload_increment(
        settings(), prefix=prefix, delimiter=delimiter, wiping=wipe
    )
    step = planned.step
    console.say(f"Configuration file {step.file} will be updated.")
    console.say(f"Incrementing model from {step.before} to {step.after}")
    if step.wiped:
        place = f"s3://{planned.settings.upload_s3_bucket}/{step.after}"
        console.warn(f"{models_view.files(step.wiped)} at {place} will be deleted.")
    prompts.agree("Are you sure?", yes=force)
    upload_prefix.make_upload_increment(planned)
    console.emit(step, models_view.upload_increment(step), as_json=as_json)
    console.say("Done.")
    undo = shlex.join(["cp", str(step.backup), str(step.file)])
    console.suggest([("dr-upload-model", "upload the model there"), (undo, "undo this change")])
