"""The trainer of a training whose workers Ray places, here or on a node (DR_RAY_TRAINER).

For a node, this process takes log, heartbeat and signals from one side to the other, and ends as
the trainer does.
"""

import math
import os
import shutil
import signal
import socket
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import FrameType
from typing import Any

from drcli.base.errors import SettingsError, WorkerDied
from drcli.base.installation import lazy_imports
from drcli.base.json_record import from_json, plain_json
from drcli.base.log import RotatingFile, get_logger, traces
from drcli.config import secret_environment
from drcli.metrics.open_sinks import tensorboard_folder
from drcli.model.model_store import ModelStore
from drcli.records.heartbeat import HeartbeatRecord
from drcli.records.job import Job, WorkerExit
from drcli.records.run_record import json_log, log_file
from drcli.run.join_check import refuse_other_versions, versions
from drcli.run.read_logs import UnreadLog, read_piece
from drcli.run.worker_processes import TRAINER, start_process
from drcli.train.ray_cluster import NodeLost, PlacedActor, connected, keys_for_nodes
from drcli.workers import worker_process
from drcli.workers.cores import with_known_overlap
from drcli.workers.heartbeat_thread import STACKS_SIGNAL
from drcli.workers.worker_process import Activity, StopRequested, StopSignal

with lazy_imports():
    from drcli.learn import compute
    from drcli.train import trainer

# What Ray runs on a node for a trainer.
#
# Its files go back piece by piece, so nothing is lost with the node.


PIECE_BYTES = 1 << 20


@dataclass(frozen=True)
class HostReport:
    """What is new since the last look.

    `files` are whole, `log` and `events` what they have more. `refusal`: why this node may not
    train.
    """

    node: str
    code: int | None
    heartbeat: HeartbeatRecord | None = None
    log: bytes = b""
    json_log: bytes = b""
    events: Mapping[str, bytes] = field(default_factory=dict)
    files: Mapping[str, bytes] = field(default_factory=dict)
    refusal: WorkerExit | None = None


class TrainerHost:
    def __init__(
        self, job: Mapping[str, Any], versions: Mapping[str, str], secrets: Mapping[str, str]
    ) -> None:
        self._refusal: WorkerExit | None = None
        try:
            refuse_other_versions(versions)
        except SettingsError as error:
            words = f"{socket.gethostname()} cannot train: {error}"
            self._refusal = replace(WorkerExit.of(error), message=words)
            return
        secret_environment.keep(secrets)
        self._folder = Path(tempfile.mkdtemp(prefix="drcli-trainer-"))
        sent = from_json(Job, dict(job))
        self._job = replace(
            sent,
            config=replace(sent.config, directory=self._folder),
            folder=self._folder / "run",
            launcher_pid=os.getpid(),
        )
        self._job.folder.mkdir()
        log = log_file(self._folder, self._job.config.model.prefix, TRAINER)
        self._log = UnreadLog(log, Path(os.devnull), PIECE_BYTES)
        self._json_log = UnreadLog(json_log(log), Path(os.devnull), PIECE_BYTES)
        self._events = tensorboard_folder(self._folder, self._job.config.model.prefix)
        self._sent_bytes: dict[str, int] = {}
        self._sent: dict[str, bytes] = {}
        self._process = start_process(self._job, TRAINER, "drcli.train.trainer")

    def look(self) -> HostReport:
        node = socket.gethostname()
        if self._refusal is not None:
            return HostReport(node, self._refusal.code, refusal=self._refusal)
        code = self._process.poll()  # first, so that its last words are read below
        report = HostReport(
            node,
            code,
            HeartbeatRecord.read(self._job.folder, TRAINER),
            _unread(self._log),
            _unread(self._json_log),
            self._new_events(),
            self._changed_files(),
        )
        if code is not None:  # who asks does not ask again
            shutil.rmtree(self._folder, ignore_errors=True)
        return report

    def stop(self) -> None:
        self.signal(signal.SIGTERM)

    def signal(self, number: int) -> None:
        with suppress(ProcessLookupError):
            self._process.send_signal(number)

    def _new_events(self) -> dict[str, bytes]:
        found = {}
        for path in sorted(self._events.glob("*")):
            begin = self._sent_bytes.get(path.name, 0)
            if data := read_piece(path, begin, PIECE_BYTES):
                found[path.name] = data
                self._sent_bytes[path.name] = begin + len(data)
        return found

    def _changed_files(self) -> dict[str, bytes]:
        found = {}
        for path in self._job.folder.iterdir():
            if not path.is_file() or path.suffix != ".json":
                continue
            data = path.read_bytes()
            if self._sent.get(path.name) != data:
                found[path.name] = self._sent[path.name] = data
        return found


