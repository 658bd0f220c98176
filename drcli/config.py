"""Loads system.env and run.env into typed, frozen settings.

Settings win in this order: flag, process environment, run.env, system.env, default. A load reports
everything that is wrong at once.
"""

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from drcli.envfile import Entry, read_env_file
from drcli.errors import SettingsError
from drcli.findings import Finding, closest, one_of, settings_error, shown
from drcli.settings.checks import contradictions, misfits, without_effect
from drcli.settings.layers import Layers, references
from drcli.settings.model import WORKER_NAMES, WORKER_STEMS, Override, Settings, catalogue

__all__ = ["Settings", "catalogue", "load_settings"]

TYPO_SIMILARITY = 0.85
"""From here on an unknown DR_ name is taken for a misspelt one. DR_WORKER and DR_WORKERS: 0.95."""


def load_settings(
    directory: Path,
    *,
    flags: Mapping[str, str] | None = None,
    environ: Mapping[str, str] | None = None,
    experiment: str | None = None,
) -> Settings:
    """Read and check all settings.

    Args:
        directory: Folder with run.env and, usually, system.env.
        flags: Values from the command line, by DR_ name.
        environ: Process environment; `os.environ` when None.
        experiment: Use experiments/<name>/run.env instead of run.env.

    Raises:
        SettingsError: Something is wrong; the message has a line for each finding.
    """
    given = dict(flags or {})
    if experiment:
        given["DR_EXPERIMENT_NAME"] = experiment
    upper = [
        _written(given, "flag"),
        _written(os.environ if environ is None else environ, "environment"),
    ]
    return _Loader(directory.absolute()).load(upper)


def _written(values: Mapping[str, str], where: str) -> dict[str, Entry]:
    return {name: Entry(name, value, where, expands=False) for name, value in values.items()}


