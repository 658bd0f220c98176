"""`dr support-bundle`."""

import shlex
import time
from pathlib import Path
from typing import Annotated

import typer

from drcli.base.installation import lazy_imports
from drcli.cli import terminal
from drcli.cli.options import ReplaceOrYes
from drcli.cli.show import show
from drcli.cli.working_folder import current_folder, working_folder

with lazy_imports():
    from drcli.run import support_bundle as run_support_bundle


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
) -> None:
    """Pack what helps others to help you, without secrets.

    Writes an archive with the report of dr-doctor, settings, your three files, records of runs,
    the journal, the newest parts of logs, installed packages, and the keys of the model's objects.
    Everything in it is text, and secrets are removed. manifest.json in the archive lists each
    removal. Read it before you send it.

    Example: dr-support-bundle --without-files
    """
    folder = working_folder()
    target = file or Path(f"drcli-support-{time.strftime('%Y%m%d-%H%M%S')}.tar.gz")
    if target.is_dir():
        target /= f"drcli-support-{time.strftime('%Y%m%d-%H%M%S')}.tar.gz"
    target = current_folder() / target
    with terminal.waiting("Collecting; this takes about ten seconds ..."):
        report = run_support_bundle.make_bundle(
            folder, target, with_custom_files=not without_files, overwrite=force
        )
    show(report)
    path = shlex.quote(report.file)
    manifest = "drcli-support/manifest.json"
    terminal.suggest(
        [
            (f"tar -xOzf {path} {manifest} | less", "see what was removed"),
            (f"tar -xOzf {path} | less", "read everything before you send it"),
        ],
        elsewhere=True,
    )
