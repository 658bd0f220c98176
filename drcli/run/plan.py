"""Plans a training: checks everything, then copies its inputs into the bucket."""

import os
import secrets
import socket
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any

from drcli.base import errors
from drcli.base.errors import SettingsError, grouped, of_severity, refuse
from drcli.bucket.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.checks.before_start import Plans, examine_stages
from drcli.checks.start_rules import probe, refuse_start, review_prefix
from drcli.config.run_config import CustomFilesConfig
from drcli.config.settings import Settings, catalogue
from drcli.learn.algorithms import Algorithm
from drcli.learn.phases import FINE_LR
from drcli.model import keys, lease
from drcli.model.best_checkpoint import forget_scores
from drcli.model.checkpoints import Checkpoint, CheckpointStore
from drcli.model.files.custom_files import Inputs, find
from drcli.model.files.hyperparameters import (
    Hyperparameters,
    TrainingMethod,
    chosen_method,
    is_taught,
)
from drcli.model.files.network_shape import Design, model_files
from drcli.model.model_prefix import ModelListing, is_aborted_start, is_used, what_helps, wipe
from drcli.model.model_store import ModelStore
from drcli.model.notes import describe
from drcli.model.repair import load_unless_lost, repair
from drcli.model.run_metadata import describe_start, read_start
from drcli.model.training_state import read_outcome, write_outcome
from drcli.records.checkpoint import CheckpointName, Counters
from drcli.records.job import Job
from drcli.records.run_record import JournalEntry, run_folder
from drcli.records.stage import Stage
from drcli.records.training_record import Pretrained, RunOutcome, TrainingStart
from drcli.run.increment import METRICS, MODEL
from drcli.run.planned_stages import files_to_train_with, freeze, parameter_files, plan_stages
from drcli.run.record_keeping import StartRecorder
from drcli.run.run_logs import begin_logs
from drcli.run.take_model import taken
from drcli.train.goals import ending
from drcli.transfer.continue_reference import plan_conversion
from drcli.transfer.record_training import NewStart
from drcli.workers.ray_extra import has_cluster

# Makes the job of a start, and the record of its begin.


def planned_job(
    settings: Settings,
    *,
    seed: int,
    began_at: float,
    goals: Mapping[str, float] | None = None,
    max_minutes: float | None = None,
    whole_run: bool = False,
    stages: tuple[Stage, ...] = (),
) -> Job:
    """`began_at`: the very first start; `max_minutes` None: the setting."""
    lives_s = 60.0 * settings.time_to_live_minutes
    config = settings.run
    by_ray = settings.launcher == "ray"
    if by_ray:  # its workers join as those of other machines do
        config = replace(config, train=config.train.replaced(workers=0))
    return Job(
        config=config,
        session=secrets.token_hex(6),
        seed=seed,
        goals=goals or {},
        max_minutes=max_minutes or settings.train_max_minutes or None,
        folder=run_folder(settings.directory, settings.run_id),
        launcher_pid=os.getpid(),
        whole_run=whole_run,
        ends_at=began_at + lives_s if lives_s else None,
        stages=stages,
        ray_workers=settings.workers if by_ray else 0,
        ray_trainer=by_ray and settings.ray_trainer != "here" and has_cluster(settings),
    )


def first_start(previous: RunOutcome | None, start: TrainingStart | None) -> float:
    if previous is not None:
        return previous.began_at
    if start is not None:
        with suppress(ValueError):
            return datetime.fromisoformat((start.earlier or [start])[0].started_at).timestamp()
    return time.time()


def begun_by(job: Job, began_at: float, goals: str) -> RunOutcome:
    return RunOutcome(job.session, socket.gethostname(), began_at, time.time(), goals=goals)


# What a start of a training notes: its machine, versions, and what has changed.


def start_entries(
    start: TrainingStart, resumes: str | None, previous: RunOutcome | None, repairs: Sequence[str]
) -> tuple[JournalEntry, ...]:
    now = time.time()
    host = socket.gethostname()
    begins = f"resumes from {resumes}" if resumes else "begins a new model"
    machine, versions = start.machine, start.versions
    where = f"{host} ({machine.get('cores')} cores, {machine.get('processor')})"
    text = f"A start on {where} with drcli {versions.get('drcli')} {begins}."
    before = start.earlier[-1] if start.earlier else None
    facts: dict[str, Any] = {"host": host, "machine": machine, "versions": versions}
    facts["resumes"] = resumes
    if before is not None:
        changed = differences(before.settings or {}, start.settings or {})
        updated = differences(before.versions, versions)
        facts |= {"settings_changed": changed, "versions_changed": updated}
        if changed:
            text += f" Changed settings: {_listed(changed)}."
        if updated:
            text += f" Changed versions: {_listed(updated)}."
    entries = [JournalEntry(now, "start", text, facts)]
    if previous is not None and not previous.ended and previous.host:
        gone = f"The start on {previous.host} ended without recording why; this one took over."
        entries.append(JournalEntry(now, "recovery", gone, {"session": previous.session}))
    entries += [JournalEntry(now, "recovery", sentence, {}) for sentence in repairs]
    return tuple(entries)


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, list[Any]]:
    names = sorted({*before, *now})
    return {
        name: [before.get(name), now.get(name)]
        for name in names
        if before.get(name) != now.get(name)
    }


