"""What `dr config check` finds: everything about the settings first, then all other rules."""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from drcli.base.problems import Problem
from drcli.checks.check_report import Report
from drcli.config.inspection import Check, check_settings


@dataclass(frozen=True)
class FullCheck(Check):
    """The settings, and everything beside them.

    Attributes:
        rules: What the rules found beside that; None where they were not checked.
    """

    rules: Report | None = None

    @property
    def valid(self) -> bool:
        """Whether nothing is wrong."""
        return not self.errors and (self.rules is None or self.rules.ok)

    def as_json(self) -> dict[str, Any]:
        """The keys that programs read."""
        return {**super().as_json(), "rules": self.rules}


def check_alone(directory: Path) -> FullCheck:
    """Check the settings of a working folder, and no other rule."""
    own = check_settings(directory)
    return FullCheck(**{field.name: getattr(own, field.name) for field in fields(own)})


def with_rules(check: FullCheck) -> FullCheck:
    """Check all rules on a folder whose settings are right."""
    from drcli.checks.validate import validate  # settings are checked without what it loads

    rules = validate(Path(check.directory))
    return replace(
        check,
        rules=replace(
            rules,
            errors=tuple(_untold(rules.errors, check)),
            warnings=tuple(_untold(rules.warnings, check)),
            notes=tuple(_untold(rules.notes, check)),
        ),
    )


def _untold(problems: tuple[Problem, ...], check: Check) -> Iterator[Problem]:
    """Those that the check of the settings has not reported already."""
    idle = {name for group in check.without_effect for name in group.names}
    return (item for item in problems if item not in check.problems and item.key not in idle)
