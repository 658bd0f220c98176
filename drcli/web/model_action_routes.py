"""Actions on a model: tasks that do what commands do."""

import re
import secrets
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import anyio
from pydantic import BeforeValidator, Field, model_validator
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from drcli.base.errors import DiskFull, DrError, SettingsError, WorkerDied
from drcli.base.files import safe_name
from drcli.base.processes import is_alive
from drcli.config.editing import set_values
from drcli.config.value_types import CheckpointChoice, parse_checkpoint
from drcli.model.files.custom_files import FILE_RULES
from drcli.model.model_store import ModelStore
from drcli.records.run_record import log_file
from drcli.run import stopping
from drcli.run.evaluation import STOPPED
from drcli.run.increment import Increment, Overrides, make_increment, plan_increment
from drcli.run.read_logs import text_tail
from drcli.transfer.record_training import files_of
from drcli.web import model_work, start_routes
from drcli.web.answers import BadRequest, Body, Text, accepts, answers, error_of, known, status_of
from drcli.web.download_folder import DownloadFolder
from drcli.web.model_questions import question
from drcli.web.model_reader import ModelReader, Prefix
from drcli.web.own_files import own_file, save_own_file
from drcli.web.subprocess_work import WorkFailed, in_subprocess
from drcli.web.tasks import Progress

MOST_ANALYSES = 50
Checkpoint = Annotated[
    CheckpointChoice, BeforeValidator(lambda value: parse_checkpoint(str(value)))
]


class OfModel(Body):
    prefix: Prefix


class Resume(OfModel):
    max_minutes: start_routes.Minutes | None = None


def _setting(name: str) -> Any:
    return Field(None, serialization_alias=name)


class Evaluate(OfModel):
    """Null or empty: as the settings say, which check the others."""

    world: Text | None = _setting("DR_WORLD_NAME")
    race_type: Text | None = _setting("DR_RACE_TYPE")
    laps: Text | int | None = _setting("DR_EVAL_NUMBER_OF_TRIALS")
    continuous: Text | bool | None = _setting("DR_EVAL_IS_CONTINUOUS")
    reverse: Text | bool | None = _setting("DR_EVAL_REVERSE_DIRECTION")
    checkpoint: Text | int | None = _setting("DR_EVAL_CHECKPOINT")
    video: Text | bool | None = _setting("DR_EVAL_SAVE_MP4")
    opponent: Text | None = _setting("DR_EVAL_OPP_S3_MODEL_PREFIX")

    def flags(self) -> dict[str, str]:
        given = self.model_dump(by_alias=True, exclude={"prefix"}, exclude_none=True)
        return {name: str(value) for name, value in given.items() if value != ""}


class Clone(OfModel):
    to: Prefix
    checkpoint: Checkpoint = "best"
    description: Text = ""
    take: Annotated[list[str], known(FILE_RULES)] = Field(default_factory=list)
    world: Text = ""


class Upload(OfModel):
    checkpoint: Checkpoint = "last"  # as dr-upload-model
    to: Prefix
    local: bool = False


class Film(OfModel):
    stamp: Text
    episode: Annotated[str, Field(pattern="^(best|all|[0-9]{1,6})$")] = "best"
    size: Literal["640x480", "1280x720"] = "640x480"
    ghosts: Annotated[int, Field(ge=0, le=4, strict=False)] = 0
    explain: bool = False
    download: bool = False


class Download(OfModel):
    kind: model_work.DownloadKind
    checkpoint: Checkpoint = "best"

    @property
    def what(self) -> str:
        words = {"car": "car archive", "onnx": "ONNX file", "logs": "logs"}
        return words.get(self.kind, "files")


class Delete(OfModel):
    confirm: Any = None
    forget: bool = False

    @model_validator(mode="after")
    def _confirmed(self) -> Self:
        if self.confirm != self.prefix:
            raise BadRequest(f"Type {self.prefix} to confirm that it is to be deleted.")
        return self


@dataclass(frozen=True)
class Actions:
    """What the work of tasks uses."""

    reader: ModelReader
    downloads: DownloadFolder
    analyses: dict[str, Any]

    @property
    def directory(self) -> Path:
        return self.reader.folder.directory


