"""A summary of a working folder and its machine."""

import time
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from platform import python_version
from typing import Annotated, Literal
from urllib.parse import quote

from drcli.base.errors import StorageError
from drcli.base.report import Styled, View, bold, counted, dim
from drcli.bucket.bucket import Bucket, ObjectDamaged, ObjectNewer
from drcli.bucket.connect import open_running_bucket
from drcli.bucket.endpoint import Endpoint
from drcli.bucket.server import server
from drcli.config.run_config import ModelConfig, StorageConfig
from drcli.config.settings import Settings
from drcli.model import keys
from drcli.model.best_checkpoint import read_scores
from drcli.model.model_list import CheckpointEntry
from drcli.model.model_prefix import newest_checkpoint
from drcli.model.model_store import ModelStore
from drcli.model.run_metadata import installed_versions, output_of
from drcli.records.run_record import running_evaluations
from drcli.records.training_record import DayBudget, budget_of
from drcli.run.periodic import within
from drcli.run.stopping import Run, kind_of, running_trainings

# Addresses of bucket, model and files: s3://, http and on this disk.


PlaceName = Literal["bucket", "model", "custom-files", "metrics"]


@dataclass(frozen=True)
class AddressedPlace:
    """A folder in the bucket."""

    name: Annotated[PlaceName, "bucket, model, custom-files or metrics."]
    s3: Annotated[str, "Its s3:// address, for the aws command."]
    http: Annotated[
        str | None,
        "Its http address, None before the first start of the local server. Needs the keys.",
    ]
    folder: Annotated[str | None, "Its folder on this disk, None if it is only on a server."]


@dataclass(frozen=True)
class Addresses:
    """The bucket's server and folders."""

    cloud: Annotated[str, "DR_CLOUD."]
    endpoint: Annotated[
        str | None, "Address of the server, None before the first start of the local one."
    ]
    running: Annotated[
        bool | None, "Whether the local server's process runs; None for other servers."
    ]
    region: Annotated[str, "Region of the bucket."]
    places: Annotated[list[AddressedPlace], "The folders."]

    def view(self) -> View:
        yield f"Server: {self.endpoint or 'not started yet'}"
        for place in self.places:
            yield from (bold(f"{place.name}:"), [place.s3, place.http, place.folder])


def addresses(
    storage: StorageConfig, model: ModelConfig, custom_files: str, names: list[PlaceName]
) -> Addresses:
    endpoint = server.last_known(storage)
    lives = endpoint is not None and endpoint.pid is not None
    prefixes: dict[PlaceName, str] = {
        "bucket": "",
        "model": keys.folder(model.prefix),
        "custom-files": keys.folder(custom_files),
        "metrics": keys.folder(model.metrics_prefix),
    }
    return Addresses(
        cloud=storage.cloud,
        endpoint=None if endpoint is None else _server(endpoint),
        running=lives if storage.cloud == "local" else None,
        region=storage.region,
        places=[
            AddressedPlace(
                name,
                f"s3://{storage.bucket}/{prefixes[name]}",
                None if endpoint is None else _http(endpoint, storage.bucket, prefixes[name]),
                _folder(storage, prefixes[name]),
            )
            for name in names
        ],
    )


def _server(endpoint: Endpoint) -> str:
    return endpoint.place if endpoint.url else f"https://s3.{endpoint.region}.amazonaws.com"


def _http(endpoint: Endpoint, bucket: str, prefix: str) -> str:
    if endpoint.url is None:
        return f"https://{bucket}.s3.{endpoint.region}.amazonaws.com/{quote(prefix)}"
    return f"{endpoint.place.rstrip('/')}/{bucket}/{quote(prefix)}"


def _folder(storage: StorageConfig, prefix: str) -> str | None:
    """Only rclone keeps objects as plain files."""
    if storage.cloud != "local" or storage.engine != "rclone":
        return None
    return str(storage.data_dir / storage.bucket / prefix)


BUCKET_PATIENCE_S = 2.0
PACKAGES = ("drcli", "torch", "mujoco")


