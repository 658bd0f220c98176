"""Finds the stages of a training, and checks that they fit."""

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from shlex import quote
from typing import Any

from drcli.base.errors import (
    BadValue,
    Place,
    Problem,
    ProblemsError,
    closest,
    few,
    of_severity,
    shown,
)
from drcli.base.json_record import RecordError
from drcli.bucket.bucket import Bucket, ObjectMissing
from drcli.config.fields import setting_problem
from drcli.config.loading import WORKER_NAMES, WORKER_STEMS, is_of_worker
from drcli.config.settings import Override, Settings, catalogue
from drcli.model import keys
from drcli.model.files.curriculum_file import (
    RULE,
    CurriculumFile,
    StageEntry,
    merged_hyperparameters,
)
from drcli.model.files.custom_files import InputFile
from drcli.model.files.data_file import as_written
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.records.stage import FrozenCurriculum, Stage, StageGoal

# Reads the curriculum, and the files that its stages name.


SETTING = "DR_CURRICULUM_FILE"

LARGEST_FILE = 1024 * 1024
"""A larger file was named by mistake."""


def curriculum_path(settings: Settings) -> Path:
    """Beside run.env or in the experiment's folder."""
    return settings.custom_files_dir.parent / Path(settings.curriculum_file).expanduser()


@dataclass
class StageFiles:
    """The curriculum and its files: of this machine, else of the model."""

    settings: Settings
    frozen: FrozenCurriculum | None
    read: dict[str, str] = field(default_factory=dict)

    def curriculum(self) -> tuple[str, bytes]:
        """Name and content; raises ProblemsError."""
        settings, name = self.settings, self.settings.curriculum_file
        path = curriculum_path(settings)
        data = _content(path, settings.place(SETTING))
        if data is not None:
            return str(path), data
        if self.frozen is not None:
            return self.frozen.name, self.frozen.text.encode()
        what = f"{SETTING}={shown(name)}: there is no such file in {path.parent}."
        remedy = "`dr-init --curriculum` writes an example, or leave the setting empty."
        raise ProblemsError([setting_problem(SETTING, settings.place(SETTING), what, remedy)])

    def named(self, name: str, place: Place) -> InputFile | None:
        """None if it does not exist; raises ProblemsError."""
        path = curriculum_path(self.settings).parent / Path(name).expanduser()
        for each in (path, self.settings.custom_files_dir / name):
            data = _content(each, place)
            if data is not None:
                self.read[name] = data.decode(errors="replace")
                return InputFile(each.name, data, str(each))
        if self.frozen is not None and name in self.frozen.files:
            self.read[name] = self.frozen.files[name]
            return InputFile(Path(name).name, self.read[name].encode(), name)
        return None


def _content(path: Path, place: Place) -> bytes | None:
    try:
        if not path.is_file():
            return None
        with path.open("rb") as file:
            return file.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        what = f"{path} cannot be read ({reason})."
        remedy = f"Make it readable for yourself, as with `chmod u+r {quote(str(path))}`."
        raise ProblemsError([Problem(RULE, "error", *place, what, remedy)]) from error


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
        for key, given, name in (
            ("reward_function", entry.reward_function, keys.REWARD_FUNCTION_FILE),
            ("hyperparameters", entry.hyperparameters, keys.HYPERPARAMETERS_FILE),
        ):
            file = self._file(read, index, key, given) if isinstance(given, str) else None
            if file is not None:
                files[name] = InputFile(name, file.data, file.origin)
        if entry.hyperparameters and not isinstance(entry.hyperparameters, str):
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
            alone = Hyperparameters.from_bytes(json.dumps(changes).encode(), chosen=changes)
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
