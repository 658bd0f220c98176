"""Runs the trainings of a sweep with Ray Tune, each on a node of the cluster.

Tune places trainings, restarts them when a node is gone, and ends or copies them. The sweep's
record in the bucket is the truth: it is written from Tune's reports, and given to Tune at
another start. Imported only where Ray is installed.
"""

import logging
import os
import signal
import socket
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import psutil
from ray import tune
from ray.tune import Callback, Stopper
from ray.tune.experiment import Trial
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from drcli.base.errors import BudgetUsedUp, DrError, WorkerDied
from drcli.base.installation import lazy_imports
from drcli.base.processes import NotedSignals
from drcli.bucket.bucket import Bucket, ObjectDamaged
from drcli.bucket.endpoint import DEFAULT, session_of
from drcli.bucket.server import server
from drcli.config import secret_environment
from drcli.config.activation import PLACES, chosen
from drcli.config.run_config import StorageConfig
from drcli.run.outcome import CTRL_C, TERMINATED
from drcli.sweeps import sweep_record
from drcli.sweeps.node_trial import END_S, TrialTask, files_for_nodes
from drcli.sweeps.sweep_file import Choices, Span, SweepFile
from drcli.sweeps.sweep_record import OVER, SweepRecord, TrialRecord, TrialState
from drcli.sweeps.sweep_report import SweepProgress, text_of
from drcli.sweeps.trial_run import Limits, TrialRun
from drcli.sweeps.trial_score import amount_of, comparable, levels_of, score_of
from drcli.sweeps.tune_schedulers import METRIC, Halving, StopFlag, TuneTrial, Unsaved, scheduler_of
from drcli.train.ray_cluster import connect, keys_for_nodes

with lazy_imports():
    from pyarrow import fs as arrow_fs

# The bucket as an Apache Arrow file system, for Ray Tune.


def arrow_files(storage: StorageConfig) -> Any:
    """The file system; paths begin with the bucket's name.

    Other machines get keys from the environment or a profile; without these, Arrow finds their own,
    as those of a role.

    Raises:
        StorageError: The server does not answer, or the profile does not exist.
    """
    endpoint = server.ensure_running(storage)
    options: dict[str, Any] = {"region": endpoint.region}
    if endpoint.url is not None:
        scheme, _, place = endpoint.url.partition("://")
        options |= {"scheme": scheme, "endpoint_override": place}
    known = secret_environment.all_secrets()
    access, secret = endpoint.access_key, endpoint.secret_key
    token = None
    if access is None and "AWS_SECRET_ACCESS_KEY" in known:
        access = known.get("AWS_ACCESS_KEY_ID")
        secret, token = known["AWS_SECRET_ACCESS_KEY"], known.get("AWS_SESSION_TOKEN")
    elif access is None and endpoint.profile not in (None, DEFAULT):
        found = session_of(endpoint.profile, endpoint.names.profile).get_credentials()
        if found is not None:
            frozen = found.get_frozen_credentials()
            access, secret, token = frozen.access_key, frozen.secret_key, frozen.token
    if access is not None:
        options |= {"access_key": access, "secret_key": secret, "session_token": token}
    return arrow_fs.S3FileSystem(**options)


LOOK_S = 1.0
MOST_FAILURES = 20
"""Vanished nodes of a training."""

CORES = 2
"""One drives, one learns."""


@dataclass(frozen=True)
class Place:
    """What a training gets on its node; 0 `parallel` is as many as fit."""

    cpus: int
    gpus: float
    parallel: int


