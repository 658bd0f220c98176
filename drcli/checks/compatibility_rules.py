"""Finds what works here but not on the reference, the console or the car."""

import re
from collections.abc import Iterator
from math import gcd

from drcli.base.errors import Problem, Severity
from drcli.config.fields import setting_problem
from drcli.config.settings import Settings
from drcli.convert.reference_layout import NETWORKS
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.network_shape import Design
from drcli.model.files.sensors import SENSORS

LONGEST_NAME = 64
"""Of an imported model. Source: the reference's validation script."""

CONSOLE_SPEED_MPS = (0.5, 4.0)
"""Of ranges; lists start at 0.1. Source: the console's limits."""

CONSOLE_ACTIONS = 2
_ROUNDING = 1e-4
MOST_EPISODES = 100


def review_names(settings: Settings, *, console: bool) -> Iterator[Problem]:
    """V-01: names of imported models."""
    for setting, prefix in (
        ("DR_LOCAL_S3_MODEL_PREFIX", settings.model_prefix),
        ("DR_UPLOAD_S3_PREFIX", settings.upload_s3_prefix),
    ):
        name = prefix.rpartition("/")[2]
        derived = setting != "DR_LOCAL_S3_MODEL_PREFIX" and setting not in settings.sources
        if derived or (re.fullmatch(r"[A-Za-z0-9-]+", name) and len(name) <= LONGEST_NAME):
            continue
        what = f"{setting}={prefix}: a model cannot be imported elsewhere as {name}."
        remedy = f"Use at most {LONGEST_NAME} letters, digits and hyphens after the last /."
        place = settings.place(setting)
        yield Problem("V-01", _severity(console), *place, what, remedy, setting)


def review_actions(
    metadata: ModelMetadata,
    parameters: Hyperparameters | None,
    settings: Settings,
    where: str,
    *,
    console: bool,
) -> Iterator[Problem]:
    """V-31 to V-34: what car or console refuse in model_metadata.json."""

    def problem(rule: str, message: str, remedy: str) -> Problem:
        severity = _severity(console) if rule == "V-34" else "warning"
        return Problem(rule, severity, where, None, message, remedy)

    space = metadata.action_space
    if space.low is not None and space.high is not None:
        (right, slow), (left, fast) = space.low, space.high
        if abs(right) > left:
            yield problem(
                "V-31",
                f"action_space.steering_angle from {right:g} to {left:g}: the physical car cannot "
                "steer further to the right than to the left.",
                f'Write "high": {abs(right):g}, or a "low" of {-left:g} or more.',
            )
        low, high = CONSOLE_SPEED_MPS
        if not low <= slow <= fast <= high:
            yield problem(
                "V-32",
                f"action_space.speed from {slow:g} to {fast:g} is outside the console's limits.",
                f"Stay within {low:g} to {high:g} if you want to train the model there.",
            )
    elif len(space.values) < CONSOLE_ACTIONS:
        what = "action_space has only one action; the console accepts 2 to 30."
        yield problem("V-32", what, "Add an action.")
    for name in metadata.sensor:
        if not SENSORS[name].on_car:
            yield problem(
                "V-33",
                f"sensor contains {name}; the physical car cannot load such a model.",
                "Use SECTOR_LIDAR if the model is for the physical car.",
            )
    name, accepted = metadata.training_algorithm, metadata.algorithm.console
    if accepted is None:
        what = f"training_algorithm={name}: it works here, but the console does not know it."
        yield problem("V-34", what, "Write clipped_ppo if you want to train the model there.")
    for written, wanted in ({} if parameters is None else accepted or {}).items():
        value = settings.workers if written == "DR_WORKERS" else getattr(parameters, written)
        if value != wanted:
            yield problem(
                "V-34",
                f"training_algorithm={name} with {written}={value}: it works here, but the console "
                f"and the reference accept only {wanted}.",
                f"Write {written}={wanted} if you want to train the model there.",
            )