class _Loader:
    """One load: gathers findings and warnings until it can raise or return."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._findings: list[Finding] = []
        self._warnings: list[str] = []

    def load(self, upper: list[dict[str, Entry]], worker: int | None = None) -> Settings:
        """Read everything.

        Args:
            upper: Layers above the files.
            worker: Number of the worker whose own file goes on top of all, counted from 1.
        """
        system: dict[str, Entry] = {}
        if (self._directory / "system.env").exists():
            system = self._file("system.env")
        else:
            self._warnings.append("system.env: is missing, so its settings have their defaults.")
        experiment = self._experiment([*upper, system])
        run = self._file(f"experiments/{experiment}/run.env" if experiment else "run.env")
        self._refuse_late_experiment(run, experiment)

        folder = f"experiments/{experiment}/" if experiment else ""
        own = self._worker_file(folder, worker) if worker is not None else {}
        entries = [own, *upper, run, system]
        for layer in entries:
            _drop_empty(layer)
        self._rename(entries)
        layers, values = self._settle(entries)
        extra = self._unknown(layers, entries)
        if self._findings:
            raise settings_error(sorted(self._findings, key=_position))

        sources = {
            name: entry.where for name in catalogue() if (entry := layers.find(name)) is not None
        }
        settings = Settings(
            directory=self._directory,
            extra=extra,
            sources=sources,
            warnings=(),
            **values,
        )
        if clashes := list(contradictions(settings)):
            raise settings_error(clashes)
        warnings = (*self._warnings, *without_effect(settings))
        overrides: tuple[Override, ...] = ()
        if worker is None and settings.train_multi_config:
            overrides, more = self._overrides(settings, upper)
            warnings = (*warnings, *more)
        elif worker is not None:
            overrides = (_override(layers, own, values),)
        return settings.model_copy(update={"warnings": warnings, "overrides": overrides})

    def _worker_file(self, folder: str, worker: int) -> dict[str, Entry]:
        """The entries of a worker's own file that may differ from worker to worker."""
        name = f"{folder}worker-{worker}.env"
        if not (self._directory / name).is_file():
            raise SettingsError(
                f"{name}: there is no such file in {self._directory}, but DR_TRAIN_MULTI_CONFIG "
                f"is True and there is a worker {worker}.",
                remedy=f"Write the track and race of that worker into {name}, or set DR_WORKERS to "
                f"{worker - 1}.",
            )
        entries = self._file(name)
        for key in [key for key in entries if not _is_of_worker(key)]:
            entry = entries.pop(key)
            self._warnings.append(
                f"{entry.where}: {shown(key)} is the same for all workers and ignored here."
            )
        return entries

    def _overrides(
        self, settings: Settings, upper: list[dict[str, Entry]]
    ) -> tuple[tuple[Override, ...], list[str]]:
        """What the files of the second and all further workers change, and what is odd in them."""
        loaded = [
            _Loader(self._directory).load([dict(layer) for layer in upper], worker)
            for worker in range(2, settings.workers + 1)
        ]
        said = set(self._warnings)
        warnings = dict.fromkeys(
            text
            for other in loaded
            for text in other.warnings
            if text not in said and "worker-" in text
        )
        return tuple(other.overrides[0] for other in loaded), list(warnings)

    def _file(self, name: str) -> dict[str, Entry]:
        """The entries of a file; a repeated name counts as last written, as in a shell."""
        path = self._directory / name
        if not path.is_file():
            raise SettingsError(
                f"{name}: there is no such file in {self._directory}.",
                remedy=f"Change to the folder that holds {name}, or create one with `dr init`.",
            )
        content = read_env_file(path, name)
        self._findings += content.findings
        entries: dict[str, Entry] = {}
        for entry in content.entries:
            if entry.name in entries:
                before = entries[entry.name].where
                self._warnings.append(
                    f"{entry.where}: {entry.name} stands at {before} too; the later line counts."
                )
            entries[entry.name] = entry
        return entries

    def _experiment(self, entries: list[dict[str, Entry]]) -> str:
        layers = Layers(entries, {})
        name = (layers.text("DR_EXPERIMENT_NAME") or "").strip()
        entry = layers.find("DR_EXPERIMENT_NAME")
        if not name or entry is None:
            return ""
        folder = self._directory / "experiments"
        existing = sorted(found.parent.name for found in folder.glob("*/run.env"))
        if name not in existing:
            what = f"DR_EXPERIMENT_NAME={shown(name)} has no experiments/{shown(name)}/run.env"
            remedy = one_of(existing, name) if existing else "Create that file, or drop the name."
            raise settings_error([Finding(entry.where, what, remedy)])
        return name

    def _refuse_late_experiment(self, run: dict[str, Entry], experiment: str) -> None:
        entry = run.pop("DR_EXPERIMENT_NAME", None)
        if entry is not None and entry.value not in ("", experiment):
            what = f"DR_EXPERIMENT_NAME={shown(entry.value)} comes too late to choose a run.env"
            self._findings.append(Finding(entry.where, what, "Move the line to system.env."))

    def _rename(self, entries: list[dict[str, Entry]]) -> None:
        """Let old names stand for the present ones."""
        old_names = [(old, s.name) for s in catalogue().values() for old in s.old_names]
        for old, name in old_names:
            layer = next((layer for layer in entries if old in layer), None)
            if layer is None:
                continue
            verdict = f"{layer[old].where}: {old} is the old name of {name}"
            if any(name in other for other in entries):
                self._warnings.append(f"{verdict} and ignored, because both are set.")
            else:
                layer[name] = replace(layer[old], name=name)
                self._warnings.append(f"{verdict}; better write that.")

    def _settle(self, entries: list[dict[str, Entry]]) -> tuple[Layers, dict[str, Any]]:
        """Values by field name; wrong ones that change nothing are dropped from the layers."""
        while True:
            layers = Layers(entries, _default_texts())
            values, dropped = self._values(layers)
            if not dropped:
                return layers, values
            for layer in entries:
                for name in dropped:
                    layer.pop(name, None)

    def _values(self, layers: Layers) -> tuple[dict[str, Any], set[str]]:
        """Texts by field name, and the names of wrong ones that change nothing."""
        dropped: set[str] = set()
        texts: dict[str, str] = {}
        for name, setting in catalogue().items():
            text = layers.text(name)
            if name in layers.findings:
                self._blame(name, layers.findings[name], dropped)
            elif text is not None and (text.strip() or setting.kind == "text"):
                texts[name] = text.strip()
        values = {catalogue()[name].field: self._tidy(name, text) for name, text in texts.items()}
        problems = {name: (reason, remedy) for name, reason, remedy in misfits(values, texts)}
        for name, (reason, remedy) in problems.items():
            setting = catalogue()[name]
            values.pop(setting.field)
            entry = layers.find(name)
            written = entry.value.strip() if entry is not None else setting.default_text
            if references(written) & problems.keys():
                continue  # the name it refers to is what needs mending
            what = f"{name}={shown(texts[name])} {reason}"
            if written != texts[name]:
                what += f" (written {shown(written)})"
            where = entry.where if entry is not None else "default"
            self._blame(name, Finding(where, what, remedy), dropped)
        return values, dropped & layers.names()

    def _blame(self, name: str, finding: Finding, dropped: set[str]) -> None:
        """Take down what is wrong with a setting; it is no failure where it changes nothing."""
        if catalogue()[name].effect != "used":
            self._warnings.append(f"{finding} It has no effect here.")
            dropped.add(name)
        elif finding not in self._findings:
            self._findings.append(finding)

    def _tidy(self, name: str, text: str) -> str:
        """Spell choices as they are declared, and make folders independent of where we stand."""
        setting = catalogue()[name]
        if setting.kind == "choice":
            spelt = {choice.casefold(): choice for choice in setting.choices}
            return spelt.get(text.casefold(), text)
        if setting.kind == "path":
            path = Path(text).expanduser() if text.startswith("~/") else Path(text)
            return str(self._directory / path)
        return text

    def _unknown(self, layers: Layers, entries: list[dict[str, Entry]]) -> dict[str, str]:
        """Names that are no settings, with their values; findings for misspelt settings."""
        old_names = {old for setting in catalogue().values() for old in setting.old_names}
        known = catalogue().keys() | old_names
        extra: dict[str, str] = {}
        for layer in entries:
            for name, entry in layer.items():
                ours = name.upper().startswith("DR_")
                if name in known or name in extra or (entry.where == "environment" and not ours):
                    continue
                meant = closest(name if ours else f"DR_{name}", catalogue(), TYPO_SIMILARITY)
                if ours and meant is not None:
                    what = f"{name}={shown(entry.value)} is no setting"
                    remedy = f"Did you mean {meant}? Correct the name, or remove the line."
                    self._findings.append(Finding(entry.where, what, remedy))
                    continue
                text = layers.text(name)
                extra[name] = entry.value if text is None or name in layers.findings else text
                if name not in layers.referenced:
                    hint = f" Did you mean {meant}?" if meant is not None else ""
                    self._warnings.append(
                        f"{entry.where}: {shown(name)} is no setting and has no effect.{hint}"
                    )
        return extra


