"""hyperparameters.json and model_metadata.json against the rules, and against each other."""

from dataclasses import dataclass

from drcli.base.errors import SettingsError
from drcli.base.problems import Finding
from drcli.checks.check_report import Violation
from drcli.checks.translation import from_error, from_findings, key_of
from drcli.config.settings import Settings
from drcli.modelfiles.custom_files import InputFile
from drcli.modelfiles.hyperparameters import KEYS, Hyperparameters
from drcli.modelfiles.model_metadata import ModelMetadata
from drcli.modelfiles.network_shape import Design

HYPERPARAMETER_RULES = {
    **dict.fromkeys(KEYS, "V-46"),
    "batch_size": "V-40",
    "num_epochs": "V-41",
    "lr": "V-41",
    "beta_entropy": "V-41",
    "discount_factor": "V-41",
    "num_episodes_between_training": "V-41",
    "loss_type": "V-43",
    "term_cond_avg_score": "V-44",
    "term_cond_max_episodes": "V-44",
    "exploration_type": "V-34",
}
"""Keys with the rule they are about; V-04 is about unknown ones and the file itself."""

METADATA_RULES = {
    "sensor": "V-33",
    "version": "V-33",
    "lidar_config": "V-33",
    "training_algorithm": "V-34",
    "neural_network": "V-36",
    "action_space_type": "V-36",
}
"""The same for the other file, where V-03 is about the rest."""


@dataclass(frozen=True)
class ParametersReview:
    """What can be said about the two files.

    Attributes:
        parameters: The hyperparameters, None where they cannot be used.
        metadata: The model metadata, None where they cannot be used.
        design: Both, where they fit each other.
        violations: What is wrong with them.
    """

    parameters: Hyperparameters | None
    metadata: ModelMetadata | None
    design: Design | None
    violations: list[Violation]


def review_parameters(
    hyperparameters: InputFile | None, metadata: InputFile | None, settings: Settings | None
) -> ParametersReview:
    """Read the files that there are.

    Args:
        hyperparameters: None where there is none.
        metadata: None where there is none.
        settings: None where they cannot be read.
    """
    found: list[Violation] = []
    learning: Hyperparameters | None = None
    model: ModelMetadata | None = None
    if hyperparameters is not None:
        try:
            learning = Hyperparameters.from_bytes(hyperparameters.data, hyperparameters.origin)
            found += from_findings(learning.notes, hyperparameter_rule, "warning")
        except SettingsError as error:
            found += from_error(error, hyperparameter_rule)
    if metadata is not None:
        try:
            model = ModelMetadata.from_bytes(metadata.data, metadata.origin)
            found += from_findings(model.notes, metadata_rule, "warning")
        except SettingsError as error:
            found += from_error(error, metadata_rule)
    if settings is not None and learning is not None and hyperparameters is not None:
        found += _workers(settings, learning, hyperparameters.origin)
    design: Design | None = None
    if learning is not None and model is not None and hyperparameters and metadata:
        design = Design(model, learning, metadata.origin, hyperparameters.origin)
        try:
            design.refuse_conflict()
        except SettingsError as error:
            found += from_error(error, lambda _: "V-34")
    return ParametersReview(learning, model, design, found)


def hyperparameter_rule(finding: Finding) -> str:
    """Which rule a finding in hyperparameters.json is about."""
    if "is no hyperparameter" in finding.what:
        return "V-04"
    return HYPERPARAMETER_RULES.get(key_of(finding), "V-04")


def metadata_rule(finding: Finding) -> str:
    """Which rule a finding in model_metadata.json is about."""
    key = key_of(finding)
    if finding.what.startswith("the indices of"):
        return "V-30"
    if "has no meaning" in finding.what or "is no key of this file" in finding.what:
        return "V-03"
    if "is beyond what the car does" in finding.what or finding.what.endswith("learn slowly"):
        return "V-32"
    if (
        key.startswith(("action_space.", "action_space_type."))
        or "no pair of ranges" in finding.what
    ):
        return "V-31"
    if key.startswith("action"):
        return METADATA_RULES.get(key, "V-30")
    return METADATA_RULES.get(key.partition(".")[0], "V-03")


def _workers(settings: Settings, parameters: Hyperparameters, origin: str) -> list[Violation]:
    """V-45: a worker without an episode would hand in nothing, and everybody would wait for it."""
    episodes = parameters.num_episodes_between_training
    if settings.workers <= episodes:
        return []
    return [
        Violation(
            "V-45",
            "error",
            settings.source("DR_WORKERS"),
            f"DR_WORKERS={settings.workers} is more than "
            f"num_episodes_between_training={episodes} in {origin}.",
            f"Set DR_WORKERS to {episodes} at most, or drive more episodes an iteration.",
        )
    ]