def _resume(at: Actions, body: Resume, progress: Progress) -> Any:
    given = at.directory, body.prefix, body.max_minutes
    return in_subprocess(progress, model_work.start_training, *given, heavy=False)


def _stop(at: Actions, body: OfModel, progress: Progress) -> Any:
    return stop_training_of(at.reader, body.prefix)


def _evaluate(at: Actions, body: Evaluate, progress: Progress) -> Any:
    given = at.directory, body.prefix, body.flags()
    began = in_subprocess(progress, model_work.start_evaluation, *given, heavy=False)
    progress(f"{began['checkpoint']} drives on {began['world']}.")
    return _driven(at.reader, body.prefix, began)


def _stop_evaluation(at: Actions, body: OfModel, progress: Progress) -> Any:
    bucket = at.reader.folder.settings().bucket
    return stopping.StopReport(stopping.stop_evaluations_of(at.directory, bucket, body.prefix))


def _upload(at: Actions, body: Upload, progress: Progress) -> Any:
    given = at.directory, body.prefix, body.checkpoint, body.to, body.local
    return in_subprocess(progress, model_work.upload_model, *given)


def _film(at: Actions, body: Film, progress: Progress) -> Any:
    path = None
    if body.download:
        name = f"{safe_name(body.prefix)}-{safe_name(body.stamp)}.mp4"
        path = at.downloads.new_folder() / name
    options = body.model_dump(include={"episode", "size", "ghosts", "explain"})
    given = at.directory, body.prefix, body.stamp, options, path
    made = in_subprocess(progress, model_work.make_lap_video, *given)
    return made if path is None else at.downloads.offer(path, made["report"])


def _download(at: Actions, body: Download, progress: Progress) -> Any:
    folder = at.downloads.new_folder()
    given = at.directory, body.prefix, body.kind, body.checkpoint, folder
    made = in_subprocess(progress, model_work.make_download, *given)
    return at.downloads.offer(Path(made["file"]), made["report"])


def _analyse(at: Actions, body: OfModel, progress: Progress) -> Any:
    found = in_subprocess(progress, model_work.analyse_model, at.directory, body.prefix)
    at.analyses.pop(body.prefix, None)
    at.analyses[body.prefix] = found  # the newest last
    for old in list(at.analyses)[:-MOST_ANALYSES]:
        at.analyses.pop(old, None)
    return found


def _delete(at: Actions, body: Delete, progress: Progress) -> Any:
    given = at.directory, body.prefix, body.forget
    return in_subprocess(progress, model_work.delete_model, *given, heavy=False)


@dataclass(frozen=True)
class ModelTask:
    """What `POST /api/model/NAME` starts.

    Attributes:
        work: Gets the body that it declares.
        kind, title: With fields of the body.
        exists: Whether it needs an existing model.
    """

    work: Callable[[Actions, Any, Progress], Any]
    kind: str
    title: str
    exists: bool = True
    goes_on: bool = False

    def route(self, name: str, at: Actions) -> Route:
        def start(_: Request, body: OfModel) -> Any:
            if self.exists:
                at.reader.open(body.prefix)
            kind, title = (text.format(body=body) for text in (self.kind, self.title))
            work = partial(self.work, at, body)
            tasks = at.reader.folder.tasks
            return {"task": tasks.start(kind, body.prefix, title, work, goes_on=self.goes_on).id}

        declared = self.work.__annotations__["body"]
        return Route(f"/api/model/{name}", accepts(start, declared), methods=["POST"])


TASKS = {
    "start": ModelTask(
        _resume, "start-training", "Resume the training of {body.prefix}", goes_on=True
    ),
    "stop": ModelTask(_stop, "stop-training", "Stop the training of {body.prefix}", exists=False),
    "evaluate": ModelTask(_evaluate, "evaluate", "Evaluate {body.prefix}", goes_on=True),
    "stop-evaluation": ModelTask(
        _stop_evaluation, "stop-evaluation", "Stop the evaluation of {body.prefix}", exists=False
    ),
    "upload": ModelTask(_upload, "upload", "Upload {body.prefix}"),
    "film": ModelTask(_film, "video", "Film evaluation {body.stamp} of {body.prefix}"),
    "download": ModelTask(
        _download, "download-{body.kind}", "Pack the {body.what} of {body.prefix}"
    ),
    "analyse": ModelTask(_analyse, "analyse", "Analyse {body.prefix}"),
    "delete": ModelTask(_delete, "delete", "Delete {body.prefix}", exists=False, goes_on=True),
}


