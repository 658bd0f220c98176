"""The report on the rules in a working folder."""

from dataclasses import dataclass
from typing import Annotated

from drcli.base.errors import Problem
from drcli.base.report import Styled, View, bold, counted, dim
from drcli.config.track_names import ASKED


@dataclass(frozen=True)
class Skipped:
    """Rules that could not be checked."""

    rules: Annotated[tuple[str, ...], "Their numbers."]
    reason: Annotated[str, "Why, as a sentence."]


@dataclass(frozen=True)
class Report:
    """All problems of a working folder."""

    directory: Annotated[str, "The folder. Places inside it are named relative to it."]
    console_compatible: Annotated[
        bool, "Whether the model is also meant for training on a DeepRacer console."
    ]
    errors: Annotated[tuple[Problem, ...], "Problems that prevent a training from starting."]
    warnings: Annotated[tuple[Problem, ...], "Things that work but may surprise you."]
    skipped: Annotated[tuple[Skipped, ...], "Rules that could not be checked."]
    notes: Annotated[tuple[Problem, ...], "What `dr-start-training` will ask."] = ()
    goes_to: Annotated[str, "Where the trained model can go; empty if that is unknown."] = ""
    destination: Annotated[str, "What --for names: droa, car or drfc; empty without it."] = ""

    @property
    def ok(self) -> bool:
        """Whether a training could start."""
        return not self.errors

    def sentence(self) -> str:
        counts = f"{counted(len(self.errors), 'error')}, {counted(len(self.warnings), 'warning')}."
        if self.ok:
            return f"{counts} A training can start{' with what the notes say' * bool(self.notes)}."
        if all(item.rule == "V-16" for item in self.errors):
            return f"{counts} A training can start, but its model could not go where --for says."
        if all(item.rule == "V-13" for item in self.errors):
            return f"{counts} A training can start when the present one has ended."
        if all(ASKED in item.remedy for item in self.errors):
            return (
                f"{counts} A training would not start, except on a terminal, where it asks first."
            )
        return f"{counts} A training would not start."

    def view(self) -> View:
        groups = (
            (Styled("Errors", "bold red"), self.errors),
            (Styled("Warnings", "yellow"), self.warnings),
            (bold("Notes"), self.notes),
        )
        for title, group in groups:
            yield group and title
            for item in group:
                remedy = item.remedy and dim(f"Try: {item.remedy}")
                yield [f"{item.rule}  {item.where}", [item.message, remedy]]
        yield self.skipped and bold("Not tried")
        yield [f"{', '.join(item.rules)}: {item.reason}" for item in self.skipped]
        yield self.ok and self.goes_to
        yield Styled(self.sentence(), "bold green" if self.ok else "bold red")