def _is_of_worker(name: str) -> bool:
    """Whether a setting may differ from worker to worker; old names count as the present ones."""
    present = next((s.name for s in catalogue().values() if name in s.old_names), name)
    return present in WORKER_NAMES or present.startswith(WORKER_STEMS)


def _override(layers: Layers, own: dict[str, Entry], values: dict[str, Any]) -> Override:
    """What a worker's own file says, with everything filled in."""
    known = [name for name in own if name in catalogue() and layers.find(name) is own[name]]
    fields = {catalogue()[name].field for name in known}
    return Override(
        values={field: values[field] for field in fields if field in values},
        sources={name: own[name].where for name in known},
    )


def _position(finding: Finding) -> tuple[str, int]:
    """File and line of a finding, to report it in the order of reading."""
    file, _, line = finding.where.partition(" line ")
    return file, int(line or 0)


def _drop_empty(layer: dict[str, Entry]) -> None:
    """An empty value means not set, except where a text may be empty."""
    for name, setting in catalogue().items():
        if setting.kind != "text" and name in layer and not layer[name].value.strip():
            del layer[name]


def _default_texts() -> dict[str, str]:
    """Defaults as texts: other values refer to them, and some refer to other names."""
    return {name: setting.default_text for name, setting in catalogue().items()}