class TuneSweep:
    """A sweep on a Ray cluster; no address means this machine."""

    def __init__(
        self,
        progress: SweepProgress,
        sweep: SweepFile,
        bucket: Bucket,
        storage: StorageConfig,
        directory: Path,
        *,
        address: str,
        threads: int,
        parallel: int | None,
        say: Callable[[str], None],
        signals: NotedSignals,
    ) -> None:
        self._progress = progress
        self._sweep = sweep
        self._plan = sweep.plan
        self._bucket = bucket
        self._storage = storage
        self._directory = directory
        self._address = address
        self._threads = threads
        self._parallel = parallel
        self._say = say
        self._signals = signals
        self._levels = levels_of(self._plan.budget, self._plan.early_stopping)
        self._over = threading.Event()

    def run(self) -> SweepRecord:
        """Train all, and mark the best.

        Raises:
            SettingsError: The cluster does not answer.
            StorageError: The bucket does not answer; nothing is lost.
            BudgetUsedUp: That of the day.
            WorkerDied: Ray has ended.
            Stopped: SIGTERM came, and all are interrupted; or KeyboardInterrupt.
        """
        if self._progress.record.ended_at is not None:
            return self._progress.record
        ray = connect(self._address, self._storage.cloud)
        servers = processes_of_ray()
        if servers:
            threading.Thread(target=self._outlive, args=(servers,), daemon=True).start()
        try:
            watch = self._train(ray)
        finally:
            self._over.set()
            self._end_all()
            ray.shutdown()
        if watch.error is not None:
            raise watch.error
        name = self._progress.record.name
        said = f"The sweep {name} was interrupted."
        self._signals.refuse(said, "Continue it with the same command.")
        left = [trial.name for trial in self._progress.record.trials if not trial.is_over]
        if left:
            raise WorkerDied(
                f"Ray Tune has ended before {left[0]} was over.",
                remedy="Continue the sweep with the same command.",
            )
        self._progress.end()
        return self._progress.record

    def _train(self, ray: Any) -> "Watch":
        nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
        place = place_for(nodes, self._threads, self._parallel)
        if not any(node.get("CPU", 0.0) >= place.cpus for node in nodes):
            self._say(f"No node has {place.cpus} cores now; the trainings wait for one.")
        here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
        flag = ray.remote(StopFlag).options(num_cpus=0, scheduling_strategy=here).remote()
        stopping, record = self._plan.early_stopping, self._progress.record
        population = stopping.method == "population"
        vary = varied_numbers(self._plan.vary.hyperparameters) if population else {}
        scheduler = scheduler_of(self._plan, self._levels, vary, record.checks, self._say)
        watch = Watch(
            self._progress,
            self._sweep,
            self._bucket,
            self._levels,
            scheduler,
            lambda trial: TrialRun(self._directory, trial, self._bucket),
            say=self._say,
            signals=self._signals,
            stop=lambda: flag.stop.remote(),
        )
        tasks = {trial.name: self._task(trial, place) for trial in record.trials}
        trainable = tune.with_parameters(TuneTrial, tasks=tasks, flag=flag)
        needed = {"cpu": place.cpus, **({"gpu": place.gpus} if place.gpus else {})}
        own = {trial.name: self._numbers(trial, vary) for trial in record.trials}
        os.environ |= {
            "TUNE_DISABLE_AUTO_CALLBACK_LOGGERS": "1",
            "TUNE_DISABLE_SIGINT_HANDLER": "1",
            "RAY_AIR_NEW_OUTPUT": "0",
        }
        with quiet_tune() as folder:
            tune.Tuner(
                tune.with_resources(trainable, needed),
                param_space={
                    "name": tune.grid_search(list(tasks)),
                    "copy": 0,
                    "hyperparameters": tune.sample_from(lambda config: own[config["name"]]),
                },
                tune_config=tune.TuneConfig(
                    scheduler=scheduler,
                    metric=METRIC if scheduler.metric is None else None,
                    mode="max" if scheduler.metric is None else None,
                    max_concurrent_trials=place.parallel or None,
                    trial_name_creator=lambda trial: trial.config["name"],
                    trial_dirname_creator=lambda trial: trial.config["name"],
                ),
                run_config=tune.RunConfig(
                    name=record.name,
                    verbose=0,
                    callbacks=[watch],
                    stop=watch.stopper,
                    failure_config=tune.FailureConfig(max_failures=MOST_FAILURES),
                    **storage_for_tune(self._storage, stopping.method, folder, record.name),
                ),
            ).fit()
            watch.update(watch.trials)
        left = self._bucket.list(sweep_record.of_tune(record.name))
        self._bucket.delete([item.key for item in left])
        return watch

    def _numbers(self, trial: TrialRecord, vary: Mapping[str, Choices]) -> dict[str, float]:
        own = {**self._progress.trials[trial.name].hyperparameters, **trial.hyperparameters}
        return {key: float(own[key]) for key in vary}

    def _outlive(self, servers: Sequence[psutil.Process]) -> None:
        """End this process once Ray here is gone: then the main thread waits for it.

        A job scheduler may send SIGTERM to all processes, and so to Ray's.
        """
        while all(is_alive(each) for each in servers) and not self._over.wait(LOOK_S):
            pass
        if self._over.is_set():
            return
        time.sleep(LOOK_S)  # for a signal that came at the same time
        self._end_all()
        name = self._progress.record.name
        if self._signals.first is None:
            self._say(f"Ray has ended, and with it the sweep {name}.")
        else:
            self._say(f"The sweep {name} was interrupted.")
        self._say("Continue it with the same command.")
        codes = {None: WorkerDied.code, signal.SIGINT: CTRL_C}
        sys.stderr.flush()
        os._exit(codes.get(self._signals.first, TERMINATED))

    def _task(self, trial: TrialRecord, place: Place) -> TrialTask:
        plan = self._plan
        population = plan.early_stopping.method == "population"
        reached = sum(level <= trial.amount for level in self._levels[:-1])
        environment, _ = secret_environment.split(chosen(os.environ))
        return TrialTask(
            trial=trial,
            budget=plan.budget,
            stopping=plan.early_stopping,
            levels=tuple(self._levels),
            # A population goes on; who is out otherwise follows from all checks.
            compared=reached if population else 0,
            metric=plan.metric,
            limits=Limits(goals=plan.goals, threads=place.cpus),
            directory=self._directory,
            host=socket.gethostname(),
            files=files_for_nodes(self._directory, trial.name),
            environment={
                key: value
                for key, value in environment.items()
                if key.startswith("DR_") and key not in PLACES
            },
            secrets=keys_for_nodes(),
        )

    def _end_all(self) -> None:
        ends_s = time.monotonic() + END_S
        for trial in self._progress.record.trials:
            run = TrialRun(self._directory, trial, self._bucket)
            if run.runs:
                run.interrupt()
            while run.runs and time.monotonic() < ends_s and self._signals.count < 2:
                time.sleep(LOOK_S)


