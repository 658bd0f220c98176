"""Runs many evaluations on all cores, and makes their table."""

import json
import os
import re
import shlex
import shutil
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Annotated

from drcli.base.early_process import ChildProcess
from drcli.base.errors import BadValue, DrError, Place, ProblemsError, SettingsError
from drcli.base.files import load_record
from drcli.base.installation import installation_error
from drcli.base.json_record import JsonRecord, SafeInt, Seconds
from drcli.base.processes import started_s
from drcli.base.report import Col, View, bold, table
from drcli.bucket.bucket import Bucket
from drcli.bucket.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.config.settings import Settings
from drcli.config.track_names import expand_worlds, track_problem, worlds_problems
from drcli.config.value_types import CheckpointChoice, parse_checkpoint
from drcli.model import keys
from drcli.model.model_list import fits, model_prefixes
from drcli.model.model_store import ModelStore
from drcli.records.evaluation_task import EvaluationTask, PolicySource, RobustResult, TaskOutcome
from drcli.records.job import Job, WorkerExit
from drcli.records.run_record import EvaluationRecord, claim, log_file, sweep
from drcli.run.evaluation import EXIT_S, failure, until_stopped
from drcli.run.evaluation_plan import check_model, checked_source, choose_checkpoint, evaluation_job
from drcli.run.evaluation_report import (
    LapsReport,
    best_average_s,
    best_finished_s,
    compare,
    laps_of,
    laps_report,
    trial_reports,
)
from drcli.run.log_sender import sent_to_cloud_watch
from drcli.run.run_logs import empty_logs
from drcli.run.worker_processes import end_process, start_process
from drcli.tracks.track_limit import limit_of_race
from drcli.workers.cores import usable_cores

# Plans evaluations that share workers: models, tracks, or a grid.


@dataclass(frozen=True)
class Refused:
    prefix: str
    reason: str
    remedy: str


@dataclass(frozen=True)
class ManyPlan:
    job: Job
    stamp: str
    worlds: list[str]
    refused: list[Refused] = field(default_factory=list)
    compares: bool = False


@dataclass(frozen=True)
class Rival:
    prefix: str | None
    choice: CheckpointChoice = "best"

    @staticmethod
    def parse(text: str) -> "Rival":
        """Read CHECKPOINT, PREFIX or PREFIX:CHECKPOINT; BadValue if it is none."""
        with suppress(BadValue):
            return Rival(None, parse_checkpoint(text))
        prefix, colon, choice = text.strip().partition(":")
        prefix = prefix.strip("/")
        if not prefix:
            raise BadValue(
                "names neither a checkpoint nor a model",
                "Write the number of a checkpoint, a word such as last, or the prefix of a model.",
            )
        return Rival(prefix, parse_checkpoint(choice)) if colon else Rival(prefix)


def worlds_of(settings: Settings, text: str) -> list[str]:
    """The tracks of a list in the form of DR_TRAIN_WORLDS, installed or not.

    Raises:
        ProblemsError: A word of it names no track.
    """
    option = "--worlds"
    problems = worlds_problems(option, Place(option), text, settings.race, known_suffices=True)
    if errors := [each for each in problems if each.severity == "error"]:
        raise ProblemsError(errors)
    return [*expand_worlds(text, settings.tracks_folder)]


