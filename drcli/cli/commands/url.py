"""`dr url`."""

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from drcli.cli.options import AsJson
from drcli.cli.working_folder import settings

if TYPE_CHECKING:
    from drcli.runs.addresses import PlaceName


class What(StrEnum):
    """What an address is wanted of."""

    bucket = "bucket"
    model = "model"
    custom_files = "custom-files"
    metrics = "metrics"
    all = "all"


def url(
    what: Annotated[
        What, typer.Argument(metavar="[WHAT]", help="bucket, model, custom-files, metrics or all.")
    ] = What.all,
    as_json: AsJson = False,
) -> None:
    """Show the addresses of bucket, model, files and metrics, ready to paste.

    No server is started or asked. Reading an http address takes the bucket's keys, which
    dr-local-aws gives to the aws command.

    Example: dr-url model
    """
    from drcli.cli import console
    from drcli.cli.views import everyday
    from drcli.runs.addresses import addresses

    every: list[PlaceName] = ["bucket", "model", "custom-files", "metrics"]
    names = [name for name in every if what in (What.all, name)]
    loaded = settings()
    report = addresses(loaded.storage, loaded.model, loaded.custom_files_prefix, names)
    console.emit(report, everyday.addresses(report), as_json=as_json, folded=False)
    if report.running is False:
        where = "" if report.endpoint is None else ", at the same address as last time"
        console.say(
            "The local S3 server does not run; dr-start-training, dr-evaluate and dr-local-aws "
            f"start it{where}."
        )
