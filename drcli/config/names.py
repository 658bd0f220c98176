"""Finds names that are not settings: old ones, misspelt ones, and the racer's own."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from drcli.base.problems import Place, Problem, closest, shown
from drcli.config.env_file import Entry
from drcli.config.former_names import FORMER
from drcli.config.layers import Layers
from drcli.config.model import catalogue
from drcli.config.secrets import hidden
from drcli.config.setting_problems import file_problem, setting_problem

TYPO_SIMILARITY = 0.85
"""From here on an unknown DR_ name is a misspelt one. DR_WORKER and DR_WORKERS: 0.95."""


@dataclass(frozen=True)
class UnknownNames:
    """Names that are not settings, with their filled-in values, and what is wrong with them."""

    values: dict[str, str] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)


def old_names() -> dict[str, str]:
    """The present name of a setting, for each name that earlier versions of the reference used."""
    return {old: setting.name for setting in catalogue().values() for old in setting.old_names}


def rename_old(layers: Sequence[dict[str, Entry]]) -> list[Problem]:
    """Let old names stand for the present ones, in the layers; a warning about each of them."""
    warnings = []
    for old, name in old_names().items():
        layer = next((layer for layer in layers if old in layer), None)
        if layer is None:
            continue
        what = f"{old} is the old name of {name}"
        if any(name in other for other in layers):
            what, remedy = f"{what} and is ignored, because both are set.", "Remove the line."
        else:
            layer[name] = replace(layer[old], name=name)
            what, remedy = f"{what}; write the new name.", "Correct the name."
        place = layer[old].place
        warnings.append(setting_problem(name, place, what, remedy, severity="warning"))
    return warnings


def unknown_names(looked_up: Layers, layers: Sequence[dict[str, Entry]]) -> UnknownNames:
    """The names that are not settings.

    Args:
        looked_up: Knows which names the values of settings refer to.
        layers: The layers that were looked up in.
    """
    found = UnknownNames()
    known = catalogue().keys() | old_names().keys()
    from_outside: list[str] = []
    for layer in layers:
        for name, entry in layer.items():
            ours = name.upper().startswith("DR_")
            outside = entry.place.file == "environment"
            if name in known or name in found.values or (outside and not ours):
                continue
            if outside and name in FORMER:
                continue
            meant = _meant(name)
            if ours and meant is not None and not outside:
                what = f"{name}={shown(hidden(name, entry.value))} is not a setting."
                remedy = f"Did you mean {meant}? Correct the name, or remove the line."
                found.problems.append(setting_problem(name, entry.place, what, remedy))
                continue
            text = looked_up.text(name)
            if text is None or name in looked_up.problems:
                text = entry.value
            found.values[name] = text
            if name in looked_up.referenced or name in FORMER:
                continue
            if outside:
                from_outside.append(name if meant is None else f"{name} (did you mean {meant}?)")
            else:
                hint = f" Did you mean {meant}?" if meant is not None else ""
                what = f"{shown(name)} is not a setting and has no effect.{hint}"
                remedy = "Correct the line, or remove it."
                found.problems.append(
                    setting_problem(name, entry.place, what, remedy, severity="warning")
                )
    if from_outside:
        # A shell in which the reference was activated has a dozen names of its own.
        what = f"unknown names without effect: {', '.join(from_outside)}."
        place, remedy = Place("environment"), "Correct them, or ignore this."
        found.problems.append(file_problem(place, what, remedy, severity="warning"))
    return found


def _meant(name: str) -> str | None:
    """The setting whose name somebody probably misspelt."""
    if name in FORMER:
        return None
    ours = name.upper().startswith("DR_")
    return closest(name if ours else f"DR_{name}", catalogue(), TYPO_SIMILARITY)
