"""Checks the settings, then all other rules, for `dr config check`."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from drcli.base.errors import MOST_SHOWN, Problem
from drcli.base.installation import lazy_imports
from drcli.base.report import Styled, View, counted, dim
from drcli.checks.check_report import Report
from drcli.config.settings_report import check_settings
from drcli.config.track_names import track_problems
from drcli.config.unused_names import WithoutEffect, harmless_summary

with lazy_imports():
    from drcli.checks import settings_rules, validate


@dataclass(frozen=True)
class WrongSetting:
    """An error in the settings."""

    where: Annotated[str, "Place, such as `run.env line 7`."]
    what: Annotated[str, "Key, value and problem, without a full stop."]
    remedy: Annotated[str, "How to fix it, starting with a verb."]

    def __str__(self) -> str:
        return f"{self.where}: {self.what}."


@dataclass(frozen=True)
class FullCheck:
    """All problems of the settings, and those that the other rules found."""

    directory: Annotated[str, "The working folder."]
    errors: Annotated[
        tuple[WrongSetting, ...], "Errors in the settings, in the order in which they were read."
    ]
    warnings: Annotated[tuple[str, ...], "Things that are allowed but may surprise you."]
    without_effect: Annotated[
        tuple[WithoutEffect, ...], "Settings in the files that have no effect here, by reason."
    ]
    rules: Annotated[
        Report | None, "The report on the other rules; None if they were not checked."
    ] = None

    @property
    def valid(self) -> bool:
        """Whether there are no errors."""
        return not self.errors and (self.rules is None or self.rules.ok)

    def view(self) -> View:
        for problem in self.errors[:MOST_SHOWN]:
            yield (Styled("Error: ", "bold red"), str(problem))
            yield [dim(f"Try: {problem.remedy}")]
        more = len(self.errors) - MOST_SHOWN
        yield more > 0 and f"And {more:,} more like these."
        yield from ((Styled("Warning: ", "yellow"), text) for text in self.warnings)
        yield self.without_effect and "Accepted without effect:"
        for group in self.without_effect:
            yield [f"{group.reason}:", [dim(", ".join(group.names))]]
        counts = f"{counted(len(self.errors), 'error')}, {counted(len(self.warnings), 'warning')}."
        yield Styled(f"Settings: {counts}", "bold red" if self.errors else "green")
        if self.rules is not None:
            yield from self.rules.view()


def check_alone(directory: Path) -> FullCheck:
    check = check_settings(directory)
    errors = tuple(
        WrongSetting(error.where, error.message.removesuffix("."), error.remedy)
        for error in check.errors
    )
    return FullCheck(check.directory, errors, check.warnings, check.without_effect)


def with_rules(check: FullCheck) -> FullCheck:
    directory = Path(check.directory)
    reviewed = settings_rules.review_settings(directory)
    settings = reviewed.settings
    known: tuple[Problem | None, ...] = ()
    if settings is not None:  # names without effect are listed
        summary = harmless_summary(settings)
        known = (*settings.problems, *track_problems(settings.races), summary)
    idle = {name for group in check.without_effect for name in group.names}

    def new(problems: tuple[Problem, ...]) -> tuple[Problem, ...]:
        return tuple(each for each in problems if each not in known and each.key not in idle)

    rules = validate.validate(directory, reviewed=reviewed)
    rules = replace(
        rules, errors=new(rules.errors), warnings=new(rules.warnings), notes=new(rules.notes)
    )
    return replace(check, rules=rules)
