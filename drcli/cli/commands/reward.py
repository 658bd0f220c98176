"""`dr reward`."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drcli.base.errors import ProblemsError, SettingsError
from drcli.base.installation import lazy_imports
from drcli.base.report import counted
from drcli.cli import completion, terminal
from drcli.cli.options import Replace, in_options, world_option
from drcli.cli.show import show
from drcli.cli.working_folder import working_folder

if TYPE_CHECKING:
    from drcli.config.settings import Settings

with lazy_imports():
    from drcli.config import loading, presets
    from drcli.rewards import check as rewards_check
    from drcli.rewards import compare as rewards_compare
    from drcli.rewards import pictures


app = typer.Typer(no_args_is_help=True, help="Check, plot and compare reward functions.")

_File = Annotated[
    Path | None,
    typer.Argument(metavar="FILE", help="A reward function; the one in custom_files/ if left out."),
]
_World = Annotated[str | None, world_option("Track to try it on; DR_WORLD_NAME if left out.", "-w")]


@app.command()
def check(file: _File = None, world: _World = None) -> None:
    """Try a reward function on a drive over the track, and report its problems.

    Finds what `dr validate` and a start find. In addition, scripted drivers drive along the centre
    line, slowly and fast, from border to border, off the road, and into an obstacle if the race has
    any, to show what the function rewards. Exits with code 3 if a training would not start.

    Example: dr-reward check
    """
    with _on_track(world) as settings, terminal.waiting("Trying the reward function ..."):
        report = rewards_check.check(settings, file, working_folder())
    show(report)
    if not report.works and terminal.on_screen():
        raise typer.Exit(SettingsError.code)
    if not report.works:
        first, *more = report.errors
        raise SettingsError(
            f"{report.file} has {counted(len(report.errors), 'error')}.",
            remedy="Start with the first one." if more else first.remedy,
        )


@app.command()
def plot(
    file: _File = None,
    out: Annotated[Path, typer.Option("-o", "--out", help="The picture.")] = Path("reward.png"),
    world: _World = None,
    force: Replace = False,
) -> None:
    """Draw the rewards of a function on a map of the track and along the lap.

    Example: dr-reward plot -o reward.png
    """
    with _on_track(world) as settings, terminal.waiting("Trying the reward function ..."):
        report = pictures.plot(settings, file, out, working_folder(), force=force)
    show(report)


@app.command()
def compare(
    first: Annotated[Path, typer.Argument(metavar="A", help="A reward function.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another one.")],
    world: _World = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Draw both into this picture.")
    ] = None,
    force: Replace = False,
) -> None:
    """Compare the rewards of two functions for the same drivers.

    Example: dr-reward compare custom_files/reward_function.py other.py -o both.png
    """
    with _on_track(world) as settings, terminal.waiting("Trying both reward functions ..."):
        report = rewards_compare.compare(
            settings, first, second, out, working_folder(), force=force
        )
    show(report)


@app.command()
def examples(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME",
            help="Print the reward function of this one.",
            autocompletion=completion.examples,
        ),
    ] = None,
) -> None:
    """List the shipped reward functions, or print one; writes nothing.

    `dr-init --example NAME` puts the three files of one into a folder.

    Example: dr-reward examples speed
    """
    if name is None:
        show(presets.Examples(presets.examples()))
    else:
        show(presets.with_code(name), folded=False)


@contextmanager
def _on_track(world: str | None) -> "Iterator[Settings]":
    flags = {"DR_WORLD_NAME": world} if world is not None else {}
    try:
        yield loading.load_settings(working_folder(), flags=flags)
    except ProblemsError as error:
        raise in_options(error, {"DR_WORLD_NAME": "--world"}, flags) from None