@dataclass(frozen=True)
class BucketState:
    """The state of the bucket, if it answers within two seconds."""

    cloud: Annotated[str, "DR_CLOUD."]
    name: Annotated[str, "DR_LOCAL_S3_BUCKET."]
    endpoint: Annotated[
        str | None, "Address of its server, None if the local one was never started."
    ]
    state: Annotated[
        Literal["answers", "stopped", "silent"],
        '"stopped": the local server does not run; "silent": a server does not answer.',
    ]
    reason: Annotated[str, "Why it is silent, empty otherwise."] = ""
    checkpoint: Annotated[
        str | None, "The model's newest checkpoint; None if it has none or it is unknown."
    ] = None
    model: Annotated[bool | None, "Whether the model has a checkpoint; None if unknown."] = None
    best: Annotated[
        CheckpointEntry | None, "The model's best checkpoint; None if it has none or it is unknown."
    ] = None

    def pairs(self, prefix: str) -> dict[str, str]:
        states = {
            "answers": Styled("answers", "green"),
            "stopped": Styled("not running; it starts when needed", "yellow"),
            "silent": Styled(self.reason, "red"),
        }
        model = {
            None: "unknown",
            False: f"{prefix} has no checkpoint yet",
            True: f"{prefix} is trained up to {self.checkpoint}",
        }
        return {
            "cloud": f"{self.cloud}, s3://{self.name}",
            "server": self.endpoint or "not started yet",
            "state": states[self.state],
            "model": model[self.model],
            "best": "" if self.best is None else self.best.text,
        }


@dataclass(frozen=True)
class Running:
    """A run in the folder."""

    kind: Annotated[Literal["training", "evaluation"], "training or evaluation."]
    run_id: Annotated[int, "Its DR_RUN_ID."]
    model: Annotated[str, "Its model, as s3://bucket/prefix."]
    world: Annotated[str, "Its track."]
    since: Annotated[float, "Unix seconds of its start."]
    pid: Annotated[int, "Its process."]

    def __str__(self) -> str:
        since = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(self.since))
        where = f"run {self.run_id}, {self.model} on {self.world}"
        return f"{where}, since {since}, process {self.pid}"


@dataclass(frozen=True)
class Summary:
    """The result of `dr-summary`."""

    folder: Annotated[str, "The working folder."]
    experiment: Annotated[str, "DR_EXPERIMENT_NAME, empty without one."]
    branch: Annotated[str | None, "The folder's git branch, None outside git."]
    run_id: Annotated[int, "DR_RUN_ID."]
    prefix: Annotated[str, "Model prefix."]
    race_type: Annotated[str, "DR_RACE_TYPE."]
    world: Annotated[str, "DR_WORLD_NAME."]
    car: Annotated[str, "DR_CAR_NAME."]
    workers: Annotated[int, "DR_WORKERS."]
    bucket: Annotated[BucketState, "The bucket."]
    running: Annotated[
        list[Running], "Trainings and evaluations of every DR_RUN_ID in this folder."
    ] = field(default_factory=list)
    versions: Annotated[
        dict[str, str | None],
        "Versions of Python and the important packages; None for one that is not installed.",
    ] = field(default_factory=dict)
    gpus: Annotated[list[str], "Names of the NVIDIA GPUs."] = field(default_factory=list)
    gpu_usable: Annotated[bool, "Whether the installed torch can use them."] = False
    warnings: Annotated[list[str], "Warnings about the settings."] = field(default_factory=list)
    budget: Annotated[
        DayBudget | None, "What all trainings of the folder have used today, and its limits."
    ] = None

    def view(self) -> View:
        origin = [self.experiment and f"experiment {self.experiment}"]
        origin += [f"git branch {self.branch}"] if self.branch else []
        budget, gpu = self.budget, ", ".join(self.gpus) or "none; the processor computes everything"
        if self.gpus and not self.gpu_usable:
            gpu += ", which the installed torch cannot use (it is the CPU build)"
        model = {
            "prefix": self.prefix,
            "world": self.world,
            "race": self.race_type,
            "car": self.car,
            "run": f"DR_RUN_ID {self.run_id}, {counted(self.workers, 'worker')}",
        }
        versions = ", ".join(f"{name} {value}" for name, value in self.versions.items() if value)
        shows = budget is not None and (budget.limited or budget.starts)
        sections = {
            "Model": model,
            "Bucket": self.bucket.pairs(self.prefix),
            "Today": _used_today(budget) if budget is not None and shows else {},
            "Machine": {"versions": versions, "GPU": gpu},
        }
        yield bold(self.folder)
        yield dim(", ".join(filter(None, origin)))
        for title, pairs in sections.items():
            if pairs:
                yield from (Styled(title, "bold cyan"), [pairs])
        yield Styled("Running", "bold cyan")
        yield [*((f"{run.kind}  {run}") for run in self.running)] or ["nothing"]
        yield from (Styled(f"Warning: {text}", "yellow") for text in self.warnings)