class Watch(Unsaved, Callback):
    """Updates the sweep's record, and ends Tune when the sweep is interrupted."""

    def __init__(
        self,
        progress: SweepProgress,
        sweep: SweepFile,
        bucket: Bucket,
        levels: Sequence[float],
        scheduler: Any,
        open_run: Callable[[TrialRecord], TrialRun],
        *,
        say: Callable[[str], None],
        signals: NotedSignals,
        stop: Callable[[], object],
    ) -> None:
        self._progress = progress
        self._sweep = sweep
        self._bucket = bucket
        self._levels = levels
        self._scheduler = scheduler
        self._open_run = open_run
        self._say = say
        self._signals = signals
        self._stop = stop
        self._stopping_since: float | None = None
        self._looked_s = 0.0
        self._runs: dict[str, TrialRun] = {}
        self.trials: Sequence[Trial] = ()
        self.error: DrError | None = None
        self.stopper = WhenSaved(self._is_saved)

    def on_step_end(self, iteration: int, trials: list[Trial], **info: Any) -> None:
        self.trials = trials
        if (self._signals.count or self.error) and self._stopping_since is None:
            self._stopping_since = time.monotonic()
            self._stop()
        if time.monotonic() < self._looked_s + LOOK_S:
            return
        self._looked_s = time.monotonic()
        self.update(trials)

    def update(self, trials: Sequence[Trial]) -> None:
        try:
            for trial in trials:
                self._look_at(trial)
        except DrError as error:
            self.error = self.error or error

    def _is_saved(self) -> bool:
        if self._stopping_since is None:
            return False
        late = time.monotonic() > self._stopping_since + END_S
        return (
            late
            or self._signals.count > 1
            or not any(each.status == Trial.RUNNING for each in self.trials)
        )

    def _look_at(self, tuned: Trial) -> None:
        trial = self._progress.trial(str(tuned))
        if trial.is_over:
            return
        result = tuned.last_result or {}
        if result.get("name") != trial.name:  # Tune gives a copy the result of what it copies
            result = {}
        if result.get("code") == BudgetUsedUp.code:
            self.error = BudgetUsedUp(result["message"], remedy=result["remedy"])
            result = {**result, "state": "paused"}
        changed = dict(result.get("trial") or {})
        if changed and changed["prefix"] != trial.prefix:
            trial = self._copied(trial, changed)
        state = self._state_of(tuned, trial, result)
        self._measure(trial)
        if state == trial.state:
            return
        message, remedy = self._words(tuned, trial, state, result) if state in OVER else ("", "")
        self._progress.change(trial.name, state=state, message=message, remedy=remedy)
        begun = "goes on" if trial.amount > 0.0 else "begins"
        said = {
            "running": f"{trial.name} {begun}: {text_of(trial)}",
            "failed": f"{trial.name} has failed: {message}",
            "stopped early": f"{trial.name} is stopped early: {message}",
        }
        if state in said:
            self._say(said[state])
        elif message:
            self._say(f"{trial.name}: {message}")

    def _state_of(self, tuned: Trial, trial: TrialRecord, result: Mapping[str, Any]) -> TrialState:
        rests: TrialState = "paused" if trial.state != "waiting" else "waiting"
        if tuned.status == Trial.RUNNING:
            if result.get("done"):
                return trial.state  # Tune is about to note it
            # Its actor may have to be started first.
            return "running" if result.get("state") == "running" else rests
        if tuned.status in (Trial.PENDING, Trial.PAUSED):
            return rests
        if tuned.status == Trial.ERROR:
            return "failed"
        found: TrialState = result.get("state", "paused")
        if found == "running":
            return "paused" if self._stopping_since is not None else "stopped early"
        return rests if found == "paused" else found

    def _words(
        self, tuned: Trial, trial: TrialRecord, state: TrialState, result: Mapping[str, Any]
    ) -> tuple[str, str]:
        if tuned.status == Trial.ERROR:
            words = "its node was lost again and again"
            with suppress(OSError, IndexError, TypeError):  # without a file, or without a line
                words = Path(tuned.error_file).read_text().strip().splitlines()[-1]
            return f"Ray could not run it: {words}", "Read `dr-logs` of its experiment."
        if state == "stopped early":
            if isinstance(self._scheduler, Halving):
                return self._scheduler.places.get(trial.name, ""), ""
            reached = int(result.get("checks", 0))
            level = self._levels[max(0, reached - 1)]
            at = comparable(self._progress.record.resource, level)
            return f"ASHA ended it at the check at {at}.", ""
        return str(result.get("message") or ""), str(result.get("remedy") or "")

    def _copied(self, trial: TrialRecord, changed: Mapping[str, Any]) -> TrialRecord:
        copy = replace(trial, **changed, score=None)
        # First the experiment: the record says which model is trained with it.
        self._progress.write_experiment(copy)
        self._progress.replace(copy)
        self._progress.note_check(self._progress.record.checks + 1)
        self._runs.pop(trial.name, None)
        values = ", ".join(f"{key}={value:g}" for key, value in copy.hyperparameters.items())
        said = f"{trial.name} goes on with the weights of {copy.source}"
        self._say(f"{said} and {values}." if values else f"{said}.")
        return copy

    def _measure(self, trial: TrialRecord) -> None:
        if trial.name not in self._runs:
            self._runs[trial.name] = self._open_run(trial)
        try:
            records = self._runs[trial.name].iterations()
        except ObjectDamaged as error:
            self._say(f"{trial.name}: {error}")
            return
        plan = self._sweep.plan
        amount = trial.earlier + amount_of(records, plan.budget.resource)
        score = score_of(records, plan.metric)
        if (amount, score) != (trial.amount, trial.score):
            self._progress.change(trial.name, amount=amount, score=score)


