"""Finds the stages of a training, and checks that they fit."""

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from drcli.base.json_record import RecordError
from drcli.base.problems import (
    BadValue,
    Place,
    Problem,
    ProblemsError,
    closest,
    few,
    of_severity,
    shown,
)
from drcli.checks.stage_files import StageFiles, curriculum_path
from drcli.config.loading import WORKER_NAMES, WORKER_STEMS, is_of_worker
from drcli.config.setting_problems import setting_problem
from drcli.config.settings import Override, Settings, catalogue
from drcli.exchange.frozen_curriculum import FrozenCurriculum
from drcli.exchange.stage import Stage, StageGoal
from drcli.modelfiles.curriculum_file import (
    RULE,
    CurriculumFile,
    StageEntry,
    merged_hyperparameters,
)
from drcli.modelfiles.custom_files import InputFile
from drcli.modelfiles.hyperparameters import Hyperparameters
from drcli.modelfiles.json_file import as_written
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing

OF_THE_NETWORK = ("stack_size", "critic", "training_method")
"""They stay the same in all stages."""


@dataclass(frozen=True)
class PlannedStage:
    """One stage; what is wrong in it is left out."""

    name: str
    settings: Settings
    files: Mapping[str, InputFile]
    goal: StageGoal

    @property
    def stage(self) -> Stage:
        """Only where nothing is wrong."""
        reward = self.files[keys.REWARD_FUNCTION_FILE]
        parameters = self.files[keys.HYPERPARAMETERS_FILE]
        read = Hyperparameters.from_bytes(parameters.data, parameters.origin)
        return Stage(
            self.name,
            self.settings.races,
            reward.data.decode("utf-8-sig"),
            reward.origin,
            json.dumps(read.model_dump(exclude_none=True)),
            self.goal,
        )


@dataclass(frozen=True)
class StagesReview:
    """The stages of a training; `frozen` is the copy below the model prefix."""

    stages: tuple[PlannedStage, ...] = ()
    frozen: FrozenCurriculum | None = None
    problems: tuple[Problem, ...] = ()

    def index(self, name: str) -> int | None:
        """From 0."""
        names = [stage.name for stage in self.stages]
        return names.index(name) if name in names else None


def review_stages(
    settings: Settings,
    files: Mapping[str, InputFile],
    bucket: Bucket | None = None,
    *,
    resumes: bool = False,
) -> StagesReview:
    """Read the curriculum and all that it names.

    If it `resumes`, the model has what this machine lacks.
    """
    if not settings.curriculum_file:
        return StagesReview()
    found: list[Problem] = []
    frozen = _frozen(settings, bucket, found) if resumes and bucket is not None else None
    try:
        reader = StageFiles(settings, frozen)
        return _Reviewer(settings, files, reader, found).review()
    except ProblemsError as error:
        return StagesReview(problems=(*found, *error.problems))


def _frozen(settings: Settings, bucket: Bucket, found: list[Problem]) -> FrozenCurriculum | None:
    """Raises StorageError if the bucket does not answer."""
    key = keys.curriculum(settings.model_prefix)
    with suppress(ObjectMissing):
        try:
            return FrozenCurriculum.decode(bucket.get(key))
        except RecordError as error:
            what = f"{bucket.name}/{key} is damaged: {error}. The files of this machine count."
            remedy = "Nothing is to be done: the start writes it again."
            found.append(Problem(RULE, "warning", f"{bucket.name}/{key}", None, what, remedy))
    return None


