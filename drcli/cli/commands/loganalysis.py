"""`dr start-loganalysis` and its companions."""

from dataclasses import dataclass
from typing import Annotated

import typer

from drcli.base.errors import Absent
from drcli.base.installation import lazy_imports
from drcli.cli import completion, terminal
from drcli.cli.open_page import open_page
from drcli.cli.working_folder import settings
from drcli.transfer.report_place import report_file

with lazy_imports():
    from drcli.analysis import analysis, outputs, read_run
    from drcli.run import stopping


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
) -> None:
    """Write the report of dr-analyze to data/analysis/, print its address, and open it.

    The report is one file, which needs no server and no network: copy it to a phone, or send it.

    Example: dr-start-loganalysis
    """
    loaded = settings()
    with terminal.waiting(f"Reading {what or loaded.model_prefix} ..."):
        run = read_run.read_run(loaded, what)
    path = report_file(loaded.directory, run.name)
    with terminal.waiting("Writing the report ..."):
        written = outputs.write_report(path, analysis.analyse(run))
    terminal.warn(*written.problems)
    address = ReportAddress(run.name, str(path), path.as_uri())
    terminal.emit(address, f"{address.html}\n{address.url}", folded=False)
    if browser and not terminal.as_json:
        open_page(address.url)


def url_loganalysis() -> None:
    """Print the address of the report that dr-start-loganalysis has written for this model.

    Example: dr-url-loganalysis
    """
    loaded = settings()
    path = report_file(loaded.directory, loaded.model_prefix)
    if not path.is_file():
        raise Absent(
            f"There is no report of {loaded.model_prefix}.",
            remedy="Write it with `dr-start-loganalysis`.",
        )
    address = ReportAddress(loaded.model_prefix, str(path), path.as_uri())
    terminal.emit(address, address.url, folded=False)


def stop_loganalysis() -> None:
    """Stop nothing: the report is a file.

    Exits 0.

    Example: dr-stop-loganalysis
    """
    _say_nothing_runs()


def logs_loganalysis() -> None:
    """Show no log: the report is a file, and dr-analyze says what was wrong with a model's files.

    Exits 0.

    Example: dr-logs-loganalysis
    """
    _say_nothing_runs()


def _say_nothing_runs() -> None:
    terminal.say(_NOTHING_RUNS)
    terminal.emit(stopping.StopReport(), None)
