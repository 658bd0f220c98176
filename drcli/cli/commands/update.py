"""`dr update`, also called `dr-update-env` and `dr-reload`."""

from dataclasses import dataclass
from typing import Annotated

import typer

from drcli.cli import console
from drcli.cli.options import AsJson
from drcli.cli.working_folder import settings


@dataclass(frozen=True)
class Checked:
    """Settings that are right.

    Attributes:
        files: Those that were read.
        settings: Number of settings in these files and in the environment.
        warnings: Sentences about what may surprise.
    """

    files: list[str]
    settings: int
    warnings: list[str]


def update(
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Print nothing.")] = False,
    as_json: AsJson = False,
) -> None:
    """Check whether the settings are right.

    Every command reads run.env and system.env itself, so there is nothing to reload. Exits 3 when
    a setting is wrong.

    Example: dr-update
    """
    loaded = settings()
    names = {place.file for place in loaded.sources.values()} - {"environment", "flag"}
    report = Checked(sorted(names), len(loaded.sources), list(loaded.warnings))
    if not quiet:
        console.warn(*report.warnings)
        files = " and ".join(report.files)
        console.say(f"{report.settings} settings of {files} are right; there is nothing to reload.")
    console.emit(report, None, as_json=as_json)