def prepare_many(
    settings: Settings,
    *,
    models: Sequence[str] = (),
    worlds: Sequence[str] = (),
    robust: bool = False,
    fresh_laps: int = 0,
    rival: Rival | None = None,
    seed: int | None = None,
    own: PolicySource | None = None,
    on_progress: Callable[[str], None] = lambda text: None,
) -> ManyPlan:
    """Find the models and their checkpoints, before a process starts.

    Args:
        settings: Describe the race in DR_EVAL_*.
        models: Prefixes, perhaps with `*` and `?`.
        worlds: Tracks; none for that of the settings.
        robust: Drive the grid of disturbances.
        fresh_laps: Laps from fresh starts instead of the trials.
        rival: Drives from the same starts; only without `models` and `worlds`.
        seed: Of all random numbers.
        own: What drives; only without `models`.
        on_progress: Shows sentences.

    Raises:
        SettingsError: A track does not exist, no model fits, or the only one cannot drive.
    """
    if settings.race_type == "HEAD_TO_MODEL":
        raise SettingsError(
            "DR_RACE_TYPE=HEAD_TO_MODEL races two models, but here each model drives alone.",
            remedy="Choose another DR_RACE_TYPE, or run `dr-evaluate` without --models, --worlds, "
            "--robust and --laps.",
        )
    worlds = list(dict.fromkeys(worlds)) or [settings.world_name]
    for world in worlds:
        problem = track_problem(on_world(settings, world).race)
        if problem is not None:
            raise ProblemsError([replace(problem, severity="error")])
    source = checked_source(own or PolicySource())
    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    prefixes = matching_models(bucket, models) if models else [settings.model_prefix]
    chosen: dict[str, str] = {}
    refused: list[Refused] = []
    for prefix in prefixes:
        try:
            if source.file is None:
                check_model(
                    ModelStore(bucket, prefix), "--models" if models else "DR_LOCAL_S3_MODEL_PREFIX"
                )
                chosen[prefix] = choose_checkpoint(settings, ModelStore(bucket, prefix))
            else:
                chosen[prefix] = source.file.name
        except DrError as error:
            if not models:
                raise
            refused.append(Refused(prefix, str(error), error.remedy))
    entrants = [
        (prefix, chosen[prefix], world, index, source)
        for index, world in enumerate(worlds)
        for prefix in chosen
    ]
    if rival is not None:
        prefix, checkpoint = _rival(settings, bucket, rival, entrants[0])
        # Its stamp is a second later, because it may be the same model.
        engine = source if source.file is None else checked_source(PolicySource())
        entrants.append((prefix, checkpoint, worlds[0], 1, engine))
    sweep(settings.directory, settings.run_id)
    stamp, folder = _claimed(settings)
    tasks = [
        EvaluationTask(
            number=number,
            prefix=prefix,
            metrics_prefix=_metrics_prefix(settings, prefix),
            checkpoint=checkpoint,
            world=world,
            stamp=_free_stamp(ModelStore(bucket, prefix), stamp, index),
            source=driver,
            robust=robust,
            fresh_laps=fresh_laps,
        )
        for number, (prefix, checkpoint, world, index, driver) in enumerate(entrants)
    ]
    if tasks:
        on_progress(_announced(tasks, worlds))
    job = replace(evaluation_job(settings, folder, seed), tasks=tuple(tasks))
    return ManyPlan(job, stamp, worlds, refused, compares=rival is not None)


def _rival(
    settings: Settings, bucket: Bucket, rival: Rival, own: tuple[str, str, str, int, PolicySource]
) -> tuple[str, str]:
    prefix = rival.prefix or settings.model_prefix
    model = ModelStore(bucket, prefix)
    check_model(model, "--against")
    asked = settings.replaced(eval_checkpoint=str(rival.choice))
    checkpoint = choose_checkpoint(asked, model)
    if (prefix, checkpoint) == own[:2] and own[-1].file is None:
        raise SettingsError(
            f"--against chooses {checkpoint} of {prefix}, which drives anyway.",
            remedy="Choose another checkpoint, as in --against last; `dr-list-checkpoints` lists "
            "them.",
        )
    return prefix, checkpoint


def on_world(settings: Settings, world: str) -> Settings:
    if world == settings.world_name:
        return settings
    sources = {**settings.sources, "DR_WORLD_NAME": Place("flag")}
    return settings.replaced(world_name=world, sources=sources)


def matching_models(bucket: Bucket, patterns: Sequence[str]) -> list[str]:
    """Sorted; SettingsError if a pattern fits none."""
    known = model_prefixes(bucket)
    found: set[str] = set()
    for pattern in patterns:
        fitting = {prefix for prefix in known if fits(prefix, pattern)}
        if not fitting:
            some = ", ".join(sorted(known)[:5]) or "no models at all"
            raise SettingsError(
                f"No model in s3://{bucket.name} fits --models {pattern!a}; it has {some}.",
                remedy="List them with `dr-list-models`; * and ? stand for any characters, as in "
                '--models "team/*".',
            )
        found |= fitting
    return sorted(found)


def _metrics_prefix(settings: Settings, prefix: str) -> str:
    if prefix == settings.model_prefix:
        return settings.metrics_prefix
    return keys.metrics_prefix(prefix)


def _announced(tasks: Sequence[EvaluationTask], worlds: Sequence[str]) -> str:
    drivers = list(dict.fromkeys((task.prefix, task.checkpoint) for task in tasks))
    what = f"{len(drivers)} models"
    if len(drivers) == 1 or {prefix for prefix, _ in drivers} == {drivers[0][0]}:
        what = f"{' and '.join(name for _, name in drivers)} of {drivers[0][0]}"
    laps = tasks[0].fresh_laps
    how = " under a grid of disturbances" if tasks[0].robust else ""
    how += f", {laps} lap{'s' * (laps != 1)} from fresh starts" if laps else ""
    return f"Evaluating {what} on {', '.join(worlds)}{how} ..."