def _unread(log: UnreadLog) -> bytes:
    found = []
    while log.log.exists():
        path, data = log.next_piece()
        if path is None:  # it was rotated just now
            continue
        if data:
            found.append(data)
            log.advance(len(data))
        elif path == log.log:
            break
        else:
            log.next_file()
    return b"".join(found)


_logger = get_logger(__name__)

POLL_S = 0.25
OWN_CORES_S = 10.0
"""Then it shares those of a worker: workers could have all cores for good."""

SILENT_S = 120.0
"""Without a new heartbeat, though its node answers."""

FIGURE_KEYS = (
    "MLFLOW_TRACKING_TOKEN",
    "MLFLOW_TRACKING_USERNAME",
    "MLFLOW_TRACKING_PASSWORD",
    "TRACKIO_WRITE_TOKEN",
)


def gpus_to_ask(
    wanted: str, learners: int, of_nodes: Sequence[float], here: Callable[[], int]
) -> int | None:
    """None if it runs here; SettingsError if no node has a GPU per learner."""
    if wanted == "gpu":
        return learners
    most = int(max(of_nodes, default=0))
    if most == 0:
        return None if wanted == "auto" else 0
    if wanted == "auto" and here():
        return None
    if most < learners:
        raise SettingsError(
            f"DR_TRAIN_LEARNERS in system.env is {learners}, but no node of the cluster has more "
            f"than {most} GPU{'s' * (most != 1)}.",
            remedy=f"Set it to {most}, or DR_RAY_TRAINER to here.",
        )
    return learners


class Copies:
    def __init__(self, job: Job) -> None:
        prefix = job.config.model.prefix
        self._folder = job.folder
        self._number = job.trainer or 0
        path = json_log(log_file(job.directory, prefix, TRAINER))
        self._json_log = RotatingFile(path, job.config.logs.log_max_mb << 20)
        self._events = tensorboard_folder(job.directory, prefix)
        self._rest = b""

    def take(self, report: HostReport) -> None:
        """On a full disk, nothing fails."""
        *lines, self._rest = (self._rest + report.log).split(b"\n")
        if report.code is not None and self._rest:
            lines, self._rest = [*lines, self._rest], b""
        for line in lines:
            traces.info("%s", line.decode("utf-8", "replace"))
        self._json_log.write(report.json_log.decode("utf-8", "replace"))
        with suppress(OSError):
            for name, data in report.events.items():
                self._events.mkdir(parents=True, exist_ok=True)
                with (self._events / Path(name).name).open("ab") as file:
                    file.write(data)
            for name, data in report.files.items():
                self._write(self._folder / self._own_name(Path(name).name), data)

    def _own_name(self, name: str) -> str:
        """Each process counts its requests from zero, and all counts are added."""
        counts = ".requests.json"
        return f"{TRAINER}-{self._number}{counts}" if name.endswith(counts) else name

    def _write(self, path: Path, data: bytes) -> None:
        scratch = path.with_name(f".{path.name}.{os.getpid()}")
        scratch.write_bytes(data)
        scratch.replace(path)


