"""One load of all settings: from files, environment and flags to one frozen object.

It collects everything that is wrong or odd, so that one start reports all of it.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from drcli.base.problems import Place, Problem, ProblemsError, shown
from drcli.config.cross_checks import contradictions, misfits
from drcli.config.effects import without_effect
from drcli.config.env_file import Entry
from drcli.config.experiment import EXPERIMENT, chosen_experiment, run_file
from drcli.config.files import Files
from drcli.config.layers import Layers, references
from drcli.config.model import WORKER_NAMES, WORKER_STEMS, Override, Settings, catalogue, typed
from drcli.config.names import old_names, rename_old, unknown_names
from drcli.config.secrets import hidden
from drcli.config.setting_problems import file_problem, setting_problem


class Loader:
    """One load: collects problems until it can raise or return. Arguments are those of `Files`."""

    def __init__(self, directory: Path, contents: Mapping[str, bytes]) -> None:
        self._files = Files(directory, contents)
        self._problems = self._files.problems

    def load(self, upper: list[dict[str, Entry]], worker: int | None = None) -> Settings:
        """Read everything.

        Args:
            upper: Layers above the files.
            worker: Number of the worker whose own file goes on top of all, counted from 1.

        Raises:
            ProblemsError: Something is wrong, or there is no run.env.
        """
        system = self._system()
        experiment = chosen_experiment(self._files, [*upper, system])
        run = self._files.read(run_file(self._files, upper, experiment))
        self._refuse_late_experiment(run, experiment)

        folder = f"experiments/{experiment}/" if experiment else ""
        own = self._worker_file(folder, worker) if worker is not None else {}
        if not self._files.complete:
            self._refuse_errors()
        entries = [own, *upper, run, system]
        for layer in entries:
            _drop_empty(layer)
        self._problems += rename_old(entries)
        layers, values = self._settle(entries)
        unknown = unknown_names(layers, entries)
        self._problems += unknown.problems
        self._refuse_errors()

        sources = {
            name: entry.place
            for name in (*catalogue(), *unknown.values)
            if (entry := layers.find(name)) is not None
        }
        settings = Settings(
            directory=self._files.directory,
            extra=unknown.values,
            sources=sources,
            problems=(),
            **typed(values),
        )
        self._problems += contradictions(settings)
        self._refuse_errors()
        overrides: tuple[Override, ...] = ()
        if worker is not None:
            overrides = (_override(layers, own, values),)
        else:
            if settings.train_multi_config:
                overrides = self._overrides(settings, upper)
                self._refuse_errors()
            self._problems += without_effect(settings)
        return settings.replaced(problems=tuple(self._problems), overrides=overrides)

    def run_file(self, upper: list[dict[str, Entry]]) -> str:
        """Name of the run.env that counts, below these layers."""
        experiment = chosen_experiment(self._files, [*upper, self._system()])
        return run_file(self._files, upper, experiment)

    def _refuse_errors(self) -> None:
        """Raise what was found so far, in the order of reading, if there is an error."""
        if any(problem.severity == "error" for problem in self._problems):
            raise ProblemsError(sorted(self._problems, key=lambda p: (p.file, p.line or 0)))

    def _system(self) -> dict[str, Entry]:
        if self._files.exist("system.env"):
            return self._files.read("system.env")
        what = "is missing, so its settings have their defaults."
        place, remedy = Place("system.env"), "`dr-init` writes one."
        self._problems.append(file_problem(place, what, remedy, severity="warning"))
        return {}

    def _worker_file(self, folder: str, worker: int) -> dict[str, Entry]:
        """The entries of a worker's own file that may differ from worker to worker."""
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
        for key in [key for key in entries if not _is_of_worker(key)]:
            place = entries.pop(key).place
            what = f"{shown(key)} is the same for all workers and is ignored here."
            remedy = "Move the line to run.env, or remove it."
            self._problems.append(setting_problem(key, place, what, remedy, severity="warning"))
        return entries

    def _overrides(self, settings: Settings, upper: list[dict[str, Entry]]) -> tuple[Override, ...]:
        """What the files of the second and all further workers change."""
        overrides: list[Override] = []
        for worker in range(2, settings.workers + 1):
            loader = Loader(self._files.directory, self._files.contents)
            try:
                loaded = loader.load([dict(layer) for layer in upper], worker)
            except ProblemsError as error:
                self._add(error.problems)
                continue
            overrides += loaded.overrides
            own_file = f"worker-{worker}.env"
            self._add(problem for problem in loaded.problems if problem.file.endswith(own_file))
        return tuple(overrides)

    def _add(self, problems: Iterable[Problem]) -> None:
        """Note problems that are not noted yet."""
        self._problems += [each for each in problems if each not in self._problems]

    def _refuse_late_experiment(self, run: dict[str, Entry], experiment: str) -> None:
        entry = run.pop(EXPERIMENT, None)
        if entry is not None and entry.value not in ("", experiment):
            what = f"{EXPERIMENT}={shown(entry.value)} is set in the run.env that it should choose."
            remedy = "Move the line to system.env."
            self._problems.append(setting_problem(EXPERIMENT, entry.place, what, remedy))

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
            if name in layers.problems:
                self._blame(name, layers.problems[name], dropped)
            elif text is not None and (text.strip() or setting.kind == "text"):
                texts[name] = text.strip()
        values = {
            catalogue()[name].field: self._tidy(name, text, layers) for name, text in texts.items()
        }
        bad = {name: (reason, remedy) for name, reason, remedy in misfits(values, texts)}
        for name, (reason, remedy) in bad.items():
            setting = catalogue()[name]
            values.pop(setting.field)
            entry = layers.find(name)
            written = entry.value.strip() if entry is not None else setting.default_text
            if references(written) & bad.keys():
                continue  # the name it refers to has to be corrected
            what = f"{name}={shown(hidden(name, texts[name]))} {reason}"
            if written != texts[name]:
                what += f" (written {shown(hidden(name, written))})"
            problem = setting_problem(name, layers.place(name), f"{what}.", remedy)
            self._blame(name, problem, dropped)
        return values, dropped & layers.names()

    def _blame(self, name: str, problem: Problem, dropped: set[str]) -> None:
        """Note what is wrong with a setting; only a warning where the setting has no effect."""
        if catalogue()[name].effect != "used":
            message = f"{problem.message} It has no effect here."
            problem = replace(problem, severity="warning", message=message)
            dropped.add(name)
        self._add([problem])

    def _tidy(self, name: str, text: str, layers: Layers) -> str:
        """Spell choices as they are declared, and make folders absolute."""
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
            what = f"{name}={shown(text)}: the home folder of this user is not known."
            remedy = "Write the whole path, or set HOME."
            self._add([setting_problem(name, layers.place(name), what, remedy)])
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
        sources={name: own[name].place for name in known},
    )


def _drop_empty(layer: dict[str, Entry]) -> None:
    """An empty value means not set, except where a text may be empty."""
    for name, setting in catalogue().items():
        if setting.kind != "text" and name in layer and not layer[name].value.strip():
            del layer[name]


def _default_texts() -> dict[str, str]:
    """Defaults as texts: other values refer to them, and some refer to other names."""
    return {name: setting.default_text for name, setting in catalogue().items()}
