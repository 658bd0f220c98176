"""What the commands of races share."""

from typing import TYPE_CHECKING, Annotated

import typer

from drcli.bucket.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.cli import completion, terminal
from drcli.cli.show import show
from drcli.cli.working_folder import settings
from drcli.races.race_report import RaceReport, with_limit
from drcli.races.stored_race import find_race

if TYPE_CHECKING:
    from drcli.bucket.bucket import Bucket
    from drcli.config.settings import Settings

Race = Annotated[
    str, typer.Argument(metavar="RACE", help="The race.", autocompletion=completion.races)
]
Closes = Annotated[
    str | None,
    typer.Option("--closes", metavar="WHEN", help="Close it then: a date in UTC, or 2h from now."),
]


def print_race(report: "RaceReport") -> None:
    loaded = settings()
    report = with_limit(report, loaded.tracks_folder, loaded.directory)
    terminal.warn(*report.damaged)
    show(report)


def open_races(loaded: "Settings") -> "Bucket":
    """Starts the server if needed."""
    return open_bucket(loaded.storage, patience_s=COMMAND_PATIENCE_S)


def found_race(loaded: "Settings", race: str) -> "tuple[Bucket, str]":
    bucket = open_races(loaded)
    return bucket, find_race(bucket, race)
