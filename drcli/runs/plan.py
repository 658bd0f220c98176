"""Plans a training: checks everything, then copies what it starts from into the bucket."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from drcli.base import notices
from drcli.base.errors import SettingsError, StorageError
from drcli.base.file_lock import only_writer
from drcli.base.problems import ProblemsError, of_severity, refuse
from drcli.checks.before_start import Plans, examine
from drcli.checks.storage_rules import review_prefix
from drcli.config.settings import CustomFilesConfig, Settings, catalogue
from drcli.exchange.job import Job
from drcli.exchange.run_record import RunRecord, run_folder
from drcli.exchange.training_start import Pretrained, TrainingStart
from drcli.modelfiles.custom_files import Inputs, find, upload_custom_files
from drcli.modelfiles.network_shape import Design
from drcli.modelfiles.params_yaml import training_parameters
from drcli.models.repair_model import repair_all
from drcli.models.run_metadata import describe_start, read_start, write_start
from drcli.runs.run_logs import begin_logs
from drcli.store import keys, lease
from drcli.store.bucket import Bucket
from drcli.store.checkpoints import CheckpointStore
from drcli.store.connect import open_bucket
from drcli.store.model_prefix import is_used, newest_checkpoint, wipe
from drcli.store.repair import Model
from drcli.workers.goals import ending

COMMAND_PATIENCE_S = 5.0
"""How long a command waits for a bucket that does not answer."""

UNTOLD = ("V-20",)
"""Rules whose warnings only `dr validate` shows."""


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
    """A training that can start: every check has passed.

    Attributes:
        job: For the processes.
        warnings: Sentences about what is allowed and may surprise.
        resumes: The checkpoint to continue from, None for a new model.
        ends: What ends it, as one sentence.
        pretrained: Whose weights a new model begins with, None where they are fresh.
    """

    job: Job
    inputs: Inputs
    warnings: list[str]
    resumes: str | None
    ends: str
    pretrained: Pretrained | None = None
    wiped: bool = False


def prepare(settings: Settings, options: StartOptions) -> RunPlan:
    """Check everything and freeze the inputs in the bucket, before a process starts.

    The model prefix belongs to the job's session from then on, so that a start which comes second
    changes nothing there.

    Raises:
        SettingsError: Something is wrong; the message has a line for each finding.
        StorageError: The bucket cannot be used.
    """
    directory = settings.directory
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
    bucket.probe()
    lease.refuse_other_owner(bucket, settings.model_prefix)

    prefix = settings.model_prefix
    newest = newest_checkpoint(bucket, prefix)
    if options.resume and newest is None:
        raise SettingsError(
            f"s3://{bucket.name}/{prefix} has no checkpoint to resume from.",
            remedy=f"Start it {'with -w' if is_used(bucket, prefix) else 'without --resume'}.",
        )
    if options.resume:
        for sentence in repair_all(Model.of(settings.model, bucket, prefix)):
            notices.warn(
                sentence
            )  # now, because the plan's warnings are lost if the start is refused
    before = read_start(bucket, prefix) if options.resume else None
    going_on, passed_over = _going_on(bucket, prefix) if options.resume else (None, [])
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
    odd = of_severity(examined.problems, "warning")
    untold = (str(problem) for problem in odd if problem.rule not in UNTOLD)
    warnings = [*passed_over, *settings.warnings, *untold]

    source = transfer.source if transfer is not None else None
    with _taken(job, bucket, options):
        wiping = options.wipe and is_used(bucket, prefix)
        if wiping:
            wipe(bucket, prefix, spared=[keys.lease(prefix)])
        _freeze(settings, bucket, inputs, design)
        warnings += _forget_other_scores(settings, bucket, before)
        start = describe_start(settings, directory, job.seed, source, before)
        write_start(bucket, prefix, start)
        if transfer is not None:
            transfer.hand_over(bucket, prefix)
        if not options.resume:
            begin_logs(directory, prefix, settings.log_max_mb)
    ends = ending(job, design.parameters)
    return RunPlan(job, inputs, warnings, going_on, ends, source, wiping)


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
    """Make the model prefix this start's own, and give it back if what is inside fails.

    The checks took seconds, in which another start may have been faster: of two that come here at
    the same time, one finds the other's lease. The folder is locked only for this step, because
    other commands need it too.

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
    """The same places, but the model's own files where `custom_files/` has none.

    A racer who changes a local file between stop and resume wants the change; a machine without
    local files continues with the files of the first start.
    """
    return replace(
        places,
        reward_key=keys.reward_function(prefix),
        hyperparameters_key=keys.hyperparameters(prefix),
        metadata_key=keys.model_metadata(prefix),
    )


def _going_on(bucket: Bucket, prefix: str) -> tuple[str | None, list[str]]:
    """The checkpoint that the trainer continues from, and sentences about damaged newer ones.

    Raises:
        StorageError: All are damaged.
    """
    found = CheckpointStore(bucket, prefix).load_latest(with_optimizer=True)
    if found is None:
        return None, []
    name = found.record.name
    told = [f"Checkpoint {why} The training continues from {name}." for why in found.damaged]
    if found.record.optimizer is not None and found.optimizer is None:
        key = keys.checkpoint_optimizer(prefix, name)
        told.append(
            f"{bucket.name}/{key} is missing or damaged. The optimizer starts with an empty state, "
            "which costs a few iterations."
        )
    return name, told


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
    """Names of the parameter files, and whose they are; workers with own races have own files."""
    name = settings.training_params_file
    files = {name: settings}
    if settings.overrides:
        stem, dot, ending = name.rpartition(".")
        stem, ending = (stem, dot + ending) if dot else (name, "")
        for worker in range(settings.workers):
            files[f"{stem}_{worker + 1}{ending}"] = settings.for_worker(worker)
    return files


def _seed(settings: Settings, options: StartOptions, before: TrainingStart | None) -> int:
    """The seed; a resumed training keeps its first one unless another is given."""
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
    """Forget the score of the best checkpoint if DR_TRAIN_BEST_MODEL_METRIC has changed.

    Returns:
        A warning about it.
    """
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
