"""`dr explain`."""

from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Group, RenderableType
from rich.text import Text

from drcli.base.installation import lazy_imports
from drcli.cli import completion, console
from drcli.cli.views.layout import indented

if TYPE_CHECKING:
    from drcli.checks.explain.lookup import Entry, Explanation

with lazy_imports():
    from drcli.checks.explain import lookup


# Shows explanations.


HEADINGS = {
    "hyperparameter": "Hyperparameters",
    "term": "Terms",
    "reward parameter": "Parameters of reward functions",
    "trace column": "Columns of traces",
    "exit code": "Exit codes",
    "setting": "Settings",
    "error text": "Error texts of other programs",
}


def explanation(report: "Explanation") -> RenderableType:
    if not report.question.strip():
        return _names(report.entries)
    return Group(*(row for entry in report.entries for row in _entry(entry)))


def _entry(entry: "Entry") -> list[RenderableType]:
    rows: list[RenderableType] = [
        Text.assemble((entry.name, "bold"), (f"  {entry.kind}", "dim")),
        indented(_printable(entry.meaning)),
    ]
    rows += [
        indented(Text.assemble((f"{detail.label}: ", "cyan"), _printable(detail.text)))
        for detail in entry.details
    ]
    rows.append(indented(Text(f"More: docs/{entry.page}", style="dim")))
    return rows


def _names(entries: "list[Entry]") -> RenderableType:
    rows: list[RenderableType] = []
    for kind, heading in HEADINGS.items():
        names = list(dict.fromkeys(entry.name for entry in entries if entry.kind == kind))
        separator = "\n" if kind == "error text" else ", "
        rows += [Text(heading, style="bold"), indented(Text(separator.join(names)))]
    return Group(*rows)


def _printable(text: str) -> str:
    return text.replace("`", "")


def explain(
    name: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME",
            help="A hyperparameter, setting, term, reward parameter, trace column, exit code, or a "
            "piece of an error text. All names if left out.",
            autocompletion=completion.explained_words,
        ),
    ] = None,
) -> None:
    """Explain a hyperparameter, a setting, a word, an exit code or an error text.

    For hyperparameters it says what a change costs: stable or fast learning. Exits with code 3 if
    nothing is known about the name, and offers names that look alike.

    Example: dr-explain discount_factor
    """
    report = lookup.Explanation.of(" ".join(name or []))
    console.emit(report, explanation(report))
