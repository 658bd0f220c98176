"""Launches the supervisor of a planned training, which is this module."""

import os
import time
from dataclasses import replace
from typing import TYPE_CHECKING

from drcli.base import errors
from drcli.base.clock import wait_until
from drcli.base.errors import DrError
from drcli.base.files import only_writer
from drcli.base.log import JsonLog, LogFile, get_logger
from drcli.base.processes import lower_priority, started_s
from drcli.bucket.connect import open_bucket
from drcli.bucket.request_count import CountFile
from drcli.bucket.s3_bucket import S3Bucket
from drcli.bucket.server import server
from drcli.checks.start_rules import refuse_second_run
from drcli.model import lease
from drcli.model.lease import Ownership
from drcli.model.model_store import ModelStore
from drcli.records.job import Job
from drcli.records.run_record import RunRecord, StorageRecord, json_log, log_file
from drcli.run.checkpoint_watch import CheckpointWatch
from drcli.run.cost import Cost, DailyBudget
from drcli.run.disk_watch import DiskWatch
from drcli.run.duty import Duty, RunningTraining
from drcli.run.end_of_training import EndCommand, EndOfTraining
from drcli.run.heartbeat_monitor import HeartbeatMonitor
from drcli.run.interruption_watch import InterruptionWatch, Renewal
from drcli.run.join_check import JoinOffer
from drcli.run.log_sender import CloudWatchLogs
from drcli.run.memory_watch import MemoryWatch, OpenFilesWatch
from drcli.run.record_keeping import RecordKeeping
from drcli.run.run_messages import Messages
from drcli.run.stall_watch import FrozenWatch, StallWatch
from drcli.run.supervisor import Supervisor
from drcli.run.timed_uploads import TimedUploads
from drcli.run.watches import FailureWatch, ParentWatch, StageWatch
from drcli.run.worker_processes import (
    READY_TIMEOUT_S,
    end_process,
    failed_start,
    log_bytes,
    start_process,
)

if TYPE_CHECKING:
    from drcli.run.plan import EndWorkPlan, RunPlan

PATIENCE_S = 5.0
"""A supervisor restarts the bucket's server itself."""

READ_TIMEOUT_S = 5.0
LEASE_PATIENCE_S = 1.0
LOG_PATIENCE_S = 5.0
EXIT_S = 15.0
"""A late supervisor may already have workers, which get ten seconds."""


def launch(plan: "RunPlan | EndWorkPlan") -> int:
    """A supervisor that outlives this process.

    Raises:
        SettingsError: Another start was faster.
        WorkerDied: It exited at once or was not ready in time.
    """
    job = plan.job
    path = log_file(job.directory, job.config.model.prefix, "supervisor")
    earlier_bytes = log_bytes(path)
    process = start_process(job, "supervisor", "drcli.run.training")
    wait_until(
        lambda: _is_ready(job) or process.poll() is not None,
        patience_s=READY_TIMEOUT_S,
        last_s=0.05,
    )
    if _is_ready(job):
        return process.pid
    code = process.poll()
    end_process(process, EXIT_S)  # or it could train later, and nobody would know
    refuse_second_run(job.config.run_id, job.folder)
    raise failed_start("The supervisor of the training", code, path, earlier_bytes)


def supervise_job(job: Job) -> int:
    """Supervise until the end; returns the exit code.

    Raises:
        SettingsError: Another start has just taken the DR_RUN_ID or the model.
    """
    path = log_file(job.directory, job.config.model.prefix, "supervisor")
    max_bytes = job.config.logs.log_max_mb << 20
    log = LogFile(path, max_bytes)
    lines = JsonLog(json_log(path), max_bytes, "supervisor") if job.config.logs.log_json else None
    if job.config.train.priority == "low":
        get_logger(__name__).info("DR_PRIORITY=low: %s.", lower_priority())
    if job.config.train.threads:
        get_logger(__name__).info("DR_THREADS=%d limits the cores.", job.config.train.threads)
    try:
        return _supervise(job)
    except DrError as error:
        get_logger(__name__).error("%s %s", error, error.remedy)
        raise
    finally:
        log.end()
        if lines is not None:
            lines.end()


def _supervise(job: Job) -> int:
    job = replace(job, launcher_pid=os.getpid(), began_s=time.monotonic())
    storage, prefix = job.config.storage, job.config.model.prefix

    def impatient(patience_s: float) -> S3Bucket:
        return open_bucket(storage, patience_s=patience_s, read_timeout_s=READ_TIMEOUT_S)

    def own(client: S3Bucket) -> S3Bucket:
        return client.fenced(Ownership(ModelStore(client, prefix), job.session, taken.term).check)

    bucket = impatient(PATIENCE_S)
    model = ModelStore(bucket, prefix)
    record = RunRecord(
        run_id=job.config.run_id,
        session=job.session,
        bucket=bucket.name,
        prefix=prefix,
        world=job.config.race().world_name,
        state="starting",
        pid=os.getpid(),
        pid_started=started_s(os.getpid()) or 0.0,
        started_at=time.time(),
        storage=StorageRecord.of(storage, job.directory),
        priority=job.config.train.priority,
        threads=job.config.train.threads,
    )
    with only_writer(job.directory):  # of two starts at the same time, one trains
        refuse_second_run(job.config.run_id, job.folder)
        lease.refuse_other_owner(model, job.session)
        taken = lease.take(model, job.session)
        record.write(job.folder)
    requests = CountFile(job.folder, "supervisor", job.session)
    requests.start()
    try:
        return Supervisor(
            replace(job, term=taken.term),
            own(bucket),
            record,
            Renewal(ModelStore(impatient(LEASE_PATIENCE_S), prefix), taken),
            open_bucket=lambda: own(open_bucket(storage, patience_s=LOG_PATIENCE_S)),
            revive_server=lambda: server.ensure_running(storage),
            restart_server=lambda: server.restart(storage),
            duties=duties,
        ).run()
    finally:
        requests.end()


def duties(run: RunningTraining) -> list[Duty]:
    """In the order in which it matters at the end."""
    checkpoints, cost = CheckpointWatch(run), Cost(run)
    heartbeats = HeartbeatMonitor(run.job.folder)
    return [
        InterruptionWatch(run),
        ParentWatch(run),
        JoinOffer(run),
        FrozenWatch(run, heartbeats),  # it looks at the heartbeats for the next ones
        StallWatch(run, heartbeats),
        OpenFilesWatch(run, heartbeats),
        MemoryWatch(run),
        DiskWatch(run),
        FailureWatch(run),
        StageWatch(run),
        checkpoints,
        TimedUploads(run, checkpoints),
        EndOfTraining(run),
        cost,
        RecordKeeping(run, cost),
        DailyBudget(run, cost),
        Messages(run, checkpoints, cost.end_facts),
        EndCommand(run, checkpoints, cost.end_facts),
        CloudWatchLogs(run),
    ]


def _is_ready(job: Job) -> bool:
    record = RunRecord.read(job.folder)
    return record is not None and record.session == job.session


if __name__ == "__main__":  # run as the supervisor process
    logger = get_logger(__name__)
    errors.show, errors.warn = logger.info, logger.warning
    try:
        raise SystemExit(supervise_job(Job.received_or_exit()))
    except DrError as error:  # it is in the log, and the command shows it
        raise SystemExit(error.code) from None
