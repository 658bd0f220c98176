"""Trainings of a sweep on the nodes of a Ray cluster.

Ray only places them: what runs, pauses, ends or is copied is decided by `sweep_run`, as on one
machine. Ray Tune for both would cost one machine Ray's start (17 s and 660 MB on two cores) and
Tune's wheels (pandas, pyarrow), has no scheduler that compares all trainings at the same amount,
and would keep beside the bucket a state that is there anyway. Optuna knows no population that
copies weights.
"""

import os
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import psutil

from drcli.base.errors import DrError, SettingsError
from drcli.base.files import rewrite
from drcli.base.installation import lazy_imports
from drcli.base.processes import is_alive, started_s
from drcli.bucket.bucket import Bucket
from drcli.bucket.connect import open_bucket
from drcli.config import secret_environment
from drcli.config.activation import PLACES, chosen
from drcli.config.loading import load_settings
from drcli.config.settings_files import EXPERIMENT
from drcli.records.run_record import RunRecord
from drcli.sweeps.sweep_record import TrialRecord
from drcli.sweeps.sweep_run import END_S
from drcli.sweeps.trial_run import Limits, TrialRun
from drcli.train.ray_cluster import NodeLost, PlacedActor, connect, keys_for_nodes

with lazy_imports():
    from ray.autoscaler import sdk as autoscaler

POLL_S = 1.0
MOST_LOST = 20
"""Vanished nodes of a training."""

CORES = 2
"""One drives, one learns."""


@dataclass(frozen=True)
class TrialTask:
    """What a node has to know of a training.

    Attributes:
        directory: On `host`.
        files: Contents by relative path, for other machines.
        environment: DR_ settings of the command.
        secrets: Access keys of the bucket.
    """

    trial: TrialRecord
    limits: Limits
    directory: Path
    host: str
    files: Mapping[str, bytes]
    environment: Mapping[str, str]
    secrets: Mapping[str, str]


@dataclass(frozen=True)
class NodeAnswer:
    """How a training is; `error` if it could not start."""

    record: RunRecord | None = None
    alive: bool = False
    error: DrError | None = None


class NodeTrial:
    """A training on its node, an actor of Ray."""

    def __init__(self, task: TrialTask) -> None:
        self._task = task
        self._run: TrialRun | None = None

    def look(self) -> NodeAnswer:
        if self._run is None:
            try:
                self._run = open_on_node(self._task)
                if not self._run.runs:
                    self._run.start(self._task.limits)
            except DrError as error:
                return NodeAnswer(error=error)
        record = self._run.record()
        return NodeAnswer(record, record is not None and record.alive)

    def stop(self) -> None:
        if self._run is not None:
            self._run.interrupt()


@dataclass(frozen=True)
class Place:
    """What a training gets on its node."""

    cpus: int
    gpus: float = 0.0

    @property
    def resources(self) -> dict[str, float]:
        return {"CPU": self.cpus, **({"GPU": self.gpus} if self.gpus else {})}


class RayTrial(TrialRun):
    """A training of a sweep on some node; its iterations are read here, in the bucket."""

    def __init__(
        self, ray: Any, place: Place, directory: Path, trial: TrialRecord, bucket: Bucket
    ) -> None:
        super().__init__(directory, trial, bucket)
        self._ray = ray
        self._place = place
        self._trial = trial
        self._actor: PlacedActor[NodeAnswer] | None = None
        self._answer = NodeAnswer()
        self._lost = 0

    def start(self, limits: Limits) -> None:
        """Ask for a node; what hinders a start there is raised by `record`."""
        task = task_for_node(self._directory, self._trial, limits)
        actor = self._ray.remote(NodeTrial)
        placed = actor.options(num_cpus=self._place.cpus, num_gpus=self._place.gpus)
        self._answer = NodeAnswer()
        self._actor = PlacedActor(self._ray, placed.remote(task))

    @property
    def runs(self) -> bool:
        if self._actor is None:
            return False
        try:
            answer = self._actor.look()
        except NodeLost:
            answer = self._after_loss()
        except SettingsError as error:
            answer = NodeAnswer(error=error)
        if answer is None:
            return True
        self._answer = answer
        if not answer.alive:
            self._give_back()
        return answer.alive

    def record(self) -> RunRecord | None:
        """Raises DrError if it could not start."""
        if self._answer.error is not None:
            raise self._answer.error
        return self._answer.record

    def interrupt(self) -> None:
        if self._actor is None:
            return
        if self._answer.alive:
            self._actor.stop()
        else:  # it may still wait for a node
            self._give_back()

    def _give_back(self) -> None:
        if self._actor is not None:
            self._actor.give_back()
            self._actor = None

    def _after_loss(self) -> NodeAnswer:
        self._lost += 1
        if self._lost > MOST_LOST:
            what = "Ray could not run it: its node was lost again and again"
            remedy = "Read `dr-logs` of its experiment."
            return NodeAnswer(error=SettingsError(what, remedy=remedy))
        record = self._answer.record
        return NodeAnswer(record and replace(record, state="interrupted"))


