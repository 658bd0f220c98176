"""One load of all settings: from files, environment and flags to one frozen object.

It gathers everything that is wrong and all that looks odd, so that one start reports all of it.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drcli.base.problems import Finding, FindingsError, few, shown
from drcli.config.cross_checks import contradictions, misfits, oddities
from drcli.config.effects import without_effect
from drcli.config.env_file import Entry
from drcli.config.experiment import EXPERIMENT, chosen_experiment, run_file
from drcli.config.files import Files
from drcli.config.layers import Layers, references
from drcli.config.model import WORKER_NAMES, WORKER_STEMS, Override, Settings, catalogue, typed
from drcli.config.names import old_names, rename_old, strangers
from drcli.config.secrets import hidden


class Loader:
    """One load: gathers findings and warnings until it can raise or return.

    Args:
        directory: Folder with run.env, absolute.
        contents: Content of files, by name, to be taken for what lies there.
    """

    def __init__(self, directory: Path, contents: Mapping[str, bytes]) -> None:
        self._files = Files(directory, contents)
        self._findings = self._files.findings
        self._warnings = self._files.warnings

    def load(self, upper: list[dict[str, Entry]], worker: int | None = None) -> Settings:
        """Read everything.

        Args:
            upper: Layers above the files.
            worker: Number of the worker whose own file goes on top of all, counted from 1.

        Raises:
            FindingsError: Something is wrong.
            SettingsError: There is no run.env.
        """
        system = self._system()
        experiment = chosen_experiment(self._files, [*upper, system])
        run = self._files.read(run_file(self._files, upper, experiment))
        self._refuse_late_experiment(run, experiment)

        folder = f"experiments/{experiment}/" if experiment else ""
        own = self._worker_file(folder, worker) if worker is not None else {}
        if not self._files.complete:
            self._refuse_findings()
        entries = [own, *upper, run, system]
        for layer in entries:
            _drop_empty(layer)
        self._warnings += rename_old(entries)
        layers, values = self._settle(entries)
        strange = strangers(layers, entries)
        self._findings += strange.findings
        self._warnings += strange.warnings
        self._refuse_findings()

        sources = {
            name: entry.where
            for name in (*catalogue(), *strange.values)
            if (entry := layers.find(name)) is not None
        }
        settings = Settings(
            directory=self._files.directory,
            extra=strange.values,
            sources=sources,
            warnings=(),
            **typed(values),
        )
        self._findings += contradictions(settings)
        self._refuse_findings()
        overrides: tuple[Override, ...] = ()
        if worker is not None:
            overrides = (_override(layers, own, values),)
        else:
            if settings.train_multi_config:
                overrides = self._overrides(settings, upper)
                self._refuse_findings()
            self._warnings += (*oddities(settings), *without_effect(settings))
        return settings.replaced(warnings=tuple(few(self._warnings)), overrides=overrides)

    def run_file(self, upper: list[dict[str, Entry]]) -> str:
        """Name of the run.env that counts.

        Args:
            upper: Layers above the files.
        """
        experiment = chosen_experiment(self._files, [*upper, self._system()])
        return run_file(self._files, upper, experiment)

    def _refuse_findings(self) -> None:
        if self._findings:
            raise FindingsError(sorted(self._findings, key=_position), few(self._warnings))

    def _system(self) -> dict[str, Entry]:
        if self._files.exist("system.env"):
            return self._files.read("system.env")
        self._warnings.append("system.env: is missing, so its settings have their defaults.")
        return {}

    def _worker_file(self, folder: str, worker: int) -> dict[str, Entry]:
        """The entries of a worker's own file that may differ from worker to worker."""
        name = f"{folder}worker-{worker}.env"
        if not self._files.exist(name):
            self._findings.append(
                Finding(
                    name,
                    f"there is no such file in {self._files.directory}, but "
                    f"DR_TRAIN_MULTI_CONFIG is True and there is a worker {worker}",
                    f"Write the track and race of that worker into {name}, or set DR_WORKERS to "
                    f"{worker - 1}.",
                )
            )
            return {}
        entries = self._files.read(name)
        for key in [key for key in entries if not _is_of_worker(key)]:
            entry = entries.pop(key)
            self._warnings.append(
                f"{entry.where}: {shown(key)} is the same for all workers and ignored here."
            )
        return entries

    def _overrides(self, settings: Settings, upper: list[dict[str, Entry]]) -> tuple[Override, ...]:
        """What the files of the second and all further workers change."""
        overrides: list[Override] = []
        warnings: list[str] = []
        for worker in range(2, settings.workers + 1):
            loader = Loader(self._files.directory, self._files.contents)
            try:
                loaded = loader.load([dict(layer) for layer in upper], worker)
            except FindingsError as error:
                self._findings += [f for f in error.findings if f not in self._findings]
                continue
            overrides += loaded.overrides
            warnings += [text for text in loaded.warnings if "worker-" in text]
        self._warnings += dict.fromkeys(text for text in warnings if text not in self._warnings)
        return tuple(overrides)

    def _refuse_late_experiment(self, run: dict[str, Entry], experiment: str) -> None:
        entry = run.pop(EXPERIMENT, None)
        if entry is not None and entry.value not in ("", experiment):
            what = f"{EXPERIMENT}={shown(entry.value)} comes too late to choose a run.env"
            self._findings.append(Finding(entry.where, what, "Move the line to system.env."))

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
        values = {
            catalogue()[name].field: self._tidy(name, text, layers) for name, text in texts.items()
        }
        problems = {name: (reason, remedy) for name, reason, remedy in misfits(values, texts)}
        for name, (reason, remedy) in problems.items():
            setting = catalogue()[name]
            values.pop(setting.field)
            entry = layers.find(name)
            written = entry.value.strip() if entry is not None else setting.default_text
            if references(written) & problems.keys():
                continue  # the name it refers to is what needs mending
            what = f"{name}={shown(hidden(name, texts[name]))} {reason}"
            if written != texts[name]:
                what += f" (written {shown(hidden(name, written))})"
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

    def _tidy(self, name: str, text: str, layers: Layers) -> str:
        """Spell choices as they are declared, and make folders independent of where we stand."""
        setting = catalogue()[name]
        if setting.kind == "choice":
            spelt = {choice.casefold(): choice for choice in setting.choices}
            return spelt.get(text.casefold(), text)
        if setting.kind == "path":
            return str(self._files.directory / self._whole_path(name, text, layers))
        return text

    def _whole_path(self, name: str, text: str, layers: Layers) -> Path:
        path = Path(text)
        if not text.startswith("~/"):
            return path
        try:
            return path.expanduser()
        except RuntimeError:  # neither HOME nor the list of users tells
            entry = layers.find(name)
            where = entry.where if entry is not None else "default"
            what = f"{name}={shown(text)}: the home folder of this user is not known"
            finding = Finding(where, what, "Write the whole path, or set HOME.")
            if finding not in self._findings:
                self._findings.append(finding)
            return path


def _is_of_worker(name: str) -> bool:
    """Whether a setting may differ from worker to worker; old names count as the present ones."""
    present = old_names().get(name, name)
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
