"""Judges names: old ones, misspelt ones, and those that are the racer's own."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from drcli.base.problems import Finding, closest, shown
from drcli.config.env_file import Entry
from drcli.config.former_names import FORMER
from drcli.config.layers import Layers
from drcli.config.model import catalogue
from drcli.config.secrets import hidden

TYPO_SIMILARITY = 0.85
"""From here on an unknown DR_ name is taken for a misspelt one. DR_WORKER and DR_WORKERS: 0.95."""


@dataclass(frozen=True)
class Strangers:
    """Names that are no settings.

    Attributes:
        values: What they stand for, with everything filled in.
        findings: Those that are misspelt settings.
        warnings: Sentences about those that nothing refers to.
    """

    values: dict[str, str] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def old_names() -> dict[str, str]:
    """The present name of a setting, for each name that earlier versions of the reference used."""
    return {old: setting.name for setting in catalogue().values() for old in setting.old_names}


def rename_old(layers: Sequence[dict[str, Entry]]) -> list[str]:
    """Let old names stand for the present ones.

    Args:
        layers: Entries by name, strongest layer first; they are changed.

    Returns:
        A sentence about each old name.
    """
    warnings = []
    for old, name in old_names().items():
        layer = next((layer for layer in layers if old in layer), None)
        if layer is None:
            continue
        verdict = f"{layer[old].where}: {old} is the old name of {name}"
        if any(name in other for other in layers):
            warnings.append(f"{verdict} and ignored, because both are set.")
        else:
            layer[name] = replace(layer[old], name=name)
            warnings.append(f"{verdict}; better write that.")
    return warnings


def strangers(looked_up: Layers, layers: Sequence[dict[str, Entry]]) -> Strangers:
    """The names that are no settings.

    Args:
        looked_up: Knows which names the values of settings refer to.
        layers: Entries by name, strongest layer first.
    """
    found = Strangers()
    known = catalogue().keys() | old_names().keys()
    from_outside: list[str] = []
    for layer in layers:
        for name, entry in layer.items():
            ours = name.upper().startswith("DR_")
            outside = entry.where == "environment"
            if name in known or name in found.values or (outside and not ours):
                continue
            if outside and name in FORMER:
                continue
            meant = _meant(name)
            if ours and meant is not None and not outside:
                what = f"{name}={shown(hidden(name, entry.value))} is no setting"
                remedy = f"Did you mean {meant}? Correct the name, or remove the line."
                found.findings.append(Finding(entry.where, what, remedy))
                continue
            text = looked_up.text(name)
            if text is None or name in looked_up.findings:
                text = entry.value
            found.values[name] = text
            if name in looked_up.referenced or name in FORMER:
                continue
            if outside:
                from_outside.append(name if meant is None else f"{name} (did you mean {meant}?)")
            else:
                hint = f" Did you mean {meant}?" if meant is not None else ""
                found.warnings.append(
                    f"{entry.where}: {shown(name)} is no setting and has no effect.{hint}"
                )
    if from_outside:
        # A shell in which the reference was activated has a dozen names of its own.
        found.warnings.append(
            f"environment: unknown and without effect here: {', '.join(from_outside)}."
        )
    return found


def _meant(name: str) -> str | None:
    """The setting whose name somebody probably misspelt."""
    if name in FORMER:
        return None
    ours = name.upper().startswith("DR_")
    return closest(name if ours else f"DR_{name}", catalogue(), TYPO_SIMILARITY)
