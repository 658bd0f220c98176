"""Hyperparameters on the page."""

import json
from collections.abc import Sequence
from typing import Any

from starlette.requests import Request
from starlette.routing import BaseRoute, Route

from drcli.base.problems import ProblemsError
from drcli.checks.parameter_rules import PPO_ONLY, review_parameters
from drcli.config.settings import Settings
from drcli.explain.hyperparameter_texts import HYPERPARAMETER_TEXTS
from drcli.explain.lookup import shipped_value, value_if_left_out
from drcli.modelfiles.custom_files import InputFile
from drcli.modelfiles.hyperparameters import KEYS, OWN_KEYS, Hyperparameters
from drcli.modelfiles.json_file import read_json_object
from drcli.store.keys import HYPERPARAMETERS_FILE, MODEL_METADATA_FILE
from drcli.web.answers import BadRequest, accepts, answers, placed, text_of
from drcli.web.own_files import OwnFile, base_of, own_file, save_own_file, values_of
from drcli.web.served_folder import ServedFolder

NO_EFFECT = ("term_cond_avg_score",)


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
        text = HYPERPARAMETER_TEXTS[key]
        found.append(
            {
                "key": key,
                **_limits(properties[key]),
                "meaning": text.meaning,
                "higher": text.higher,
                "lower": text.lower,
                "advice": text.advice,
                "shipped": shipped_value(key),
                "left_out": value_if_left_out(key),
                "beyond": key in OWN_KEYS,
                "algorithms": _algorithms(key),
                "effect": key not in NO_EFFECT,
            }
        )
    return found


def _algorithms(key: str) -> list[str]:
    if key.startswith("sac_"):
        return ["sac"]
    return ["clipped_ppo"] if key in PPO_ONLY | {"training_method"} else ["clipped_ppo", "sac"]


def _text(file: OwnFile, changes: dict[str, Any]) -> bytes:
    """None removes a key; order and other keys stay."""
    values = {**read_json_object(file.data, file.shown, "V-04").values, **changes}
    kept = {key: value for key, value in values.items() if value is not None}
    return (json.dumps(kept, indent=2, ensure_ascii=False) + "\n").encode()


def _changes(body: dict[str, Any]) -> dict[str, Any]:
    changes = body.get("values")
    simple = (str, int, float, type(None))  # bool is an int
    if not isinstance(changes, dict) or not all(
        key in KEYS and isinstance(value, simple) for key, value in changes.items()
    ):
        raise BadRequest("The request needs values: hyperparameters by name.")
    return changes


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

    def check(_: Request, body: dict[str, Any]) -> Any:
        settings = folder.settings()
        file = own_file(settings, HYPERPARAMETERS_FILE)
        try:
            data = _text(file, _changes(body))
        except ProblemsError:
            data = file.data  # the review says what is wrong
        return {"problems": _problems(settings, InputFile(file.name, data, file.shown))}

    def save(_: Request, body: dict[str, Any]) -> Any:
        settings = folder.settings()
        file = own_file(settings, HYPERPARAMETERS_FILE)
        data = _text(base_of(file, body), _changes(body))
        Hyperparameters.from_bytes(data, file.shown)
        saved = save_own_file(settings, HYPERPARAMETERS_FILE, data, text_of(body, "version"))
        return {**saved, **_content(own_file(settings, HYPERPARAMETERS_FILE))}

    return [
        Route("/api/hyperparameters", answers(show), methods=["GET"]),
        Route("/api/hyperparameters", accepts(save), methods=["PUT"]),
        Route("/api/hyperparameters/check", accepts(check), methods=["POST"]),
    ]
