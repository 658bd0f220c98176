"""Starts and stops a training: every check first, then the frozen inputs, then the processes."""

import json
import os
import secrets
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import psutil

from drcli.config import Settings
from drcli.errors import SettingsError, WorkerDied
from drcli.hyperparameters import Hyperparameters
from drcli.job import Job, LastWords
from drcli.model_metadata import ModelMetadata
from drcli.runs import lease
from drcli.runs.inputs import Inputs, gather, upload_custom_files
from drcli.runs.logs import log_file
from drcli.runs.parameters import training_parameters
from drcli.runs.record import RunRecord, is_alive, run_folder
from drcli.runs.report import RunReport
from drcli.runs.status import inspect
from drcli.runs.supervisor import Supervisor
from drcli.store import keys
from drcli.store.bucket import Bucket
from drcli.store.connect import ensure_storage, open_bucket

TRIAL_TIMEOUT_S = 60.0
"""How long the trial of world and reward function may take, endless loops included."""

READY_TIMEOUT_S = 20.0

COMMAND_PATIENCE_S = 5.0
"""How long a command waits for a bucket that does not answer."""


@dataclass(frozen=True)
class StartOptions:
    """What the command line adds to the settings.

    Attributes:
        wipe: Delete what lies under the model prefix.
        resume: Go on with what lies there.
        max_minutes: Finish after so much wall time.
        until_laps: Finish once an evaluation completes all its laps, at least so many.
        seed: What all random numbers are derived from; drawn if left out.
    """

    wipe: bool = False
    resume: bool = False
    max_minutes: float | None = None
    until_laps: int | None = None
    seed: int | None = None


@dataclass(frozen=True)
class RunPlan:
    """A training that can start: everything that can be known to be wrong is right."""

    job: Job
    inputs: Inputs
    warnings: list[str]
    resumes: str | None


def prepare(settings: Settings, options: StartOptions, directory: Path | None = None) -> RunPlan:
    """Check everything and freeze the inputs in the bucket, before a process starts.

    Args:
        settings: Checked in themselves.
        options: From the command line.
        directory: The racer's working folder; the current one if left out.

    Raises:
        DrError: The first thing that is wrong.
    """
    directory = (directory or Path.cwd()).absolute()
    if options.wipe and options.resume:
        raise SettingsError(
            "-w wipes the model and --resume continues it: both at once make no sense.",
            remedy="Choose one of them.",
        )
    refuse_unsupported(settings, "training")
    folder = run_folder(settings, directory)
    _refuse_second_run(settings, folder)
    bucket = open_bucket(settings, directory, patience_s=COMMAND_PATIENCE_S)
    bucket.probe()
    _refuse_second_trainer(settings, bucket)

    prefix = settings.model_prefix
    newest = _newest_checkpoint(bucket, prefix)
    used = bool(bucket.list(keys.folder(prefix)))
    if used and not (options.wipe or options.resume):
        raise SettingsError(
            f"Selected path s3://{bucket.name}/{prefix} exists. Delete it, or use -w option.",
            remedy="Continue that training with --resume, replace it with -w, or choose another "
            "DR_LOCAL_S3_MODEL_PREFIX in run.env.",
        )
    if options.resume and newest is None:
        raise SettingsError(
            f"There is no checkpoint at s3://{bucket.name}/{prefix} to resume from.",
            remedy="Start a new training without --resume.",
        )
    inputs = gather(_resumed(settings) if options.resume else settings, directory, bucket)
    parameters, metadata = inputs.check()
    if options.resume:
        _refuse_another_action_space(bucket, prefix, metadata, inputs.metadata.origin)
    for file, unsupported in (
        (inputs.metadata, metadata.unsupported()),
        (inputs.hyperparameters, parameters.unsupported()),
    ):
        if unsupported is not None:
            raise SettingsError(f"{file.origin}: {unsupported}", remedy=f"Change {file.name}.")
    _check_workers(settings, parameters, inputs.hyperparameters.origin)
    warnings = [*settings.warnings, *parameters.warnings, *metadata.warnings]
    seed = _seed(settings, options, bucket)
    job = Job(
        settings=settings,
        directory=directory,
        session=secrets.token_hex(6),
        seed=seed,
        until_laps=options.until_laps,
        max_minutes=options.max_minutes or settings.train_max_minutes or None,
        folder=folder,
        launcher_pid=os.getpid(),
    )
    _try_inputs(job, inputs)

    if options.wipe and used:
        _wipe(bucket, prefix)
    upload_custom_files(settings, directory, bucket, inputs)
    bucket.put(keys.reward_function(prefix), inputs.reward.data)
    bucket.put(keys.model_metadata(prefix), inputs.metadata.data)
    bucket.put(keys.hyperparameters(prefix), parameters.canonical_json().encode())
    bucket.put(
        keys.parameter_file(prefix, settings.training_params_file), training_parameters(settings)
    )
    bucket.put(keys.run_note(prefix), json.dumps({"seed": seed}).encode())
    return RunPlan(job, inputs, warnings, str(newest) if options.resume else None)


