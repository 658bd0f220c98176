"""`dr doctor`."""

import typer

from drcli.cli import console
from drcli.cli.options import AsJson
from drcli.cli.show import show
from drcli.cli.working_folder import working_folder


def doctor(as_json: AsJson = False) -> None:
    """Examine the installation, this machine and the bucket.

    Shows a line for each subject, and what to do about each problem, in ten seconds at most. Needs
    no run.env; without one, the bucket is not examined. Writes small test objects to the bucket and
    deletes them again; a running training is not affected. Exits 3 when there is a problem, and 4
    when only a bucket has one.

    Example: dr-doctor
    """
    from drcli.checks.doctor.diagnose import diagnose

    folder = working_folder()
    with console.waiting("Examining this machine and the bucket ...", only_live=True):
        report = diagnose(folder)
    show(report, as_json=as_json)
    if report.exit_code:
        raise typer.Exit(report.exit_code)
