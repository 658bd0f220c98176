"""Plans a training: checks everything, then copies its inputs into the bucket."""

import secrets
import time
from dataclasses import dataclass, replace

from drcli.base import notices
from drcli.base.errors import SettingsError
from drcli.base.problems import of_severity, refuse
from drcli.checks.before_start import Plans, examine_stages
from drcli.checks.start_rules import refuse_start
from drcli.checks.storage_rules import probe, review_prefix
from drcli.config.bucket_config import CustomFilesConfig
from drcli.config.run_env import written
from drcli.config.settings import Settings, catalogue
from drcli.exchange.checkpoint import CheckpointName, Counters
from drcli.exchange.job import Job
from drcli.exchange.journal_entry import JournalEntry
from drcli.exchange.run_outcome import RunOutcome
from drcli.exchange.training_start import Pretrained, TrainingStart
from drcli.learn.phases import FINE_LR
from drcli.modelfiles.custom_files import Inputs, find
from drcli.modelfiles.hyperparameters import Hyperparameters, TrainingMethod
from drcli.modelfiles.network_shape import Design, model_files
from drcli.modelfiles.training_method import chosen_method, kept_method
from drcli.models.continue_reference import plan_conversion
from drcli.models.pretrained import sentence_of
from drcli.models.repair_model import repair_all
from drcli.models.run_metadata import describe_start, read_start
from drcli.runs.freeze_inputs import files_to_train_with, freeze, parameter_files
from drcli.runs.increment import METRICS, MODEL
from drcli.runs.journal_of_start import start_entries
from drcli.runs.planned_job import begun_by, first_start, planned_job
from drcli.runs.planned_stages import plan_stages
from drcli.runs.record_keeping import StartRecorder
from drcli.runs.run_logs import begin_logs
from drcli.runs.take_model import taken
from drcli.store import keys, lease
from drcli.store.best_checkpoint import forget_scores
from drcli.store.bucket import Bucket
from drcli.store.checkpoints import CheckpointStore
from drcli.store.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.store.last_outcome import read_outcome, write_outcome
from drcli.store.lost_checkpoints import find_lost
from drcli.store.model_kind import what_helps
from drcli.store.model_prefix import is_aborted_start, is_used, newest_checkpoint, wipe
from drcli.store.notes import describe
from drcli.store.repair import Model
from drcli.workers.goals import ending


@dataclass(frozen=True)
class StartOptions:
    """What is asked of a start.

    Attributes:
        until_laps: The least number of laps.
        until_lap_time_s: For each of them, simulated seconds.
        whole_run: Any machine may continue with the same command.
        over_aborted: The prefix may hold a start without a checkpoint.
        method: Replaces that of hyperparameters.json.
    """

    wipe: bool = False
    resume: bool = False
    max_minutes: float | None = None
    until_laps: int | None = None
    seed: int | None = None
    whole_run: bool = False
    over_aborted: bool = False
    until_lap_time_s: float | None = None
    method: TrainingMethod | None = None


@dataclass(frozen=True)
class RunPlan:
    """Every check has passed.

    `resumes` is a checkpoint, `pretrained` the model whose weights a new one begins with.
    """

    job: Job
    inputs: Inputs
    warnings: list[str]
    resumes: str | None
    ends: str
    pretrained: Pretrained | None = None
    wiped: bool = False


@dataclass(frozen=True)
class EndWorkPlan:
    job: Job
    outcome: RunOutcome


