"""`dr validate` and `dr update`."""

from dataclasses import dataclass
from typing import Annotated, Literal

import typer

from drcli.base.errors import SettingsError, refuse
from drcli.base.installation import lazy_imports
from drcli.cli import terminal
from drcli.cli.show import show
from drcli.cli.working_folder import settings, working_folder

with lazy_imports():
    from drcli.checks import validate as checks_validate
    from drcli.config import settings_report, track_names


def validate(
    console_compatible: Annotated[
        bool,
        typer.Option(
            "--console-compatible", help="Also apply the limits of the DeepRacer console."
        ),
    ] = False,
    destination: Annotated[
        Literal["droa", "car", "drfc"] | None,
        typer.Option(
            "--for",
            metavar="WHERE",
            help="Also check that the trained model can go to DeepRacer on AWS (droa), the "
            "physical car (car) or DeepRacer-for-Cloud (drfc).",
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Exit 0 even with errors.")] = False,
) -> None:
    """Check settings, your three files, the bucket and this machine.

    Reports every problem with rule, place and remedy; `dr docs validation` lists the rules. Changes
    nothing, but starts the local S3 server if it is not running. Exits 3 when a training could not
    start.

    Example: dr-validate --for droa
    """
    folder = working_folder()
    with terminal.waiting(f"Checking {folder} ..."):
        report = checks_validate.validate(
            folder, console_compatible=console_compatible, destination=destination or ""
        )
    show(report)
    if not report.ok and not force:
        raise typer.Exit(SettingsError.code)


@dataclass(frozen=True)
class Checked:
    """Settings that are right."""

    files: Annotated[list[str], "Files that were read."]
    settings: Annotated[int, "Number of settings in these files and in the environment."]
    warnings: Annotated[list[str], "Things that are allowed but may surprise you."]


def update(
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Print nothing.")] = False,
) -> None:
    """Check whether the settings are right.

    Every command reads run.env and system.env itself, so there is nothing to reload. Exits 3 when
    a setting is wrong; a track that must be fetched before a start is a warning.

    Example: dr-update
    """
    loaded = settings()
    tracks = track_names.track_problems(loaded.races, known_suffices=True)
    refuse(tracks)
    names = {place.file for place in loaded.sources.values() if place.line is not None}
    report = Checked(
        sorted(names), len(loaded.sources), [*loaded.warnings, *settings_report.warnings_of(tracks)]
    )
    if not quiet:
        terminal.warn(*report.warnings)
        files = " and ".join(report.files)
        terminal.say(
            f"{report.settings} settings of {files} are right; there is nothing to reload."
        )
    terminal.emit(report, None)
