"""Actions on a model: tasks that do what commands do."""

import re
import secrets
import shutil
import time
from collections.abc import Sequence
from difflib import unified_diff
from pathlib import Path
from typing import Any, get_args

import anyio
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from drcli.base.errors import BadValue, DiskFull, DrError, SettingsError, WorkerDied
from drcli.base.files import safe_name
from drcli.base.processes import is_alive
from drcli.config.editing import set_values
from drcli.config.settings import catalogue
from drcli.config.track_names import built_in, own
from drcli.config.value_types import CheckpointChoice, parse_checkpoint
from drcli.model.files.custom_files import FILE_RULES
from drcli.model.model_store import ModelStore
from drcli.records.run_record import log_file
from drcli.run import stopping
from drcli.run.evaluation import STOPPED
from drcli.run.increment import Increment, Overrides, make_increment, plan_increment
from drcli.run.read_logs import text_tail
from drcli.transfer.model_removal import plan_removal
from drcli.transfer.record_training import files_of
from drcli.transfer.training_list import entry_of
from drcli.web import model_work
from drcli.web.answers import BadRequest, accepts, answers, error_of, status_of, text_of
from drcli.web.download_folder import DownloadFolder
from drcli.web.model_reader import ModelReader, checked, prefix_of
from drcli.web.own_files import own_file, save_own_file
from drcli.web.subprocess_work import WorkFailed, in_subprocess
from drcli.web.tasks import Progress, Task

EVALUATION_FIELDS = {
    "world": "DR_WORLD_NAME",
    "race_type": "DR_RACE_TYPE",
    "laps": "DR_EVAL_NUMBER_OF_TRIALS",
    "continuous": "DR_EVAL_IS_CONTINUOUS",
    "reverse": "DR_EVAL_REVERSE_DIRECTION",
    "checkpoint": "DR_EVAL_CHECKPOINT",
    "video": "DR_EVAL_SAVE_MP4",
    "opponent": "DR_EVAL_OPP_S3_MODEL_PREFIX",
}
MOST_ANALYSES = 50
_EPISODES = ("best", "all")