def _listed(changed: Mapping[str, list[Any]]) -> str:
    return ", ".join(
        f"{name} {_shown(before)} -> {_shown(now)}" for name, (before, now) in changed.items()
    )


def _shown(value: Any) -> str:
    return "(not set)" if value is None else str(value)


@dataclass(frozen=True)
class StartOptions:
    """What is asked of a start.

    Attributes:
        goals: As in `Job`.
        whole_run: Any machine may continue with the same command.
        over_aborted: The prefix may hold a start without a checkpoint.
        method: Replaces that of hyperparameters.json.
    """

    wipe: bool = False
    resume: bool = False
    max_minutes: float | None = None
    seed: int | None = None
    whole_run: bool = False
    over_aborted: bool = False
    goals: Mapping[str, float] = field(default_factory=dict)
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
    prefix = settings.model_prefix
    if options.wipe and options.resume:
        raise SettingsError(
            "-w deletes the model and --resume continues it; they cannot be combined.",
            remedy="Choose one of them.",
        )
    refuse_start(settings)
    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    model = ModelStore.of(settings.model, bucket, prefix)
    clock = probe(model)
    lease.refuse_other_owner(model)

    listed = ModelListing(model)
    found = None
    if not options.wipe:  # rather than iteration 0 among a model's remains
        found = load_unless_lost(
            listed,
            metrics_too="$" not in settings.written.get(METRICS, catalogue()[METRICS].default_text),
            in_environment=settings.source(MODEL) == "environment",
            with_optimizer=options.resume,
        )
    if options.resume and not listed.checkpoints:
        raise SettingsError(
            f"{model.url} has no checkpoint to resume from.", remedy=what_helps(model)
        )
    conversion = plan_conversion(listed) if options.resume else None
    repairs = repair(model) if options.resume and conversion is None else []
    for sentence in repairs:
        # Show these now: the plan's warnings are lost if the start is refused.
        errors.warn(sentence)
    before = read_start(model) if options.resume else None
    damaged: list[str] = []
    if conversion is not None:
        found, damaged = conversion.checkpoint, [conversion.sentence]
    elif options.resume:
        if found is None or repairs:
            found = CheckpointStore(model).load_latest(with_optimizer=True)
        damaged = [] if found is None else _damaged(model, found)
    resumed = found.record if found is not None and options.resume else None
    trained = None if resumed is None else Design.of_record(model, resumed)
    resumes = None if resumed is None else resumed.name
    continues = options.resume or options.over_aborted
    previous = read_outcome(model) if continues else None
    began_at = first_start(previous, before)
    custom = settings.custom_files
    found_files = find(resumed_files(custom, prefix) if options.resume else custom, bucket)
    if conversion is not None:
        found_files |= conversion.own_files(found_files)
    before_this = prefix if options.resume else settings.pretrained_prefix
    taught = trained is not None and trained.parameters.taught
    if settings.pretrained and not options.resume:
        taught = is_taught(ModelStore(bucket, before_this))
    files = chosen_method(found_files, options.method, taught=taught)
    mark = None if resumed is None else resumed.counters.stage
    staged = plan_stages(settings, files, model, mark, resumes=options.resume)
    settings = staged.settings
    job = _job(settings, options, _seed(settings, options, before), began_at)
    wiping = options.wipe or options.over_aborted
    plans = Plans(wiping, trained, None if wiping or options.resume else listed)
    examined = examine_stages(settings, staged.review, files, bucket, plans, first=staged.first)
    refuse(examined.problems)
    inputs, design, transfer = examined.inputs, examined.design, examined.transfer
    if keys.HYPERPARAMETERS_FILE in found_files:  # the racer's file keeps what it says
        inputs = replace(inputs, hyperparameters=found_files[keys.HYPERPARAMETERS_FILE])
    noticed = grouped(of_severity([*clock, *examined.problems], "warning"))
    warnings = [*damaged, *settings.warnings, *staged.warnings, *map(str, noticed)]
    if taught:
        kept = not options.method and files != found_files
        warnings += _after_a_teacher(before_this, design, kept=kept)
    if resumes is not None and design.metadata.algorithm.replay:
        warnings += _replay_lost(design.metadata.algorithm, model, CheckpointName.parse(resumes))
    job = replace(job, stages=staged.stages, inputs=files_to_train_with(settings, inputs, design))
    source = None
    if transfer is not None:
        source = transfer.source
        errors.show(transfer.sentence)
    ends = ending(job, design.parameters)

    def review() -> None:
        if options.wipe or options.resume:
            return
        now, files = ModelListing(model), parameter_files(settings)
        if not (options.over_aborted and is_aborted_start(now, files)):
            refuse(review_prefix(now))

    with taken(job, model, review):
        records = StartRecorder(model)
        training = records.prepare(before, resumes=options.resume)
        wiped = options.wipe and is_used(model)
        if wiped:
            wipe(model, spared=[keys.lease(prefix)])
        begun = begun_by(job, began_at, ends)
        # First of all: a start that is cut off here must be known as one.
        write_outcome(model, begun)
        freeze(settings.custom_files, model, inputs, job.inputs, staged.review.frozen, trained)
        warnings += _forget_other_scores(settings, model, before)
        start = describe_start(settings, job.seed, source, before, training)
        bucket.put(keys.training_start(prefix), start.encode())
        new = NewStart(settings, start, begun, resumes, previous, job.inputs)
        training = records.record(new)
        describe(model, settings.model_description, is_new=not options.resume)
        noted = start_entries(start, resumes, previous, repairs)
        if transfer is not None:
            # Checkpoint 0 with a fresh optimizer: steps, episodes and time count from 0.
            own = {name: job.inputs[name] for name in model_files(prefix)}
            counters = Counters(critic_warmup=transfer.critic_warmup, inputs=own)
            CheckpointStore(model).save(0, 0, transfer.tensors, counters=counters)
        if conversion is not None:
            conversion.write()
        if not options.resume:
            begin_logs(settings.directory, prefix, settings.log_max_mb)
    job = replace(job, begun=begun, noted=noted, training=training)
    return RunPlan(job, inputs, warnings, resumes, ends, source, wiped)


