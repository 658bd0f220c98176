"""Says which settings of the racer's files do nothing here, and why."""

from collections.abc import Iterator
from dataclasses import dataclass

from drcli.base.problems import Place, Problem, shown
from drcli.config.former_names import FORMER
from drcli.config.model import Settings, catalogue
from drcli.config.secrets import hidden
from drcli.config.setting_problems import file_problem, setting_problem

OUTSIDE = ("default", "environment")
"""Sources of values that the racer has not written into a file: a shell in which the reference was
activated holds all of its names."""

REMEDY = "Keep the lines or remove them."


@dataclass(frozen=True)
class Idle:
    """Settings that do nothing, all for the same reason.

    Attributes:
        reason: Why, without a full stop.
        names: The settings, in the order of the documentation.
    """

    reason: str
    names: tuple[str, ...]


def idle(settings: Settings) -> tuple[Idle, ...]:
    """Every name in the racer's files that does nothing, also where it has its default."""
    by_reason: dict[str, list[str]] = {}
    for item in _useless(settings):
        if settings.place(item.name).file not in OUTSIDE:
            by_reason.setdefault(item.reason, []).append(item.name)
    return tuple(Idle(reason, tuple(names)) for reason, names in by_reason.items())


def without_effect(settings: Settings) -> Iterator[Problem]:
    """Warnings about settings that do nothing: one per reason, and one for all harmless ones."""
    by_reason: dict[str, list[_Useless]] = {}
    for item in _useless(settings):
        if item.missed:
            by_reason.setdefault(item.reason, []).append(item)
    for reason, group in by_reason.items():
        name, written = group[0].name, ", ".join(item.written for item in group)
        what = f"{written} {'has' if len(group) == 1 else 'have'} no effect: {reason}."
        yield setting_problem(name, settings.place(name), what, REMEDY, severity="warning")
    rest = remainder(settings)
    if rest is not None:
        yield rest


def remainder(settings: Settings) -> Problem | None:
    """One warning about all others in the racer's files, None where there are none."""
    told = {item.name for item in _useless(settings) if item.missed}
    harmless = [name for group in idle(settings) for name in group.names if name not in told]
    if not harmless:
        return None
    place = Place(" and ".join(sorted({settings.place(name).file for name in harmless})))
    what = (
        f"{len(harmless)} of the settings {'is' if len(harmless) == 1 else 'are'} for containers, "
        "windows, videos and the like, without effect here. `dr config check` names them."
    )
    return file_problem(place, what, REMEDY, severity="warning")


@dataclass(frozen=True)
class _Useless:
    """A name that does nothing here, whoever set it."""

    name: str
    reason: str
    written: str
    """Name and value, as they may be shown."""
    missed: bool
    """Whether somebody may expect an effect."""


def _useless(settings: Settings) -> Iterator[_Useless]:
    for name, setting in catalogue().items():
        if setting.effect != "used":
            value = getattr(settings, setting.field)
            missed = setting.effect == "planned" and value != setting.default
            yield _Useless(name, setting.reason, _written(name, str(value)), missed)
    for name, value in settings.extra.items():
        if name in FORMER:
            former = FORMER[name]
            yield _Useless(name, former.reason, _written(name, value), former.missed(value))


def _written(name: str, value: str) -> str:
    return f"{name}={shown(hidden(name, value))}"
