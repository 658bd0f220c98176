"""Plans the stages of a training, and finds the one to begin with."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

from drcli.base.errors import Problem, refuse, shown
from drcli.base.json_record import RecordError
from drcli.bucket.bucket import ObjectMissing
from drcli.checks.stage_rules import SETTING, StagesReview, review_stages
from drcli.config.fields import setting_problem
from drcli.config.run_config import CustomFilesConfig
from drcli.config.settings import Settings
from drcli.model import keys
from drcli.model.files.custom_files import (
    InputFile,
    Inputs,
    texts_of,
    upload_custom_files,
    write_model_files,
)
from drcli.model.files.network_shape import Design
from drcli.model.files.params_yaml import training_parameters
from drcli.model.model_store import ModelStore
from drcli.records.stage import FrozenCurriculum, Stage, StageMark


@dataclass(frozen=True)
class StagesPlan:
    settings: Settings
    review: StagesReview
    first: int = 0
    warnings: tuple[str, ...] = ()

    @property
    def stages(self) -> tuple[Stage, ...]:
        return tuple(planned.stage for planned in self.review.stages)


def plan_stages(
    settings: Settings,
    files: Mapping[str, InputFile],
    model: ModelStore,
    mark: StageMark | None,
    *,
    resumes: bool,
) -> StagesPlan:
    """`before_start.examine_stages` finds problems of stages; `mark` is that of a resumed model.

    Raises:
        ProblemsError: The curriculum cannot be read, or has lost the model's stage.
    """
    review = review_stages(settings, files, model.bucket, resumes=resumes)
    if not review.stages:
        refuse(review.problems)
    if review.frozen is None:
        return StagesPlan(settings, review, warnings=_without_curriculum(mark))
    names = [stage.name for stage in review.stages]
    if mark is not None and mark.name not in names:
        refuse([_lost_stage(settings, mark.name, names)])
    first = 0 if mark is None else names.index(mark.name)
    return StagesPlan(
        review.stages[first].settings,
        review,
        first,
        (*(_changed(settings, model, review.frozen, mark) if resumes else ()),),
    )


def _without_curriculum(mark: StageMark | None) -> tuple[str, ...]:
    if mark is None:
        return ()
    return (
        f"The model is in {mark}, but {SETTING} is empty: the training goes on without stages, "
        "with the track of run.env.",
    )


def _lost_stage(settings: Settings, name: str, names: Sequence[str]) -> Problem:
    what = (
        f"{SETTING}={shown(settings.curriculum_file)} has no stage {name}, in which the training "
        f"of {settings.model_prefix} is; its stages are {', '.join(names)}."
    )
    remedy = f"Give one of the stages the name {name} again; the training goes on with that one."
    return setting_problem(SETTING, settings.place(SETTING), what, remedy)


def _changed(
    settings: Settings, model: ModelStore, now: FrozenCurriculum, mark: StageMark | None
) -> tuple[str, ...]:
    place = settings.place(SETTING)
    try:
        before = FrozenCurriculum.decode(model.bucket.get(keys.curriculum(model.prefix)))
    except ObjectMissing:
        return (
            f"{place}: The model was trained without stages until now; the first one begins with "
            "its newest checkpoint.",
        )
    except RecordError:
        return ()
    names = sorted({*before.files, *now.files})
    changed = [name for name in names if before.files.get(name) != now.files.get(name)]
    if before.text != now.text:
        changed.insert(0, settings.curriculum_file)
    if not changed:
        return ()
    what = f"{', '.join(changed)} changed since the last start; the new version counts"
    return (f"{what}." if mark is None else f"{what}, from {mark} on.",)


# Copies the files of a training below its model prefix.


def files_to_train_with(settings: Settings, inputs: Inputs, design: Design) -> dict[str, str]:
    """With all values of hyperparameters."""
    parameters = design.parameters.canonical_json(design.metadata.training_algorithm)
    own = parameter_files(settings).items()
    return {
        **texts_of(inputs),
        keys.HYPERPARAMETERS_FILE: parameters,
        **{name: training_parameters(each).decode() for name, each in own},
    }


def freeze(
    places: CustomFilesConfig,
    model: ModelStore,
    inputs: Inputs,
    files: Mapping[str, str],
    curriculum: FrozenCurriculum | None,
    resumed: Design | None,
) -> None:
    """Copy the files of a start and its curriculum below the model prefix.

    Those of a `resumed` training become the model's with the first checkpoint that has learned
    with them.
    """
    if curriculum is not None:
        model.bucket.put(keys.curriculum(model.prefix), curriculum.encode())
    upload_custom_files(places, model.bucket, inputs)
    write_model_files(model, files, None if resumed is None else resumed.texts)


def parameter_files(settings: Settings) -> dict[str, Settings]:
    file = PurePosixPath(settings.training_params_file)
    files = {settings.training_params_file: settings}
    if settings.overrides:
        for worker in range(settings.workers):
            name = file.with_stem(f"{file.stem}_{worker + 1}")
            files[str(name)] = settings.for_worker(worker)
    return files