def prepare_end_work(settings: Settings, outcome: RunOutcome, model: ModelStore) -> EndWorkPlan:
    """Take the model for the work that is left after a complete training.

    Raises:
        SettingsError: Another start trains the model.
    """
    seed = settings.train_seed or 0  # nothing is learned, so nothing is drawn
    job = _job(settings, StartOptions(whole_run=True), seed, outcome.began_at)
    begun = replace(begun_by(job, outcome.began_at, outcome.goals), message=outcome.message)
    text = f"A start on {begun.host} tries what is left to do: {', '.join(outcome.left)}."
    noted = JournalEntry(time.time(), "start", text, {"host": begun.host})
    job = replace(job, begun=begun, end_work=outcome.left, noted=(noted,))
    with taken(job, model, lambda: None):
        return EndWorkPlan(job, outcome)


def goals_of(
    settings: Settings, options: StartOptions, outcome: RunOutcome, model: ModelStore
) -> str:
    """Everything that would end a continuing training."""
    files = find(resumed_files(settings.custom_files, model.prefix), model.bucket)
    file = files.get(keys.HYPERPARAMETERS_FILE)
    if file is None:
        return ""  # a start says which file is missing
    parameters = Hyperparameters.from_bytes(file.data, file.origin)
    mark = CheckpointStore(model).stage_of_newest()
    staged = plan_stages(settings, files, model, mark, resumes=True)
    refuse(staged.review.problems)
    job = _job(staged.settings, options, 0, outcome.began_at)
    return ending(replace(job, stages=staged.stages), parameters)


def _after_a_teacher(before: str, design: Design, *, kept: bool) -> list[str]:
    lr = design.parameters.lr
    if kept:
        return [
            f"{design.parameters_origin} has no training_method, so that of {before} is kept: "
            'teacher. --no-teacher, or "training_method": "camera" in the file, goes on without it.'
        ]
    if design.parameters.taught or lr <= FINE_LR:
        return []
    return [
        f"{design.parameters_origin}: lr={lr:g} is high for the weights of {before}, which "
        f"learned from a teacher: they may be lost within a few updates. Write lr={FINE_LR:g} and "
        "target_kl=0.03 to go on without a teacher."
    ]


def _job(settings: Settings, options: StartOptions, seed: int, began_at: float) -> Job:
    return planned_job(
        settings,
        seed=seed,
        began_at=began_at,
        goals=options.goals,
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


def _replay_lost(
    algorithm: Algorithm, model: ModelStore, newest: CheckpointName | None
) -> list[str]:
    listed = (
        keys.rollout_key(model.prefix, info.key)
        for info in model.bucket.list(keys.rollouts_folder(model.prefix))
    )
    learned = range(0 if newest is None else newest.number)
    if not learned or any(each is not None and each.iteration in learned for each in listed):
        return []
    return [
        f"{algorithm.label} starts with an empty replay buffer, because the steps "
        "of earlier iterations are not in the bucket: a copy of a model has none. It learns from "
        "new steps only, which costs some iterations."
    ]


def _damaged(model: ModelStore, found: Checkpoint) -> list[str]:
    name = found.record.name
    warnings = [f"Checkpoint {why} The training continues from {name}." for why in found.damaged]
    if found.record.optimizer is not None and found.optimizer is None:
        key = keys.checkpoint_optimizer(model.prefix, name)
        warnings.append(
            f"{model.bucket.name}/{key} is missing or damaged. The optimizer starts with an empty "
            "state, which costs a few iterations."
        )
    return warnings


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
    settings: Settings, model: ModelStore, before: TrainingStart | None
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
            forget_scores(model)
            return [
                f"{settings.source(name)}: {name} was {known or 'not set'} until now, so the next "
                "checkpoint that is evaluated becomes the best."
            ]
    return []
