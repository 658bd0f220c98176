"""Writes trainings of a sweep as experiments."""

from collections.abc import Mapping

from drcli.base.errors import ProblemsError, refuse
from drcli.base.files import rewrite
from drcli.bucket.bucket import Bucket
from drcli.config.new_folder import FolderPlan, plan_experiment, write
from drcli.config.presets import MODEL_FILES
from drcli.config.settings import Settings
from drcli.config.settings_files import parse_env
from drcli.model import keys
from drcli.model.files.curriculum_file import merged_hyperparameters
from drcli.model.files.custom_files import find, missing_files
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.sweeps.sweep_file import Budget, SweepFile
from drcli.sweeps.trials import Trial

_LIMITS = {
    "steps": "DR_TRAIN_MAX_STEPS",
    "episodes": "DR_TRAIN_MAX_EPISODES",
    "iterations": "DR_TRAIN_MAX_ITERATIONS",
}


def settings_of_model(
    budget: Budget, prefix: str, *, used: float = 0.0, source: str = ""
) -> dict[str, str]:
    """Earlier models of a population `used` budget; `source` gives weights."""
    found = {
        "DR_LOCAL_S3_MODEL_PREFIX": prefix,
        "DR_LOCAL_S3_METRICS_PREFIX": f"{prefix}/metrics",
    }
    if source:
        found |= {
            "DR_LOCAL_S3_PRETRAINED": "True",
            "DR_LOCAL_S3_PRETRAINED_PREFIX": source,
            "DR_LOCAL_S3_PRETRAINED_CHECKPOINT": "last",
        }
    if budget.resource in _LIMITS:
        found[_LIMITS[budget.resource]] = f"{max(1.0, budget.most - used):.0f}"
    return found


class TrialFiles:
    """Writes experiments; `bucket` has the racer's files if custom_files/ does not.

    Raises:
        ProblemsError: One of them is missing.
    """

    def __init__(self, settings: Settings, sweep: SweepFile, bucket: Bucket) -> None:
        self._folder = settings.directory
        self._sweep = sweep
        self._own = find(settings.custom_files, bucket)
        refuse(missing_files(self._own, settings.custom_files, bucket.name))

    def check(self, trials: list[Trial]) -> None:
        """Check all before writing any; raises ProblemsError."""
        for trial in trials:
            self._plan(trial, {}, settings_of_model(self._sweep.plan.budget, trial.name))

    def write(
        self,
        trial: Trial,
        prefix: str,
        *,
        used: float = 0.0,
        hyperparameters: Mapping[str, float],
        source: str = "",
    ) -> int:
        """Write an experiment; returns its DR_RUN_ID.

        Raises:
            ProblemsError: A value is wrong.
            SettingsError: Something cannot be written.
        """
        more = settings_of_model(self._sweep.plan.budget, prefix, used=used, source=source)
        plan = self._plan(trial, hyperparameters, more)
        if all((self._folder / file.name).exists() for file in plan.files):
            for file in plan.files:
                rewrite(self._folder / file.name, file.data)
        else:
            write(plan)
        run = next(file for file in plan.files if file.name.endswith("/run.env"))
        return int(parse_env(run.data, run.name).last["DR_RUN_ID"].value)

    def _plan(
        self,
        trial: Trial,
        hyperparameters: Mapping[str, float],
        more: Mapping[str, str],
    ) -> FolderPlan:
        here = f"custom_files/{trial.name}"
        values = {
            **trial.settings,
            "DR_LOCAL_S3_CUSTOM_FILES_PREFIX": here,
            "DR_LOCAL_S3_REWARD_KEY": f"{here}/reward_function.py",
            "DR_LOCAL_S3_HYPERPARAMETERS_KEY": f"{here}/hyperparameters.json",
            "DR_LOCAL_S3_MODEL_METADATA_KEY": f"{here}/model_metadata.json",
            "DR_MODEL_DESCRIPTION": f"Sweep {self._sweep.name}: {trial.text}",
            **more,
        }
        existing = self._folder / "experiments" / trial.name / "run.env"
        if existing.is_file():
            entry = parse_env(existing.read_bytes(), "run.env").last.get("DR_RUN_ID")
            if entry is not None:
                values["DR_RUN_ID"] = entry.value
        files = self._files(trial, hyperparameters)
        try:
            return plan_experiment(self._folder, trial.name, values, files_of_model=files)
        except ProblemsError as error:
            raise self._of_settings(trial, error) from None

    def _files(self, trial: Trial, hyperparameters: Mapping[str, float]) -> dict[str, bytes]:
        files = {name: self._own[name].data for name in MODEL_FILES}
        if trial.reward_function:
            files[keys.REWARD_FUNCTION_FILE] = self._read("reward_function", trial.reward_function)
        if trial.model_metadata:
            files[keys.MODEL_METADATA_FILE] = self._read("model_metadata", trial.model_metadata)
        changes = {**trial.hyperparameters, **hyperparameters}
        whole = files[keys.HYPERPARAMETERS_FILE]
        Hyperparameters.from_bytes(whole, self._own[keys.HYPERPARAMETERS_FILE].origin)
        if changes:
            merged = merged_hyperparameters(whole, changes)
            try:
                Hyperparameters.from_bytes(merged, chosen=changes)
            except ProblemsError as error:
                raise self._of_sweep(trial, error) from None
            files[keys.HYPERPARAMETERS_FILE] = merged
        return files

    def _of_sweep(self, trial: Trial, error: ProblemsError) -> ProblemsError:
        found = []
        for each in error.errors:
            key = each.key.split(".")[0].split("[")[0]
            if key not in trial.hyperparameters:
                return error
            path = ("vary", "hyperparameters", key)
            found.append(self._sweep.problem(path, each.message, each.remedy))
        return ProblemsError(found)

    def _of_settings(self, trial: Trial, error: ProblemsError) -> ProblemsError:
        found = []
        for each in error.errors:
            if each.key not in trial.settings:
                return error
            varied = each.key in self._sweep.plan.vary.settings
            path = ("vary", "settings", each.key) if varied else ("settings", each.key)
            if each.key == "DR_TRAIN_SEED" and self._sweep.plan.vary.seed:
                path = ("vary", "seed")
            found.append(self._sweep.problem(path, each.message, each.remedy))
        return ProblemsError(found)

    def _read(self, section: str, name: str) -> bytes:
        for path in (self._sweep.folder / name, self._folder / "custom_files" / name):
            if path.is_file():
                try:
                    return path.read_bytes()
                except OSError as error:
                    what = f"{path} cannot be read ({error.strerror or error})."
                    refuse([self._sweep.problem(("vary", section), what, "Make it readable.")])
        what = f"{section}: there is no file {name}."
        remedy = f"Put it into {self._sweep.folder}, or correct its path there."
        refuse([self._sweep.problem(("vary", section), what, remedy)])
        raise AssertionError
