"""Everything about models."""

import json
import math
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field
from starlette.requests import Request
from starlette.responses import FileResponse
from starlette.routing import BaseRoute, Route

from drcli.base.files import safe_name
from drcli.base.json_record import keys_of
from drcli.bucket.bucket import ObjectDamaged, ObjectMissing
from drcli.model import keys, lease
from drcli.model.checkpoint_list import list_checkpoints
from drcli.model.growing_file import read_all_metrics
from drcli.model.model_list import signature_of
from drcli.model.model_store import ModelStore
from drcli.model.reconstruct import readable_history, readable_scores
from drcli.model.traces import models_in
from drcli.records.episode_metrics import EpisodeMetrics
from drcli.records.iteration import IterationRecord
from drcli.records.run_record import running_evaluations
from drcli.run.evaluation_report import is_video, list_evaluations
from drcli.run.stopping import running_trainings
from drcli.transfer.family_tree import family_tree
from drcli.transfer.model_notes import delete_note, notes_of, rewrite_note, write_note
from drcli.transfer.record_training import files_of
from drcli.transfer.report_place import report_file, report_folder
from drcli.transfer.training_details import compare, compared
from drcli.transfer.training_list import TrainingEntry, entry_of, settings_of
from drcli.web.answers import BadRequest, Body, Text, accepts, answers
from drcli.web.download_folder import DownloadFolder, ObjectCopies
from drcli.web.evaluation_words import shown_evaluations
from drcli.web.hub import Read
from drcli.web.model_action_routes import Actions, action_routes, import_routes
from drcli.web.model_questions import checkpoint_options
from drcli.web.model_reader import ModelReader, checked, prefix_of
from drcli.web.model_words import (
    ACTIONS,
    CHECKPOINT_ACTIONS,
    badges_of,
    figures_of,
    marks_of,
    story_of,
)
from drcli.web.served_folder import ServedFolder

