"""`dr doctor`."""

import typer

from drcli.base.installation import lazy_imports
from drcli.cli import terminal
from drcli.cli.show import show
from drcli.cli.working_folder import working_folder

with lazy_imports():
    from drcli.checks.doctor import diagnose


def doctor() -> None:
    """Examine the installation, this machine and the bucket.

    Shows a line for each subject, and what to do about each problem, in ten seconds at most. Needs
    no run.env; without one, the bucket is not examined. Writes small test objects to the bucket and
    deletes them again; a running training is not affected. Exits 3 when there is a problem, and 4
    when only a bucket has one.

    Example: dr-doctor
    """
    folder = working_folder()
    with terminal.waiting("Examining this machine and the bucket ...", only_live=True):
        report = diagnose.diagnose(folder)
    show(report)
    if report.exit_code:
        raise typer.Exit(report.exit_code)