def _claimed(settings: Settings) -> tuple[str, Path]:
    at = time.time()
    while True:
        stamp = time.strftime("%Y%m%d%H%M%S", time.localtime(at))
        folder = claim(settings.directory, settings.run_id, stamp)
        if folder is not None:
            return stamp, folder
        at += 1.0


def _free_stamp(model: ModelStore, stamp: str, index: int) -> str:
    at = time.mktime(time.strptime(stamp, "%Y%m%d%H%M%S")) + index
    while True:
        found = time.strftime("%Y%m%d%H%M%S", time.localtime(at))
        if not model.bucket.exists(keys.evaluation_trace(model.prefix, found)):
            return found
        at += 60.0


POLL_S = 0.2
_installation_error = cache(installation_error)  # many evaluations may fail for the same reason


@dataclass(frozen=True)
class TableRow(JsonRecord):
    """A model on a track.

    Attributes:
        prefix: Model prefix.
        checkpoint: Name of its checkpoint; empty where it cannot be evaluated.
        world: The track.
        completed: Trials that completed the lap, with or without resets.
        trials: All trials.
        progress: Mean percent of the lap over the trials.
        best_lap_s: Fastest clean lap, simulated seconds.
        best_average_s: Least mean time of DR_EVAL_AVERAGE_LAPS completed laps in a row.
        off_track: How often the car left the track.
        robust_score: Of a robust evaluation.
        reason: Why it could not be evaluated; empty if it was.
        remedy: What to do about it.
        clean: Trials that completed the lap without reset and penalty.
        resets: How often the car was put back on the track in all trials.
        median_s: Median time of the clean laps.
        best_finished_s: Fastest completed lap, penalties included.
    """

    prefix: str
    checkpoint: str
    world: str
    completed: SafeInt = 0
    trials: SafeInt = 0
    progress: float = 0.0
    best_lap_s: Seconds | None = None
    best_average_s: Seconds | None = None
    off_track: SafeInt = 0
    robust_score: float | None = None
    reason: str = ""
    remedy: str = ""
    clean: SafeInt = 0
    resets: SafeInt = 0
    median_s: Seconds | None = None
    best_finished_s: Seconds | None = None


@dataclass(frozen=True)
class BestStart:
    """The best model on a track."""

    world: Annotated[str, "The track."]
    prefix: Annotated[str, "Model prefix."]
    checkpoint: Annotated[str, "Name of the checkpoint that drove."]
    command: Annotated[str, "Trains a new model on this track from it."]


_COLUMNS = (
    Col("track", of=lambda row: row.world, side="left"),
    Col("model", of=lambda row: row.prefix, side="left"),
    Col("checkpoint", of=lambda row: row.checkpoint, side="left"),
    Col("clean laps", of=lambda row: f"{row.clean}/{row.trials}"),
    Col("resets", of=lambda row: row.resets),
    Col("progress", "{:.0f} %", of=lambda row: row.progress),
    Col("median", "{:.2f} s", of=lambda row: row.median_s, none=""),
    Col("best lap", "{:.2f} s", of=lambda row: row.best_lap_s, none=""),
    Col("best average", "{:.2f} s", of=lambda row: row.best_average_s, none=""),
    Col("robust score", "{:.1f}", of=lambda row: row.robust_score, none=""),
)


@dataclass(frozen=True)
class TableReport:
    """The result of many evaluations."""

    rows: Annotated[
        list[TableRow], "Track by track, the best model first; models that cannot drive last."
    ]
    best: Annotated[
        list[BestStart],
        "For each track with a model that got somewhere, how to train on from the best there.",
    ]
    table: Annotated[str, "Key of this table in the bucket."]
    robust: Annotated[
        list[RobustResult], "The grids, if these were driven, in the order of the rows."
    ] = field(default_factory=list)
    notes: Annotated[list[str], "What was driven otherwise than the settings ask, and why."] = (
        field(default_factory=list)
    )
    laps: Annotated[
        list[LapsReport],
        "The laps from fresh starts, if these were driven, in the order of the rows; a "
        "single report, which has the other one in it, if two are compared.",
    ] = field(default_factory=list)

    def view(self) -> View:
        driven = [row for row in self.rows if not row.reason]
        failed = [row for row in self.rows if row.reason]
        yield table(driven, *_COLUMNS)
        reason = Col("not evaluated", of=lambda row: row.reason, side="left")
        yield table(failed, *_COLUMNS[:2], reason)
        for best in self.best:
            yield f"Best on {best.world}: {best.prefix}. Train on from it there with:"
            yield [bold(best.command)]


