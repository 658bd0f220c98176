"""Starts and stops a training that was planned: its processes, from launch to end."""

import os
import signal
import time
from dataclasses import replace
from typing import TYPE_CHECKING

from drcli.base.errors import WorkerDied
from drcli.base.process_identity import is_alive, started_s
from drcli.config.run_config import RunConfig
from drcli.exchange.run_record import RunRecord, StorageRecord, run_folder
from drcli.runs.launching import end_process, start_process
from drcli.runs.report import RunReport
from drcli.runs.run_logs import log_file
from drcli.runs.status import inspect

if TYPE_CHECKING:  # what a start needs is loaded by a start: a stop shall be quick
    from drcli.exchange.job import Job
    from drcli.runs.plan import RunPlan
    from drcli.store.s3_bucket import S3Bucket

PATIENCE_S = 5.0
"""How long a supervisor waits for a bucket that does not answer, before it restarts the server."""

READ_TIMEOUT_S = 5.0
"""How long it lets an answer stall."""

READY_TIMEOUT_S = 20.0

LOG_PATIENCE_S = 5.0
"""How long the upload of logs waits for a bucket that does not answer; it tries again later."""

LEAVE_S = 15.0
"""How long a supervisor that was not ready in time may take to exit: it may have started workers,
and gives those ten seconds."""


def launch(plan: "RunPlan") -> int:
    """Start the supervisor as a process that outlives this one.

    Returns:
        Its process number.

    Raises:
        SettingsError: Another start was faster.
        WorkerDied: It exited at once, or was not ready in time.
    """
    from drcli.runs.plan import refuse_second_run

    process = start_process(plan.job, "supervisor", "drcli.runs.supervisor_process")
    deadline = time.monotonic() + READY_TIMEOUT_S
    while process.poll() is None and time.monotonic() < deadline:
        if _is_ready(plan.job):
            return process.pid
        time.sleep(0.05)
    if process.poll() is not None and _is_ready(plan.job):  # it was, and has ended since
        return process.pid
    end_process(process, LEAVE_S)  # or it would start to train later
    refuse_second_run(plan.job.config.run_id, plan.job.folder)
    path = log_file(plan.job.directory, plan.job.config.model.prefix, "supervisor")
    raise WorkerDied(
        "The supervisor of the training did not start.", remedy=f"Read the reason in {path}."
    )


def supervise_job(job: "Job") -> int:
    """What the supervising process does, in the foreground or detached.

    Returns:
        The exit code of the command.

    Raises:
        SettingsError: Another start has taken the run number or the prefix meanwhile.
    """
    from drcli.base.atomic_file import only_writer
    from drcli.runs.lease_renewal import Renewal
    from drcli.runs.plan import refuse_second_run
    from drcli.runs.supervisor import Supervisor
    from drcli.store import lease
    from drcli.store.connect import open_bucket
    from drcli.store.ownership import Ownership
    from drcli.store.server import server

    job = replace(job, launcher_pid=os.getpid())
    storage, prefix = job.config.storage, job.config.model.prefix

    def impatient(patience_s: float) -> "S3Bucket":
        return open_bucket(storage, patience_s=patience_s, read_timeout_s=READ_TIMEOUT_S)

    def own(client: "S3Bucket") -> "S3Bucket":
        return client.fenced(Ownership(client, prefix, job.session, taken.term).check)

    bucket = impatient(PATIENCE_S)
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
    )
    with only_writer(job.directory):  # of two starts in the same moment one trains
        refuse_second_run(job.config.run_id, job.folder)
        lease.refuse_other_owner(bucket, prefix, job.session)
        taken = lease.take(bucket, prefix, job.session)
        record.write(job.folder)
    return Supervisor(
        replace(job, term=taken.term),
        own(bucket),
        record,
        Renewal(impatient(0.0), prefix, taken),
        open_bucket=lambda: own(open_bucket(storage, patience_s=LOG_PATIENCE_S)),
        revive_server=lambda: server.ensure_running(storage),
        restart_server=lambda: server.restart(storage),
    ).run()


def stop(config: RunConfig, *, wait_s: float = 30.0) -> RunReport:
    """Ask the supervisor to end the training, and wait until it has.

    A second request meanwhile kills the workers at once.
    """
    record = RunRecord.read(run_folder(config.directory, config.run_id))
    if record is not None and record.alive:
        os.kill(record.pid, signal.SIGTERM)
        deadline = time.monotonic() + wait_s
        while is_alive(record.pid, record.pid_started) and time.monotonic() < deadline:
            time.sleep(0.05)
    return inspect(config)


def is_running(config: RunConfig) -> bool:
    """Whether a training of this run number is alive on this machine."""
    record = RunRecord.read(run_folder(config.directory, config.run_id))
    return record is not None and record.alive


def _is_ready(job: "Job") -> bool:
    """Whether the supervisor of a job has written its run record."""
    record = RunRecord.read(job.folder)
    return record is not None and record.session == job.session