class PlacedTrainer:
    def __init__(
        self,
        host: PlacedActor[HostReport],
        job: Job,
        stop_signal: StopSignal,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._host = host
        self._folder = job.folder
        self._stop_signal = stop_signal
        self._clock = clock
        self._copies = Copies(job)
        self._stopped = False
        self._asked_for_stacks = 0
        self._heartbeat: HeartbeatRecord | None = None
        self._heard_s = clock()
        self.node = ""

    def move(self, host: PlacedActor[HostReport]) -> None:
        self._host.give_back()
        self._host = host

    def give_back(self) -> None:
        self._host.give_back()

    def look(self) -> int | None:
        """Take over what is new; returns the trainer's exit code once it ended.

        Raises:
            WorkerDied: The node is gone, or the trainer is silent.
            SettingsError: The node cannot train.
        """
        if self._asked_for_stacks and self.node:
            self._host.call("signal", self._asked_for_stacks)
            self._asked_for_stacks = 0
        if not self._stopped and self._stop_signal.should_stop():
            if not self.node:
                raise StopRequested
            self._host.stop()
            self._stopped = True
        try:
            report = self._host.look()
        except NodeLost as error:
            self._give_up(f"The node of the trainer{self._where()} is gone ({error}).", lost=True)
        if report is None:
            return None
        if report.refusal is not None:
            report.refusal.write(self._folder, TRAINER)
            _logger.error("%s %s", report.refusal.message, report.refusal.remedy)
            return report.refusal.code
        if not self.node:
            self.node, self._heard_s = report.node, self._clock()
            _logger.info("The trainer runs on %s.", self.node)
        self._copies.take(report)
        if report.heartbeat is not None and report.heartbeat != self._heartbeat:
            self._heartbeat, self._heard_s = report.heartbeat, self._clock()
            self._stop_signal.heartbeat.relay(report.heartbeat)
        if report.code is None and self._clock() - self._heard_s > SILENT_S:
            self._give_up(f"The trainer{self._where()} gave no sign for {SILENT_S:.0f} s.")
        return report.code

    def ask_stacks(self, number: int, _frame: FrameType | None) -> None:
        self._asked_for_stacks = number

    def _where(self) -> str:
        return f" ({self.node})" if self.node else ""

    def _give_up(self, what: str, *, lost: bool = False) -> None:
        _logger.error("%s", what)
        words = WorkerExit(what, "Read its log with `dr-logs trainer`.", WorkerDied.code, lost=lost)
        words.write(self._folder, TRAINER)
        raise SystemExit(words.code)


def main(job: Job, stop_signal: StopSignal) -> None:
    train = job.config.train
    code: int | None = None
    with connected(job) as ray:
        nodes = [node["Resources"].get("GPU", 0.0) for node in ray.nodes() if node["Alive"]]
        gpus = gpus_to_ask(train.ray_trainer, train.train_learners, nodes, _gpus_here)
        if gpus is not None:
            code = train_elsewhere(ray, job, stop_signal, gpus)
    if code is not None:
        end_as(code)
        return
    _logger.info("The trainer runs here: the cluster has no GPU that this machine has not.")

    trainer.main(job, stop_signal)


def train_elsewhere(ray: Any, job: Job, stop_signal: StopSignal, gpus: int) -> int:
    cores = job.config.train.threads or job.config.train.train_learners

    def asked(cores: int) -> PlacedActor[HostReport]:
        return PlacedActor(ray, place(ray, job, gpus, cores))

    placed = PlacedTrainer(asked(0 if gpus else cores), job, stop_signal)
    if STACKS_SIGNAL is not None:
        signal.signal(STACKS_SIGNAL, placed.ask_stacks)
    try:
        code = wait_for_node(placed, job, stop_signal, gpus, lambda: asked(0))
        while code is None:
            time.sleep(POLL_S)
            code = placed.look()
        return code
    finally:
        placed.give_back()


def _gpus_here() -> int:
    return compute.gpu_count()


def wait_for_node(
    placed: PlacedTrainer,
    job: Job,
    stop_signal: StopSignal,
    gpus: int,
    without_cores: Callable[[], PlacedActor[HostReport]],
) -> int | None:
    """Without free cores for some time, it gets a place `without_cores` of its own."""
    bucket = worker_process.open_own_bucket(job, stop_signal)
    activity = Activity(ModelStore(bucket, job.config.model.prefix), TRAINER, stop_signal.heartbeat)
    what = f"{gpus} free GPU{'s' * (gpus != 1)}" if gpus else "free cores"
    shares_at_s = math.inf if gpus else time.monotonic() + OWN_CORES_S
    try:
        while (code := placed.look()) is None and not placed.node:
            activity.wait(f"waits for a node with {what}")
            if time.monotonic() >= shares_at_s:
                shares_at_s = math.inf
                _logger.info("No node has free cores; the trainer shares those of a worker.")
                placed.move(without_cores())
            time.sleep(POLL_S)
        return code
    finally:
        activity.close()


def place(ray: Any, job: Job, gpus: int, cores: int) -> Any:
    """With a GPU it asks for no cores: workers could keep it from there for good."""
    train = with_known_overlap(job.config.train)
    if not gpus:
        train = train.replaced(threads=train.threads or train.train_learners)
    public = job.without_addresses()
    sent = replace(public, config=replace(public.config, train=train), began_s=0.0)
    data = plain_json(sent)
    options = ray.remote(TrainerHost).options(num_cpus=cores, num_gpus=gpus, max_restarts=0)
    return options.remote(data, versions(), keys_for_nodes(*FIGURE_KEYS))


def end_as(code: int) -> None:
    if code < 0:
        with suppress(OSError):  # SIGKILL has no handler
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    if code:
        raise SystemExit(code)


if __name__ == "__main__":
    worker_process.run(TRAINER, main)