# Topic `models`, and topic `model:PREFIX` about changes of one.


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
    def of_model(topic: str, prefix: str) -> Read:
        if not keys.is_valid_prefix(prefix):
            raise ValueError(topic)
        return lambda: changes(reader, prefix)

    reader.folder.hub.poll("models", MODELS_S, lambda _: lambda: all_models(reader))
    reader.folder.hub.poll("model:(.+)", MODEL_S, of_model)

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
    current = reader.folder.settings().model_prefix
    trained = {each.prefix for each in running_trainings(directory)}
    evaluated = {each["prefix"] for each in _evaluations(reader, None)}
    rows = []
    for model in listed.models:
        prefix, training = model.prefix, newest.get(model.prefix)
        badges = badges_of(
            model,
            training,
            trains=model.training or prefix in trained,
            evaluated=prefix in evaluated,
            current=prefix == current,
        )
        row = {"model": model, "training": training, "laps": laps.get(prefix)}
        rows.append(row | {"badges": list(badges)})
    gone = len(known.records) - len(known.existing)
    return {"bucket": listed.bucket, "models": rows, "gone": gone}


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
    holder = lease.live_holder(ModelStore(bucket, prefix))
    return {
        "exists": prefix in models_in(listed),
        "parts": {name: list(signature_of(objects)) for name, objects in parts.items()},
        "training": holder is not None,
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


# Files of a model that a browser shows or keeps.


REPORT_POLICY = (
    "sandbox allow-scripts; default-src 'none'; img-src data:; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""The report's own policy allows its scripts by hash. The sandbox has no origin, so a script in it
could neither read nor ask anything of the console.
"""


def file_routes(
    reader: ModelReader, downloads: DownloadFolder, analyses: dict[str, Any]
) -> Sequence[BaseRoute]:
    videos = ObjectCopies(reader.folder.directory / "data" / "viewer" / "videos")

    def video(request: Request) -> Any:
        prefix, name = prefix_of(request), request.query_params.get("name", "")
        if not is_video(name):
            raise BadRequest("This is not the name of a video of a model.", 404)
        _, bucket = reader.open(prefix)
        key = keys.folder(prefix) + name
        file = ""
        if "download" in request.query_params:
            file = f"{safe_name(prefix)}-{safe_name(name.removesuffix('.mp4'))}.mp4"
        return videos.answer(bucket, key, media_type="video/mp4", filename=file)

    def report(request: Request) -> Any:
        path = _report(reader.folder.directory, prefix_of(request))
        if path is None:
            raise BadRequest("There is no report of this model yet. Analyse it first.", 404)
        headers = {"content-security-policy": REPORT_POLICY}
        if "download" in request.query_params:
            return FileResponse(path, media_type="text/html", filename=path.name, headers=headers)
        return FileResponse(path, media_type="text/html; charset=utf-8", headers=headers)

    def about(request: Request) -> Any:
        prefix = prefix_of(request)
        path = _report(reader.folder.directory, prefix)
        written = None if path is None else path.stat().st_mtime
        return {"written": written, "analysis": analyses.get(prefix)}

    def download(request: Request) -> Any:
        return downloads.answer(request.path_params["name"])

    return [
        Route("/api/model/video", answers(video)),
        Route("/api/model/report", answers(report)),
        Route("/api/model/report/about", answers(about)),
        Route("/api/download/{name}", answers(download)),
    ]


def _report(directory: Path, prefix: str) -> Path | None:
    """A link out of the folder is none."""
    path = report_file(directory, prefix)
    inside = path.resolve().is_relative_to(report_folder(directory).resolve())
    return path if inside and path.is_file() else None


# The reward graph of a training.


MOST_EPISODES = 4_000
"""Of more, every second one is left out, or two of three ..."""

_METRICS = re.compile(r"TrainingMetrics(_\d+)?\.json")


@dataclass(frozen=True)
class RewardCurve:
    """As the graphs of the page take it.

    Attributes:
        iterations: Figures of the records, and `clean_share`: percent of clean laps in the
            evaluation with the 95 % interval of the true share, or None.
        episodes: Iteration, 1 for an evaluation, reward, progress in percent.
        best: Name of the best checkpoint, or None.
    """

    iterations: list[dict[str, Any]]
    episodes: list[tuple[int, int, float, float]]
    all_episodes: int
    best: str | None
    damaged: list[str] = field(default_factory=list)


_FIGURES = (
    *("iteration", "mean_reward", "mean_progress", "best_lap_s"),
    *("evaluation_progress", "evaluation_lap_s"),
)


def read_reward_curve(model: ModelStore) -> RewardCurve:
    """Reconstructs damaged records; raises StorageError."""
    history, damaged = readable_history(model)
    scores, worse = readable_scores(model)
    damaged += worse
    records: list[EpisodeMetrics] = []
    for key in _metrics_keys(model):
        try:
            records += read_all_metrics(model.bucket, key)
        except ObjectMissing:
            continue
        except ObjectDamaged as error:
            damaged.append(str(error))
    numbered = [record for record in records if record.iteration is not None]
    numbered.sort(key=lambda record: (record.iteration or 0, record.episode))
    every = max(1, math.ceil(len(numbered) / MOST_EPISODES))
    return RewardCurve(
        [_point(record) for record in history],
        [_episode(record) for record in numbered[::every]],
        len(records),
        None if scores is None else scores.best_checkpoint.name,
        damaged,
    )


def _metrics_keys(model: ModelStore) -> list[str]:
    folder = keys.folder(model.metrics_prefix)
    listed = model.bucket.list(folder)
    names = {info.key.removeprefix(folder).partition(".part-")[0] for info in listed}
    return sorted(folder + name for name in names if _METRICS.fullmatch(name))


def _point(record: IterationRecord) -> dict[str, Any]:
    laps, clean = record.evaluation, None
    if laps is not None:
        clean = [100.0 * share for share in (laps.clean / laps.driven, *laps.interval)]
    return {name: getattr(record, name) for name in _FIGURES} | {"clean_share": clean}


def _episode(record: EpisodeMetrics) -> tuple[int, int, float, float]:
    is_evaluation = int(record.phase == "evaluation")
    reward, progress = record.reward_score, record.completion_percentage
    return record.iteration or 0, is_evaluation, reward, progress


# The page of one model.


def text_of(value: Any) -> str:
    if value in (None, ""):
        return "(not set)"
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _rows(values: Mapping[str, Any]) -> list[list[str]]:
    return [[name, text_of(value)] for name, value in values.items()]


class NewNote(Body):
    text: Text


class Note(NewNote):
    number: Annotated[int, Field(ge=0)]


def detail_routes(reader: ModelReader) -> Sequence[BaseRoute]:
    def overview(request: Request) -> Any:
        prefix = prefix_of(request)
        settings, bucket = reader.open(prefix)
        listed = next((m for m in reader.models()[0].models if m.prefix == prefix), None)
        record = reader.record(prefix)
        training = None
        if record is not None:
            training = entry_of(record, exists=record.id in reader.known().existing)
        trains = lease.live_holder(ModelStore(bucket, prefix)) is not None
        badges = badges_of(
            listed,
            training,
            trains=trains,
            evaluated=bool(_evaluations(reader, prefix)),
            current=prefix == settings.model_prefix,
        )
        return {
            **{"model": listed, "training": training, "trains": trains},
            **{"badges": list(badges), "story": story_of(training, trains=trains)},
            **{"figures": figures_of(listed, training), "actions": list(ACTIONS.items())},
        }

    def checkpoints(request: Request) -> Any:
        prefix = prefix_of(request)
        settings, bucket = reader.open(prefix)
        listed = list_checkpoints(ModelStore.of(settings.model, bucket, prefix))
        marks = {each.number: list(marks_of(each)) for each in listed.checkpoints}
        more = {"options": checkpoint_options(listed), "marks": marks}
        return keys_of(listed) | more | {"actions": list(CHECKPOINT_ACTIONS.items())}

    def curve(request: Request) -> Any:
        prefix = prefix_of(request)
        settings, bucket = reader.open(prefix)
        return read_reward_curve(ModelStore.of(settings.model, bucket, prefix))

    def evaluations(request: Request) -> Any:
        prefix = prefix_of(request)
        settings, bucket = reader.open(prefix)
        return shown_evaluations(list_evaluations(settings.model, ModelStore(bucket, prefix)))

    def files(request: Request) -> Any:
        prefix = prefix_of(request)
        _, bucket = reader.open(prefix)
        record = reader.record(prefix)
        newest = None if record is None else record.newest
        settings = {} if record is None else settings_of(record)
        own = set(newest.settings or ()) if newest is not None else set()
        return {
            "files": files_of(ModelStore(bucket, prefix)),
            "given": _rows({name: each for name, each in settings.items() if name in own}),
            "defaults": _rows({name: each for name, each in settings.items() if name not in own}),
            "machine": [] if newest is None else _rows({**newest.machine, **newest.versions}),
            "parent": "" if record is None or record.parent is None else record.parent.prefix,
        }

    def difference(request: Request) -> Any:
        known = reader.known()
        bucket = reader.bucket(reader.folder.settings())
        other = checked(request.query_params.get("other"))
        mine = prefix_of(request)
        found = compare(compared(bucket, known, other), compared(bucket, known, mine))
        sections = {
            title: [[each.name, text_of(each.before), text_of(each.after)] for each in changed]
            for title, changed in found.sections().items()
        }
        return {"files": found.files, "results": found.result_rows(), "sections": sections}

    def notes(request: Request) -> Any:
        prefix = prefix_of(request)
        _, bucket = reader.open(prefix)
        return notes_of(ModelStore(bucket, prefix))

    def add(request: Request, body: NewNote) -> Any:
        return write_note(reader.folder.settings(), prefix_of(request), body.text)

    def edit(request: Request, body: Note) -> Any:
        settings = reader.folder.settings()
        return rewrite_note(settings, prefix_of(request), body.number, body.text)

    def remove(request: Request) -> Any:
        number = request.query_params.get("number", "")
        if not number.isdecimal() or len(number) > 8:
            raise BadRequest("The request needs the number of a note.")
        return delete_note(reader.folder.settings(), prefix_of(request), int(number))

    return [
        Route("/api/model", answers(overview)),
        Route("/api/model/checkpoints", answers(checkpoints)),
        Route("/api/model/curve", answers(curve)),
        Route("/api/model/evaluations", answers(evaluations)),
        Route("/api/model/files", answers(files)),
        Route("/api/model/difference", answers(difference)),
        Route("/api/model/notes", answers(notes), methods=["GET"]),
        Route("/api/model/notes", accepts(add), methods=["POST"]),
        Route("/api/model/notes", accepts(edit), methods=["PUT"]),
        Route("/api/model/notes", answers(remove), methods=["DELETE"]),
    ]


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    reader = ModelReader(folder)
    downloads = DownloadFolder(folder.directory)
    analyses: dict[str, Any] = {}
    return [
        *list_routes(reader),
        *detail_routes(reader),
        *file_routes(reader, downloads, analyses),
        *action_routes(Actions(reader, downloads, analyses)),
        *import_routes(reader),
    ]
