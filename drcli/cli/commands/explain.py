"""`dr explain`."""

from typing import Annotated

import typer

from drcli.cli import candidates, console
from drcli.cli.options import AsJson
from drcli.cli.views import explain_view


def explain(
    name: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME",
            help="A hyperparameter, setting, term, reward parameter, trace column, exit code, or a "
            "piece of an error text. All names if left out.",
            autocompletion=candidates.explained_words,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Explain a hyperparameter, a setting, a word, an exit code or an error text.

    For hyperparameters it says what a change costs: stable or fast learning. Exits with code 3 if
    nothing is known about the name, and offers names that look alike.

    Example: dr-explain discount_factor
    """
    from drcli.explain.explanation import Explanation

    report = Explanation.of(" ".join(name or []))
    console.emit(report, explain_view.explanation(report), as_json=as_json)
