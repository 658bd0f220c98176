"""What is known about one word."""

from dataclasses import dataclass
from typing import Literal

Kind = Literal[
    "hyperparameter",
    "setting",
    "term",
    "reward parameter",
    "trace column",
    "exit code",
    "error text",
]


@dataclass(frozen=True)
class Detail:
    """One more thing about a word.

    Attributes:
        label: What it is about, such as "Higher".
        text: The text.
    """

    label: str
    text: str


@dataclass(frozen=True)
class Entry:
    """What is known about one word.

    Attributes:
        kind: What the word is.
        name: The word, as it is written in files, or an error text.
        meaning: What it means, in a sentence or two.
        details: More about it, in the order to show.
        page: Page in docs/ that says more.
    """

    kind: Kind
    name: str
    meaning: str
    details: tuple[Detail, ...] = ()
    page: str = ""
