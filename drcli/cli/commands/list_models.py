"""`dr list-models` and `dr list-aws-models`."""

from typing import Annotated

import typer

from drcli.cli import console
from drcli.cli.options import AsJson, models_argument
from drcli.cli.show import show
from drcli.cli.working_folder import settings

_Pattern = Annotated[
    str, models_argument("PATTERN", "Part of a name, or a whole name with * and ?.")
]


def list_models(
    pattern: _Pattern = "",
    upload: Annotated[
        bool, typer.Option("--upload", help="List the models in the upload bucket.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """List the models in the bucket: number of checkpoints, best and last one, size.

    The number in brackets after a checkpoint is its evaluation score.

    Example: dr-list-models "team/*"
    """
    _list(pattern, upload=upload, as_json=as_json)


def list_aws_models(pattern: _Pattern = "", as_json: AsJson = False) -> None:
    """List the models in the upload bucket, as `dr-list-models --upload` does.

    Example: dr-list-aws-models
    """
    _list(pattern, upload=True, as_json=as_json)


def _list(pattern: str, *, upload: bool, as_json: bool) -> None:
    from drcli.model import model_list
    from drcli.transfer import transfer_buckets

    bucket = transfer_buckets.bucket_to_look_at(settings().transfer, upload=upload)
    with console.waiting(f"Reading s3://{bucket.name} ..."):
        found = model_list.list_models(bucket, pattern)
    console.warn(*(sentence for model in found.models for sentence in model.damaged))
    show(found, as_json=as_json)