def launch(plan: RunPlan) -> int:
    """Start the supervisor as a process that outlives this one.

    Returns:
        Its process number.

    Raises:
        WorkerDied: It ended at once, or gave no sign of life.
    """
    settings, directory = plan.job.settings, plan.job.directory
    path = log_file(settings, directory, "supervisor")
    path.parent.mkdir(parents=True, exist_ok=True)
    before = RunRecord.read(plan.job.folder)
    with path.open("ab") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "drcli.runs.detached"],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=plan.job.to_environment(),
            cwd=directory,
            start_new_session=True,
        )
    deadline = time.monotonic() + READY_TIMEOUT_S
    while RunRecord.read(plan.job.folder) == before and time.monotonic() < deadline:
        if process.poll() is not None:
            break
        time.sleep(0.05)
    if RunRecord.read(plan.job.folder) == before:
        raise WorkerDied(
            "The supervisor of the training did not start.", remedy=f"Read the reason in {path}."
        )
    return process.pid


def supervise(plan: RunPlan) -> int:
    """Run the training in this process until it is over.

    Returns:
        The exit code of the command.
    """
    return supervise_job(plan.job)


def supervise_job(job: Job) -> int:
    """What the supervising process does, in the foreground or detached."""
    job = replace(job, launcher_pid=os.getpid())
    settings = job.settings
    bucket = open_bucket(settings, job.directory)
    lease.renew(bucket, settings.model_prefix, job.session)
    record = RunRecord(
        run_id=settings.run_id,
        session=job.session,
        bucket=bucket.name,
        prefix=settings.model_prefix,
        world=settings.world_name,
        state="starting",
        pid=os.getpid(),
        pid_started=psutil.Process().create_time(),
        started_at=time.time(),
    )
    record.write(job.folder)
    return Supervisor(job, bucket, record, lambda: ensure_storage(settings, job.directory)).run()


def stop(settings: Settings, *, wait_s: float = 20.0, directory: Path | None = None) -> RunReport:
    """Ask the supervisor to end the training, and wait until it has.

    A second request while it is leaving kills the workers at once.
    """
    directory = (directory or Path.cwd()).absolute()
    record = RunRecord.read(run_folder(settings, directory))
    if record is not None and record.alive:
        os.kill(record.pid, signal.SIGTERM)
        deadline = time.monotonic() + wait_s
        while is_alive(record.pid, record.pid_started) and time.monotonic() < deadline:
            time.sleep(0.05)
    return inspect(settings, directory)


def refuse_unsupported(settings: Settings, job: Literal["training", "evaluation"]) -> None:
    """Say what cannot be run yet instead of running something else."""
    sentence = settings.unsupported(job)
    if sentence is not None:
        raise SettingsError(sentence, remedy="Change that setting.")


def is_running(settings: Settings, directory: Path) -> bool:
    """Whether a training of this run number is alive on this machine."""
    record = RunRecord.read(run_folder(settings, directory))
    return record is not None and record.alive


def _refuse_second_run(settings: Settings, folder: Path) -> None:
    record = RunRecord.read(folder)
    if record is not None and record.alive:
        raise SettingsError(
            f"Run {settings.run_id} is training s3://{record.bucket}/{record.prefix} already "
            f"(process {record.pid}).",
            remedy="Stop it with `dr-stop-training`, or give this one another DR_RUN_ID and "
            "another DR_LOCAL_S3_MODEL_PREFIX.",
        )


