"""Plans the stages of a training, and finds the one to begin with."""

from collections.abc import Mapping
from dataclasses import dataclass

from drcli.base.json_record import RecordError
from drcli.base.problems import Problem, refuse, shown
from drcli.checks.stage_files import SETTING
from drcli.checks.stage_rules import StagesReview, review_stages
from drcli.config.setting_problems import setting_problem
from drcli.config.settings import Settings
from drcli.exchange.frozen_curriculum import FrozenCurriculum
from drcli.exchange.stage import Stage, StageMark
from drcli.modelfiles.custom_files import InputFile
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing
from drcli.store.checkpoints import CheckpointStore


@dataclass(frozen=True)
class StagesPlan:
    settings: Settings
    review: StagesReview
    first: int = 0
    warnings: tuple[str, ...] = ()

    @property
    def stages(self) -> tuple[Stage, ...]:
        return tuple(planned.stage for planned in self.review.stages)

    @property
    def frozen(self) -> FrozenCurriculum | None:
        return self.review.frozen


def plan_stages(
    settings: Settings, files: Mapping[str, InputFile], bucket: Bucket, *, resumes: bool
) -> StagesPlan:
    """`before_start.examine_stages` finds problems of stages.

    Raises:
        ProblemsError: The curriculum cannot be read, or has lost the model's stage.
    """
    review = review_stages(settings, files, bucket, resumes=resumes)
    if not review.stages:
        refuse(review.problems)
    mark = None
    if resumes:
        mark = CheckpointStore(bucket, settings.model_prefix).stage_of_newest()
    if review.frozen is None:
        return StagesPlan(settings, review, warnings=_without_curriculum(mark))
    first = 0 if mark is None else review.index(mark.name)
    if first is None or mark is None:
        refuse(_lost_stage(settings, mark, review) if first is None else ())
        first = 0
    return StagesPlan(
        review.stages[first].settings,
        review,
        first,
        (*(_changed(settings, bucket, review.frozen, mark) if resumes else ()),),
    )


def _without_curriculum(mark: StageMark | None) -> tuple[str, ...]:
    if mark is None:
        return ()
    return (
        f"The model is in {mark}, but {SETTING} is empty: the training goes on without stages, "
        "with the track of run.env.",
    )


def _lost_stage(
    settings: Settings, mark: StageMark | None, review: StagesReview
) -> tuple[Problem, ...]:
    name = "" if mark is None else mark.name
    names = ", ".join(stage.name for stage in review.stages)
    what = (
        f"{SETTING}={shown(settings.curriculum_file)} has no stage {name}, in which the training "
        f"of {settings.model_prefix} is; its stages are {names}."
    )
    remedy = f"Give one of the stages the name {name} again; the training goes on with that one."
    return (setting_problem(SETTING, settings.place(SETTING), what, remedy),)


def _changed(
    settings: Settings, bucket: Bucket, now: FrozenCurriculum, mark: StageMark | None
) -> tuple[str, ...]:
    place = settings.place(SETTING)
    try:
        before = FrozenCurriculum.decode(bucket.get(keys.curriculum(settings.model_prefix)))
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
