"""The report of `dr-explain`."""

from dataclasses import dataclass

from drcli.explain.entry import Entry
from drcli.explain.lookup import every_entry, explain


@dataclass(frozen=True)
class Explanation:
    """What is known about a word.

    Attributes:
        question: What was asked for; empty for everything.
        entries: What is known about it; a word may have several meanings.
    """

    question: str
    entries: list[Entry]

    @staticmethod
    def of(question: str) -> "Explanation":
        """Look a word up.

        Raises:
            SettingsError: Nothing is known about it.
        """
        found = explain(question) if question.strip() else every_entry()
        return Explanation(question, list(found))
