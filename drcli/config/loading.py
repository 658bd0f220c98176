"""Loads system.env and run.env into typed, frozen settings, with all problems at once.

The order is flag, process environment, run.env, system.env, default.
"""

import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from drcli.base.problems import BadValue, Place, Problem, ProblemsError, shown
from drcli.config import activation
from drcli.config.cross_checks import contradictions
from drcli.config.fields import Setting
from drcli.config.run_config import RaceConfig
from drcli.config.setting_problems import file_problem, hidden, setting_problem
from drcli.config.settings import Override, Settings, catalogue
from drcli.config.settings_files import EXPERIMENT, Entry, Layers, SettingsFiles, given, references
from drcli.config.track_names import track_problem
from drcli.config.unused_names import effect_warnings, old_names, rename_old, unknown_names

WORKER_NAMES = (
    "DR_WORLD_NAME",
    "DR_RACE_TYPE",
    "DR_CAR_COLOR",
    "DR_CAR_BODY_SHELL_TYPE",
    "DR_ENABLE_DOMAIN_RANDOMIZATION",
    "DR_RANDOMIZE_TEXTURES",
    "DR_TRAIN_CHANGE_START_POSITION",
    "DR_TRAIN_ALTERNATE_DRIVING_DIRECTION",
    "DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST",
    "DR_TRAIN_START_POSITION_OFFSET",
    "DR_TRAIN_REVERSE_DIRECTION",
    "DR_TRAIN_LANES",
    "DR_PHYSICS",
    "DR_CAMERA_MAIN_ENABLE",
    "DR_CAMERA_SUB_ENABLE",
    "DR_ENABLE_EXTRA_KVS_OVERLAY",
    "DR_CAR_STEERING_LEFT",
    "DR_CAR_STEERING_RIGHT",
    "DR_CAR_STEERING_TRIM",
    "DR_CAR_MAX_SPEED",
    "DR_CAR_BATTERY",
)
"""In worker-N.env, besides those that begin as follows."""

WORKER_STEMS = ("DR_OA_", "DR_H2B_", "DR_SIM_")


def load_settings(
    directory: Path,
    *,
    flags: Mapping[str, str] | None = None,
    environ: Mapping[str, str] | None = None,
    contents: Mapping[str, bytes] | None = None,
) -> Settings:
    """Read and check all settings; `contents` replace files on the disk.

    Raises:
        ProblemsError: Something is wrong, or there is no run.env.
    """
    files = SettingsFiles(directory.absolute(), contents)
    return _Loader(files).load(_outside(flags or {}, environ))


def active_run_file(
    directory: Path,
    *,
    flags: Mapping[str, str] | None = None,
    environ: Mapping[str, str] | None = None,
) -> str:
    """Name of the active run.env: that of the experiment, if there is one.

    Raises:
        SettingsError: There is no such experiment, or system.env cannot be read.
    """
    files = SettingsFiles(directory.absolute())
    system = files.read("system.env") if files.exist("system.env") else {}
    layers = _outside(flags or {}, environ)
    return files.run_file(layers, files.experiment([*layers, system]))


def _outside(flags: Mapping[str, str], environ: Mapping[str, str] | None) -> list[dict[str, Entry]]:
    chosen = activation.chosen(os.environ if environ is None else environ)
    return [given(flags, "flag"), given(chosen, "environment")]


