"""V-16: what the place refuses that a model is trained for, said before the training."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

from drcli.base.errors import Problem
from drcli.checks.compatibility_rules import not_in_reference
from drcli.config.settings import Settings
from drcli.config.track_names import COMMUNITY
from drcli.convert.car_rules import action_problems, sensor_problems, stack_problems
from drcli.convert.droa_rules import (
    NAME_RULE,
    content_problems,
    race_problems,
    track_problems,
)
from drcli.model import keys
from drcli.model.files.custom_files import InputFile
from drcli.model.files.network_shape import Design
from drcli.model.files.params_yaml import (
    COUNTER_CLOCKWISE,
    DROA_TRACKS,
    droa_parameters,
    read_parameters,
    split_world,
    training_parameters,
)
from drcli.transfer.export_droa import droa_hyperparameters

DESTINATIONS: Mapping[str, str] = {
    "droa": "DeepRacer on AWS",
    "car": "the physical car",
    "drfc": "DeepRacer-for-Cloud",
}


def review_destination(
    destination: str, settings: Settings, files: Mapping[str, InputFile], design: Design
) -> Iterator[Problem]:
    """V-16: errors are what it refuses, warnings what it changes.

    `destination` is a key of `DESTINATIONS`; `files` are the three of the model, by name.
    """
    found = {"droa": _droa, "car": _car, "drfc": _drfc}[destination]
    origins = {name: file.origin for name, file in files.items()}
    origins[f"ip/{keys.HYPERPARAMETERS_FILE}"] = origins[keys.HYPERPARAMETERS_FILE]
    for each in found(settings, files, design):
        yield replace(each, rule="V-16", file=origins.get(each.file, each.file))


def _droa(settings: Settings, files: Mapping[str, InputFile], design: Design) -> Iterator[Problem]:
    yield from _other_networks(design, "droa")
    track, _ = split_world(settings.world_name)
    route = DROA_TRACKS.get(track, (COUNTER_CLOCKWISE,))[0]
    package = {
        keys.MODEL_METADATA_FILE: files[keys.MODEL_METADATA_FILE].data,
        keys.REWARD_FUNCTION_FILE: files[keys.REWARD_FUNCTION_FILE].data,
        f"ip/{keys.HYPERPARAMETERS_FILE}": droa_hyperparameters(design.parameters),
    }
    yield from content_problems(package)
    values = read_parameters(droa_parameters(training_parameters(settings), route))
    yield from (replace(each, file="run.env") for each in race_problems(values))
    for each in track_problems(values):  # another can be named when the model goes there
        remedy = f"{each.remedy} Or name one then: `dr-export droa --world TRACK`."
        yield Problem("", "warning", *settings.place("DR_WORLD_NAME"), each.message, remedy)
    if not NAME_RULE.fullmatch(settings.model_prefix):
        what = f"{settings.model_prefix} cannot be its name there: letters, digits and hyphens."
        remedy = "Give another with `dr-droa import --model-name NAME`."
        yield Problem("", "warning", *settings.place("DR_LOCAL_S3_MODEL_PREFIX"), what, remedy)


def _car(settings: Settings, files: Mapping[str, InputFile], design: Design) -> Iterator[Problem]:
    yield from sensor_problems(design.metadata.sensor, design.metadata_origin)
    yield from stack_problems(design.parameters.stack_size, design.parameters_origin)
    yield from action_problems(design.metadata.action_space, design.metadata_origin)


def _drfc(settings: Settings, files: Mapping[str, InputFile], design: Design) -> Iterator[Problem]:
    yield from _other_networks(design, "drfc")
    name = settings.world_name
    if name not in COMMUNITY and name not in DROA_TRACKS:
        what = f"DR_WORLD_NAME={name} is not a track of DeepRacer-for-Cloud."
        remedy = "Train on one of `dr-tracks list --all` that it has, or evaluate on another there."
        yield Problem("", "warning", *settings.place("DR_WORLD_NAME"), what, remedy)


def _other_networks(design: Design, destination: str) -> Iterator[Problem]:
    form = {"droa": "droa", "drfc": "tf-checkpoint"}[destination]
    for where, key, value, wanted in not_in_reference(design):
        what = (
            f"{key}={value}: {DESTINATIONS[destination]} has no such network, so it cannot load "
            "the model."
        )
        remedy = (
            f"Write {key}={wanted} before you train, or let a network that it has learn from the "
            f"trained model: `dr-export {form} --distill`."
        )
        yield Problem("", "error", where, None, what, remedy)
