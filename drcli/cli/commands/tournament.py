"""`dr start-tournament`."""

from typing import Annotated

import typer

from drcli.base.errors import shown
from drcli.base.installation import lazy_imports
from drcli.cli import completion, terminal
from drcli.cli.commands.race import drive
from drcli.cli.race_access import open_races
from drcli.cli.working_folder import settings

with lazy_imports():
    from drcli.races import organise


def start_tournament(
    race: Annotated[
        str | None,
        typer.Argument(
            metavar="RACE",
            help="The race; not needed if there is only one in pairs that is not finished.",
            autocompletion=completion.races,
        ),
    ] = None,
    quiet: Annotated[
        bool, typer.Option("-q", "--quiet", help="Drive in the background, and return at once.")
    ] = False,
    video: Annotated[
        bool | None,
        typer.Option(
            "--video/--no-video", help="Film every pair; without this, if the encoder is there."
        ),
    ] = None,
    file: Annotated[str | None, typer.Option("-f", hidden=True)] = None,
) -> None:
    """Drive the pairs of a head-to-head race, or go on with them.

    Make the race with `dr-race create NAME --type HEAD_TO_MODEL`, submit models with `dr-race
    submit NAME`, then run this. It does the same as `dr-race run`.

    Example: dr-start-tournament club-night
    """
    if file is not None:
        terminal.warn(f"`dr start-tournament` ignores -f {shown(file)}: `dr-race` makes races.")
    if race is None:
        race = organise.only_tournament(open_races(settings()))
    drive(race, quiet=quiet, video=video, limit=0)
