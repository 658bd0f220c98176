"""`dr support-bundle`."""

import shlex
import time
from pathlib import Path
from typing import Annotated

import typer

from drcli.cli import console
from drcli.cli.options import AsJson, ReplaceOrYes
from drcli.cli.show import show
from drcli.cli.working_folder import current_folder, working_folder


def support_bundle(
    file: Annotated[
        Path | None,
        typer.Argument(metavar="FILE", help="The archive; by default named after the time."),
    ] = None,
    without_files: Annotated[
        bool,
        typer.Option("--without-files", help="Leave out your reward function and its two files."),
    ] = False,
    force: ReplaceOrYes = False,
    as_json: AsJson = False,
) -> None:
    """Pack what helps others to help you, without secrets.

    Writes an archive with the report of dr-doctor, settings, your three files, records of runs,
    the journal, the newest parts of logs, installed packages, and the keys of the model's objects.
    Everything in it is text, and secrets are removed. manifest.json in the archive lists each
    removal. Read it before you send it.

    Example: dr-support-bundle --without-files
    """
    from drcli.run.support_bundle import make_bundle

    folder = working_folder()
    target = file or Path(f"drcli-support-{time.strftime('%Y%m%d-%H%M%S')}.tar.gz")
    if target.is_dir():
        target /= f"drcli-support-{time.strftime('%Y%m%d-%H%M%S')}.tar.gz"
    target = current_folder() / target
    with console.waiting("Collecting; this takes about ten seconds ..."):
        report = make_bundle(folder, target, with_custom_files=not without_files, overwrite=force)
    show(report, as_json=as_json)
    path = shlex.quote(report.file)
    manifest = "drcli-support/manifest.json"
    console.suggest(
        [
            (f"tar -xOzf {path} {manifest} | less", "see what was removed"),
            (f"tar -xOzf {path} | less", "read everything before you send it"),
        ],
        elsewhere=True,
    )