def run_many(plan: ManyPlan, on_progress: Callable[[str], None] = lambda text: None) -> TableReport:
    """Drive all evaluations of a plan, and put the table into the bucket.

    Raises:
        DrError: There is only one evaluation or comparison, and it failed.
    """
    job = plan.job
    try:
        if job.tasks:
            with until_stopped():
                _drive(plan, on_progress)
        outcomes = [_outcome(plan, task) for task in job.tasks]
    finally:
        shutil.rmtree(job.folder, ignore_errors=True)
    failed = next((outcome for outcome in outcomes if outcome.reason), None)
    if failed is not None and not plan.refused and (len(outcomes) == 1 or plan.compares):
        raise failure(failed.code, failed.reason, failed.remedy)
    report = _report(plan, outcomes)
    table = {"rows": [row.to_json() for row in report.rows], "best": list(map(asdict, report.best))}
    bucket = open_bucket(job.config.storage)
    bucket.put(report.table, json.dumps(table, allow_nan=False).encode())
    return report


def _drive(plan: ManyPlan, on_progress: Callable[[str], None]) -> None:
    job = plan.job
    shares = min(usable_cores(job.config.train), len(job.tasks))
    names = ["evaluation", *(f"evaluation-{share}" for share in range(1, shares))]
    for name in names:
        empty_logs(job.directory, job.config.model.prefix, name)
    with sent_to_cloud_watch(job, names):
        _work(plan, names, on_progress)


def _work(plan: ManyPlan, names: Sequence[str], on_progress: Callable[[str], None]) -> None:
    job = plan.job
    processes: list[ChildProcess] = []
    said: set[int] = set()
    try:
        for share, name in enumerate(names):
            module = "drcli.drive.evaluate_many"
            processes.append(start_process(job, name, module, str(share), str(len(names))))
            if share == 0:
                _write_record(plan, processes[0].pid)
        while any(process.poll() is None for process in processes):
            time.sleep(POLL_S)
            for task in job.tasks:
                if task.number not in said and (job.folder / task.outcome_file).exists():
                    said.add(task.number)
                    if len(job.tasks) > 1:
                        on_progress(f"{len(said)} of {len(job.tasks)}: {task.prefix}, {task.world}")
    except BaseException:
        for process in processes:
            process.terminate()
        for process in processes:
            end_process(process, EXIT_S)
        raise


def _write_record(plan: ManyPlan, worker_pid: int) -> None:
    config, (first, *rest) = plan.job.config, plan.job.tasks
    EvaluationRecord(
        run_id=config.run_id,
        stamp=plan.stamp,
        bucket=config.storage.bucket,
        prefix=first.prefix,
        world=first.world,
        checkpoint=first.checkpoint,
        pid=os.getpid(),
        pid_started=started_s(os.getpid()) or 0.0,
        worker_pid=worker_pid,
        started_at=time.time(),
        others=list(dict.fromkeys(task.prefix for task in rest)),
    ).write(plan.job.folder)


def _outcome(plan: ManyPlan, task: EvaluationTask) -> TaskOutcome:
    found = load_record(TaskOutcome, plan.job.folder / task.outcome_file)
    if found is not None:
        return found
    words = WorkerExit.read(plan.job.folder, "evaluation")
    if words is not None:
        return TaskOutcome(reason=words.message, remedy=words.remedy, code=words.code)
    if broken := _installation_error():
        return TaskOutcome(reason=str(broken), remedy=broken.remedy, code=broken.code)
    path = log_file(plan.job.directory, plan.job.config.model.prefix, "evaluation")
    return TaskOutcome(
        reason="Its worker process ended without a result.", remedy=f"Read its log: {path}."
    )


