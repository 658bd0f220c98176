"""Actions on a model: tasks that do what commands do."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

from starlette.requests import Request
from starlette.routing import BaseRoute, Route

from drcli.base.errors import SettingsError, WorkerDied
from drcli.base.problems import BadValue
from drcli.base.process_identity import is_alive
from drcli.base.replaceable import safe_name
from drcli.config.checkpoint_words import CheckpointChoice, parse_checkpoint
from drcli.exchange.log_places import log_file
from drcli.runs import stopping
from drcli.runs.evaluation import STOPPED
from drcli.runs.increment import Increment, make_increment, plan_increment
from drcli.runs.increment_overrides import Overrides
from drcli.runs.model_removal import plan_removal
from drcli.runs.text_tail import text_tail
from drcli.web import model_work
from drcli.web.answers import BadRequest, accepts, answers, text_of
from drcli.web.apart import run_apart
from drcli.web.download_folder import DownloadFolder
from drcli.web.model_reader import ModelReader, checked, prefix_of
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
            return run_apart(
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
            began = run_apart(
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
        return clone_model(reader, prefix, target, choice, description)

    def upload(_: Request, body: dict[str, Any]) -> Any:
        # As dr-upload-model: the last one.
        prefix, choice = _existing(reader, body), choice_of(body, "last")
        to, local = checked(body.get("to"), "name at the target"), body.get("local") is True

        def work(progress: Progress) -> Any:
            arguments = directory, prefix, choice, to, local
            return run_apart(progress, model_work.upload_model, *arguments)

        return started(tasks.start("upload", prefix, f"Upload {prefix}", work))

    def film(_: Request, body: dict[str, Any]) -> Any:
        prefix, stamp = _existing(reader, body), text_of(body, "stamp")
        wish = film_wish(body)
        keep = body.get("download") is True

        def work(progress: Progress) -> Any:
            path = None
            if keep:
                path = downloads.new_folder() / f"{safe_name(prefix)}-{safe_name(stamp)}.mp4"
            made = run_apart(
                progress, model_work.make_lap_video, directory, prefix, stamp, wish, path
            )
            return made if path is None else downloads.offer(path, made["report"])

        return started(tasks.start("video", prefix, f"Film evaluation {stamp} of {prefix}", work))

    def download(_: Request, body: dict[str, Any]) -> Any:
        prefix, kind, choice = _existing(reader, body), body.get("kind"), choice_of(body)
        if kind not in get_args(model_work.DownloadKind):
            raise BadRequest("The kind of a download is car, onnx, logs, model or everything.")

        def work(progress: Progress) -> Any:
            arguments = directory, prefix, kind, choice, downloads.new_folder()
            made = run_apart(progress, model_work.make_download, *arguments)
            return downloads.offer(Path(made["file"]), made["report"])

        words = {"car": "car archive", "onnx": "ONNX file", "logs": "logs"}
        title = f"Pack the {words.get(str(kind), 'files')} of {prefix}"
        return started(tasks.start(f"download-{kind}", prefix, title, work))

    def analyse(_: Request, body: dict[str, Any]) -> Any:
        prefix = _existing(reader, body)

        def work(progress: Progress) -> Any:
            found = run_apart(progress, model_work.analyse_model, directory, prefix)
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
            return run_apart(progress, model_work.delete_model, *arguments, heavy=False)

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


def film_wish(body: dict[str, Any]) -> dict[str, Any]:
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
    from drcli.config.settings import catalogue
    from drcli.config.track_names import built_in, own

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
