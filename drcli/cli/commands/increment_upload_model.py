"""`dr increment-upload-model`."""

from typing import Annotated

import typer

from drcli.cli.increment_dialog import announce, finish
from drcli.cli.options import AsJson, Delimiter, Force
from drcli.cli.working_folder import settings


def increment_upload_model(
    force: Force = False,
    wipe: Annotated[
        bool, typer.Option("-w", "--wipe", help="Delete what lies there in the upload bucket.")
    ] = False,
    prefix: Annotated[
        str | None, typer.Option("-p", "--prefix", help="The next name, as it shall be.")
    ] = None,
    delimiter: Delimiter = None,
    as_json: AsJson = False,
) -> None:
    """Give the next upload a new name: raise the number at the end of DR_UPLOAD_S3_PREFIX.

    Edits run.env, of which a copy stays as run.env.bak. A name without a number gets -1.

    Example: dr-increment-upload-model -f
    """
    from drcli.cli import console, prompts
    from drcli.cli.views import models_view
    from drcli.models.upload_prefix import make_upload_increment, plan_upload_increment

    planned = plan_upload_increment(settings(), prefix=prefix, delimiter=delimiter, wiping=wipe)
    step = planned.step
    announce(step.file, step.before, step.after)
    if step.wiped:
        place = f"s3://{planned.settings.upload_s3_bucket}/{step.after}"
        console.warn(f"{models_view.files(step.wiped)} at {place} will be deleted.")
    prompts.agree("Are you sure?", yes=force)
    make_upload_increment(planned)
    console.emit(step, models_view.upload_increment(step), as_json=as_json)
    finish(step.file, step.backup, ("dr-upload-model", "upload the model there"))
