"""Topic `models`, and topic `model:PREFIX` about changes of one."""

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

from starlette.requests import Request
from starlette.routing import BaseRoute, Route

from drcli.exchange.evaluation_record import running_evaluations
from drcli.models.family_tree import family_tree
from drcli.models.model_list import signature_of
from drcli.models.training_entry import TrainingEntry, entry_of
from drcli.runs.stopping import running_trainings
from drcli.store import keys, lease
from drcli.store.model_traces import models_in
from drcli.web.answers import answers
from drcli.web.hub import Polled, Publish
from drcli.web.model_reader import ModelReader
from drcli.web.topics import Snapshot

MODELS_S = 3.0
MODEL_S = 1.5
_GROUPS = {
    "model/": "checkpoints",
    "metrics/evaluation/": "evaluations",
    "metrics/EvaluationMetrics-": "evaluations",
    "metrics/": "curve",
    "ip/": "files",
    "reward_function.py": "files",
    "notes/": "notes",
    "mp4/": "evaluations",
    "evaluation-": "evaluations",
    "logs/": "",
    "training-simtrace/": "",
}
"""Beginnings of names; the first counts."""


def list_routes(reader: ModelReader) -> Sequence[BaseRoute]:
    def open_models(topic: str, publish: Publish) -> Polled:
        return Polled(topic, publish, lambda: Snapshot.of(topic, all_models(reader)), MODELS_S)

    def open_model(topic: str, publish: Publish) -> Polled:
        prefix = topic.partition(":")[2]
        if not keys.is_valid_prefix(prefix):
            raise ValueError(topic)
        return Polled(topic, publish, lambda: Snapshot.of(topic, changes(reader, prefix)), MODEL_S)

    reader.folder.hub.add_kind("models", open_models)
    reader.folder.hub.add_kind("model", open_model)

    def family(request: Request) -> Any:
        known = reader.known()
        prefix = request.query_params.get("prefix")
        return family_tree(known, None if not prefix else known.find(prefix))

    return [
        Route("/api/models", answers(lambda _: all_models(reader))),
        Route("/api/models/family", answers(family)),
    ]


def all_models(reader: ModelReader) -> dict[str, Any]:
    listed, known = reader.models()
    newest: dict[str, TrainingEntry] = {}
    laps: dict[str, int] = {}
    for record in known.records:
        if record.id in known.existing:
            newest[record.prefix] = entry_of(record, exists=True)
            laps[record.prefix] = record.results.full_laps + record.results.evaluated_laps
    directory = reader.folder.directory
    settings = reader.folder.settings()
    return {
        "bucket": listed.bucket,
        "current": settings.model_prefix,
        "models": [
            {
                "model": model,
                "training": newest.get(model.prefix),
                "laps": laps.get(model.prefix),
            }
            for model in listed.models
        ],
        "gone": len(known.records) - len(known.existing),
        "trainings": [
            {"prefix": each.prefix, "run_id": each.run_id, "state": each.state}
            for each in running_trainings(directory)
        ],
        "evaluations": _evaluations(reader, None),
    }


def changes(reader: ModelReader, prefix: str) -> dict[str, Any]:
    """A signature for each part of the page of a model."""
    settings = reader.folder.settings()
    bucket = reader.bucket(settings)
    folder = keys.folder(prefix)
    listed = bucket.list(folder)
    inner = [keys.folder(other) for other in models_in(listed) if other != prefix]
    parts = defaultdict(list)
    for info in listed:
        if any(info.key.startswith(other) for other in inner):
            continue
        name = info.key.removeprefix(folder)
        found = next((part for start, part in _GROUPS.items() if name.startswith(start)), "")
        if found:
            parts[found].append(info)
    holder = lease.live_holder(bucket, prefix)
    here = [run for run in running_trainings(reader.folder.directory) if run.prefix == prefix]
    return {
        "exists": prefix in models_in(listed),
        "parts": {name: list(signature_of(objects)) for name, objects in parts.items()},
        "training": holder is not None,
        "training_here": bool(here),
        "state": here[0].state if here else "",
        "evaluations": _evaluations(reader, prefix),
        "current": settings.model_prefix == prefix,
    }


def _evaluations(reader: ModelReader, prefix: str | None) -> list[dict[str, Any]]:
    return [
        {
            "prefix": each.prefix,
            "stamp": each.stamp,
            "world": each.world,
            "checkpoint": each.checkpoint,
            "started_at": each.started_at,
        }
        for each in running_evaluations(reader.folder.directory)
        if prefix is None or prefix in (each.prefix, *each.others)
    ]
