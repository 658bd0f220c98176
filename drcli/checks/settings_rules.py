"""The settings files against the rules: names, types, ranges, and values that need each other."""

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from drcli.base.errors import SettingsError
from drcli.base.problems import Finding
from drcli.checks.check_report import Violation
from drcli.checks.translation import from_error, from_findings, from_sentence, key_of
from drcli.config.settings import Settings, catalogue, load_settings

MOST_REPAIRS = 5
"""How often lines are taken out: a line that is gone may show what was wrong behind it."""

RULES = {
    "DR_WORLD_NAME": "V-05",
    "DR_RACE_TYPE": "V-07",
    "DR_CAR_COLOR": "V-08",
    "DR_LOCAL_S3_PRETRAINED": "V-10",
    "DR_LOCAL_S3_PRETRAINED_PREFIX": "V-10",
    "DR_LOCAL_S3_PRETRAINED_CHECKPOINT": "V-10",
    "DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST": "V-42",
    "DR_WORKERS": "V-45",
}
"""Settings with a rule of their own; V-12 is about all others."""

SCREEN = (
    "DR_HOST_X",
    "DR_DISPLAY",
    "DR_GUI_ENABLE",
    "DR_ROBOMAKER_CUDA_DEVICES",
)
"""Settings about X servers and GPUs that nothing here needs (V-06)."""

_LINE = re.compile(r"(.+\.env)(?: line (\d+))?")


@dataclass(frozen=True)
class SettingsReview:
    """What can be said about the settings.

    Attributes:
        settings: As they would count with the wrong lines left out; None where nothing helps.
        whole: Whether they count as they are.
        violations: What is wrong with them.
    """

    settings: Settings | None
    whole: bool
    violations: list[Violation]


def review_settings(directory: Path, environ: Mapping[str, str] | None = None) -> SettingsReview:
    """Load the settings of a working folder, whatever is in its files."""
    names = dict(os.environ if environ is None else environ)
    contents: dict[str, bytes] = {}
    violations: list[Violation] = []
    for attempt in range(MOST_REPAIRS):
        try:
            settings = load_settings(directory, environ=names, contents=contents)
        except SettingsError as error:
            found = from_error(error, _rule_of)
            violations += [item for item in found if item not in violations]
            if not _take_out(found, directory, contents, names):
                return SettingsReview(None, False, violations)
            continue
        return SettingsReview(settings, attempt == 0, [*violations, *judge(settings)])
    return SettingsReview(None, False, violations)


def judge(settings: Settings) -> list[Violation]:
    """What is wrong or odd about settings that load."""
    found = [_remark(sentence) for sentence in settings.warnings]
    refusal = settings.unsupported("training")
    if refusal is not None:
        finding = from_sentence(refusal, "Choose another DR_RACE_TYPE, or use `dr-evaluate`.")
        found += from_findings([finding], lambda _: "V-07")
    for name in SCREEN:
        setting = catalogue()[name]
        if name in settings.sources and getattr(settings, setting.field) != setting.default:
            found.append(
                Violation(
                    "V-06",
                    "warning",
                    settings.source(name),
                    f"{name}={getattr(settings, setting.field)} is accepted and not needed: "
                    f"{setting.reason}.",
                    "Keep or remove the line.",
                )
            )
    return found


def _remark(sentence: str) -> Violation:
    finding = from_sentence(sentence, "Correct the line, or remove it.")
    if "is missing" in finding.what:
        finding = replace(finding, remedy="`dr-init` writes one.")
    if "effect here" in finding.what:
        finding = replace(finding, remedy="Keep the lines or remove them.")
    return Violation(
        _rule_of(finding), "warning", finding.where, f"{finding.what}.", finding.remedy
    )


def _rule_of(finding: Finding) -> str:
    if re.search(r"worker-\d+\.env$", finding.where):
        return "V-45"
    return RULES.get(key_of(finding), "V-12")


def _take_out(
    found: list[Violation], directory: Path, contents: dict[str, bytes], names: dict[str, str]
) -> bool:
    """Blank the lines that are wrong; False where the place of one is not known."""
    for item in found:
        line = _LINE.fullmatch(item.where)
        name = key_of(Finding(item.where, item.message, ""))
        if item.where == "environment" and name in names:
            del names[name]
        elif line is not None:
            contents[line[1]] = _without(line[1], line[2], directory, contents)
        else:
            return False
    return True


def _without(
    name: str, number: str | None, directory: Path, contents: Mapping[str, bytes]
) -> bytes:
    """A file's content with one of its lines, counted from 1, left empty; without all of it."""
    path = directory / name
    if number is None or not (name in contents or path.is_file()):
        return b""
    lines = (contents[name] if name in contents else path.read_bytes()).splitlines(keepends=True)
    index = int(number) - 1
    if index < len(lines):
        lines[index] = b"\n"
    return b"".join(lines)
