"""`dr list-models` and `dr list-aws-models`."""

from typing import Annotated

import typer

from drcli.cli.options import AsJson
from drcli.cli.working_folder import settings

_Pattern = Annotated[
    str, typer.Argument(metavar="[PATTERN]", help="Part of a name, or all of it with * and ?.")
]


def list_models(
    pattern: _Pattern = "",
    upload: Annotated[
        bool, typer.Option("--upload", help="Look into the bucket of uploads.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """List the models in the bucket: checkpoints, the best and the last, size.

    Behind a checkpoint stands what its evaluation scored, where that is known.

    Example: dr-list-models "team/*"
    """
    _list(pattern, upload=upload, as_json=as_json)


def list_aws_models(pattern: _Pattern = "", as_json: AsJson = False) -> None:
    """List the models in the bucket of uploads, as `dr-list-models --upload` does.

    Example: dr-list-aws-models
    """
    _list(pattern, upload=True, as_json=as_json)


def _list(pattern: str, *, upload: bool, as_json: bool) -> None:
    from drcli.cli import console
    from drcli.cli.views import models_view
    from drcli.models.model_list import list_models as find
    from drcli.models.transfer_buckets import bucket_to_look_at

    bucket = bucket_to_look_at(settings().transfer, upload=upload)
    with console.waiting(f"Looking through s3://{bucket.name} ..."):
        found = find(bucket, pattern)
    for sentence in (sentence for model in found.models for sentence in model.damaged):
        console.warn(sentence)
    console.emit(found, models_view.models(found), as_json=as_json)
