"""`dr explain`."""

from typing import TYPE_CHECKING, Annotated

import typer

from drcli.cli import completion
from drcli.cli.options import AsJson
from drcli.cli.show import show

if TYPE_CHECKING:
    pass


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
    as_json: AsJson = False,
) -> None:
    """Explain a hyperparameter, a setting, a word, an exit code or an error text.

    For hyperparameters it says what a change costs: stable or fast learning. Exits with code 3 if
    nothing is known about the name, and offers names that look alike.

    Example: dr-explain discount_factor
    """
    from drcli.checks.explain.lookup import Explanation

    show(Explanation.of(" ".join(name or [])), as_json=as_json)
