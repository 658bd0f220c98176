"""Drives for a training on another machine; if that is gone, trains here."""

import os
import re
import secrets
import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from types import FrameType
from typing import Annotated

from drcli.base.errors import OwnershipLost, SettingsError
from drcli.base.json_record import RecordError, from_json
from drcli.base.processes import handle, restore, started_s
from drcli.bucket.bucket import (
    Bucket,
    ObjectDamaged,
    find_record,
    readable_record,
)
from drcli.bucket.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.checks.start_rules import refuse_second_run
from drcli.config.run_config import DriveConfig
from drcli.config.settings import Settings
from drcli.model import keys
from drcli.model.lease import STALE_S, ModelInUse, read_lease
from drcli.model.model_store import ModelStore
from drcli.model.training_state import read_outcome, write_outcome
from drcli.records.heartbeat import HeartbeatRecord
from drcli.records.job import Job, JoinRecord, WorkerExit
from drcli.records.run_record import TrainingEnd, WaitingStart, log_file, run_folder
from drcli.records.training_record import RunOutcome
from drcli.rewards.source import exit_of_stuck
from drcli.run import training
from drcli.run.join_check import refuse_other_machine
from drcli.run.outcome import CTRL_C, INTERRUPTED, TERMINATED
from drcli.run.run_ending import died_too_often
from drcli.run.run_logs import LogUpload, begin_logs
from drcli.run.take_model import taken
from drcli.run.worker_processes import Child, end_process, start_process

POLL_S = 0.2
POLL_S = 2.0
EXIT_S = 15.0
LOGS_S = 10.0
OUTAGE_S = 900.0


@dataclass(frozen=True)
class JoinReport:
    """How it ended."""

    model: Annotated[str, "As s3://bucket/prefix."]
    message: Annotated[str, "Why this machine drives no longer."]
    code: Annotated[int, "Exit code."]
    took_over: Annotated[bool, "Whether it went on with the training itself."] = False


@dataclass(frozen=True)
class _Ended:
    message: str
    code: int = 0


def join_training(
    settings: Settings,
    prefix: str,
    *,
    waits: bool,
    takes_over: bool,
    say: Callable[[str], object],
    ends_with: int | None = None,
) -> JoinReport:
    machine = JoinedMachine(
        settings, prefix, waits=waits, takes_over=takes_over, say=say, ends_with=ends_with
    )
    return machine.run()


