"""`dr reward`: checks, plots and compares reward functions."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drcli.base.errors import SettingsError
from drcli.cli import candidates, console
from drcli.cli.options import AsJson
from drcli.cli.views import reward_view
from drcli.cli.working_folder import working_folder

if TYPE_CHECKING:
    from drcli.config.settings import Settings

app = typer.Typer(no_args_is_help=True, help="Check, plot and compare reward functions.")

_File = Annotated[
    Path | None,
    typer.Argument(metavar="FILE", help="A reward function; the one in custom_files/ if left out."),
]
_World = Annotated[
    str | None,
    typer.Option(
        "--world",
        "-w",
        help="Track to try it on; DR_WORLD_NAME if left out.",
        autocompletion=candidates.worlds,
    ),
]


@app.command()
def check(file: _File = None, world: _World = None, as_json: AsJson = False) -> None:
    """Try a reward function on a drive over the track, and report its problems.

    Scripted drivers drive along the centre line, slowly and fast, from border to border, off the
    road, and into an obstacle if the race has any. Exits with code 3 if a training would fail, or
    if the function has side effects such as writing files.

    Example: dr-reward check
    """
    from drcli.rewards import check as checking

    with console.waiting("Trying the reward function ..."):
        report = checking.check(_settings(world), file, working_folder())
    console.emit(report, reward_view.check(report), as_json=as_json)
    if not report.works:
        count = len(report.errors)
        raise SettingsError(
            f"{report.file} has {count} error{'s' * (count > 1)}.",
            remedy=report.errors[0].remedy if count == 1 else "Start with the first one.",
        )


@app.command()
def plot(
    file: _File = None,
    out: Annotated[
        Path, typer.Option("-o", "--out", help="The picture; an older one is replaced.")
    ] = Path("reward.png"),
    world: _World = None,
    as_json: AsJson = False,
) -> None:
    """Draw the rewards of a function on a map of the track and along the lap.

    Example: dr-reward plot -o reward.png
    """
    from drcli.rewards import plot as plotting

    with console.waiting("Trying the reward function ..."):
        report = plotting.plot(_settings(world), file, out, working_folder())
    console.emit(report, reward_view.plot(report), as_json=as_json)


@app.command()
def compare(
    first: Annotated[Path, typer.Argument(metavar="A", help="A reward function.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another one.")],
    world: _World = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Draw both into this picture.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare the rewards of two functions for the same drivers.

    Example: dr-reward compare custom_files/reward_function.py other.py -o both.png
    """
    from drcli.rewards import compare as comparing

    with console.waiting("Trying both reward functions ..."):
        report = comparing.compare(_settings(world), first, second, out, working_folder())
    console.emit(report, reward_view.comparison(report), as_json=as_json)


def _settings(world: str | None) -> "Settings":
    from drcli.config.loading import load_settings

    flags = {"DR_WORLD_NAME": world} if world is not None else {}
    return load_settings(working_folder(), flags=flags)