class WhenSaved(Unsaved, Stopper):
    def __init__(self, condition: Callable[[], bool]) -> None:
        self._condition = condition

    def __call__(self, trial_id: str, result: dict[str, Any]) -> bool:
        return False

    def stop_all(self) -> bool:
        return self._condition()


def varied_numbers(vary: Mapping[str, Choices]) -> dict[str, Choices]:
    return {
        key: choices
        for key, choices in vary.items()
        if isinstance(choices, Span) or not any(isinstance(each, str) for each in choices)
    }


def place_for(nodes: Sequence[Mapping[str, float]], threads: int, parallel: int | None) -> Place:
    """An autoscaler may add other nodes than these."""
    cores = sum(int(node.get("CPU", 0.0)) for node in nodes) or CORES
    largest = max((int(node.get("CPU", 0.0)) for node in nodes), default=0) or CORES
    share = max(1, cores // parallel) if parallel else cores
    cpus = threads or min(CORES, share, largest)
    gpus = sum(node.get("GPU", 0.0) for node in nodes)
    slots = parallel or max(1, cores // cpus)
    return Place(cpus, min(1.0, gpus / slots) if gpus else 0.0, parallel or 0)


@contextmanager
def quiet_tune() -> Iterator[str]:
    """Suppress needless warnings; gives Tune a folder."""
    logging.getLogger("ray").setLevel(logging.ERROR)
    with (
        warnings.catch_warnings(),
        tempfile.TemporaryDirectory(prefix="drcli-sweep-", ignore_cleanup_errors=True) as folder,
    ):
        warnings.filterwarnings("ignore", module="ray")
        yield folder


def processes_of_ray() -> list[psutil.Process]:
    """Those that this process started."""
    return [
        child for child in psutil.Process().children() if child.name() in ("raylet", "gcs_server")
    ]


def is_alive(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def storage_for_tune(storage: StorageConfig, method: str, folder: str, name: str) -> dict[str, Any]:
    """The bucket for a population, whose copies find their models there; else the folder."""
    if storage.cloud == "local" or method != "population":
        return {"storage_path": folder}
    return {
        "storage_path": f"{storage.bucket}/{sweep_record.of_tune(name)}".rstrip("/"),
        "storage_filesystem": arrow_files(storage),
    }
