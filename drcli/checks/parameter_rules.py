"""hyperparameters.json and model_metadata.json: against the rules, and against each other."""

from dataclasses import dataclass

from drcli.base.problems import Problem, ProblemsError
from drcli.config.setting_problems import setting_problem
from drcli.config.settings import Settings
from drcli.modelfiles.custom_files import InputFile
from drcli.modelfiles.hyperparameters import Hyperparameters
from drcli.modelfiles.model_metadata import ModelMetadata
from drcli.modelfiles.network_shape import Design


@dataclass(frozen=True)
class ParametersReview:
    """What can be said about the two files.

    Attributes:
        parameters: The hyperparameters, None where they cannot be used.
        metadata: The model metadata, None where it cannot be used.
        design: Both, where they fit each other.
        problems: What is wrong or odd about them.
    """

    parameters: Hyperparameters | None
    metadata: ModelMetadata | None
    design: Design | None
    problems: list[Problem]


def review_parameters(
    hyperparameters: InputFile | None, metadata: InputFile | None, settings: Settings | None
) -> ParametersReview:
    """Read the files that exist.

    Args:
        hyperparameters: None where there is no such file.
        metadata: None where there is no such file.
        settings: None where they cannot be read.
    """
    found: list[Problem] = []
    learning: Hyperparameters | None = None
    model: ModelMetadata | None = None
    design: Design | None = None
    if hyperparameters is not None:
        try:
            learning = Hyperparameters.from_bytes(hyperparameters.data, hyperparameters.origin)
            found += learning.problems
        except ProblemsError as error:
            found += error.problems
    if metadata is not None:
        try:
            model = ModelMetadata.from_bytes(metadata.data, metadata.origin)
            found += model.problems
        except ProblemsError as error:
            found += error.problems
    if settings is not None and learning is not None and hyperparameters is not None:
        found += _idle_workers(settings, learning, hyperparameters.origin)
    if learning is not None and model is not None and hyperparameters and metadata:
        design = Design(model, learning, metadata.origin, hyperparameters.origin)
        found += design.conflicts()
    return ParametersReview(learning, model, design, found)


def _idle_workers(settings: Settings, parameters: Hyperparameters, origin: str) -> list[Problem]:
    """V-45: everybody would wait for a worker that has no episode to drive."""
    episodes = parameters.num_episodes_between_training
    if settings.workers <= episodes:
        return []
    what = (
        f"DR_WORKERS={settings.workers} is more than num_episodes_between_training={episodes} in "
        f"{origin}."
    )
    remedy = f"Set DR_WORKERS to at most {episodes}, or drive more episodes per iteration."
    return [setting_problem("DR_WORKERS", settings.place("DR_WORKERS"), what, remedy)]