def prepare(settings: Settings, options: StartOptions) -> RunPlan:
    """Check everything and copy the inputs into the bucket, before a process starts.

    Then the prefix belongs to the job's session; a second start changes nothing there.

    Raises:
        SettingsError: With a line for each problem.
        CheckpointsLost: None of the model's checkpoints can be read.
    """
    directory, prefix = settings.directory, settings.model_prefix
    if options.wipe and options.resume:
        raise SettingsError(
            "-w deletes the model and --resume continues it; they cannot be combined.",
            remedy="Choose one of them.",
        )
    refuse_start(settings)
    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    clock = probe(bucket, prefix)
    lease.refuse_other_owner(bucket, prefix)

    if not options.wipe:
        _refuse_lost(settings, bucket)
    newest = newest_checkpoint(bucket, prefix)
    if options.resume and newest is None:
        raise SettingsError(
            f"s3://{bucket.name}/{prefix} has no checkpoint to resume from.",
            remedy=what_helps(bucket, prefix),
        )
    model = Model.of(settings.model, bucket, prefix)
    conversion = plan_conversion(bucket, prefix) if options.resume else None
    repairs = repair_all(model) if options.resume and conversion is None else []
    for sentence in repairs:
        # Show these now: the plan's warnings are lost if the start is refused.
        notices.warn(sentence)
    before = read_start(bucket, prefix) if options.resume else None
    resumes, damaged = None, []
    if conversion is not None:
        resumes, damaged = conversion.name, [conversion.sentence]
    elif options.resume:
        resumes, damaged = _resumable(bucket, prefix)
    continues = options.resume or options.over_aborted
    previous = read_outcome(bucket, prefix) if continues else None
    began_at = first_start(previous, before)
    custom = settings.custom_files
    found_files = find(resumed_files(custom, prefix) if options.resume else custom, bucket)
    if conversion is not None:
        found_files |= conversion.own_files(found_files)
    before_this = prefix if options.resume else _pretrained_prefix(settings)
    kept = kept_method(bucket, before_this) if options.method is None else None
    files = chosen_method(found_files, options.method, kept)
    staged = plan_stages(settings, files, bucket, resumes=options.resume)
    settings = staged.settings
    job = _job(settings, options, _seed(settings, options, before), began_at)
    trained = Design.of_checkpoint(bucket, prefix, resumes) if resumes else None
    plans = Plans(
        wiping=options.wipe or options.over_aborted,
        resumed=trained if conversion is None else conversion.design,
    )
    examined = examine_stages(
        settings, staged.review, job, files, bucket, plans, first=staged.first
    )
    refuse(examined.problems)
    inputs, design, transfer = examined.inputs, examined.design, examined.transfer
    if keys.HYPERPARAMETERS_FILE in found_files:  # the racer's file keeps what it says
        inputs = replace(inputs, hyperparameters=found_files[keys.HYPERPARAMETERS_FILE])
    found = of_severity([*clock, *examined.problems], "warning")
    warnings = [*damaged, *settings.warnings, *staged.warnings, *map(str, found)]
    if before_this is not None and not design.parameters.taught:
        warnings += _steps_too_large(bucket, before_this, design)
    if files != found_files and kept is not None:
        warnings.append(_keeps_teacher(inputs.hyperparameters.origin, before_this))
    if resumes is not None and design.metadata.training_algorithm == "sac":
        warnings += _replay_lost(bucket, prefix, CheckpointName.parse(resumes))
    job = replace(job, stages=staged.stages, inputs=files_to_train_with(settings, inputs, design))
    source = transfer.source if transfer is not None else None
    if source is not None:
        notices.show(sentence_of(bucket, source))
    ends = ending(job, design.parameters)

    def review() -> None:
        if options.wipe or options.resume:
            return
        files = parameter_files(settings)
        if not (options.over_aborted and is_aborted_start(bucket, prefix, files)):
            refuse(review_prefix(prefix, bucket))

    with taken(job, bucket, review):
        records = StartRecorder(model, settings)
        training = records.prepare(before, resumes=options.resume)
        wiping = options.wipe and is_used(bucket, prefix)
        if wiping:
            wipe(bucket, prefix, spared=[keys.lease(prefix)])
        begun = begun_by(job, began_at, ends)
        # First of all: a start that is cut off here must be known as one.
        write_outcome(bucket, prefix, begun)
        freeze(settings, bucket, inputs, job.inputs, staged.frozen, plans.resumed)
        warnings += _forget_other_scores(settings, bucket, before)
        start = describe_start(settings, directory, job.seed, source, before, training)
        bucket.put(keys.training_start(prefix), start.encode())
        training = records.record(start, begun, resumes, previous, job.inputs)
        describe(bucket, prefix, settings.model_description, is_new=not options.resume)
        noted = start_entries(start, resumes, previous, repairs)
        if transfer is not None:
            # Checkpoint 0 with a fresh optimizer: steps, episodes and time count from 0.
            own = {name: job.inputs[name] for name in model_files(prefix)}
            counters = Counters(critic_warmup=transfer.critic_warmup, inputs=own)
            CheckpointStore(bucket, prefix).save(0, 0, transfer.tensors, counters=counters)
        if conversion is not None:
            conversion.write()
        if not options.resume:
            begin_logs(directory, prefix, settings.log_max_mb)
    job = replace(job, begun=begun, noted=noted, training=training)
    return RunPlan(job, inputs, warnings, resumes, ends, source, wiping)


def prepare_end_work(settings: Settings, outcome: RunOutcome) -> EndWorkPlan:
    """Take the model for the work that is left after a complete training.

    Raises:
        SettingsError: Another start trains the model.
    """
    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    seed = settings.train_seed or 0  # nothing is learned, so nothing is drawn
    job = _job(settings, StartOptions(whole_run=True), seed, outcome.began_at)
    begun = replace(begun_by(job, outcome.began_at, outcome.goals), message=outcome.message)
    text = f"A start on {begun.host} tries what is left to do: {', '.join(outcome.left)}."
    noted = JournalEntry(time.time(), "start", text, {"host": begun.host})
    job = replace(job, begun=begun, end_work=outcome.left, noted=(noted,))
    with taken(job, bucket, lambda: None):
        return EndWorkPlan(job, outcome)