class RayNodes:
    """A cluster for a sweep; `parallel` of None takes all room, also that of further nodes."""

    def __init__(
        self,
        ray: Any,
        directory: Path,
        bucket: Bucket,
        *,
        threads: int,
        parallel: int | None,
        trials: int,
        say: Callable[[str], None],
    ) -> None:
        self._ray = ray
        self._directory = directory
        self._bucket = bucket
        self._parallel = parallel
        nodes = self._nodes()
        self.place = place_for(nodes, threads, parallel)
        if not any(node.get("CPU", 0.0) >= self.place.cpus for node in nodes):
            say(f"No node has {self.place.cpus} cores now; the trainings wait for one.")
        many = min(trials, parallel or trials)
        autoscaler.request_resources(bundles=[self.place.resources] * many)

    def room(self) -> int:
        """For so many trainings at a time."""
        slots = sum(int(node.get("CPU", 0.0) // self.place.cpus) for node in self._nodes())
        return min(slots, self._parallel or slots)

    def open_run(self, trial: TrialRecord) -> RayTrial:
        return RayTrial(self._ray, self.place, self._directory, trial, self._bucket)

    def _nodes(self) -> list[dict[str, float]]:
        return [node["Resources"] for node in self._ray.nodes() if node["Alive"]]


@contextmanager
def connected(
    address: str, cloud: str, runs: Sequence[TrialRun], end: Callable[[], None]
) -> Iterator[Any]:
    """Ray; no address means this machine, where `runs` and then this process end with it.

    Raises:
        SettingsError: The cluster does not answer.
    """
    ray = connect(address, cloud)
    over = threading.Event()
    servers = processes_of_ray()
    if servers:
        arguments = (servers, over, runs, end)
        threading.Thread(target=_outlive, args=arguments, daemon=True).start()
    try:
        yield ray
    finally:
        over.set()
        with suppress(ray.exceptions.RayError, RuntimeError):  # Ray may be gone
            autoscaler.request_resources(bundles=[])
        ray.shutdown()


def place_for(nodes: Sequence[Mapping[str, float]], threads: int, parallel: int | None) -> Place:
    """An autoscaler may add other nodes than these."""
    cores = sum(int(node.get("CPU", 0.0)) for node in nodes) or CORES
    largest = max((int(node.get("CPU", 0.0)) for node in nodes), default=0) or CORES
    share = max(1, cores // parallel) if parallel else cores
    cpus = threads or min(CORES, share, largest)
    gpus = sum(node.get("GPU", 0.0) for node in nodes)
    slots = parallel or max(1, cores // cpus)
    return Place(cpus, min(1.0, gpus / slots) if gpus else 0.0)


def task_for_node(directory: Path, trial: TrialRecord, limits: Limits) -> TrialTask:
    environment, _ = secret_environment.split(chosen(os.environ))
    return TrialTask(
        trial=trial,
        limits=limits,
        directory=directory,
        host=socket.gethostname(),
        files=files_for_nodes(directory, trial.name),
        environment={
            key: value
            for key, value in environment.items()
            if key.startswith("DR_") and key not in PLACES
        },
        secrets=keys_for_nodes(),
    )


def files_for_nodes(directory: Path, name: str) -> dict[str, bytes]:
    places = [
        *directory.glob("*.env"),
        *(directory / "experiments" / name).rglob("*"),
        *(directory / "tracks").rglob("*"),
    ]
    return {
        str(path.relative_to(directory)): path.read_bytes()
        for path in sorted(places)
        if path.is_file()
    }


def open_on_node(task: TrialTask) -> TrialRun:
    """Prepare this node.

    Raises:
        SettingsError: Settings are wrong here, or the folder cannot be written.
        StorageError: The bucket does not answer.
    """
    for name in [each for each in os.environ if each.startswith("DR_")]:
        del os.environ[name]
    os.environ.update(task.environment)
    secret_environment.keep(task.secrets)
    folder = folder_on_node(task, Path.home() / ".cache" / "drcli" / "ray")
    settings = load_settings(folder, flags={EXPERIMENT: task.trial.name})
    return TrialRun(folder, task.trial, open_bucket(settings.storage), ends_with_parent=True)


def folder_on_node(task: TrialTask, beside: Path) -> Path:
    """The sweep's own folder on its machine, elsewhere a copy."""
    if task.host == socket.gethostname() and task.directory.is_dir():
        return task.directory
    folder = beside / re.sub(r"\W+", "-", f"{task.host}{task.directory}")
    for name, data in task.files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        rewrite(path, data)
    return folder


def processes_of_ray() -> list[tuple[int, float]]:
    """Those that this process started, and when."""
    return [
        (child.pid, started_s(child.pid) or 0.0)
        for child in psutil.Process().children()
        if child.name() in ("raylet", "gcs_server")
    ]


def _outlive(
    servers: Sequence[tuple[int, float]],
    over: threading.Event,
    runs: Sequence[TrialRun],
    end: Callable[[], None],
) -> None:
    """End this process once Ray here is gone: then the main thread waits for it.

    A job scheduler may send SIGTERM to all processes, and so to Ray's.
    """
    while all(is_alive(pid, started) for pid, started in servers) and not over.wait(POLL_S):
        pass
    if over.is_set():
        return
    time.sleep(POLL_S)  # for a signal that came at the same time
    ends_s = time.monotonic() + END_S
    for run in runs:
        run.interrupt()
        while run.runs and time.monotonic() < ends_s:
            time.sleep(POLL_S)
    end()
