"""`dr url`."""

from typing import Annotated, Literal, get_args

import typer

from drcli.base.installation import lazy_imports
from drcli.cli import terminal
from drcli.cli.show import show
from drcli.cli.working_folder import settings

with lazy_imports():
    from drcli.run import summary


What = Literal["bucket", "model", "custom-files", "metrics", "all"]


def url(
    what: Annotated[
        What, typer.Argument(metavar="WHAT", help="bucket, model, custom-files, metrics or all.")
    ] = "all",
) -> None:
    """Show the addresses of bucket, model, custom files and metrics, ready to paste.

    Starts no server. Reading an http address needs the keys of the bucket; dr-local-aws passes
    them to the aws command.

    Example: dr-url model
    """
    loaded = settings()
    names = [name for name in get_args(summary.PlaceName) if what in ("all", name)]
    report = summary.addresses(loaded.storage, loaded.model, loaded.custom_files_prefix, names)
    show(report, folded=False)
    if report.running is False:
        where = "" if report.endpoint is None else ", at the same address as last time"
        terminal.say(
            "The local S3 server is not running; dr-start-training, dr-evaluate and dr-local-aws "
            f"start it{where}."
        )
