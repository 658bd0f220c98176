"""What `dr config show` and `dr config check` report."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any

from drcli.base.errors import Problem, ProblemsError, closest, few
from drcli.base.report import BLANK, Log, Styled, View, bold, dim
from drcli.config.fields import Effect, Setting, hidden
from drcli.config.loading import load_settings
from drcli.config.settings import Settings, catalogue
from drcli.config.settings_files import Layers, given
from drcli.config.track_names import track_problems
from drcli.config.unused_names import FORMER, WithoutEffect, without_effect


@dataclass(frozen=True)
class Value:
    """One setting with its present value."""

    name: Annotated[str, "Name of the setting, or another name from the racer's files."]
    value: Annotated[str, "Its value, with all `$NAME` replaced; passwords and keys are hidden."]
    default: Annotated[str, "Its default value."]
    source: Annotated[
        str, "Where it was given: `run.env line 7`, `environment`, `flag` or `default`."
    ]
    file: Annotated[str | None, "The file, None if the value does not come from a file."]
    line: Annotated[int | None, "The line there."]
    changed: Annotated[bool, "Whether it differs from its default."]
    effect: Annotated[Effect, "Whether it does something here."]
    reason: Annotated[str, "Why it has no effect."]
    meaning: Annotated[str, "What it does."]
    expected: Annotated[str, "The allowed values."]
    group: Annotated[str, "Heading in the documentation."]

    def pieces(self) -> tuple[str, str]:
        quote = '"' if re.search(r"\s|#", self.value) else ""
        written = f"{self.name}={quote}{self.value}{quote}"
        place = f"# {self.source}" + (", no effect" if self.reason else "")
        return (written if self.changed else dim(written)), dim(place)


@dataclass(frozen=True)
class WorkerValues:
    """What the file of one simulation worker changes."""

    worker: Annotated[int, "Its number, counted from 1 as in the name of the file."]
    settings: Annotated[tuple[Value, ...], "The values."]


@dataclass(frozen=True)
class Values:
    """What `dr config show` shows."""

    directory: Annotated[str, "The working folder."]
    experiment: Annotated[str, "Name of the experiment, empty without one."]
    settings: Annotated[tuple[Value, ...], "The values, in the order of the documentation."]
    workers: Annotated[tuple[WorkerValues, ...], "The settings that worker-N.env changes."]

    def view(self, *, explained: bool) -> View:
        if explained:
            for value in self.settings:
                default = f" Default: {value.default}." if value.default else ""
                no_effect = value.reason and Styled(f"No effect here: {value.reason}.", "yellow")
                yield Log([value.pieces()])
                yield [value.meaning, dim(f"Allowed: {value.expected}.{default}"), no_effect]
            yield from (_log(worker.settings) for worker in self.workers)
            return
        of_group = groupby(self.settings, lambda value: value.group)  # a group may come twice
        groups = [(title, tuple(values)) for title, values in of_group]
        groups += [(f"Worker {worker.worker}", worker.settings) for worker in self.workers]
        for number, (title, values) in enumerate(groups):
            yield from (number and BLANK, bold(f"# {title}"), _log(values))
        if not groups:
            yield "Every setting has its default."


def _log(values: Iterable[Value]) -> Log:
    return Log([value.pieces() for value in values])


@dataclass(frozen=True)
class SettingsCheck:
    """What `dr config check` found."""

    directory: str
    problems: tuple[Problem, ...] = ()
    without_effect: tuple[WithoutEffect, ...] = ()

    @property
    def errors(self) -> tuple[Problem, ...]:
        return tuple(problem for problem in self.problems if problem.severity == "error")

    @property
    def warnings(self) -> tuple[str, ...]:
        return tuple(warnings_of(self.problems))


def find_name(written: str, others: Sequence[str] = ()) -> str | None:
    """The name that is meant: small letters and a missing DR_ are fine."""
    if written in others:
        return written
    candidates = (written.upper(), f"DR_{written.upper()}")
    return next((name for name in candidates if name in catalogue()), None)


def suggestion(written: str) -> str:
    full = written.upper()
    if full in FORMER:
        return f"It is a name of the reference and has no effect here: {FORMER[full].reason}."
    likely = closest(full if full.startswith("DR_") else f"DR_{full}", catalogue())
    hint = f"Did you mean {likely}? " if likely is not None else ""
    present = next((s.name for s in catalogue().values() if full in s.old_names), None)
    return f"It is the old name of {present}." if present else f"{hint}`dr config show` lists all."


def inspect_values(
    settings: Settings, names: Sequence[str] = (), *, changed: bool = False
) -> Values:
    """All settings and other names, or some."""

    def chosen(values: Iterable[Value]) -> tuple[Value, ...]:
        wanted = (value for value in values if not names or value.name in names)
        return tuple(value for value in wanted if value.changed or not changed)

    everything = [_value(settings, setting) for setting in catalogue().values()]
    everything += [_other_name(settings, name) for name in settings.extra]
    workers = []
    for number, override in enumerate(settings.overrides, start=2):
        own = settings.for_worker(number - 1)
        of_worker = chosen(_value(own, catalogue()[name]) for name in override.sources)
        if of_worker:
            workers.append(WorkerValues(number, of_worker))
    return Values(
        str(settings.directory), settings.experiment_name, chosen(everything), tuple(workers)
    )


def check_settings(
    directory: Path,
    environ: Mapping[str, str] | None = None,
    contents: Mapping[str, bytes] | None = None,
    *,
    known_suffices: bool = False,
) -> SettingsCheck:
    """Report all problems; see `load_settings`."""
    try:
        settings = load_settings(directory, environ=environ, contents=contents)
    except ProblemsError as error:
        return SettingsCheck(str(directory), error.problems)
    problems = (*settings.problems, *track_problems(settings.races, known_suffices=known_suffices))
    return SettingsCheck(str(directory), problems, without_effect(settings))


def warnings_of(problems: Iterable[Problem]) -> list[str]:
    """Warnings and notes as sentences; notes with what to do."""
    odd = (problem for problem in problems if problem.severity != "error")
    return few(f"{each} {each.remedy}" if each.severity == "note" else str(each) for each in odd)


def _value(settings: Settings, setting: Setting) -> Value:
    text, default = _text(getattr(settings, setting.field)), _default(settings, setting)
    return _present(settings, setting, text, default)


def _other_name(settings: Settings, name: str) -> Value:
    former = FORMER.get(name)
    meaning = "A name of your own, which other values can refer to."
    reason = ""
    if former is not None:
        meaning, reason = former.meaning, former.reason
    other = Setting(
        name, "", meaning, None, None, (), "accepted", reason, None, group="Other names"
    )
    return _present(settings, other, settings.extra[name], None)


def _present(settings: Settings, setting: Setting, text: str, default: str | None) -> Value:
    place = settings.place(setting.name)
    return Value(
        name=setting.name,
        value=hidden(setting.name, text),
        default=hidden(setting.name, default or ""),
        source=str(place),
        file=None if place.line is None else place.file,
        line=place.line,
        changed=text != default,
        effect=setting.effect,
        reason=setting.reason,
        meaning=setting.meaning,
        expected=setting.expected,
        group=setting.group,
    )


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return ";".join(",".join(f"{number:g}" for number in pair) for pair in value)
    return "" if value is None else str(value)


def _default(settings: Settings, setting: Setting) -> str:
    if setting.kind == "path" and setting.default is not None:
        return str(settings.directory / setting.default)
    if "$" not in setting.default_text:
        return setting.default_text
    others = {
        other.name: _text(getattr(settings, other.field))
        for other in catalogue().values()
        if other is not setting
    }
    layers = Layers([given(others, "")], {setting.name: setting.default_text})
    return layers.text(setting.name) or ""