def action_routes(
    reader: ModelReader, downloads: DownloadFolder, analyses: dict[str, Any]
) -> Sequence[BaseRoute]:
    """Routes below /api/model; each answers with its task."""
    folder, tasks = reader.folder, reader.folder.tasks
    directory = folder.directory

    def started(task: Task) -> dict[str, int]:
        return {"task": task.id}

    def start(_: Request, body: dict[str, Any]) -> Any:
        prefix = _existing(reader, body)
        minutes = body.get("max_minutes")
        if minutes is not None and not _is_number(minutes, 0.01, 1e7):
            raise BadRequest("The longest time is a number of minutes, such as 60.")

        def work(progress: Progress) -> Any:
            return in_subprocess(
                progress, model_work.start_training, directory, prefix, minutes, heavy=False
            )

        title = f"Resume the training of {prefix}"
        return started(tasks.start("start-training", prefix, title, work, goes_on=True))

    def stop(_: Request, body: dict[str, Any]) -> Any:
        prefix = checked(body.get("prefix"))

        def work(_: Progress) -> Any:
            return stop_training_of(reader, prefix)

        return started(tasks.start("stop-training", prefix, f"Stop the training of {prefix}", work))

    def evaluate(_: Request, body: dict[str, Any]) -> Any:
        prefix = _existing(reader, body)
        flags = evaluation_flags(body)

        def work(progress: Progress) -> Any:
            began = in_subprocess(
                progress, model_work.start_evaluation, directory, prefix, flags, heavy=False
            )
            progress(f"{began['checkpoint']} drives on {began['world']}.")
            return _driven(reader, prefix, began)

        return started(tasks.start("evaluate", prefix, f"Evaluate {prefix}", work, goes_on=True))

    def stop_evaluation(_: Request, body: dict[str, Any]) -> Any:
        prefix = checked(body.get("prefix"))

        def work(_: Progress) -> Any:
            bucket = folder.settings().bucket
            return stopping.StopReport(stopping.stop_evaluations_of(directory, bucket, prefix))

        title = f"Stop the evaluation of {prefix}"
        return started(tasks.start("stop-evaluation", prefix, title, work))

    def clone(_: Request, body: dict[str, Any]) -> Any:
        prefix, target = _existing(reader, body), checked(body.get("to"), "name of the new model")
        choice = choice_of(body)
        description = text_of(body, "description", "") or None
        take, world = body.get("take", []), text_of(body, "world", "")
        if not isinstance(take, list) or not all(name in FILE_RULES for name in take):
            raise BadRequest(f"A clone can take {', '.join(FILE_RULES)}.")
        bucket = reader.open(prefix)[1]
        files = files_of(ModelStore(bucket, prefix))
        if world:  # refused before anything is changed
            set_values(directory, {"DR_WORLD_NAME": world}, write=False)
        increment = clone_model(reader, prefix, target, choice, description)
        settings = folder.settings()
        for name in take:
            if name in files:
                seen = own_file(settings, name).version
                save_own_file(settings, name, files[name].encode(), seen)
        if world:
            set_values(directory, {"DR_WORLD_NAME": world})
        return increment

    def clone_plan(request: Request) -> Any:
        prefix = prefix_of(request)
        settings, bucket = reader.open(prefix)
        record = reader.record(prefix)
        texts = files_of(ModelStore(bucket, prefix))
        own = {name: own_file(settings, name).text for name in FILE_RULES}
        return {
            "files": [
                {"name": name, "diff": changed_lines(own[name], texts[name])}
                for name in FILE_RULES
                if name in texts
            ],
            "world": None if record is None else entry_of(record, exists=True).world,
            "folder_world": settings.world_name,
        }

    def upload(_: Request, body: dict[str, Any]) -> Any:
        # As dr-upload-model: the last one.
        prefix, choice = _existing(reader, body), choice_of(body, "last")
        to, local = checked(body.get("to"), "name at the target"), body.get("local") is True

        def work(progress: Progress) -> Any:
            arguments = directory, prefix, choice, to, local
            return in_subprocess(progress, model_work.upload_model, *arguments)

        return started(tasks.start("upload", prefix, f"Upload {prefix}", work))

    def film(_: Request, body: dict[str, Any]) -> Any:
        prefix, stamp = _existing(reader, body), text_of(body, "stamp")
        options = video_options_of(body)
        keep = body.get("download") is True

        def work(progress: Progress) -> Any:
            path = None
            if keep:
                path = downloads.new_folder() / f"{safe_name(prefix)}-{safe_name(stamp)}.mp4"
            made = in_subprocess(
                progress, model_work.make_lap_video, directory, prefix, stamp, options, path
            )
            return made if path is None else downloads.offer(path, made["report"])

        return started(tasks.start("video", prefix, f"Film evaluation {stamp} of {prefix}", work))

    def download(_: Request, body: dict[str, Any]) -> Any:
        prefix, kind, choice = _existing(reader, body), body.get("kind"), choice_of(body)
        if kind not in get_args(model_work.DownloadKind):
            raise BadRequest("The kind of a download is car, onnx, logs, model or everything.")

        def work(progress: Progress) -> Any:
            arguments = directory, prefix, kind, choice, downloads.new_folder()
            made = in_subprocess(progress, model_work.make_download, *arguments)
            return downloads.offer(Path(made["file"]), made["report"])

        words = {"car": "car archive", "onnx": "ONNX file", "logs": "logs"}
        title = f"Pack the {words.get(str(kind), 'files')} of {prefix}"
        return started(tasks.start(f"download-{kind}", prefix, title, work))

    def analyse(_: Request, body: dict[str, Any]) -> Any:
        prefix = _existing(reader, body)

        def work(progress: Progress) -> Any:
            found = in_subprocess(progress, model_work.analyse_model, directory, prefix)
            analyses.pop(prefix, None)
            analyses[prefix] = found  # the newest last
            for old in list(analyses)[:-MOST_ANALYSES]:
                analyses.pop(old, None)
            return found

        return started(tasks.start("analyse", prefix, f"Analyse {prefix}", work))

    def removal(request: Request) -> Any:
        return plan_removal(folder.settings(), [prefix_of(request)], dry_run=True).report

    def delete(_: Request, body: dict[str, Any]) -> Any:
        prefix = checked(body.get("prefix"))
        if body.get("confirm") != prefix:
            raise BadRequest(f"Type {prefix} to confirm that it is to be deleted.")
        forget = body.get("forget") is True

        def work(progress: Progress) -> Any:
            arguments = directory, prefix, forget
            return in_subprocess(progress, model_work.delete_model, *arguments, heavy=False)

        return started(tasks.start("delete", prefix, f"Delete {prefix}", work, goes_on=True))

    def choices(request: Request) -> Any:
        return evaluation_choices(reader, prefix_of(request))

    actions = {
        "start": start,
        "stop": stop,
        "evaluate": evaluate,
        "stop-evaluation": stop_evaluation,
        "clone": clone,
        "upload": upload,
        "film": film,
        "download": download,
        "analyse": analyse,
        "delete": delete,
    }
    return [
        *(
            Route(f"/api/model/{name}", accepts(function), methods=["POST"])
            for name, function in actions.items()
        ),
        Route("/api/model/removal", answers(removal)),
        Route("/api/model/choices", answers(choices)),
        Route("/api/model/clone-plan", answers(clone_plan)),
    ]