@dataclass
class _Reviewer:
    settings: Settings
    files: Mapping[str, InputFile]
    reader: StageFiles
    found: list[Problem]

    def review(self) -> StagesReview:
        name, data = self.reader.curriculum()
        read = CurriculumFile.from_bytes(data, name)
        planned = []
        for index, entry in enumerate(read.stages):
            settings = self._settings(read, index, entry)
            files = self._files(read, index, entry)
            planned.append(PlannedStage(entry.name, settings, files, entry.stage_goal))
        self._compare(read, planned)
        text = data.decode("utf-8-sig")
        frozen = FrozenCurriculum(name, text, dict(self.reader.read))
        return StagesReview(tuple(planned), frozen, tuple(self.found))

    def _settings(self, read: CurriculumFile, index: int, entry: StageEntry) -> Settings:
        given = {f"settings.{name}": (name, text) for name, text in entry.settings.items()}
        for key, name, text in (
            ("world", "DR_WORLD_NAME", entry.world),
            ("race_type", "DR_RACE_TYPE", entry.race_type),
        ):
            if text is None:
                continue
            if name in entry.settings:
                what = f"{name} is given twice, as {key} and in settings."
                self.found.append(read.problem(index, f"settings.{name}", what, "Remove one."))
            given[key] = name, text
        values: dict[str, Any] = {}
        sources: dict[str, Place] = {}
        for key, (name, text) in given.items():
            problem = read.problem(index, key, "", "")
            if name not in catalogue() or not is_of_worker(name):
                self.found.append(_not_of_a_stage(read, index, key, name))
                continue
            setting = catalogue()[name]
            try:
                values[setting.field] = setting.read(text.strip())
            except BadValue as error:
                what = f"{name}={shown(text)} {error.reason}."
                self.found.append(setting_problem(name, _place(problem), what, error.remedy))
                continue
            sources[name] = _place(problem)
        changed = self.settings.replaced(
            **values,
            sources={**self.settings.sources, **sources},
            overrides=tuple(
                Override({**each.values, **values}, {**each.sources, **sources})
                for each in self.settings.overrides
            ),
        )
        if changed.untrainable is not None:
            self.found.append(changed.untrainable)
        if changed.h2b_lower_lane_change_time > changed.h2b_upper_lane_change_time:
            what = (
                f"DR_H2B_LOWER_LANE_CHANGE_TIME={changed.h2b_lower_lane_change_time} is more than "
                f"DR_H2B_UPPER_LANE_CHANGE_TIME={changed.h2b_upper_lane_change_time} in stage "
                f"{index + 1} ({entry.name})."
            )
            remedy = "Swap the two, or set both to the same time."
            self.found.append(read.problem(index, "settings", what, remedy))
        return changed

    def _files(self, read: CurriculumFile, index: int, entry: StageEntry) -> dict[str, InputFile]:
        files = dict(self.files)
        if entry.reward_function is not None:
            file = self._file(read, index, "reward_function", entry.reward_function)
            if file is not None:
                files[keys.REWARD_FUNCTION_FILE] = InputFile(
                    keys.REWARD_FUNCTION_FILE, file.data, file.origin
                )
        if isinstance(entry.hyperparameters, str):
            file = self._file(read, index, "hyperparameters", entry.hyperparameters)
            if file is not None:
                files[keys.HYPERPARAMETERS_FILE] = InputFile(
                    keys.HYPERPARAMETERS_FILE, file.data, file.origin
                )
        elif entry.hyperparameters:
            self._merge(read, index, entry.hyperparameters, files)
        return files

    def _file(self, read: CurriculumFile, index: int, key: str, name: str) -> InputFile | None:
        problem = read.problem(index, key, "", "")
        try:
            file = self.reader.named(name, _place(problem))
        except ProblemsError as error:
            self.found += error.problems
            return None
        if file is None:
            folder = curriculum_path(self.settings).parent
            what = f"stages[{index}].{key}={as_written(name)}: there is no such file in {folder}."
            remedy = "Write its name as seen from the folder of the curriculum, or add the file."
            self.found.append(read.problem(index, key, what, remedy))
        return file

    def _merge(
        self,
        read: CurriculumFile,
        index: int,
        changes: Mapping[str, Any],
        files: dict[str, InputFile],
    ) -> None:
        if "term_cond_max_episodes" in changes:
            what = "term_cond_max_episodes counts the iterations of the whole training."
            remedy = "Write goal: {iterations: ...} to end the stage."
            key = "hyperparameters.term_cond_max_episodes"
            self.found.append(read.problem(index, key, what, remedy))
        try:
            alone = Hyperparameters.from_bytes(json.dumps(changes).encode())
            problems: tuple[Problem, ...] = alone.problems
        except ProblemsError as error:
            problems = error.problems
        for each in problems:
            at = read.problem(index, f"hyperparameters.{each.key}", "", "")
            self.found.append(
                Problem(each.rule, each.severity, *_place(at), each.message, each.remedy, each.key)
            )
        whole = files.get(keys.HYPERPARAMETERS_FILE)
        if whole is None or of_severity(problems, "error"):
            return
        with suppress(ValueError):  # another rule tells what is wrong with it
            merged = merged_hyperparameters(whole.data, changes)
            files[keys.HYPERPARAMETERS_FILE] = InputFile(whole.name, merged, whole.origin)

    def _compare(self, read: CurriculumFile, planned: list[PlannedStage]) -> None:
        designs = {}
        for stage in planned:
            file = stage.files.get(keys.HYPERPARAMETERS_FILE)
            if file is not None:
                with suppress(ProblemsError):
                    designs[stage.name] = Hyperparameters.from_bytes(file.data, file.origin)
        first = next(iter(designs.values()), None)
        for index, entry in enumerate(read.stages):
            if first is None or entry.name not in designs:
                continue
            for key in OF_THE_NETWORK:
                value, before = getattr(designs[entry.name], key), getattr(first, key)
                if value != before:
                    what = (
                        f"{key}={value} in stage {index + 1} ({entry.name}), but the first stage "
                        f"has {key}={before}, and its weights only fit that."
                    )
                    remedy = f"Write {key}: {json.dumps(before)} there, or remove it."
                    self.found.append(read.problem(index, f"hyperparameters.{key}", what, remedy))


def _not_of_a_stage(read: CurriculumFile, index: int, key: str, name: str) -> Problem:
    if name in catalogue():
        what = f"{name} holds for the whole training and cannot change from stage to stage."
        return read.problem(index, key, what, "Move it to run.env.")
    known = [each for each in catalogue() if is_of_worker(each)]
    meant = closest(name, known)
    hint = f"Did you mean {meant}? " if meant is not None else ""
    what = f"{shown(name)} is not a setting."
    names = ", ".join(few([*WORKER_NAMES, *(f"{stem}..." for stem in WORKER_STEMS)]))
    return read.problem(index, key, what, f"{hint}A stage may change {names}.")


def _place(problem: Problem) -> Place:
    return Place(problem.file, problem.line)