class JoinedMachine:
    """This machine, for one training.

    Args:
        settings: Of this machine.
        prefix: Of the model.
        waits: Wait for a training that has not started yet.
        takes_over: Go on with the training if its machine is gone.
        say: Shows a sentence.
        ends_with: Process whose end ends this one.
    """

    def __init__(
        self,
        settings: Settings,
        prefix: str,
        *,
        waits: bool,
        takes_over: bool,
        say: Callable[[str], object],
        ends_with: int | None = None,
    ) -> None:
        self._ends_with = ends_with
        self._settings = settings
        self._prefix = prefix
        self._waits = waits
        self._takes_over = takes_over
        self._say = say
        self._signal: int | None = None
        self._took_over = self._joined = False
        host = re.sub(r"[^A-Za-z0-9-]+", "-", socket.gethostname())[:40].strip("-") or "machine"
        self._member = f"joined-{host}-{secrets.token_hex(3)}"
        storage = settings.storage
        # A wrong address is said soon; once the bucket has answered, an outage is waited for.
        read_lease(ModelStore(open_bucket(storage, patience_s=COMMAND_PATIENCE_S), prefix))
        patience_s = 60.0 if storage.cloud == "local" else OUTAGE_S
        self._bucket: Bucket = open_bucket(storage, patience_s=patience_s, hurried=self._is_stopped)
        self._store = ModelStore(self._bucket, self._prefix)
        self._model = f"s3://{self._bucket.name}/{prefix}"

    def run(self) -> JoinReport:
        """Drive until the training ends or somebody stops this machine.

        Raises:
            SettingsError: There is no such training, or this machine may not join it.
            WorkerDied: The worker dies again and again.
        """
        with self._noting_signals():
            while True:
                found = self._find()
                if found is None:
                    return self._report("Waited for a training until now.", self._signal_code())
                if isinstance(found, _Ended):
                    return self._report(found.message, found.code)
                record, gone = found
                job = self._own_job(record)
                refuse_other_machine(record, job)
                ended = self._go_on_with(job) if gone else self._drive(job)
                if ended is not None:
                    return self._report(ended.message, ended.code)
                if self._is_stopped():
                    break
        return self._report(
            f"This machine has left the training of {self._model}, which goes on.",
            self._signal_code(),
        )

    def _signal_code(self) -> int:
        return CTRL_C if self._signal == signal.SIGINT else TERMINATED

    def _report(self, message: str, code: int) -> JoinReport:
        return JoinReport(self._model, message, code, self._took_over)

    def _is_stopped(self) -> bool:
        if self._ends_with not in (None, os.getppid()):
            self._signal = signal.SIGTERM
        return self._signal is not None

    @contextmanager
    def _noting_signals(self) -> Iterator[None]:
        def note(number: int, _frame: FrameType | None) -> None:
            self._signal = number

        before = handle(note)
        try:
            yield
        finally:
            restore(before)

    def _find(self) -> tuple[JoinRecord, bool] | _Ended | None:
        """Without its machine, a training counts only if this one has joined or waits."""
        said = ""
        while not self._is_stopped():
            lease, record = read_lease(self._store), self._join_record()
            if lease is not None and lease.newer:
                raise SettingsError(
                    f"{self._model} is trained by a newer version of drcli.",
                    remedy="Install the same version on this machine.",
                )
            lives = lease is not None and not lease.released and lease.age_s < STALE_S
            may_wait = self._joined or self._waits
            outcome = None if lease is None or lives else read_outcome(self._store)
            if lease is None:
                sentence = f"No training of {self._model} has begun yet"
            elif lives and self._is_complete(lease.session):
                sentence = f"The training of {self._model} is complete, and saves its results"
            elif lives:
                if record is not None and record.session == lease.session:
                    return record, False
                sentence = f"The training of {self._model} is starting"
            elif outcome is not None and _is_over(outcome):
                if self._joined or not self._waits:
                    return _Ended(f"The training of {self._model} has ended: {outcome.message}")
                sentence = f"The training of {self._model} has ended"
            elif self._takes_over and record is not None and may_wait:
                return record, True
            else:
                sentence = f"The machine of the training of {self._model} is gone"
            if not lives and not may_wait:
                raise SettingsError(
                    f"{self._model} is not being trained.",
                    remedy="Start it on the other machine with `dr-start-training`, check bucket "
                    "and prefix, or give --wait.",
                )
            if sentence != said:
                self._say(f"{sentence}; waiting.")
                said = sentence
            time.sleep(POLL_S)
        return None

    def _is_complete(self, session: str) -> bool:
        end = readable_record(self._bucket, keys.finished(self._prefix), TrainingEnd.decode)
        return end is not None and end.session == session

    def _join_record(self) -> JoinRecord | None:
        with suppress(ObjectDamaged):
            return find_record(self._bucket, keys.join_record(self._prefix), JoinRecord.decode)
        return None

    def _own_job(self, record: JoinRecord) -> Job:
        try:
            job = from_json(Job, dict(record.job))
        except RecordError as error:
            raise SettingsError(
                f"{self._model}: what the training tells its workers cannot be read: {error}.",
                remedy="Install the same version of drcli on both machines.",
            ) from error
        own, theirs = self._settings.run, job.config

        def here(race: DriveConfig) -> DriveConfig:
            return race.replaced(
                directory=self._settings.directory, tracks_dir=own.race().tracks_dir
            )

        config = replace(
            theirs,
            run_id=own.run_id,
            directory=self._settings.directory,
            storage=self._settings.storage,
            logs=own.logs,
            live_view=own.live_view,
            races=tuple(map(here, theirs.races)),
            train=theirs.train.replaced(threads=own.train.threads, priority=own.train.priority),
        )
        stages = tuple(replace(stage, races=tuple(map(here, stage.races))) for stage in job.stages)
        return replace(
            job,
            config=config,
            stages=stages,
            folder=run_folder(self._settings.directory, own.run_id) / self._member,
            launcher_pid=os.getpid(),
        )

    def _drive(self, job: Job) -> _Ended | None:
        job.folder.mkdir(parents=True, exist_ok=True)
        logs = LogUpload(
            lambda: open_bucket(job.config.storage, patience_s=LOGS_S),
            job.directory,
            self._prefix,
            job.config.logs,
            [self._member],
        )
        child = Child(self._member, "drcli.train.joined_sim", [self._member])
        self._say(f"Joining the training of {self._model} as {self._member}.")
        self._joined = True
        logs.start()
        shown = WaitingStart(
            os.getpid(),
            started_s(os.getpid()) or 0.0,
            self._bucket.name,
            self._prefix,
            "worker",
        )
        try:
            with shown.shown(run_folder(job.directory, job.config.run_id)):
                return self._watch(job, child)
        finally:
            if child.process is not None and child.running:
                end_process(child.process, EXIT_S)
            logs.finish(LOGS_S, self._is_stopped)

    def _watch(self, job: Job, child: Child) -> _Ended | None:
        said = ""
        while True:
            WorkerExit.delete(job.folder, child.name)
            child.process = start_process(job, child.name, child.module, *child.arguments)
            child.started = time.monotonic()
            while child.running:
                if self._is_stopped():
                    return None
                said = self._show_activity(job, child.name, said)
                time.sleep(POLL_S)
            code = child.process.returncode
            if code == 0 or self._is_stopped():
                return None
            words = WorkerExit.read(job.folder, child.name) or exit_of_stuck(
                code, log_file(job.directory, self._prefix, child.name)
            )
            if words is not None and words.code == OwnershipLost.code:
                return None
            if words is not None and words.final:
                return _Ended(f"{words.message} {words.remedy}".strip(), words.code)
            lived_s = time.monotonic() - child.started
            if (outcome := died_too_often(child, code, lived_s, words)) is not None:
                return _Ended(f"{outcome.message} {outcome.remedy}".strip(), outcome.code)
            child.restarts += 1
            self._say(f"The worker ended with code {code} and is started again.")

    def _show_activity(self, job: Job, name: str, said: str) -> str:
        heartbeat = HeartbeatRecord.read(job.folder, name)
        if heartbeat is None:
            return said
        kind = re.sub(r"\d+", "N", heartbeat.activity)
        if kind in said.split("|"):
            return said
        self._say(f"{self._member} {heartbeat.activity}.")
        return f"{said}|{kind}"

    def _go_on_with(self, job: Job) -> _Ended | None:
        """None if another machine was faster."""
        self._say(
            f"The machine of the training of {self._model} is gone; this machine goes on with it."
        )
        own = self._settings.run
        job = replace(
            job,
            config=replace(job.config, train=job.config.train.replaced(workers=1)),
            ray_workers=0,  # this machine may not know the cluster
            ray_trainer=False,
            ends_with=0,  # a process of the machine before
            session=secrets.token_hex(6),
            term=0,
            folder=run_folder(self._settings.directory, own.run_id),
            noted=(),
        )
        refuse_second_run(own.run_id, job.folder)
        previous = read_outcome(self._store)
        now = time.time()
        begun = RunOutcome(
            job.session,
            socket.gethostname(),
            now if previous is None else previous.began_at,
            now,
            goals="" if previous is None else previous.goals,
        )
        try:
            with taken(job, self._store, lambda: None):
                write_outcome(self._store, begun)
                begin_logs(job.directory, self._prefix, job.config.logs.log_max_mb)
            self._took_over = True
            code = training.supervise_job(replace(job, begun=begun, launcher_pid=os.getpid()))
        except ModelInUse as error:  # another machine was faster
            self._took_over = False
            self._say(f"{error}")
            time.sleep(POLL_S)
            return None
        if code == OwnershipLost.code:
            self._took_over = False
            return None
        outcome = read_outcome(self._store)
        message = "" if outcome is None else outcome.message
        return _Ended(f"The training has ended: {message}", code)


def _is_over(outcome: RunOutcome) -> bool:
    return outcome.ended and (outcome.stays_ended or outcome.code != INTERRUPTED)