def _report(plan: ManyPlan, outcomes: Sequence[TaskOutcome]) -> TableReport:
    laps = plan.job.config.evaluation.eval_average_laps
    rows = [
        _row(task, outcome, laps) for task, outcome in zip(plan.job.tasks, outcomes, strict=True)
    ]
    rows += [
        TableRow(one.prefix, "", world, reason=one.reason, remedy=one.remedy)
        for one in plan.refused
        for world in plan.worlds
    ]
    rows.sort(key=lambda row: (plan.worlds.index(row.world), _rank(row)))
    places = {(row.prefix, row.world): place for place, row in enumerate(rows)}
    robust = [outcome.robust for outcome in outcomes if outcome.robust is not None]
    robust.sort(key=lambda found: places[found.prefix, found.world])
    samples = [
        _laps(plan.job, task, outcome)
        for task, outcome in zip(plan.job.tasks, outcomes, strict=True)
        if task.fresh_laps and not outcome.reason
    ]
    if plan.compares:
        first, second = samples
        samples = [replace(first, against=second, comparison=compare(first, second))]
    samples.sort(key=lambda found: places[found.prefix, found.world])
    notes = dict.fromkeys(note for outcome in outcomes for note in outcome.notes)
    return TableReport(
        rows, _best(plan.worlds, rows), keys.comparison(plan.stamp), robust, [*notes], samples
    )


def _laps(job: Job, task: EvaluationTask, outcome: TaskOutcome) -> LapsReport:
    return laps_report(
        trial_reports(outcome.trials),
        prefix=task.prefix,
        world=task.world,
        checkpoint=task.checkpoint,
        seed=job.seed,
        simtrace=keys.evaluation_trace(task.prefix, task.stamp),
        metrics=keys.evaluation_metrics(task.metrics_prefix, task.stamp),
        runtime=task.source.runtime or "torch",
        file=None if task.source.file is None else str(task.source.file),
        line=limit_of_race(
            job.config.race().replaced(world_name=task.world),
            reverse=job.config.evaluation.eval_reverse_direction,
        ),
    )


def _row(task: EvaluationTask, outcome: TaskOutcome, laps: int) -> TableRow:
    begin = (task.prefix, task.checkpoint, task.world)
    if outcome.reason:
        return TableRow(*begin, reason=outcome.reason, remedy=outcome.remedy)
    if outcome.robust is not None:
        cells = outcome.robust.cells
        trials = sum(cell.trials for cell in cells)
        times = [cell.lap_s for cell in cells if cell.lap_s is not None]
        return TableRow(
            *begin,
            completed=sum(cell.completed for cell in cells),
            clean=sum(cell.completed for cell in cells),
            trials=trials,
            progress=sum(cell.progress * cell.trials for cell in cells) / trials,
            best_lap_s=min(times, default=None),
            best_finished_s=min(times, default=None),
            robust_score=outcome.robust.robust_score,
        )
    trials_ = trial_reports(outcome.trials)
    clean = laps_of(trials_)
    return TableRow(
        *begin,
        completed=sum(trial.finished for trial in trials_),
        clean=clean.clean,
        resets=sum(trial.resets for trial in trials_),
        median_s=clean.median_s,
        best_finished_s=best_finished_s(trials_),
        trials=len(trials_),
        progress=sum(trial.progress for trial in trials_) / max(len(trials_), 1),
        best_lap_s=clean.fastest_s,
        # Laps from fresh starts do not follow each other.
        best_average_s=None if task.fresh_laps else best_average_s(trials_, laps),
        off_track=sum(trial.off_track for trial in trials_),
    )


def _rank(row: TableRow) -> tuple[float, ...]:
    many = float("inf")
    times = row.best_average_s or row.median_s, row.best_lap_s, row.best_finished_s
    return (
        float(bool(row.reason)),
        -(row.robust_score or 0.0),
        -row.clean / max(row.trials, 1),
        -row.completed / max(row.trials, 1),
        *(many if time_s is None else time_s for time_s in times),
        -row.progress,
    )


def _best(worlds: Sequence[str], rows: Sequence[TableRow]) -> list[BestStart]:
    found = []
    for world in worlds:
        first = next((row for row in rows if row.world == world and not row.reason), None)
        if first is not None and first.progress > 0.0:
            command = training_command(first.prefix, world)
            found.append(BestStart(world, first.prefix, first.checkpoint, command))
    return found


def training_command(prefix: str, world: str) -> str:
    short = re.sub(r"[^A-Za-z0-9._-]+", "-", world.rpartition("/")[2].removesuffix(".npy"))
    settings = {
        "DR_WORLD_NAME": world,
        "DR_LOCAL_S3_PRETRAINED": "True",
        "DR_LOCAL_S3_PRETRAINED_PREFIX": prefix,
        "DR_LOCAL_S3_MODEL_PREFIX": f"{prefix}-{short}",
    }
    given = " ".join(f"{name}={shlex.quote(value)}" for name, value in settings.items())
    return f"{given} dr-start-training"
