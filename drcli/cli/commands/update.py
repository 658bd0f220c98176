"""`dr update`, which the reference also calls `dr-update-env` and `dr-reload`."""

from dataclasses import dataclass
from typing import Annotated

import typer

from drcli.cli.options import AsJson
from drcli.cli.working_folder import settings


@dataclass(frozen=True)
class Checked:
    """Settings that can be used.

    Attributes:
        files: Those that were read.
        settings: How many settings stand there or in the environment.
        warnings: Sentences about what is allowed and may surprise.
    """

    files: list[str]
    settings: int
    warnings: list[str]


def update(
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing.")] = False,
    as_json: AsJson = False,
) -> None:
    """Read the settings again and say whether they are right.

    Every command reads run.env and system.env when it is called, so nothing has to be reloaded;
    this only checks them. Wrong settings exit 3.

    Example: dr-update
    """
    from drcli.cli import console

    loaded = settings()
    files = {place.file for place in loaded.sources.values()}
    files = {name for name in files if name not in ("environment", "flag")}
    report = Checked(sorted(files), len(loaded.sources), list(loaded.warnings))
    if not quiet:
        for warning in report.warnings:
            console.warn(warning)
        console.say(
            f"{report.settings} settings of {' and '.join(report.files)} are right; "
            "every command reads them when it is called."
        )
    if as_json:
        console.emit(report, "", as_json=True)
