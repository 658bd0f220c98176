"""The page of one model."""

from collections.abc import Sequence
from typing import Any

from starlette.requests import Request
from starlette.routing import BaseRoute, Route

from drcli.config.run_env import raised
from drcli.models.checkpoint_list import list_checkpoints
from drcli.models.model_notes import delete_note, notes_of, rewrite_note, write_note
from drcli.models.recorded_files import files_of
from drcli.models.reward_curve import read_reward_curve
from drcli.models.training_comparison import compare
from drcli.models.training_details import compared
from drcli.models.training_entry import entry_of, settings_of
from drcli.models.transfer_buckets import UNDEFINED
from drcli.runs.evaluation_list import list_evaluations
from drcli.web.answers import BadRequest, accepts, answers, text_of
from drcli.web.model_reader import ModelReader, checked, prefix_of


def detail_routes(reader: ModelReader) -> Sequence[BaseRoute]:
    def overview(request: Request) -> Any:
        prefix = prefix_of(request)
        settings, bucket = reader.open(prefix)
        listed = next((m for m in reader.models()[0].models if m.prefix == prefix), None)
        record = reader.record(prefix)
        trainings = [r for r in reader.known().records if r.prefix == prefix]
        upload = settings.upload_s3_bucket
        return {
            "model": listed,
            "bucket": bucket.name,
            "training": None
            if record is None
            else entry_of(record, exists=record.id in reader.known().existing),
            "trainings": len(trainings),
            "current": prefix == settings.model_prefix,
            "next_name": raised(prefix, prefix)[1],
            "upload_bucket": "" if upload in ("", UNDEFINED) else upload,
            "upload_to": settings.upload_s3_prefix if prefix == settings.model_prefix else prefix,
        }

    def checkpoints(request: Request) -> Any:
        prefix = prefix_of(request)
        settings, bucket = reader.open(prefix)
        return list_checkpoints(settings.model, bucket, prefix)

    def curve(request: Request) -> Any:
        prefix = prefix_of(request)
        settings, bucket = reader.open(prefix)
        return read_reward_curve(settings.model, bucket, prefix)

    def evaluations(request: Request) -> Any:
        prefix = prefix_of(request)
        settings, bucket = reader.open(prefix)
        return list_evaluations(settings.model, bucket, prefix)

    def files(request: Request) -> Any:
        prefix = prefix_of(request)
        _, bucket = reader.open(prefix)
        record = reader.record(prefix)
        return {
            "files": files_of(bucket, prefix),
            "settings": {} if record is None else settings_of(record),
            "given": [] if record is None else sorted(record.newest.settings or ()),
            "versions": {} if record is None else record.newest.versions,
            "machine": {} if record is None else record.newest.machine,
            "parent": "" if record is None or record.parent is None else record.parent.prefix,
        }

    def difference(request: Request) -> Any:
        known = reader.known()
        bucket = reader.bucket(reader.folder.settings())
        other = checked(request.query_params.get("other"), "other model")
        mine = prefix_of(request)
        return compare(compared(bucket, known, other), compared(bucket, known, mine))

    def notes(request: Request) -> Any:
        prefix = prefix_of(request)
        _, bucket = reader.open(prefix)
        return notes_of(bucket, prefix)

    def add(request: Request, body: dict[str, Any]) -> Any:
        return write_note(reader.folder.settings(), prefix_of(request), text_of(body, "text"))

    def edit(request: Request, body: dict[str, Any]) -> Any:
        prefix, number = prefix_of(request), _number(body.get("number"))
        return rewrite_note(reader.folder.settings(), prefix, number, text_of(body, "text"))

    def remove(request: Request) -> Any:
        number = _number(request.query_params.get("number"))
        return delete_note(reader.folder.settings(), prefix_of(request), number)

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


def _number(value: Any) -> int:
    if isinstance(value, str) and value.isdecimal() and len(value) < 9:
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise BadRequest("The request needs the number of a note.")
    return value
