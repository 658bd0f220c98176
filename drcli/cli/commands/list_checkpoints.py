"""`dr list-checkpoints`."""

from typing import Annotated

import typer

from drcli.base.installation import lazy_imports
from drcli.cli import terminal
from drcli.cli.options import models_argument
from drcli.cli.show import show
from drcli.cli.working_folder import settings
from drcli.model.model_store import ModelStore

with lazy_imports():
    from drcli.model import checkpoint_list
    from drcli.transfer import transfer_buckets


def list_checkpoints(
    model: Annotated[
        str | None,
        models_argument("MODEL", "Prefix of a model; that of run.env if left out."),
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Read all weights, and report damaged ones.")
    ] = False,
) -> None:
    """List the checkpoints of a model, with the laps of their evaluations during the training.

    Numbers and words of the list are what --checkpoint takes. A training keeps the newest four, the
    best, the milestones, and every n-th if you want (DR_TRAIN_KEEP_EVERY).

    Example: dr-list-checkpoints team/model-1
    """
    loaded = settings()
    prefix = loaded.model_prefix if model is None else model.rstrip("/")
    bucket = transfer_buckets.bucket_to_look_at(loaded.transfer, upload=False)
    with terminal.waiting(f"Reading s3://{bucket.name}/{prefix} ..."):
        found = checkpoint_list.list_checkpoints(
            ModelStore.of(loaded.model, bucket, prefix), check=check
        )
    terminal.warn(*found.damaged)
    show(found)