def _refuse_second_trainer(settings: Settings, bucket: Bucket) -> None:
    """A training of the same prefix from another folder or machine."""
    held = lease.holder(bucket, settings.model_prefix)
    if held is None or not lease.is_owner_alive(held):
        return
    raise SettingsError(
        f"s3://{bucket.name}/{settings.model_prefix} is being trained by process {held.pid} on "
        f"{held.host} (last heard of {time.time() - held.renewed:.0f} s ago).",
        remedy="Stop that training, or choose another DR_LOCAL_S3_MODEL_PREFIX. If that machine "
        f"is gone, try again in {lease.STALE_S:.0f} seconds.",
    )


def _check_workers(settings: Settings, parameters: Hyperparameters, origin: str) -> None:
    """A worker without an episode would never hand anything in, and everybody would wait for it."""
    episodes = parameters.num_episodes_between_training
    if settings.workers > episodes:
        raise SettingsError(
            f"{settings.source('DR_WORKERS')}: DR_WORKERS={settings.workers} is more than "
            f"num_episodes_between_training={episodes} in {origin}.",
            remedy=f"Set DR_WORKERS to {episodes} at most, or drive more episodes an iteration.",
        )


def _newest_checkpoint(bucket: Bucket, prefix: str) -> keys.CheckpointName | None:
    names = (keys.checkpoint_of(prefix, o.key) for o in bucket.list(keys.model_folder(prefix)))
    return max((name for name in names if name is not None), default=None)


def _resumed(settings: Settings) -> Settings:
    """Settings under which files that are not in `custom_files/` come from the model itself.

    A racer who changes a local file between stop and resume wants the change; a machine that has
    no local files goes on with what the model was started with.
    """
    prefix = settings.model_prefix
    return settings.model_copy(
        update={
            "reward_key": keys.reward_function(prefix),
            "hyperparameters_key": keys.hyperparameters(prefix),
            "model_metadata_key": keys.model_metadata(prefix),
        }
    )


def _refuse_another_action_space(
    bucket: Bucket, prefix: str, metadata: ModelMetadata, origin: str
) -> None:
    """A network's outputs cannot be added to or taken away from; their meaning may change."""
    key = keys.model_metadata(prefix)
    trained = ModelMetadata.from_bytes(bucket.get(key), f"{bucket.name}/{key}")
    old, new = trained.action_space, metadata.action_space
    if (old.continuous, old.num_actions) != (new.continuous, new.num_actions):
        raise SettingsError(
            f"{origin}: the model was trained with {old.num_actions} "
            f"{'continuous' if old.continuous else 'discrete'} actions, this file has "
            f"{new.num_actions} {'continuous' if new.continuous else 'discrete'} ones.",
            remedy="Keep type and number of actions (their values may change), or start a new "
            "model.",
        )


def _seed(settings: Settings, options: StartOptions, bucket: Bucket) -> int:
    """The seed of a resumed training is its first one, unless the racer insists."""
    if options.seed is not None:
        return options.seed
    if settings.train_seed is not None:
        return settings.train_seed
    key = keys.run_note(settings.model_prefix)
    if options.resume and bucket.exists(key):
        return int(json.loads(bucket.get(key))["seed"])
    return secrets.randbelow(2**31)


def _try_inputs(job: Job, inputs: Inputs) -> None:
    """Load the world and try the reward function on it, in a process that can be given up.

    The launcher itself never imports a racer's code.
    """
    job.folder.mkdir(parents=True, exist_ok=True)
    path = job.folder / keys.REWARD_FUNCTION_FILE
    path.write_bytes(inputs.reward.data)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "drcli.worker.trial", str(path), inputs.reward.origin],
            env=job.to_environment(),
            cwd=job.directory,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=TRIAL_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise SettingsError(
            f"{inputs.reward.origin}: trying the reward function took longer than "
            f"{TRIAL_TIMEOUT_S:.0f} seconds.",
            remedy="Look for an endless loop in it.",
        ) from None
    if done.returncode == 0:
        return
    words = LastWords.find(job.folder, "trial")
    if words is not None and words.code == SettingsError.code:
        raise SettingsError(words.message, remedy=words.remedy)
    raise RuntimeError(f"The trial of the reward function failed:\n{done.stdout}{done.stderr}")


def _wipe(bucket: Bucket, prefix: str) -> None:
    for folder in (keys.folder(prefix), keys.rollouts_folder(prefix), keys.run_folder(prefix)):
        bucket.delete([item.key for item in bucket.list(folder)])
