"""`dr explain`."""

from typing import Annotated

import typer

from drcli.base.installation import lazy_imports
from drcli.cli import completion
from drcli.cli.show import show

with lazy_imports():
    from drcli.checks.explain import lookup


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
    show(lookup.Explanation.of(" ".join(name or [])))
