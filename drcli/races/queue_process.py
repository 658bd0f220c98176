"""Drives a queue in the background: `python -m drcli.races.queue_process`."""

import json
import os
import signal
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from drcli.base.clock import wait_until
from drcli.base.errors import Absent, DrError, SettingsError
from drcli.base.log import LogFile, get_logger
from drcli.base.processes import is_alive, this_machine
from drcli.bucket.bucket import Bucket
from drcli.bucket.connect import open_bucket
from drcli.config import secret_environment
from drcli.config.loading import load_settings
from drcli.config.settings import Settings
from drcli.races.queue_lease import live_lease, read_queue_lease
from drcli.races.race_queue import check_queue, run_queue
from drcli.run.worker_processes import READY_TIMEOUT_S, failed_start, log_bytes
from drcli.view.video.encode import require_encoder

STOPPED_S = 10.0


@dataclass(frozen=True)
class QueueStarted:
    """A queue that is driven in the background."""

    race: Annotated[str, "Id of the race."]
    pid: Annotated[int, "The process."]
    log: Annotated[str, "On this machine."]

    def __str__(self) -> str:
        return f"Driving the queue of {self.race} (process {self.pid}). Log: {self.log}"


@dataclass(frozen=True)
class QueueStopped:
    """A queue that was stopped."""

    race: Annotated[str, "Id of the race."]
    pid: Annotated[int, "The process."]

    def __str__(self) -> str:
        return f"Stopped the queue of {self.race} (process {self.pid}). What was driven is kept."


def queue_log(settings: Settings, race: str) -> Path:
    return settings.directory / "data" / "logs" / "races" / f"{race}.log"


def launch_queue(
    settings: Settings, bucket: Bucket, race: str, *, video: bool | None = None
) -> QueueStarted:
    """Drive the queue in a process that outlives this one.

    Raises:
        SettingsError: As for `run_queue`.
        WorkerDied: It did not begin.
    """
    check_queue(settings, bucket, race)
    if video:
        require_encoder()
    log = queue_log(settings, race)
    log.parent.mkdir(parents=True, exist_ok=True)
    earlier_bytes = log_bytes(log)
    plain, _ = secret_environment.split(os.environ)
    secrets = secret_environment.all_secrets()
    if secrets:
        secret_environment.hide_process()
    call = {"race": race, "folder": str(settings.directory), "video": video, "secrets": secrets}
    with log.open("ab") as file:
        process = subprocess.Popen(
            # -P: a file of the working folder must not replace a module of the same name.
            [sys.executable, "-P", "-m", "drcli.races.queue_process"],
            stdin=subprocess.PIPE,
            stdout=file,
            stderr=file,
            cwd=settings.directory,
            env=plain,
            start_new_session=True,
        )
    assert process.stdin is not None
    with suppress(BrokenPipeError), process.stdin as pipe:
        pipe.write(json.dumps(call).encode())
    process.stdin = None
    code: int | None = None

    def is_decided() -> bool:
        nonlocal code
        code = process.poll()
        lease = read_queue_lease(bucket, race)
        return code is not None or (lease is not None and lease.pid == process.pid)

    if not wait_until(is_decided, patience_s=READY_TIMEOUT_S, last_s=0.2) or code:
        if code is None:
            process.kill()
            process.wait()
        raise failed_start(f"The queue of race {race}", code, log, earlier_bytes)
    return QueueStarted(race, process.pid, str(log))


def stop_queue(bucket: Bucket, race: str) -> QueueStopped:
    """What was being driven waits again.

    Raises:
        Absent: No process drives it.
        SettingsError: It runs elsewhere, or does not end.
    """
    lease = live_lease(bucket, race)
    if lease is None:
        raise Absent(
            f"No process drives the queue of race {race}.",
            remedy=f"Drive it with `dr-race run {race}`.",
        )
    if lease.newer or lease.machine != this_machine():
        raise SettingsError(
            f"The queue of race {race} is driven by {lease.owner}, on another machine.",
            remedy=f"Run `dr-race stop {race}` there.",
        )
    with suppress(ProcessLookupError):
        os.kill(lease.pid, signal.SIGTERM)
    if wait_until(lambda: not is_alive(lease.pid, lease.pid_started), patience_s=STOPPED_S):
        return QueueStopped(race, lease.pid)
    raise SettingsError(
        f"The process {lease.pid} that drives the queue of race {race} does not end.",
        remedy="Look at it with `ps`; it may wait for a network or a disk.",
    )


def main() -> None:
    """Standard input names the queue."""
    call = json.loads(sys.stdin.buffer.read())
    with Path(os.devnull).open("rb") as nothing:
        os.dup2(nothing.fileno(), sys.stdin.fileno())
    secret_environment.keep(call["secrets"])
    logger = get_logger(__name__)
    try:
        settings = load_settings(Path(call["folder"]))
        LogFile(queue_log(settings, call["race"]), settings.run.logs.log_max_mb << 20)
        bucket = open_bucket(settings.storage)
        report = run_queue(
            settings,
            bucket,
            call["race"],
            video=call["video"],
            on_progress=lambda text: logger.info("%s", text),
        )
        logger.info("The queue is empty; %d on the leaderboard.", len(report.leaderboard))
    except DrError as error:
        logger.error("%s %s", error, error.remedy)
        raise SystemExit(error.code) from None


if __name__ == "__main__":
    main()
