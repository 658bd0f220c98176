"""`dr url`."""

from typing import Annotated, Literal, get_args

import typer

from drcli.cli import console
from drcli.cli.options import AsJson
from drcli.cli.show import show
from drcli.cli.working_folder import settings

What = Literal["bucket", "model", "custom-files", "metrics", "all"]


def url(
    what: Annotated[
        What, typer.Argument(metavar="WHAT", help="bucket, model, custom-files, metrics or all.")
    ] = "all",
    as_json: AsJson = False,
) -> None:
    """Show the addresses of bucket, model, custom files and metrics, ready to paste.

    Starts no server. Reading an http address needs the keys of the bucket; dr-local-aws passes
    them to the aws command.

    Example: dr-url model
    """
    from drcli.run.summary import PlaceName, addresses

    loaded = settings()
    names = [name for name in get_args(PlaceName) if what in ("all", name)]
    report = addresses(loaded.storage, loaded.model, loaded.custom_files_prefix, names)
    show(report, as_json=as_json, folded=False)
    if report.running is False:
        where = "" if report.endpoint is None else ", at the same address as last time"
        console.say(
            "The local S3 server is not running; dr-start-training, dr-evaluate and dr-local-aws "
            f"start it{where}."
        )