def _used_today(budget: DayBudget) -> dict[str, str]:
    hours = f" of {budget.max_hours:g} hours" if budget.max_hours else " machine hours"
    money = f" of {budget.max_usd:g}" if budget.max_usd else ""
    cost = f"{budget.usd:.2f}{money} USD" if budget.usd or budget.max_usd else ""
    style = "yellow" if budget.used_up else ""
    return {"trained": Styled(f"{budget.hours:.2f}{hours}", style), "cost": cost}


def summarize(settings: Settings) -> Summary:
    """Starts no server; waits two seconds for the bucket."""
    directory = settings.directory
    versions = {"python": python_version(), **installed_versions(PACKAGES)}
    # Asking torch for the GPUs would take seconds to load it.
    listed = output_of("nvidia-smi", "--query-gpu=name", "--format=csv,noheader") or ""
    gpus = [line.strip() for line in listed.splitlines()]
    return Summary(
        folder=str(directory),
        experiment=settings.experiment_name,
        branch=output_of("git", "-C", str(directory), "branch", "--show-current") or None,
        run_id=settings.run_id,
        prefix=settings.model_prefix,
        race_type=settings.race_type,
        world=settings.world_name,
        car=settings.car_name,
        workers=settings.workers,
        bucket=_bucket_state(settings),
        running=_running(directory),
        versions=versions,
        gpus=gpus,
        # Builds for the CPU alone say so in their version.
        gpu_usable=bool(gpus) and "+cpu" not in (versions["torch"] or "+cpu"),
        warnings=list(settings.warnings),
        budget=budget_of(directory, settings.run.unattended, time.time()),
    )


def _bucket_state(settings: Settings) -> BucketState:
    """In a thread: some libraries wait for too long."""
    late = f"no answer within {BUCKET_PATIENCE_S:.0f} s"
    state = BucketState(settings.cloud, settings.bucket, None, "silent", late)
    try:
        endpoint = server.last_known(settings.storage)
    except StorageError as error:
        return replace(state, reason=str(error))
    if endpoint is not None:
        state = replace(state, endpoint=endpoint.place)
    if settings.cloud == "local" and (endpoint is None or endpoint.pid is None):
        newest = _newest_on_disk(settings)
        known = None if newest is None else newest != ""
        return replace(state, state="stopped", reason="", checkpoint=newest or None, model=known)

    answer: list[BucketState] = []

    def ask() -> None:
        try:
            bucket = open_running_bucket(settings.storage)
            if bucket is None:
                return
            newest = newest_checkpoint(ModelStore(bucket, settings.model_prefix))
            best = _best(bucket, settings)
        except StorageError as error:
            answer.append(replace(state, reason=str(error)))
        else:
            found = None if newest is None else str(newest)
            answer.append(
                replace(
                    state,
                    state="answers",
                    reason="",
                    checkpoint=found,
                    model=bool(found),
                    best=best,
                )
            )

    within(BUCKET_PATIENCE_S, ask)
    return answer[0] if answer else state


def _best(bucket: Bucket, settings: Settings) -> CheckpointEntry | None:
    with suppress(ObjectDamaged, ObjectNewer):
        scores = read_scores(ModelStore(bucket, settings.model_prefix))
        if scores is not None:
            return CheckpointEntry.of(scores.best_checkpoint, settings.model.metric)
    return None


def _newest_on_disk(settings: Settings) -> str | None:
    [place] = addresses(
        settings.storage, settings.model, settings.custom_files_prefix, ["model"]
    ).places
    if place.folder is None:
        return None
    prefix = settings.model_prefix
    files = Path(place.folder, "model").glob("*")
    names = (keys.checkpoint_of(prefix, keys.model_folder(prefix) + path.name) for path in files)
    newest = max((name for name in names if name is not None), default=None)
    return "" if newest is None else str(newest)


def _running(directory: Path) -> list[Running]:
    runs: list[Run] = [*running_trainings(directory), *running_evaluations(directory)]
    return [
        Running(
            kind_of(run),
            run.run_id,
            f"s3://{run.bucket}/{run.prefix}",
            run.world,
            run.started_at,
            run.pid,
        )
        for run in runs
    ]