def goals_of(settings: Settings, options: StartOptions, outcome: RunOutcome, bucket: Bucket) -> str:
    """Everything that would end a continuing training."""
    places = resumed_files(settings.custom_files, settings.model_prefix)
    files = find(places, bucket)
    file = files.get(keys.HYPERPARAMETERS_FILE)
    if file is None:
        return ""  # a start says which file is missing
    parameters = Hyperparameters.from_bytes(file.data, file.origin)
    staged = plan_stages(settings, files, bucket, resumes=True)
    refuse(staged.review.problems)
    job = _job(staged.settings, options, 0, outcome.began_at)
    return ending(replace(job, stages=staged.stages), parameters)


def _pretrained_prefix(settings: Settings) -> str | None:
    return None if settings.pretrained_model is None else settings.pretrained_model.prefix


def _steps_too_large(bucket: Bucket, before: str, design: Design) -> list[str]:
    lr = design.parameters.lr
    if lr <= FINE_LR or kept_method(bucket, before) is None:
        return []
    return [
        f"{design.parameters_origin}: lr={lr:g} is high for the weights of {before}, which learned "
        f"from a teacher: they may be lost within a few updates. Write lr={FINE_LR:g} and "
        "target_kl=0.03 to go on without a teacher."
    ]


def _keeps_teacher(file: str, before: str | None) -> str:
    return (
        f"{file} has no training_method, so that of {before} is kept: teacher. --no-teacher, or "
        '"training_method": "camera" in the file, goes on without it.'
    )


def _job(settings: Settings, options: StartOptions, seed: int, began_at: float) -> Job:
    return planned_job(
        settings,
        seed=seed,
        began_at=began_at,
        until_laps=options.until_laps,
        until_lap_time_s=options.until_lap_time_s,
        max_minutes=options.max_minutes,
        whole_run=options.whole_run,
    )


def resumed_files(places: CustomFilesConfig, prefix: str) -> CustomFilesConfig:
    """Files of `custom_files/`, else those of the model."""
    return replace(
        places,
        reward_key=keys.reward_function(prefix),
        hyperparameters_key=keys.hyperparameters(prefix),
        metadata_key=keys.model_metadata(prefix),
    )


def _replay_lost(bucket: Bucket, prefix: str, newest: CheckpointName | None) -> list[str]:
    listed = (
        keys.rollout_key(prefix, info.key) for info in bucket.list(keys.rollouts_folder(prefix))
    )
    learned = range(0 if newest is None else newest.number)
    if not learned or any(each is not None and each.iteration in learned for each in listed):
        return []
    return [
        "SAC starts with an empty replay buffer, because the steps of earlier iterations are not "
        "in the bucket: a copy of a model has none. It learns from new steps only, which costs "
        "some iterations."
    ]


def _resumable(bucket: Bucket, prefix: str) -> tuple[str | None, list[str]]:
    """The checkpoint, and sentences about damaged newer ones.

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


def _refuse_lost(settings: Settings, bucket: Bucket) -> None:
    """Rather than iteration 0 among a model's remains."""
    lost = find_lost(bucket, settings.model_prefix)
    if lost is None:
        return
    metrics = written(settings, METRICS)
    stays = metrics is not None and "$" not in metrics  # so it would be that of the old model
    raise lost.refusal(
        *([f"{METRICS}={keys.metrics_prefix(lost.beside)}"] if stays else []),
        set_in_environment=settings.source(MODEL) == "environment",
    )


def _seed(settings: Settings, options: StartOptions, before: TrainingStart | None) -> int:
    """A resumed training keeps its first one."""
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
    if before is None or before.settings is None:
        return []
    names = ["DR_TRAIN_BEST_MODEL_METRIC", "DR_TRAIN_BEST_MODEL_WORLD"]
    if settings.train_best_model_world != "training":
        names.append("DR_TRAIN_EVAL_WORLD")
    elsewhere = settings.train_eval_world and settings.train_best_model_world == "evaluation"
    if not elsewhere and not settings.curriculum_file:
        names.append("DR_WORLD_NAME")  # laps of different tracks cannot be compared
    for name in names:
        setting = catalogue()[name]
        known = before.settings.get(name, setting.default)
        if known != getattr(settings, setting.field):
            forget_scores(bucket, settings.model_prefix)
            return [
                f"{settings.source(name)}: {name} was {known or 'not set'} until now, so the next "
                "checkpoint that is evaluated becomes the best."
            ]
    return []
