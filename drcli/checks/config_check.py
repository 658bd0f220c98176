"""What `dr config check` finds: everything about the settings first, then all other rules."""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path

from drcli.checks.check_report import Report, Violation
from drcli.config.effects import NAMED_BY_CHECK
from drcli.config.inspection import Check, check_settings


@dataclass(frozen=True)
class FullCheck(Check):
    """The settings, and everything beside them.

    Attributes:
        rules: What the rules found that is not told above; None where they were not tried.
    """

    rules: Report | None = None

    @property
    def valid(self) -> bool:
        """Whether nothing is wrong."""
        return not self.errors and (self.rules is None or self.rules.ok)


def check_alone(directory: Path) -> FullCheck:
    """Check the settings; no other rule is tried.

    Args:
        directory: The working folder.

    Raises:
        SettingsError: There is no run.env.
    """
    own = check_settings(directory)
    return FullCheck(**{field.name: getattr(own, field.name) for field in fields(own)})


def with_rules(check: FullCheck) -> FullCheck:
    """Try all rules on a folder whose settings are right."""
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


def _untold(violations: tuple[Violation, ...], check: Check) -> Iterator[Violation]:
    """Those that the check of the settings has not told already."""
    idle = {name for group in check.without_effect for name in group.names}
    for item in violations:
        sentences = (item.sentence, f"{item.sentence} {item.remedy}")
        told = any(text in check.warnings for text in sentences) or item.message.endswith(
            NAMED_BY_CHECK
        )
        if not told and item.message.partition("=")[0] not in idle:
            yield item
