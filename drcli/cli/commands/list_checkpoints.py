"""`dr list-checkpoints`."""

from typing import Annotated

import typer

from drcli.cli import console
from drcli.cli.options import AsJson, models_argument
from drcli.cli.views import checkpoints_view
from drcli.cli.working_folder import settings


def list_checkpoints(
    model: Annotated[
        str | None,
        models_argument("MODEL", "Prefix of a model; that of run.env if left out."),
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Read all weights, and report damaged ones.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """List the checkpoints of a model, with the laps of their evaluations during the training.

    Numbers and words of the list are what --checkpoint takes. A training keeps the newest four, the
    best, the milestones, and every n-th if you want (DR_TRAIN_KEEP_EVERY).

    Example: dr-list-checkpoints team/model-1
    """
    from drcli.models import checkpoint_list
    from drcli.models.transfer_buckets import bucket_to_look_at

    loaded = settings()
    prefix = loaded.model_prefix if model is None else model.rstrip("/")
    bucket = bucket_to_look_at(loaded.transfer, upload=False)
    with console.waiting(f"Reading s3://{bucket.name}/{prefix} ..."):
        found = checkpoint_list.list_checkpoints(loaded.model, bucket, prefix, check=check)
    console.warn(*found.damaged)
    console.emit(found, checkpoints_view.checkpoints(found), as_json=as_json)
