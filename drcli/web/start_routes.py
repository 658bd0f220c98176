"""Checks everything and starts a training."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, create_model
from starlette.requests import Request
from starlette.routing import BaseRoute, Route

from drcli.base.errors import DrError, WorkerDied
from drcli.base.installation import lazy_imports
from drcli.base.json_record import plain
from drcli.base.report import counted
from drcli.bucket.connect import open_running_bucket
from drcli.config.settings import Settings
from drcli.model.model_prefix import is_used, newest_checkpoint
from drcli.model.model_store import ModelStore
from drcli.records.run_record import RunRecord, run_folder
from drcli.run.status import inspect
from drcli.run.track_fetch import fetch, missing_tracks, tracks_to_fetch
from drcli.train.goals import OPTIONS
from drcli.web.answers import BadRequest, Body, accepts, answers, placed
from drcli.web.model_questions import field
from drcli.web.page_words import in_page
from drcli.web.served_folder import ServedFolder
from drcli.web.subprocess_work import in_subprocess
from drcli.web.tasks import Progress

if TYPE_CHECKING:
    from drcli.checks.check_report import Report
    from drcli.run.plan import StartOptions

with lazy_imports():
    from drcli.checks import validate
    from drcli.run import plan, training

# Starts trainings in a process of its own.


def start_training(
    progress: Progress, settings: Settings, options: "StartOptions", fetches: bool
) -> dict[str, Any]:
    """As `dr-start-training -q`; `fetches` missing community tracks."""
    missing = missing_tracks(settings) if fetches else []
    for name in missing:
        progress(f"Fetching the track {name} ...")
        fetch(settings, name)
    progress("Checking settings, files and reward function ...")
    planned = plan.prepare(settings, options)
    progress("Starting the workers ...")
    pid = training.launch(planned)
    if inspect(settings.run).pid != pid:
        raise WorkerDied(
            "The training did not start.", remedy="Read the reason with `dr-logs supervisor`."
        )
    return {
        "model": settings.model_prefix,
        "bucket": settings.bucket,
        "pid": pid,
        "warnings": planned.warnings,
        "resumes": planned.resumes,
        "ends": planned.ends,
    }


MOST = 100_000
Minutes = Annotated[float, Field(ge=0.01, le=1e7)]


class Check(Body):
    console_compatible: bool = False


class Start(Body):
    """With a value for each goal of `OPTIONS`."""

    STATUS = 422

    how: Literal["new", "resume", "wipe"] = "new"
    confirmed: Any = None
    fetch: bool = False
    max_minutes: Minutes | None = None
    seed: Annotated[int, Field(ge=0, lt=2**32)] | None = None

    def options(self, settings: Settings) -> "StartOptions":
        """Deleting or continuing a model needs its name as confirmation."""
        if self.how != "new" and self.confirmed != settings.model_prefix:
            raise BadRequest(
                f"{'Deleting' if self.how == 'wipe' else 'Continuing'} the model "
                f"{settings.model_prefix} must be confirmed with its name.",
                409,
            )
        return plan.StartOptions(
            wipe=self.how == "wipe",
            resume=self.how == "resume",
            max_minutes=self.max_minutes,
            seed=self.seed,
            goals=self.model_dump(include=set(OPTIONS), exclude_none=True),
        )


_GOALS: dict[str, Any] = {
    key: (
        Annotated[int if each.whole else float, Field(ge=each.low, le=each.high or MOST)] | None,
        None,
    )
    for key, each in OPTIONS.items()
}
_Start = create_model("_Start", __base__=Start, **_GOALS)


def _fields() -> list[dict[str, Any]]:
    goals = [
        field(
            *(each.key, each.label, None, "whole" if each.whole else "number"),
            help=each.hint,
            placeholder="no limit",
        )
        for each in OPTIONS.values()
    ]
    about = "Repeats a training exactly. Empty: DR_TRAIN_SEED, or a new one."
    seed = field("seed", "Seed (this start only)", None, "whole", help=about, placeholder="drawn")
    return [*goals, seed]


def _said(found: dict[str, Any], settings: Settings) -> Iterator[str]:
    """What there is to say about the model before its start."""
    yield f"The model is called {found['model']}."
    if settings.pretrained:
        yield f"It begins with the weights of {settings.pretrained_prefix}."
    if found["trains"]:
        yield (
            f"Run {settings.run_id} is training {found['trains']} now. Stop it first, or choose "
            "another DR_RUN_ID in the settings."
        )
    elif found["checkpoint"]:
        yield (
            f"The bucket has a model of this name, with checkpoint {found['checkpoint']}. Resume "
            "this one, or give the new model another name in step 1."
        )
    elif found["used"]:
        yield (
            "The bucket has files under this name, but no checkpoint. Give the new model another "
            "name in step 1."
        )
    if found["fetch"]:
        yield f"{', '.join(found['fetch'])} will be downloaded first."


def _asks(found: dict[str, Any], settings: Settings) -> dict[str, Any]:
    """What is asked before a start of each kind, and before a download."""
    tracks = ", ".join(found["fetch"])
    return {
        "wipe": {
            "question": f"Delete the model {found['model']} and start over?",
            "action": "Delete and start",
            "detail": "All its checkpoints, traces and videos in the bucket are lost.",
        },
        "resume": {
            "question": f"Resume the training of {found['model']}?",
            "action": "Resume",
            "detail": f"It goes on from checkpoint {found['checkpoint']}.",
        },
        "fetch": {
            "question": f"Download the track {tracks} from the address DR_TRACKS_URL?",
            "action": "Download and start",
            "detail": "It is a track of the community that is not installed.",
        }
        if tracks and settings.tracks_fetch == "ask"
        else None,
    }


def _verdict(found: "Report") -> str:
    warnings = counted(len(found.warnings), "warning")
    if found.ok:
        return f"A training can start. {warnings}."
    return f"A training cannot start: {counted(len(found.errors), 'error')}, {warnings}."


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    def check(_: Request, body: Check) -> Any:
        found = validate.validate(folder.directory, console_compatible=body.console_compatible)
        groups = {"errors": found.errors, "warnings": found.warnings, "notes": found.notes}
        return {
            "ok": found.ok,
            "said": _verdict(found),
            **{name: [placed(each) for each in group] for name, group in groups.items()},
            "skipped": plain(found.skipped),
        }

    def about(_: Request) -> Any:
        settings = folder.settings()
        prefix = settings.model_prefix
        record = RunRecord.read(run_folder(settings.directory, settings.run_id))
        found: dict[str, Any] = {
            "model": prefix,
            "trains": record.prefix if record is not None and record.alive else None,
            "used": False,
            "checkpoint": None,
            "fetch": tracks_to_fetch(settings),
            "fields": _fields(),
        }
        unread = []
        try:
            bucket = open_running_bucket(settings.storage)
            if bucket is not None:
                newest = newest_checkpoint(ModelStore(bucket, prefix))
                found["used"] = is_used(ModelStore(bucket, prefix))
                found["checkpoint"] = None if newest is None else str(newest)
        except DrError as error:
            unread = [f"The bucket cannot be read now: {in_page(str(error))}"]
        said = [*_said(found, settings), *unread]
        return found | {"said": said, "asks": _asks(found, settings)}

    def start(_: Request, body: Start) -> Any:
        settings = folder.settings()
        options = body.options(settings)
        fetches = body.fetch or settings.tracks_fetch == "always"

        def run(progress: Progress) -> Any:
            # The simulation, which the checks load, takes seconds and a hundred megabytes.
            return in_subprocess(progress, start_training, settings, options, fetches, heavy=False)

        title = f"Start the training of {settings.model_prefix}"
        return folder.tasks.start("start-training", settings.model_prefix, title, run, goes_on=True)

    return [
        Route("/api/validate", accepts(check), methods=["POST"]),
        Route("/api/start", answers(about), methods=["GET"]),
        Route("/api/start", accepts(start, _Start), methods=["POST"]),
    ]
