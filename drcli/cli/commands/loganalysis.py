"""`dr start-loganalysis` and its companions."""

from dataclasses import dataclass
from typing import Annotated

import typer

from drcli.base.errors import Absent
from drcli.cli import completion, console
from drcli.cli.open_page import open_page
from drcli.cli.options import AsJson
from drcli.cli.working_folder import settings

_NOTHING_RUNS = "No log analysis is running. dr-start-loganalysis writes a file; it starts nothing."


@dataclass(frozen=True)
class ReportAddress:
    """Where the report of a model is."""

    model: Annotated[str, "Its name."]
    html: Annotated[str, "The file."]
    url: Annotated[str, "The same as an address for a browser."]


def start_loganalysis(
    what: Annotated[
        str | None,
        typer.Argument(
            metavar="WHAT",
            help="As for dr-analyze; the model of run.env if left out.",
            autocompletion=completion.model_prefixes,
        ),
    ] = None,
    browser: Annotated[
        bool, typer.Option("--open/--no-open", help="Open it in a browser, if there is a display.")
    ] = True,
    as_json: AsJson = False,
) -> None:
    """Write the report of dr-analyze to data/analysis/, print its address, and open it.

    The report is one file, which needs no server and no network: copy it to a phone, or send it.

    Example: dr-start-loganalysis
    """
    from drcli.analysis.analysis import analyse
    from drcli.analysis.outputs import write_report
    from drcli.analysis.read_run import read_run
    from drcli.transfer.report_place import report_file

    loaded = settings()
    with console.waiting(f"Reading {what or loaded.model_prefix} ..."):
        run = read_run(loaded, what)
    path = report_file(loaded.directory, run.name)
    with console.waiting("Writing the report ..."):
        written = write_report(path, analyse(run))
    console.warn(*written.problems)
    address = ReportAddress(run.name, str(path), path.as_uri())
    console.emit(address, f"{address.html}\n{address.url}", as_json=as_json, folded=False)
    if browser and not as_json:
        open_page(address.url)


def url_loganalysis(as_json: AsJson = False) -> None:
    """Print the address of the report that dr-start-loganalysis has written for this model.

    Example: dr-url-loganalysis
    """
    from drcli.transfer.report_place import report_file

    loaded = settings()
    path = report_file(loaded.directory, loaded.model_prefix)
    if not path.is_file():
        raise Absent(
            f"There is no report of {loaded.model_prefix}.",
            remedy="Write it with `dr-start-loganalysis`.",
        )
    address = ReportAddress(loaded.model_prefix, str(path), path.as_uri())
    console.emit(address, address.url, as_json=as_json, folded=False)


def stop_loganalysis(as_json: AsJson = False) -> None:
    """Stop nothing: the report is a file.

    Exits 0.

    Example: dr-stop-loganalysis
    """
    _say_nothing_runs(as_json=as_json)


def logs_loganalysis(as_json: AsJson = False) -> None:
    """Show no log: the report is a file, and dr-analyze says what was wrong with a model's files.

    Exits 0.

    Example: dr-logs-loganalysis
    """
    _say_nothing_runs(as_json=as_json)


def _say_nothing_runs(*, as_json: bool) -> None:
    console.say(_NOTHING_RUNS)
    if as_json:
        from drcli.run.stopping import StopReport

        console.emit(StopReport(), "", as_json=True)