def action_routes(at: Actions) -> Sequence[BaseRoute]:
    """Routes below /api/model; those of `TASKS` answer with their task."""
    reader, folder = at.reader, at.reader.folder

    def clone(_: Request, body: Clone) -> Any:
        bucket = reader.open(body.prefix)[1]
        files = files_of(ModelStore(bucket, body.prefix))
        world = {"DR_WORLD_NAME": body.world} if body.world else {}
        if world:  # refused before anything is changed
            set_values(at.directory, world, write=False)
        increment = clone_model(reader, body)
        settings = folder.settings()
        for name in body.take:
            if name in files:
                seen = own_file(settings, name).version
                save_own_file(settings, name, files[name].encode(), seen)
        if world:
            set_values(at.directory, world)
        return increment

    return [
        *(task.route(name, at) for name, task in TASKS.items()),
        Route("/api/model/clone", accepts(clone), methods=["POST"]),
        Route("/api/model/question", answers(lambda request: question(reader, request))),
    ]


def stop_training_of(reader: ModelReader, prefix: str) -> Any:
    """Stop a training as dr-stop-training does.

    Raises:
        SettingsError: It is not on this machine.
        WorkerDied: It is still stopping.
    """
    settings = reader.folder.settings()
    running = stopping.running_trainings(reader.folder.directory)
    record = next((run for run in running if run.prefix == prefix), None)
    if record is None:
        raise SettingsError(
            f"{prefix} is not being trained from this folder.",
            remedy="If another machine trains it, stop it there with `dr-stop-training`.",
        )
    run = settings.replaced(run_id=record.run_id).run
    waiting = stopping.stop_waiting(settings.directory, record.run_id)
    report = stopping.stop(run)
    model = f"s3://{report.bucket}/{report.prefix}"
    if stopping.is_running(run):
        raise WorkerDied(
            f"The training of {model} (process {report.pid}) is still stopping.",
            remedy="Stop it again to end it at once.",
        )
    ended = stopping.Stopped("training", report.run_id, model, report.pid or 0)
    return stopping.StopReport([ended, *waiting])


def clone_model(reader: ModelReader, body: Clone) -> Increment:
    """Make the next training start from this model, as dr-increment-training.

    Raises:
        SettingsError: Nothing was changed.
    """
    settings = reader.folder.settings()
    if body.prefix != settings.model_prefix:
        other = reader.settings_of(body.prefix)
        settings = settings.replaced(model_prefix=body.prefix, metrics_prefix=other.metrics_prefix)
    overrides = Overrides(body.checkpoint, description=body.description or None)
    planned = plan_increment(settings, prefix=body.to, overrides=overrides)
    return make_increment(planned, settings.storage)


def _driven(reader: ModelReader, prefix: str, began: dict[str, Any]) -> dict[str, Any]:
    closing = reader.folder.tasks.closing
    while is_alive(began["pid"], began["pid_started"]):
        if closing.wait(0.5):
            return {"stopped": False}  # the evaluation goes on, and the next console shows it
    bucket = reader.bucket(reader.folder.settings())
    if not bucket.exists(began["metrics"]):
        log = log_file(reader.folder.directory, prefix, "evaluation")
        lines = [line for line in text_tail(log, 2000).splitlines() if line.strip()]
        said = lines[-1][:300] if lines else "nothing"
        if STOPPED in said:
            return {"stopped": True}
        raise WorkerDied(
            f"The evaluation has no results; the last line of its log is: {said}",
            remedy="Read the whole log with `dr-logs evaluation -a`.",
        )
    return {name: began[name] for name in ("stamp", "checkpoint", "world")}


# Models that the racer drops on the page.


LARGEST_UPLOAD = 2 << 30
"""Consoles refuse more than 1 GB."""

LEAST_FREE = 512 << 20
"""For a training."""

MOST_FILES = 8
KEPT_S = 3600.0
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,120}")
_ID = re.compile(r"[0-9a-f]{24}")


class Import(OfModel):
    upload: str
    world: Text | None = None


