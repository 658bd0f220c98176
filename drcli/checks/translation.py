"""From the findings of the parsers to violations with the number of a rule."""

import re
from collections.abc import Callable, Iterable

from drcli.base.errors import DrError, SettingsError
from drcli.base.problems import Finding, FindingsError
from drcli.checks.check_report import Severity, Violation

RuleOf = Callable[[Finding], str]
"""Which rule a finding belongs to."""

_PLACE = re.compile(
    r"(environment|flag|default|[^\n]*?\.(?:env|json|py)(?: line \d+)?(?: column \d+)?): (.*)",
    re.DOTALL,
)
_KEY = re.compile(r"[A-Za-z_][\w.\[\]-]*")


def from_error(error: DrError, rule_of: RuleOf) -> list[Violation]:
    """A parser's refusal, finding by finding."""
    if isinstance(error, FindingsError):
        return from_findings(error.findings, rule_of)
    finding = from_sentence(str(error), error.remedy)
    if not isinstance(error, SettingsError):
        finding = Finding("", str(error).removesuffix("."), error.remedy)
    return from_findings([finding], rule_of)


def from_findings(
    findings: Iterable[Finding], rule_of: RuleOf, severity: Severity = "error"
) -> list[Violation]:
    """Findings as violations."""
    return [
        Violation(rule_of(finding), severity, finding.where, f"{finding.what}.", finding.remedy)
        for finding in findings
    ]


def from_sentence(sentence: str, remedy: str = "") -> Finding:
    """A sentence of the form `place: what is wrong.` taken apart; the place may be missing."""
    match = _PLACE.fullmatch(sentence)
    where, what = match.groups() if match is not None else ("", sentence)
    return Finding(where, what.removesuffix("."), remedy)


def key_of(finding: Finding) -> str:
    """The key or setting that a finding begins with, such as `action_space[2].speed`."""
    match = _KEY.match(finding.what)
    return match[0] if match is not None else ""