def _existing(reader: ModelReader, body: dict[str, Any]) -> str:
    prefix = checked(body.get("prefix"))
    reader.open(prefix)
    return prefix


def choice_of(body: dict[str, Any], default: str = "best") -> CheckpointChoice:
    """A number, or a word such as best; else BadRequest."""
    try:
        return parse_checkpoint(text_of(body, "checkpoint", default))
    except BadValue as error:
        raise BadRequest(f"The checkpoint {error.reason}. {error.remedy}") from None


def video_options_of(body: dict[str, Any]) -> dict[str, Any]:
    """BadRequest if it cannot be so."""
    episode = text_of(body, "episode", "best")
    if episode not in _EPISODES and not (episode.isdecimal() and len(episode) < 7):
        raise BadRequest("The episode is best, all or a number.")
    size = text_of(body, "size", "640x480")
    if size not in ("640x480", "1280x720"):
        raise BadRequest("The size is 640x480 or 1280x720.")
    ghosts = body.get("ghosts", 0)
    if isinstance(ghosts, bool) or not isinstance(ghosts, int) or not 0 <= ghosts <= 4:
        raise BadRequest("The number of ghosts is 0 to 4.")
    return {
        "episode": episode,
        "size": size,
        "ghosts": ghosts,
        "explain": body.get("explain") is True,
    }


def evaluation_flags(body: dict[str, Any]) -> dict[str, str]:
    """Settings that a request changes, not yet checked."""
    flags = {}
    for field, name in EVALUATION_FIELDS.items():
        value = body.get(field)
        if value is None or value == "":
            continue
        if not isinstance(value, str | int) or "\0" in str(value):
            raise BadRequest(f"The request has no usable {field}.")
        flags[name] = str(value)
    return flags


def evaluation_choices(reader: ModelReader, prefix: str) -> dict[str, Any]:
    """What it can be, and what the settings say."""
    settings = reader.settings_of(prefix)
    record = reader.record(prefix)
    return {
        "worlds": sorted({*built_in(), *own(settings.tracks_folder)}),
        "race_types": list(catalogue()["DR_RACE_TYPE"].choices or ()),
        "world": settings.world_name,
        "trained_on": "" if record is None else record.world,
        "race_type": settings.race_type,
        "laps": settings.eval_number_of_trials,
        "continuous": settings.eval_is_continuous,
        "reverse": settings.eval_reverse_direction,
        "checkpoint": settings.eval_checkpoint,
        "video": settings.eval_save_mp4,
        "opponent": settings.eval_opp_s3_model_prefix,
    }


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


def clone_model(
    reader: ModelReader,
    prefix: str,
    target: str,
    choice: CheckpointChoice,
    description: str | None,
) -> Increment:
    """Make the next training start from this model, as dr-increment-training.

    Raises:
        SettingsError: Nothing was changed.
    """
    settings = reader.folder.settings()
    if prefix != settings.model_prefix:
        other = reader.settings_of(prefix)
        settings = settings.replaced(model_prefix=prefix, metrics_prefix=other.metrics_prefix)
    overrides = Overrides(choice, description=description)
    planned = plan_increment(settings, prefix=target, overrides=overrides)
    return make_increment(planned, settings.storage)


def changed_lines(before: str, after: str) -> list[str]:
    """A unified difference without its head; empty where only spaces at ends of lines differ."""
    old, new = ([line.rstrip() for line in text.strip().splitlines()] for text in (before, after))
    return list(unified_diff(old, new, n=2, lineterm=""))[2:]


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


def _is_number(value: Any, least: float, most: float) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and least <= value <= most


# Models that the racer drops on the page.


LARGEST_UPLOAD = 2 << 30
"""Consoles refuse more than 1 GB."""

LEAST_FREE = 512 << 20
"""For a training."""

MOST_FILES = 8
KEPT_S = 3600.0
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,120}")
_ID = re.compile(r"[0-9a-f]{24}")


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

    def start(_: Request, body: dict[str, Any]) -> Any:
        prefix = checked(body.get("prefix"), "name of the new model")
        folder = _folder(place, body.get("upload"))
        files = sorted(folder.iterdir())
        if not files:
            raise BadRequest("No file has arrived. Drop it again.")
        source = files[0] if len(files) == 1 else _main_file(files)
        world = body.get("world") or None
        if world is not None and not isinstance(world, str):
            raise BadRequest("The track is a name.")

        def work(progress: Progress) -> Any:
            try:
                arguments = reader.folder.directory, source, prefix, world
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


def _folder(place: Path, number: Any) -> Path:
    if not isinstance(number, str) or _ID.fullmatch(number) is None:
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
