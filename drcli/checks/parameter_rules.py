"""Checks hyperparameters.json and model_metadata.json."""

from dataclasses import dataclass
from typing import TypeVar

from drcli.base.errors import Problem, ProblemsError
from drcli.config.fields import setting_problem
from drcli.config.settings import Settings
from drcli.model.files.custom_files import InputFile
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.network_shape import Design

T = TypeVar("T", Hyperparameters, ModelMetadata)


@dataclass(frozen=True)
class ParametersReview:
    """The two files as far as usable; `design` has both."""

    parameters: Hyperparameters | None
    metadata: ModelMetadata | None
    design: Design | None
    problems: list[Problem]


def review_parameters(
    hyperparameters: InputFile | None, metadata: InputFile | None, settings: Settings | None
) -> ParametersReview:
    """Read the files that exist, and compare them with the settings."""
    found: list[Problem] = []
    learning = _read(Hyperparameters, hyperparameters, found)
    model = _read(ModelMetadata, metadata, found)
    design: Design | None = None
    if settings is not None and learning is not None and hyperparameters is not None:
        found += _idle_workers(settings, learning, hyperparameters.origin)
        found += _idle_learners(settings, learning)
    if learning is not None and model is not None and hyperparameters and metadata:
        found = [each for each in found if each.severity == "error" or _matters(each, model)]
        design = Design(model, learning, metadata.origin, hyperparameters.origin)
        found += design.conflicts()
    return ParametersReview(learning, model, design, found)


def _matters(problem: Problem, model: ModelMetadata) -> bool:
    if problem.key == "num_episodes_between_training":
        return not model.algorithm.replay
    return model.algorithm.reads(problem.key)


def _read(kind: type[T], file: InputFile | None, found: list[Problem]) -> T | None:
    if file is None:
        return None
    try:
        content = kind.from_bytes(file.data, file.origin)
    except ProblemsError as error:
        found += error.problems
        return None
    found += content.problems
    return content


def _idle_workers(settings: Settings, parameters: Hyperparameters, origin: str) -> list[Problem]:
    """V-45: all others would wait for them."""
    episodes = parameters.num_episodes_between_training
    if settings.workers <= episodes:
        return []
    what = (
        f"DR_WORKERS={settings.workers} is more than num_episodes_between_training={episodes} in "
        f"{origin}."
    )
    remedy = f"Set DR_WORKERS to at most {episodes}, or drive more episodes per iteration."
    return [setting_problem("DR_WORKERS", settings.place("DR_WORKERS"), what, remedy)]


def _idle_learners(settings: Settings, parameters: Hyperparameters) -> list[Problem]:
    """A training with a teacher has one process that learns."""
    name, count = "DR_TRAIN_LEARNERS", settings.train_learners
    if not parameters.taught or count == 1:
        return []
    what = (
        f"{name}={count}: with training_method=teacher, the trainer learns in one process, with "
        "all cores."
    )
    remedy = f"Set {name}=1, or train without a teacher (--no-teacher)."
    return [setting_problem(name, settings.place(name), what, remedy, severity="warning")]
