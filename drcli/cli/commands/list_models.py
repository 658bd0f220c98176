"""`dr list-models` and `dr list-aws-models`."""

from typing import Annotated

import typer

from drcli.base.installation import lazy_imports
from drcli.cli import terminal
from drcli.cli.options import models_argument
from drcli.cli.show import show
from drcli.cli.working_folder import settings

with lazy_imports():
    from drcli.model import model_list
    from drcli.transfer import minio_folder, transfer_buckets


_Pattern = Annotated[
    str, models_argument("PATTERN", "Part of a name, or a whole name with * and ?.")
]


def list_models(
    pattern: _Pattern = "",
    upload: Annotated[
        bool, typer.Option("--upload", help="List the models in the upload bucket.")
    ] = False,
) -> None:
    """List the models in the bucket: number of checkpoints, best and last one, size.

    The number in brackets after a checkpoint is its evaluation score.

    Example: dr-list-models "team/*"
    """
    loaded = settings()
    bucket = transfer_buckets.bucket_to_look_at(loaded.transfer, upload=upload)
    with terminal.waiting(f"Reading s3://{bucket.name} ..."):
        found = model_list.list_models(bucket, pattern)
    terminal.warn(*(sentence for model in found.models for sentence in model.damaged))
    show(found)
    if not upload:
        unread = minio_folder.unread_models(loaded.storage, loaded.directory, bucket)
        if unread:
            terminal.warn(" ".join(minio_folder.told_unread(unread, bucket)))


def list_aws_models(pattern: _Pattern = "") -> None:
    """List the models in the upload bucket, as `dr-list-models --upload` does.

    Example: dr-list-aws-models
    """
    list_models(pattern, upload=True)
