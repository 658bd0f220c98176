"""Plans a training: checks everything, then copies what it starts from into the bucket."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from drcli.base import notices
from drcli.base.errors import SettingsError, StorageError
from drcli.base.file_lock import only_writer
from drcli.base.problems import ProblemsError, of_severity, refuse
from drcli.checks.before_start import Plans, examine
from drcli.checks.storage_rules import review_prefix
from drcli.config.settings import CustomFilesConfig, Settings, catalogue
from drcli.exchange.checkpoint import Counters
from drcli.exchange.job import Job
from drcli.exchange.run_record import RunRecord, run_folder
from drcli.exchange.training_start import Pretrained, TrainingStart
from drcli.modelfiles.custom_files import Inputs, find, upload_custom_files
from drcli.modelfiles.network_shape import Design
from drcli.modelfiles.params_yaml import training_parameters
from drcli.models.repair_model import repair_all
from drcli.models.run_metadata import describe_start, read_start
from drcli.runs.run_logs import begin_logs
from drcli.store import keys, lease
from drcli.store.bucket import Bucket
from drcli.store.checkpoints import CheckpointStore
from drcli.store.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.store.model_prefix import is_used, newest_checkpoint, wipe
from drcli.store.repair import Model
from drcli.workers.goals import ending

NOT_SHOWN = ("V-20",)
"""Rules whose warnings only `dr validate` shows."""


@dataclass(frozen=True)
class StartOptions:
    """Options of the command; `until_laps` is the least number of laps that must be completed."""

    wipe: bool = False
    resume: bool = False
    max_minutes: float | None = None
    until_laps: int | None = None
    seed: int | None = None


@dataclass(frozen=True)
class RunPlan:
    """A training that can start: every check has passed.

    Attributes:
        warnings: Sentences about allowed settings that may surprise.
        resumes: The checkpoint to continue from, None for a new model.
        ends: A sentence that says when the training ends.
        pretrained: The model whose weights a new model begins with, None for fresh weights.
    """

    job: Job
    inputs: Inputs
    warnings: list[str]
    resumes: str | None
    ends: str
    pretrained: Pretrained | None = None
    wiped: bool = False


def prepare(settings: Settings, options: StartOptions) -> RunPlan:
    """Check everything and copy the inputs into the bucket, before a process starts.

    Then the model prefix belongs to the job's session, and a second start changes nothing there.

    Raises:
        SettingsError: Something is wrong; the message has a line for each problem.
    """
    directory, prefix = settings.directory, settings.model_prefix
    if options.wipe and options.resume:
        raise SettingsError(
            "-w deletes the model and --resume continues it; they cannot be combined.",
            remedy="Choose one of them.",
        )
    if settings.untrainable is not None:
        raise ProblemsError([settings.untrainable])
    folder = run_folder(directory, settings.run_id)
    refuse_second_run(settings.run_id, folder)
    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    bucket.probe(keys.run_folder(prefix))
    lease.refuse_other_owner(bucket, prefix)

    newest = newest_checkpoint(bucket, prefix)
    if options.resume and newest is None:
        raise SettingsError(
            f"s3://{bucket.name}/{prefix} has no checkpoint to resume from.",
            remedy=f"Start it {'with -w' if is_used(bucket, prefix) else 'without --resume'}.",
        )
    if options.resume:
        # Show these now: the plan's warnings are lost if the start is refused.
        for sentence in repair_all(Model.of(settings.model, bucket, prefix)):
            notices.warn(sentence)
    before = read_start(bucket, prefix) if options.resume else None
    resumes, damaged = _resumable(bucket, prefix) if options.resume else (None, [])
    job = Job(
        config=settings.run,
        session=secrets.token_hex(6),
        seed=_seed(settings, options, before),
        until_laps=options.until_laps,
        max_minutes=options.max_minutes or settings.train_max_minutes or None,
        folder=folder,
        launcher_pid=os.getpid(),
    )
    custom = settings.custom_files
    examined = examine(
        settings,
        job,
        find(_resumed(custom, prefix) if options.resume else custom, bucket),
        bucket,
        Plans(options.wipe, Design.of_model(bucket, prefix) if options.resume else None),
    )
    refuse(examined.problems)
    inputs, design, transfer = examined.inputs, examined.design, examined.transfer
    found = of_severity(examined.problems, "warning")
    shown = (str(problem) for problem in found if problem.rule not in NOT_SHOWN)
    warnings = [*damaged, *settings.warnings, *shown]
    source = transfer.source if transfer is not None else None
    with _taken(job, bucket, options):
        wiping = options.wipe and is_used(bucket, prefix)
        if wiping:
            wipe(bucket, prefix, spared=[keys.lease(prefix)])
        _freeze(settings, bucket, inputs, design)
        warnings += _forget_other_scores(settings, bucket, before)
        start = describe_start(settings, directory, job.seed, source, before)
        bucket.put(keys.training_start(prefix), start.encode())
        if transfer is not None:
            # Checkpoint 0 with a fresh optimizer: steps, episodes and time count from 0.
            counters = Counters(critic_warmup=transfer.critic_warmup)
            CheckpointStore(bucket, prefix).save(0, 0, transfer.tensors, counters=counters)
        if not options.resume:
            begin_logs(directory, prefix, settings.log_max_mb)
    ends = ending(job, design.parameters)
    return RunPlan(job, inputs, warnings, resumes, ends, source, wiping)


def refuse_second_run(run_id: int, folder: Path) -> None:
    """Refuse while a training of this run number is alive on this machine."""
    record = RunRecord.read(folder)
    if record is not None and record.alive:
        raise SettingsError(
            f"Run {run_id} is training s3://{record.bucket}/{record.prefix} already "
            f"(process {record.pid}).",
            remedy="Stop it with `dr-stop-training`, or give this one another DR_RUN_ID and "
            "another DR_LOCAL_S3_MODEL_PREFIX.",
        )


@contextmanager
def _taken(job: Job, bucket: Bucket, options: StartOptions) -> Iterator[None]:
    """Take the lease of the model prefix, and release it if the `with` block fails.

    Another start may have taken it during the checks, which need seconds. The folder is locked only
    for this step, because other commands need it too.

    Raises:
        SettingsError: Another start was faster.
    """
    prefix = job.config.model.prefix
    with only_writer(job.directory):
        refuse_second_run(job.config.run_id, job.folder)
        lease.refuse_other_owner(bucket, prefix, job.session)
        if not (options.wipe or options.resume):
            refuse(review_prefix(prefix, bucket))
        lease.take(bucket, prefix, job.session)
    try:
        yield
    except BaseException:
        with suppress(StorageError):
            lease.release(bucket, prefix, job.session)
        raise


def _resumed(places: CustomFilesConfig, prefix: str) -> CustomFilesConfig:
    """The same places, with the model's own files for those that `custom_files/` does not have.

    So a local file that was changed between stop and resume counts, and a machine without local
    files continues with those of the first start.
    """
    return replace(
        places,
        reward_key=keys.reward_function(prefix),
        hyperparameters_key=keys.hyperparameters(prefix),
        metadata_key=keys.model_metadata(prefix),
    )


def _resumable(bucket: Bucket, prefix: str) -> tuple[str | None, list[str]]:
    """The checkpoint to continue from, and sentences about damaged newer ones.

    Raises:
        StorageError: All checkpoints are damaged.
    """
    found = CheckpointStore(bucket, prefix).load_latest(with_optimizer=True)
    if found is None:
        return None, []
    name = found.record.name
    warnings = [f"Checkpoint {why} The training continues from {name}." for why in found.damaged]
    if found.record.optimizer is not None and found.optimizer is None:
        key = keys.checkpoint_optimizer(prefix, name)
        warnings.append(
            f"{bucket.name}/{key} is missing or damaged. The optimizer starts with an empty state, "
            "which costs a few iterations."
        )
    return name, warnings


def _freeze(settings: Settings, bucket: Bucket, inputs: Inputs, design: Design) -> None:
    """Copy the files of the training below the model prefix."""
    prefix = settings.model_prefix
    upload_custom_files(settings.custom_files, bucket, inputs)
    bucket.put(keys.reward_function(prefix), inputs.reward.data)
    bucket.put(keys.model_metadata(prefix), inputs.metadata.data)
    parameters = design.parameters.canonical_json(design.metadata.training_algorithm)
    bucket.put(keys.hyperparameters(prefix), parameters.encode())
    for name, own in _parameter_files(settings).items():
        bucket.put(keys.parameter_file(prefix, name), training_parameters(own))


def _parameter_files(settings: Settings) -> dict[str, Settings]:
    """The settings of each parameter file: each worker with its own race has its own file."""
    file = PurePosixPath(settings.training_params_file)
    files = {settings.training_params_file: settings}
    if settings.overrides:
        for worker in range(settings.workers):
            name = file.with_stem(f"{file.stem}_{worker + 1}")
            files[str(name)] = settings.for_worker(worker)
    return files


def _seed(settings: Settings, options: StartOptions, before: TrainingStart | None) -> int:
    """The seed; a resumed training keeps its first one unless the racer gives another."""
    if options.seed is not None:
        return options.seed
    if settings.train_seed is not None:
        return settings.train_seed
    if before is not None:
        return before.seed
    return secrets.randbelow(2**31)


def _forget_other_scores(
    settings: Settings, bucket: Bucket, before: TrainingStart | None
) -> list[str]:
    """Forget the best score if DR_TRAIN_BEST_MODEL_METRIC has changed; returns a warning then."""
    name = "DR_TRAIN_BEST_MODEL_METRIC"
    if before is None or before.settings is None:
        return []
    metric = before.settings.get(name, catalogue()[name].default)
    if metric == settings.train_best_model_metric:
        return []
    CheckpointStore(bucket, settings.model_prefix).forget_scores()
    return [
        f"{settings.source(name)}: {name} was {metric} until now, so the next checkpoint that is "
        "evaluated becomes the best."
    ]