def import_routes(reader: ModelReader) -> Sequence[BaseRoute]:
    """`POST /api/uploads?name=FILE&upload=ID` takes a file, `POST /api/models/import` imports it.

    The answer to the first file has the ID for others.
    """
    place = reader.folder.directory / "data" / "viewer" / "uploads"

    async def upload(request: Request) -> Response:
        try:
            number, path = await anyio.to_thread.run_sync(_target, place, request)
            size = await _store(request, path)
        except Exception as error:
            return JSONResponse(error_of(error), status_of(error))
        return JSONResponse({"upload": number, "name": path.name, "size_bytes": size})

    def start(_: Request, body: Import) -> Any:
        prefix, folder = body.prefix, _folder(place, body.upload)
        files = sorted(folder.iterdir())
        if not files:
            raise BadRequest("No file has arrived. Drop it again.")
        source = files[0] if len(files) == 1 else _main_file(files)

        def work(progress: Progress) -> Any:
            try:
                arguments = reader.folder.directory, source, prefix, body.world or None
                return in_subprocess(progress, model_work.import_archive, *arguments)
            except DrError as error:
                # The racer knows the file by its name alone.
                said = str(error).replace(f"{folder}/", "").replace(str(folder), "The files")
                raise WorkFailed(said, remedy=error.remedy, code=error.code) from None
            finally:
                shutil.rmtree(folder, ignore_errors=True)

        task = reader.folder.tasks.start("import", prefix, f"Import {prefix}", work)
        return {"task": task.id}

    return [
        Route("/api/uploads", upload, methods=["POST"]),
        Route("/api/models/import", accepts(start), methods=["POST"]),
    ]


def _main_file(files: Sequence[Path]) -> Path:
    others = {".json", ".py", ".yaml", ".yml", ".md", ".txt"}
    found = [path for path in files if path.suffix.lower() not in others]
    return found[0] if len(found) == 1 else files[0].parent


def _target(place: Path, request: Request) -> tuple[str, Path]:
    name = request.query_params.get("name", "")
    if _NAME.fullmatch(name) is None:
        raise BadRequest(
            "The file needs a name of letters, digits and . _ - without folders. Rename it."
        )
    number = request.query_params.get("upload") or ""
    if not number:
        _sweep(place)
        number = secrets.token_hex(12)
        (place / number).mkdir(parents=True, mode=0o700)
    folder = _folder(place, number)
    if len(list(folder.iterdir())) >= MOST_FILES:
        raise BadRequest(f"One import has at most {MOST_FILES} files; pack more as .tar.gz.")
    return number, folder / name


def _folder(place: Path, number: str) -> Path:
    if _ID.fullmatch(number) is None:
        raise BadRequest("The request needs the number of an upload.")
    folder = place / number
    if not folder.is_dir():
        raise BadRequest("These files are no longer kept. Drop them again.", 404)
    return folder


def _sweep(place: Path) -> None:
    if not place.is_dir():
        return
    for folder in place.iterdir():
        if time.time() - folder.stat().st_mtime > KEPT_S:
            shutil.rmtree(folder, ignore_errors=True)


async def _store(request: Request, path: Path) -> int:
    """Nothing is left of a body that is too large."""
    announced = request.headers.get("content-length", "")
    size = int(announced) if announced.isdecimal() and len(announced) < 16 else 0
    room = min(LARGEST_UPLOAD, shutil.disk_usage(path.parent).free - LEAST_FREE)
    _refuse_large(size, room)
    written = 0
    try:
        async with await anyio.open_file(path, "xb") as file:
            async for chunk in request.stream():
                written += len(chunk)
                _refuse_large(written, room)
                await file.write(chunk)
        if not written or (size and written != size):
            raise BadRequest("The file did not arrive as a whole. Drop it again.")
    except FileExistsError:
        raise BadRequest(f"{path.name} was sent twice.", 409) from None
    except ClientDisconnect:
        path.unlink(missing_ok=True)
        raise BadRequest("The file did not arrive as a whole. Drop it again.") from None
    except BaseException:
        path.unlink(missing_ok=True)
        raise
    return written


def _refuse_large(size: int, room: int) -> None:
    if size > LARGEST_UPLOAD:
        raise BadRequest(f"A file has at most {LARGEST_UPLOAD >> 30} GB.", 413)
    if size > room:
        raise DiskFull("The disk has no room for this file.", remedy="Make room, then try again.")
