"""`dr spot watch`."""

import os
from typing import Annotated, Literal

import typer

from drcli.base.errors import SettingsError
from drcli.cli import console
from drcli.cli.options import AsJson


def watch(
    command: Annotated[
        list[str] | None,
        typer.Argument(metavar="-- COMMAND ...", help="Program to run, with its arguments."),
    ] = None,
    pid: Annotated[
        int | None, typer.Option("--pid", min=1, metavar="N", help="Watch for this process.")
    ] = None,
    on_notice: Annotated[
        str | None,
        typer.Option("--on-notice", metavar="CMD", help="Program to run when the notice comes."),
    ] = None,
    number: Annotated[
        str, typer.Option("--signal", metavar="S", help="Signal that the program gets then.")
    ] = "TERM",
    wait_s: Annotated[
        float | None,
        typer.Option(
            "--wait",
            min=0,
            max=86_400,
            metavar="SECONDS",
            help="How long the program may take to exit; without it, as long as the notice leaves.",
        ),
    ] = None,
    rebalance: Annotated[
        bool,
        typer.Option("--rebalance", help="A recommendation to move counts as a notice too."),
    ] = False,
    once: Annotated[
        bool, typer.Option("--once", help="Ask once, and exit 1 if there is no notice.")
    ] = False,
    cloud: Annotated[
        Literal["auto", "aws", "gcp", "azure"],
        typer.Option("--cloud", help="Whose metadata service to ask."),
    ] = "auto",
    hook: Annotated[
        str,
        typer.Option(
            "--hook", metavar="CMD", help="Program that exits 0 when the machine goes away."
        ),
    ] = "",
    as_json: AsJson = False,
) -> None:
    """Watch for the notice that this machine will be taken away, for a program other than drcli.

    Runs the program, or watches for a running one. On notice, the program gets a signal and time to
    exit, and this command exits 75. Otherwise it has the exit code of the program. Without a
    program, it waits for the notice, prints it and exits 0. SIGTERM counts as a notice.

    Example: dr-spot watch --on-notice ./save.sh -- python train.py
    """
    from drcli.runs.foreign_watch import ForeignWatch, NoticeHandling, signal_named
    from drcli.spot.cloud_notices import cloud_of_machine
    from drcli.spot.notice_sources import source_of
    from drcli.spot.notice_watch import NoticeWatch, command_words

    if command and pid is not None:
        raise typer.BadParameter("Give a program or --pid, not both.")
    if command and not command[0]:
        raise typer.BadParameter("The name of the program is empty.")
    if once and (command or pid is not None):
        raise typer.BadParameter("--once asks for the notice only: leave out the program.")
    handling = NoticeHandling(
        signal_named(number),
        tuple(command_words(on_notice or "", "--on-notice")),
        wait_s,
        rebalance,
    )
    words = command_words(hook, "--hook")
    found = cloud_of_machine(os.environ) if cloud == "auto" else cloud
    address = os.environ.get("DR_METADATA_SERVICE_URL", "")
    source = None if found is None else source_of(found, os.environ, address)
    if source is None and not words:
        what = "This machine belongs to no cloud whose notices could be read."
        if not command and pid is None:
            remedy = "Name the cloud with --cloud, or a program of yours with --hook."
            raise SettingsError(what, remedy=remedy)
        console.warn(f"{what} Only SIGTERM is watched for.")
    watching = ForeignWatch(NoticeWatch(source, words), handling)
    if once:
        report = watching.once()
    elif command:
        report = watching.run(command)
    elif pid is not None:
        report = watching.follow(pid)
    else:
        report = watching.wait()
    if command or pid is not None:
        console.say(report.text)
        console.emit(report, None, as_json=as_json)
    else:
        console.emit(report, report.text, as_json=as_json)
    raise typer.Exit(report.exit_code)