def review_import(settings: Settings, design: Design) -> Iterator[Problem]:
    """V-34: the import after a training takes only the reference's networks."""
    if not (settings.droa_url and settings.import_model_on_completion):
        return
    for where, key, value, wanted in not_in_reference(design):
        what = (
            f"{key}={value}: the model cannot be imported into DeepRacer on AWS at the end of "
            "the training, because the reference has no such network."
        )
        remedy = (
            f"Write {key}={wanted}, or DR_IMPORT_MODEL_ON_COMPLETION=False in run.env and "
            "import afterwards what `dr-export droa --distill` makes of the model."
        )
        yield Problem("V-34", "warning", where, None, what, remedy)


def not_in_reference(design: Design) -> Iterator[tuple[str, str, object, object]]:
    """File, key, value, and what to write instead, for what other networks need."""
    metadata, stack_size = design.metadata, design.parameters.stack_size
    network = metadata.neural_network
    if not metadata.algorithm.in_reference:
        algorithm = metadata.training_algorithm
        yield design.metadata_origin, "training_algorithm", algorithm, "clipped_ppo"
    if network not in NETWORKS:
        yield design.metadata_origin, "neural_network", network, NETWORKS[0]
    if stack_size != 1:
        yield design.parameters_origin, "stack_size", stack_size, 1


_DISTILL = f"`dr-export droa --distill` lets {NETWORKS[0]}, which they have, learn from the model"


def destinations(metadata: ModelMetadata) -> str:
    """Where a model can go after its training, in a sentence or two."""
    others = "DeepRacer on AWS or DeepRacer-for-Cloud"
    if not metadata.algorithm.in_reference:
        return (
            f"The trained model can go to the physical car, but not to {others}: there, "
            f"{metadata.training_algorithm} has other networks. {_DISTILL}."
        )
    if metadata.neural_network in NETWORKS:
        return f"The trained model can go to the physical car, and to {others}."
    return (
        f"The trained model can go to the physical car, but not to {others}, which have no "
        f"{metadata.neural_network}. {_DISTILL}; or begin the training with "
        f'"neural_network": "{NETWORKS[0]}" in model_metadata.json.'
    )


def review_balance(
    settings: Settings, parameters: Hyperparameters, origin: str, *, console: bool
) -> Iterator[Problem]:
    """V-45 and, for elsewhere, V-42: numbers of episodes, workers and starts fit."""
    episodes, workers = parameters.num_episodes_between_training, settings.workers
    if workers > episodes:
        return  # review_parameters reports it
    if not workers:
        return  # they come and go
    if episodes % workers:
        around = (episodes // workers * workers, (episodes // workers + 1) * workers)
        better = " or ".join(str(n) for n in around if n <= MOST_EPISODES)
        what = (
            f"DR_WORKERS={workers} does not divide num_episodes_between_training={episodes} in "
            f"{origin}: some workers drive an episode more than others."
        )
        remedy = f"Write {better} episodes, or DR_WORKERS={gcd(episodes, workers)}."
        place = settings.place("DR_WORKERS")
        yield setting_problem("DR_WORKERS", place, what, remedy, severity="warning")
    advance = settings.train_round_robin_advance_dist
    lap = episodes / workers * advance
    if console and settings.train_change_start_position and abs(lap - 1.0) > _ROUNDING:
        name = "DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST"
        what = (
            f"({episodes} episodes / {workers} workers) x {name}={advance:g} is {lap:.4g} and not "
            "1: elsewhere, each evaluation would start at another place; here it does not."
        )
        remedy = f"Write {name}={workers / episodes:.6g}{_better_episodes(workers, advance)}."
        yield setting_problem(name, settings.place(name), what, remedy, severity="warning")


def _better_episodes(workers: int, advance: float) -> str:
    episodes = workers / advance if advance else 0.0
    if not 1 <= episodes <= MOST_EPISODES or abs(episodes - round(episodes)) > 1e-6:
        return ""
    return f", or num_episodes_between_training={round(episodes)}"


def _severity(console: bool) -> Severity:
    return "error" if console else "warning"