class _Loader:
    def __init__(self, files: SettingsFiles) -> None:
        self._files = files
        self._problems = files.problems

    def load(self, outside: list[dict[str, Entry]], worker: int | None = None) -> Settings:
        system = self._system()
        experiment = self._files.experiment([*outside, system])
        run = self._files.read(self._files.run_file(outside, experiment))
        self._refuse_late_experiment(run, experiment)

        folder = f"experiments/{experiment}/" if experiment else ""
        own = self._worker_file(folder, worker) if worker is not None else {}
        if not self._files.complete:
            self._refuse_errors()
        entries = [own, *outside, run, system]
        for layer in entries:
            _drop_empty(layer)
        self._problems += rename_old(entries)
        layers, values = self._resolve(entries)
        others, problems = unknown_names(layers, entries)
        self._problems += problems

        sources = {
            name: entry.place
            for name in (*catalogue(), *others)
            if (entry := layers.find(name)) is not None
        }
        defaults = {setting.field: setting.default for setting in catalogue().values()}
        settings = Settings(
            **defaults | values,
            directory=self._files.directory,
            extra=others,
            sources=sources,
            problems=(),
            overrides=(),
        )
        self._refuse_errors(settings.race)
        self._problems += contradictions(settings)
        self._refuse_errors(settings.race)
        overrides: tuple[Override, ...] = ()
        if worker is not None:
            overrides = (_override(layers, own, values),)
        else:
            if settings.train_multi_config:
                overrides = self._overrides(settings, outside)
                self._refuse_errors(settings.race)
            self._problems += effect_warnings(settings)
        return settings.replaced(problems=tuple(self._problems), overrides=overrides)

    def _refuse_errors(self, race: RaceConfig | None = None) -> None:
        """An unknown track is told then too; alone, it keeps no settings from loading."""
        if any(problem.severity == "error" for problem in self._problems):
            track = track_problem(race) if race is not None else None
            if track is not None and track.severity == "error":
                self._add([track])
            raise ProblemsError(sorted(self._problems, key=lambda p: (p.file, p.line or 0)))

    def _system(self) -> dict[str, Entry]:
        if self._files.exist("system.env"):
            return self._files.read("system.env")
        what = "is missing, so its settings have their defaults."
        place, remedy = Place("system.env"), "`dr-init` writes one."
        self._problems.append(file_problem(place, what, remedy, severity="warning"))
        return {}

    def _worker_file(self, folder: str, worker: int) -> dict[str, Entry]:
        name = f"{folder}worker-{worker}.env"
        if not self._files.exist(name):
            what = (
                f"there is no such file in {self._files.directory}, but DR_TRAIN_MULTI_CONFIG is "
                f"True and there is a worker {worker}."
            )
            remedy = (
                f"Write the track and race of that worker into {name}, or set DR_WORKERS to "
                f"{worker - 1}."
            )
            self._problems.append(setting_problem("DR_WORKERS", Place(name), what, remedy))
            return {}
        entries = self._files.read(name)
        for key in [key for key in entries if not is_of_worker(key)]:
            place = entries.pop(key).place
            what = f"{shown(key)} is the same for all workers and is ignored here."
            remedy = "Move the line to run.env, or remove it."
            self._problems.append(setting_problem(key, place, what, remedy, severity="warning"))
        return entries

    def _overrides(
        self, settings: Settings, outside: list[dict[str, Entry]]
    ) -> tuple[Override, ...]:
        overrides: list[Override] = []
        for worker in range(2, settings.workers + 1):
            loader = _Loader(SettingsFiles(self._files.directory, self._files.contents))
            try:
                loaded = loader.load([dict(layer) for layer in outside], worker)
            except ProblemsError as error:
                self._add(error.problems)
                continue
            overrides += loaded.overrides
            own_file = f"worker-{worker}.env"
            self._add(problem for problem in loaded.problems if problem.file.endswith(own_file))
        return tuple(overrides)

    def _add(self, problems: Iterable[Problem]) -> None:
        self._problems += [each for each in problems if each not in self._problems]

    def _refuse_late_experiment(self, run: dict[str, Entry], experiment: str) -> None:
        entry = run.pop(EXPERIMENT, None)
        if entry is not None and entry.value not in ("", experiment):
            what = f"{EXPERIMENT}={shown(entry.value)} is set in the run.env that it should choose."
            remedy = "Move the line to system.env."
            self._problems.append(setting_problem(EXPERIMENT, entry.place, what, remedy))

    def _resolve(self, entries: list[dict[str, Entry]]) -> tuple[Layers, dict[str, Any]]:
        # Other values refer to defaults, and some defaults refer to other names.
        defaults = {name: setting.default_text for name, setting in catalogue().items()}
        while True:
            layers = Layers(entries, defaults)
            values, bad = self._values(layers)
            dropped = bad & set().union(*entries)
            if not dropped:
                return layers, values
            for layer in entries:
                for name in dropped:
                    layer.pop(name, None)

    def _values(self, layers: Layers) -> tuple[dict[str, Any], set[str]]:
        dropped: set[str] = set()
        texts: dict[str, str] = {}
        values: dict[str, Any] = {}
        bad: dict[str, BadValue] = {}
        for name, setting in catalogue().items():
            text = layers.text(name)
            if name in layers.problems:
                self._blame(name, layers.problems[name], dropped)
            elif text is not None and (text.strip() or setting.kind == "text"):
                texts[name] = text.strip()
                try:
                    values[setting.field] = self._value(setting, texts[name])
                except BadValue as error:
                    bad[name] = error
        for name, fault in bad.items():
            entry = layers.find(name)
            place = Place("default") if entry is None else entry.place
            written = catalogue()[name].default_text if entry is None else entry.value.strip()
            if references(written) & bad.keys():
                continue  # the name it refers to has to be corrected
            what = f"{name}={shown(hidden(name, texts[name]))} {fault.reason}"
            if written != texts[name]:
                what += f" (written {shown(hidden(name, written))})"
            problem = setting_problem(name, place, f"{what}.", fault.remedy)
            self._blame(name, problem, dropped)
        return values, dropped

    def _value(self, setting: Setting, text: str) -> Any:
        value = setting.read(text)
        if not all(character >= " " for character in text):
            remedy = f"Remove it from {setting.name}."
            raise BadValue("contains a line break or control character", remedy)
        if setting.kind != "path":
            return value
        try:
            return self._files.directory / (value.expanduser() if text.startswith("~/") else value)
        except RuntimeError as e:  # neither HOME nor the list of users has it
            reason = "begins with ~, but the home folder of this user is not known"
            raise BadValue(reason, "Write the whole path, or set HOME.") from e

    def _blame(self, name: str, problem: Problem, dropped: set[str]) -> None:
        setting = catalogue()[name]
        harmless = ""
        if setting.effect != "used":
            harmless = "It has no effect here."
        elif setting.cosmetic:
            harmless = f"{setting.default_text} is used instead."
        if harmless:
            message = f"{problem.message} {harmless}"
            problem = replace(problem, severity="warning", message=message)
            dropped.add(name)
        self._add([problem])


def is_of_worker(name: str) -> bool:
    """Whether a setting, also by an old name, may differ from worker to worker."""
    present = old_names().get(name, name)
    return present in WORKER_NAMES or present.startswith(WORKER_STEMS)


def _override(layers: Layers, own: dict[str, Entry], values: dict[str, Any]) -> Override:
    known = [name for name in own if name in catalogue() and layers.find(name) is own[name]]
    fields = [catalogue()[name].field for name in known]
    return Override(
        values={field: values[field] for field in fields if field in values},
        sources={name: own[name].place for name in known},
    )


def _drop_empty(layer: dict[str, Entry]) -> None:
    """An empty value means not set, except where a text may be empty."""
    for name, setting in catalogue().items():
        if setting.kind != "text" and name in layer and not layer[name].value.strip():
            del layer[name]
