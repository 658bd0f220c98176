"""Hyperparameters on the page."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, get_args

from pydantic import Field
from starlette.requests import Request
from starlette.routing import BaseRoute, Route

from drcli.base.errors import Problem, ProblemsError
from drcli.checks.explain.lookup import shipped_value, value_if_left_out
from drcli.checks.parameter_rules import review_parameters
from drcli.config.settings import Settings
from drcli.learn.algorithms import ALGORITHMS
from drcli.model.files.action_choice import grid
from drcli.model.files.action_space import USUAL
from drcli.model.files.custom_files import InputFile
from drcli.model.files.data_file import read_json_object
from drcli.model.files.hyperparameters import KEYS, TEXTS, Hyperparameters
from drcli.model.files.model_metadata import (
    RULES,
    ModelMetadata,
    Network,
)
from drcli.model.files.sensors import CAMERAS, LIDARS, SENSORS
from drcli.model.keys import HYPERPARAMETERS_FILE, MODEL_METADATA_FILE
from drcli.transfer.action_space_change import metadata_text, with_metadata
from drcli.web.answers import BadRequest, Body, accepts, answers, known, placed
from drcli.web.model_questions import field
from drcli.web.own_files import OwnFile, Save, base_of, own_file, save_own_file, values_of
from drcli.web.served_folder import ServedFolder

NO_EFFECT = ("term_cond_avg_score",)
USUAL_KEYS = (
    *("batch_size", "num_epochs", "lr", "beta_entropy", "discount_factor", "loss_type"),
    *("num_episodes_between_training", "exploration_type", "training_method"),
)
"""The others are folded."""

NETWORK_WORDS = {
    "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW": "shallow, of the reference",
    "DEEP_CONVOLUTIONAL_NETWORK": "middle, of the reference",
    "DEEP_CONVOLUTIONAL_NETWORK_DEEP": "deep, of the reference",
    "COMPACT_CONVOLUTIONAL_NETWORK": "compact: learns fastest",
}


USUAL_METADATA = {
    "sensor": ["FRONT_FACING_CAMERA"],
    "training_algorithm": "clipped_ppo",
    "neural_network": "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW",
    "action_space": [],
}
"""Where the file says nothing."""


def _content(file: OwnFile) -> dict[str, Any]:
    values = values_of(file, "V-04")
    return {"values": values or {}, "broken": values is None}


def _limits(schema: dict[str, Any]) -> dict[str, Any]:
    options = [each for each in schema.get("anyOf", [schema]) if each.get("type") != "null"]
    one = options[0]
    kinds = {"integer": "whole", "boolean": "flag", "number": "number"}
    return {
        "kind": "choice" if "enum" in one else kinds.get(one.get("type", ""), "text"),
        "choices": one.get("enum", []),
        "low": one.get("minimum"),
        "high": one.get("maximum"),
        "optional": len(options) < len(schema.get("anyOf", options)),
    }


def _keys() -> list[dict[str, Any]]:
    properties = Hyperparameters.model_json_schema()["properties"]
    found = []
    for key in KEYS:
        text, limits, shipped = TEXTS[key], _limits(properties[key]), shipped_value(key)
        algorithms = [each.name for each in ALGORITHMS.values() if each.reads(key)]
        said = [
            text.meaning,
            _limits_text(limits),
            f"Shipped: {shipped}." if shipped else "",
            "No effect." if key in NO_EFFECT else "",
        ]
        choices = ["true", "false"] if limits["kind"] == "flag" else limits["choices"]
        left_out = f"left out: {value_if_left_out(key)}"
        more = {"Higher" if text.lower else "Effect": text.higher, "Lower": text.lower}
        found.append(
            {
                "key": key,
                "kind": limits["kind"],
                "options": [("", left_out), *choices] if choices else None,
                "placeholder": left_out,
                "help": " ".join(filter(None, said)),
                "effects": [(name, each) for name, each in more.items() if each]
                + [("Advice", text.advice)] * bool(text.advice),
                "algorithms": algorithms,
                "usual": key in USUAL_KEYS or key.startswith(tuple(f"{a}_" for a in algorithms)),
            }
        )
    return found


def _limits_text(limits: dict[str, Any]) -> str:
    low, high = limits["low"], limits["high"]
    if low is None:
        return ""
    return f"{low:g} or more." if high is None else f"From {low:g} to {high:g}."


def _text(file: OwnFile, changes: dict[str, Any]) -> bytes:
    """None removes a key; order and other keys stay."""
    values = {**read_json_object(file.data, file.shown, "V-04").values, **changes}
    kept = {key: value for key, value in values.items() if value is not None}
    return (json.dumps(kept, indent=2, ensure_ascii=False) + "\n").encode()


Parameters = Annotated[dict[str, str | int | float | None], known(KEYS)]
Metadata = Annotated[dict[str, Any], known(RULES)]


class CheckParameters(Body):
    values: Parameters


class SaveParameters(Save, CheckParameters):
    pass


def _problems(settings: Settings, file: InputFile) -> list[dict[str, Any]]:
    metadata = own_file(settings, MODEL_METADATA_FILE).input
    review = review_parameters(file, metadata, settings)
    return [placed(each) for each in review.problems if each.file != metadata.origin]


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    def show(_: Request) -> Any:
        settings = folder.settings()
        file = own_file(settings, HYPERPARAMETERS_FILE)
        problems = _problems(settings, file.input)
        return {**file.facts(), **_content(file), "keys": _keys(), "problems": problems}

    def check(_: Request, body: CheckParameters) -> Any:
        settings = folder.settings()
        file = own_file(settings, HYPERPARAMETERS_FILE)
        try:
            data = _text(file, body.values)
        except ProblemsError:
            data = file.data  # the review says what is wrong
        return {"problems": _problems(settings, InputFile(file.name, data, file.shown))}

    def save(_: Request, body: SaveParameters) -> Any:
        settings = folder.settings()
        file = own_file(settings, HYPERPARAMETERS_FILE)
        data = _text(base_of(file, body), body.values)
        Hyperparameters.from_bytes(data, file.shown)
        saved = save_own_file(settings, HYPERPARAMETERS_FILE, data, body.version)
        return {**saved, **_content(own_file(settings, HYPERPARAMETERS_FILE))}

    return [
        Route("/api/hyperparameters", answers(show), methods=["GET"]),
        Route("/api/hyperparameters", accepts(save), methods=["PUT"]),
        Route("/api/hyperparameters/check", accepts(check), methods=["POST"]),
    ]


# Sensors, algorithm, network and actions on the page: model_metadata.json.


MOST_ANGLES = 100
"""Angles, and speeds, of a generated list, as in `dr-action-space generate`."""

WIDEST_DEG, LEAST_DEG = 30.0, 0.5


def _metadata_content(file: OwnFile) -> dict[str, Any]:
    values = values_of(file, "V-03")
    return {"values": values or {}, "broken": values is None}


def _metadata_problems(settings: Settings, file: OwnFile) -> list[dict[str, Any]]:
    parameters = own_file(settings, HYPERPARAMETERS_FILE).input
    review = review_parameters(parameters, file.input, None)
    ours = (each for each in review.problems if each.file != parameters.origin)
    return [placed(each) for each in (*ours, *_conflicts(review.problems, parameters.origin))]


def _conflicts(problems: Sequence[Problem], origin: str) -> list[Problem]:
    return [each for each in problems if each.file == origin and each.rule == "V-34"]


class CheckMetadata(Body):
    values: Metadata

    def changes(self) -> dict[str, Any]:
        if "action_space" not in self.values:
            return self.values
        kind = "continuous" if isinstance(self.values["action_space"], dict) else "discrete"
        return {**self.values, "action_space_type": kind}


class SaveMetadata(Save, CheckMetadata):
    pass


class Generate(Body):
    STATUS = 422

    angles: Annotated[int, Field(ge=1, le=MOST_ANGLES)]
    speeds: Annotated[int, Field(ge=1, le=MOST_ANGLES)]
    max_angle: Annotated[float, Field(ge=LEAST_DEG, le=WIDEST_DEG)]
    max_speed: Annotated[float, Field(ge=USUAL["speed"][0], le=USUAL["speed"][1])]


_GRID = [
    field("max_angle", "Maximum steering, degrees", 30, "number", help="0.5 to 30"),
    field(
        *("angles", "Steering granularity", 5, "whole"),
        help="Number of angles; 3, 5 or 7 are usual",
    ),
    field("max_speed", "Maximum speed, m/s", 1, "number", help="0.1 to 4"),
    field(
        *("speeds", "Speed granularity", 2, "whole"),
        help="Number of speeds; 1, 2 or 3 are usual",
    ),
]
"""What a list is generated from."""

_KINDS = [("discrete", "Discrete: a list of actions"), ("continuous", "Continuous: ranges")]
_RANGES = [
    ("Rightmost steering, degrees", "steering_angle", "low"),
    ("Leftmost steering, degrees", "steering_angle", "high"),
    ("Least speed, m/s", "speed", "low"),
    ("Greatest speed, m/s", "speed", "high"),
]


def _sensors(values: dict[str, Any]) -> dict[str, Any]:
    """What the metadata begins with, and the fields of all but the actions."""
    start = {**USUAL_METADATA, **values}
    start["training_algorithm"] = str(start["training_algorithm"]).lower()
    chosen = start["sensor"] if isinstance(start["sensor"], list) else []
    cameras = [name for name in CAMERAS if name in chosen or not SENSORS[name].alias_of]

    def named(names: Sequence[str], words: Mapping[str, str]) -> list[tuple[str, str]]:
        return [(name, words[name]) for name in names]

    sensors = {name: each.words for name, each in SENSORS.items()}
    algorithms = {name: each.words for name, each in ALGORITHMS.items()}
    lidar = "Sees other cars and boxes behind and beside the car; a time trial does not need it."
    learns = (
        "PPO is steady and the usual choice. SAC learns from every step again and needs a "
        "continuous action space."
    )
    fields = [
        field("sensor", "Camera", "", options=named(cameras, sensors)),
        field(
            *("lidar_config", "Lidar", ""),
            options=[("", "none"), *named(LIDARS, sensors)],
            help=lidar,
        ),
        field(
            *("training_algorithm", "Algorithm", ""), options=list(algorithms.items()), help=learns
        ),
        field("neural_network", "Network", "", options=named(get_args(Network), NETWORK_WORDS)),
    ]
    return {"start": start, "fields": fields, "cameras": CAMERAS, "lidars": LIDARS}


def action_space_routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    def show(_: Request) -> Any:
        settings = folder.settings()
        file = own_file(settings, MODEL_METADATA_FILE)
        content = _metadata_content(file)
        return {
            **file.facts(),
            **content,
            **_sensors(content["values"]),
            "problems": _metadata_problems(settings, file),
            "kinds": _KINDS,
            "ranges": _RANGES,
            "grid": _GRID,
        }

    def check(_: Request, body: CheckMetadata) -> Any:
        settings = folder.settings()
        file = own_file(settings, MODEL_METADATA_FILE)
        written = values_of(file, "V-03")
        if written is None:
            return {"problems": _metadata_problems(settings, file)}
        values = {**written, **body.changes()}
        kept = {key: value for key, value in values.items() if value is not None}
        new = replace(file, data=metadata_text(kept).encode())
        return {"problems": _metadata_problems(settings, new)}

    def save(_: Request, body: SaveMetadata) -> Any:
        settings = folder.settings()
        file = own_file(settings, MODEL_METADATA_FILE)
        data = with_metadata(base_of(file, body).data, file.shown, body.changes())
        saved = save_own_file(settings, MODEL_METADATA_FILE, data, body.version)
        new = own_file(settings, MODEL_METADATA_FILE)
        warnings = [placed(each) for each in ModelMetadata.from_bytes(data, file.shown).problems]
        return {**saved, **_metadata_content(new), "problems": warnings}

    def generate(_: Request, body: Generate) -> Any:
        made = grid(**body.model_dump())
        if len({(each.steering_angle, each.speed) for each in made}) < len(made):
            raise BadRequest("Some of these actions are equal: choose fewer angles or speeds.", 422)
        return {
            "actions": [
                {"steering_angle": each.steering_angle, "speed": each.speed} for each in made
            ],
            "note": ""
            if body.angles % 2
            else f"With {body.angles} angles no action drives straight ahead.",
        }

    return [
        Route("/api/metadata", answers(show), methods=["GET"]),
        Route("/api/metadata", accepts(save), methods=["PUT"]),
        Route("/api/metadata/check", accepts(check), methods=["POST"]),
        Route("/api/metadata/generate", accepts(generate), methods=["POST"]),
    ]
