"""Looks up the state of a run: in its record here and in the bucket."""

import socket
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from drcli.base.errors import StorageError
from drcli.base.json_record import RecordError
from drcli.base.processes import exists
from drcli.bucket.bucket import Bucket, ObjectDamaged, ObjectMissing, read_record
from drcli.bucket.connect import open_running_bucket
from drcli.bucket.request_count import read_counts
from drcli.config.run_config import RunConfig
from drcli.learn.phases import Phase
from drcli.model import keys
from drcli.model.alarms import Convergence, alarms, convergence
from drcli.model.checkpoint_choice import laps_of
from drcli.model.checkpoints import CheckpointStore
from drcli.model.history import HistoryReader
from drcli.model.milestones import NO_MILESTONES, MilestoneKind, with_history
from drcli.model.model_list import CheckpointEntry
from drcli.model.model_prefix import newest_checkpoint
from drcli.model.model_store import ModelStore
from drcli.model.notes import read_notes
from drcli.model.reconstruct import readable_history, readable_scores
from drcli.model.training_state import (
    GONE_S,
    Rollback,
    read_reward_errors,
    read_rollbacks,
    read_shares_record,
)
from drcli.records.checkpoint import checkpoint_name
from drcli.records.heartbeat import WatchRecord
from drcli.records.iteration import IterationRecord, Laps
from drcli.records.job import MemberRecord
from drcli.records.reward import RewardCounts, sum_of
from drcli.records.run_record import (
    LIVE_STATES,
    ActivityRecord,
    RunRecord,
    State,
    log_file,
    run_folder,
)
from drcli.records.stage import PHASES, PhaseMark, StageMark
from drcli.records.training_record import DayBudget, Spending, budget_of
from drcli.run.cost import RequestReport, money_left, request_report, time_left_s
from drcli.run.seen_in_bucket import ended_elsewhere, trained_by
from drcli.run.seen_pulses import WorkerHealth
from drcli.run.worker_processes import TRAINER
from drcli.tracks.track_limit import limit_of_race, limit_text

# The phase of a training with a teacher.


@dataclass(frozen=True)
class PhaseReport:
    """A phase of a training with a teacher.

    Attributes:
        name: teacher, distillation or ppo.
        number: Its place among the phases, from 1.
        count: How many phases there are.
        iterations: Of the phase, until now.
        laps: Training episodes of its newest iteration that completed a lap.
        episodes: All training episodes of that iteration.
        best_lap_s: The fastest of these laps, simulated seconds; None without one.
        imitation_loss: How far the student is from its teacher; None where it is not taught.
        text: The same in words.
    """

    name: Phase
    number: int
    count: int
    iterations: int
    laps: int
    episodes: int
    best_lap_s: float | None
    imitation_loss: float | None
    text: str

    @staticmethod
    def of(mark: PhaseMark | None, history: Sequence[IterationRecord]) -> "PhaseReport | None":
        """The phase of the newest checkpoint; None without a teacher."""
        if mark is None:
            return None
        own = [each for each in history if each.iteration >= mark.iteration and each.phase]
        newest = own[-1] if own else None
        return PhaseReport(
            mark.name,
            mark.number,
            len(PHASES),
            len(own),
            0 if newest is None else newest.full_laps,
            0 if newest is None else newest.episodes,
            None if newest is None else newest.best_lap_s,
            None if newest is None else newest.imitation_loss,
            f"{mark}: {_driven(newest)}",
        )


def _driven(newest: IterationRecord | None) -> str:
    if newest is None:
        return "begins"
    words = f"{newest.full_laps} of {newest.episodes} laps"
    return words if newest.best_lap_s is None else f"{words}, best {newest.best_lap_s:.2f} s"


_NOT_RUNNING = "The local S3 server does not run."


@dataclass(frozen=True)
class WorkerReport:
    """One worker process.

    Attributes:
        name: "trainer", "sim-0", "sim-1", ...
        pid: Its process; None before it started.
        alive: Whether that process runs.
        restarts: How often the supervisor has restarted it.
        activity: What it does or waits for, in a few words.
        log: Path of its log file on this machine.
        health: Its progress and memory; null if it does not run.
        host: Machine on which it works; empty for this one.
    """

    name: str
    pid: int | None
    alive: bool
    restarts: int
    activity: str
    log: str
    health: WorkerHealth | None = None
    host: str = ""


@dataclass(frozen=True)
class JoinedReport:
    """A simulation worker on another machine.

    Attributes:
        name: Its number, as in "sim-2".
        host: Its machine.
        activity: What it does or waits for, in a few words.
        alive: Whether it was heard from lately.
        episodes: How many training episodes it drives in an iteration now.
    """

    name: str
    host: str
    activity: str
    alive: bool
    episodes: int


@dataclass(frozen=True)
class CheckpointLaps:
    """Laps of a checkpoint in evaluations during the training, which end at the first violation.

    Attributes:
        checkpoint: Its number; --checkpoint takes it.
        laps: How many it drove.
        clean: How many of them are clean: completed without a violation.
        median_s: Median time of the clean ones, simulated seconds; None without one.
        fastest_s: The fastest clean one.
        text: The same in words.
    """

    checkpoint: int
    laps: int
    clean: int
    median_s: float | None
    fastest_s: float | None
    text: str

    @staticmethod
    def of(checkpoint: int, laps: Laps | None) -> "CheckpointLaps | None":
        """The laps of a checkpoint; None without any."""
        if laps is None:
            return None
        return CheckpointLaps(
            checkpoint,
            laps.driven,
            laps.clean,
            laps.median_s,
            laps.fastest_s,
            str(laps),
        )


@dataclass(frozen=True)
class MilestoneReport:
    """A milestone of the training.

    Attributes:
        word: first-lap, three-laps or best-lap; --checkpoint takes it.
        checkpoint: Name of its checkpoint.
        laps: Clean laps of its evaluation.
        episodes: Episodes of its evaluation.
        best_lap_s: Fastest of the clean laps, simulated seconds.
    """

    word: MilestoneKind
    checkpoint: str
    laps: int
    episodes: int
    best_lap_s: float


@dataclass(frozen=True)
class RunReport:
    """Everything `dr-status` knows.

    Attributes:
        run_id: DR_RUN_ID.
        bucket: Name of the bucket.
        prefix: Model prefix in the bucket.
        world: DR_WORLD_NAME.
        state: Whether the run is starting or running, or how it ended.
        message: Why it ended.
        remedy: What to do if it failed.
        exit_code: Exit code of the supervisor once it has ended.
        started_at: Unix seconds of the start.
        elapsed_s: Wall time of training so far.
        pid: The supervisor.
        workers: All worker processes of this machine.
        joined: Simulation workers of other machines.
        history: All finished iterations, oldest first.
        best: The best checkpoint by DR_TRAIN_BEST_MODEL_METRIC.
        last: The newest checkpoint.
        best_laps: All evaluation laps of the best checkpoint; None without any.
        newest_laps: The newest evaluation; None before the first.
        warning: Problems with the learning curve; empty if there is none.
        advice: What to do about them, a sentence for each.
        damaged: What is wrong with each damaged object that this needs, and what to do about it;
            what it told is worked out from others, as far as possible.
        unreachable: Why the bucket cannot be read; iterations and checkpoints are then missing.
            Empty if it can be.
        iterations: Finished iterations.
        iterations_left: Until DR_TRAIN_MAX_ITERATIONS; None without that limit.
        time_left_s: Until the time limit; None without one.
        spending: Machine hours and money of all starts; None before the first count.
        money_left: Until DR_MAX_COST, USD; None without that limit.
        requests: Requests to the bucket of the newest start; None before the first count.
        priority: DR_PRIORITY at the start.
        threads: DR_THREADS at the start; 0 for all cores.
        ending: Whether the run is ending its workers: none of them is missed then.
        limit: How far the fastest lap of the best checkpoint is from the limit of the car on the
            track; empty if unknown.
        elsewhere: A sentence about the training of the model on another machine, if nothing was
            started on this one.
        watches: What the watches of the training warn of, a sentence each: memory, disk, stalls.
        reward_errors: Failures of the reward function that all workers have counted, and episodes
            that it declared broken; None if nothing was counted.
        rollbacks: When the training went back to an older checkpoint, oldest first.
        convergence: How near training and evaluation are; None before there are five evaluations.
        milestones: Checkpoints of the first lap, the first three laps, the fastest lap, as far as
            they were reached; `dr-list-checkpoints` says whether they are still there.
        notes: What the racer wrote about the model; only in `dr-status`.
        stage: Stage of the newest checkpoint; None without a curriculum.
        phase: Phase of the newest checkpoint; None without a teacher.
        budget: Of today, for all trainings of the folder; None without a limit.
    """

    run_id: int
    bucket: str
    prefix: str
    world: str
    state: State
    message: str = ""
    remedy: str = ""
    exit_code: int | None = None
    started_at: float | None = None
    elapsed_s: float = 0.0
    pid: int | None = None
    workers: list[WorkerReport] = field(default_factory=list)
    history: list[IterationRecord] = field(default_factory=list)
    best: CheckpointEntry | None = None
    last: CheckpointEntry | None = None
    best_laps: CheckpointLaps | None = None
    newest_laps: CheckpointLaps | None = None
    warning: str = ""
    damaged: list[str] = field(default_factory=list)
    unreachable: str = ""
    iterations: int = 0
    iterations_left: int | None = None
    time_left_s: float | None = None
    spending: Spending | None = None
    money_left: float | None = None
    requests: RequestReport | None = None
    watches: list[str] = field(default_factory=list)
    advice: list[str] = field(default_factory=list)
    reward_errors: RewardCounts | None = None
    rollbacks: list[Rollback] = field(default_factory=list)
    convergence: Convergence | None = None
    milestones: list[MilestoneReport] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    stage: StageMark | None = None
    phase: PhaseReport | None = None
    budget: DayBudget | None = None
    priority: str = "normal"
    threads: int = 0
    joined: list[JoinedReport] = field(default_factory=list)
    ending: bool = False
    elsewhere: str = ""
    limit: str = ""

    @property
    def dead(self) -> list[str]:
        """Workers that should run but do not."""
        if self.state not in LIVE_STATES or self.ending:
            return []
        return [worker.name for worker in self.workers if worker.pid and not worker.alive]


def inspect(config: RunConfig, reader: HistoryReader | None = None) -> RunReport:
    """A `reader` saves time if this is repeated."""
    folder = run_folder(config.directory, config.run_id)
    record = RunRecord.read(folder)
    alive = record is not None and record.alive
    if not alive:
        record = RunRecord.read(folder)  # a supervisor records the outcome just before it exits
    if record is None:
        nothing = RunReport(
            run_id=config.run_id,
            bucket=config.storage.bucket,
            prefix=config.model.prefix,
            world=config.race().world_name,
            state="none",
            budget=_budget(config),
        )
        try:
            bucket = open_running_bucket(config.storage)
            if bucket is None and config.storage.engine == "rclone":
                return nothing  # the bucket does not exist yet
            if bucket is None:
                return replace(nothing, unreachable=_NOT_RUNNING)
            record = ended_elsewhere(config, bucket)
            if record is None:
                return replace(
                    nothing, elsewhere=trained_by(ModelStore(bucket, config.model.prefix))
                )
        except StorageError as error:
            return replace(nothing, unreachable=str(error))
    # The bucket of the start: the settings may name another one now.
    bucket = open_running_bucket(record.storage_at_start(config.storage, config.directory))
    history: list[IterationRecord] = []
    best = last = best_laps = None
    damaged: list[str] = []
    said: dict[str, ActivityRecord] = {}
    failed: RewardCounts | None = None
    rollbacks: list[Rollback] = []
    joined: list[JoinedReport] = []
    stage: StageMark | None = None
    phase: PhaseReport | None = None
    unreachable = "" if bucket is not None else _NOT_RUNNING
    if bucket is not None:
        try:
            model = ModelStore.of(config.model, bucket, record.prefix)
            history, damaged = readable_history(model, reader)
            scores, also = readable_scores(model)
            damaged += also
            if scores is not None:
                name = scores.best_checkpoint.name
                laps = laps_of(model, history, name)
                best = CheckpointEntry.of(scores.best_checkpoint, model.metric, laps)
                best_laps = CheckpointLaps.of(checkpoint_name(name).number, laps)
                last = CheckpointEntry.of(scores.last_checkpoint, model.metric)
            elif newest := newest_checkpoint(
                ModelStore(bucket, record.prefix)
            ):  # its index is lost
                last = CheckpointEntry(str(newest), None)
            counted = read_reward_errors(ModelStore(bucket, record.prefix))
            if counted:
                failed = sum_of(each.total for each in counted)
            try:
                rollbacks = read_rollbacks(ModelStore(bucket, record.prefix)).entries
            except ObjectDamaged as error:
                damaged.append(f"{error} {error.remedy}")
            marked = not history or history[-1].stage or history[-1].phase
            if config.train.curriculum_file or marked:
                counters = CheckpointStore(ModelStore(bucket, record.prefix)).counters_of_newest()
                stage, phase = counters.stage, PhaseReport.of(counters.phase, history)
            if alive:
                joined = _joined(bucket, record)
            names = [worker.name for worker in record.workers]
            said = {name: _said(ModelStore(bucket, record.prefix), name) for name in names}
        except StorageError as error:
            said = {TRAINER: _here(f"the bucket does not answer: {error}")}
            unreachable = str(error)
    if record.state in LIVE_STATES and not alive:
        record = replace(
            record,
            state="lost",
            message="The supervisor died without giving a reason; its workers exited with it.",
            remedy="Continue with `dr-start-training --resume`.",
        )
    running = record.state in LIVE_STATES
    workers = [
        WorkerReport(
            name=worker.name,
            pid=worker.pid,
            alive=running and worker.pid is not None and exists(worker.pid),
            restarts=worker.restarts,
            activity=said[worker.name].activity if running and worker.name in said else "",
            log=str(log_file(config.directory, record.prefix, worker.name)),
            health=WorkerHealth.of(folder, worker.name, worker.pid) if running else None,
            host=_other_host(said.get(worker.name)) if running else "",
        )
        for worker in record.workers
    ]
    spending = Spending.read(folder)
    if spending is not None and spending.session != record.session:
        spending = None  # of an earlier start; this one has not counted yet
    most = config.train.train_max_iterations
    found = alarms(history, best.name if best is not None else None)
    return RunReport(
        run_id=record.run_id,
        bucket=record.bucket,
        prefix=record.prefix,
        world=record.world if stage is None else stage.world,
        state=record.state,
        message=record.message,
        remedy=record.remedy,
        exit_code=record.exit_code,
        started_at=record.started_at,
        elapsed_s=history[-1].elapsed_s if history else 0.0,
        pid=record.pid or None,
        ending=record.ending,
        workers=workers,
        history=history,
        best=best,
        last=last,
        best_laps=best_laps,
        limit=_limit(config, record.world if stage is None else stage.world, best_laps),
        newest_laps=_newest_laps(history),
        warning="; ".join(alarm.text for alarm in found),
        advice=[alarm.remedy for alarm in found],
        reward_errors=failed,
        rollbacks=rollbacks,
        convergence=convergence(history),
        damaged=damaged,
        unreachable=unreachable,
        iterations=len(history),
        iterations_left=max(0, most - len(history)) if most > 0 and not unreachable else None,
        time_left_s=time_left_s(spending),
        spending=spending,
        money_left=money_left(spending),
        requests=request_report(
            read_counts(folder, record.session),
            0.0 if spending is None else spending.own_hours,
            record.storage_at_start(config.storage, config.directory),
        ),
        watches=WatchRecord.of_session(folder, record.session).warnings,
        milestones=[
            MilestoneReport(kind, found.checkpoint, found.laps, found.episodes, found.best_lap_s)
            for kind, found in with_history(NO_MILESTONES, history).reached()
        ],
        stage=stage,
        phase=phase,
        budget=_budget(config),
        priority=record.priority,
        threads=record.threads,
        joined=joined,
    )


def _limit(config: RunConfig, world: str, laps: CheckpointLaps | None) -> str:
    if laps is None or laps.fastest_s is None:
        return ""
    race = config.race()
    stored = limit_of_race(race.replaced(world_name=world), reverse=race.train_reverse_direction)
    return limit_text(laps.fastest_s, stored)


def _newest_laps(history: Sequence[IterationRecord]) -> CheckpointLaps | None:
    newest = next((each for each in reversed(history) if each.evaluation is not None), None)
    return None if newest is None else CheckpointLaps.of(newest.iteration, newest.evaluation)


def _budget(config: RunConfig) -> DayBudget | None:
    budget = budget_of(config.directory, config.unattended, time.time())
    return budget if budget.limited else None


def notes_of_run(config: RunConfig, report: RunReport) -> list[str]:
    bucket = open_running_bucket(config.storage)
    if bucket is None or bucket.name != report.bucket:
        return []
    try:
        notes = read_notes(ModelStore(bucket, report.prefix))
    except StorageError:
        return []
    return [note.record.text for note in notes if note.record is not None]


def _joined(bucket: Bucket, record: RunRecord) -> list[JoinedReport]:
    model = ModelStore(bucket, record.prefix)
    shares = read_shares_record(model)
    if shares is None or shares.session != record.session:
        return []
    newest = shares.newest[-1] if shares.newest else None
    found = []
    for member, number in sorted(shares.numbers.items(), key=lambda each: each[1]):
        try:
            data, age_s = bucket.get_with_age(keys.member(record.prefix, member))
            host = MemberRecord.decode(data).host
        except (ObjectMissing, RecordError):
            continue  # it has just left
        own = newest.of(number) if newest is not None else None
        found.append(
            JoinedReport(
                name=f"sim-{number}",
                host=host,
                activity=_said(model, f"sim-{number}").activity,
                alive=age_s is None or age_s < GONE_S,
                episodes=0 if own is None else own.count,
            )
        )
    return found


def _said(model: ModelStore, name: str) -> ActivityRecord:
    key = keys.status(model.prefix, name)
    try:
        return read_record(model.bucket, key, ActivityRecord.decode)
    except ObjectMissing:
        return _here("starting")
    except ObjectDamaged as error:
        return _here(str(error))


def _here(text: str) -> ActivityRecord:
    return ActivityRecord(text, 0.0, 0, "")


def _other_host(said: ActivityRecord | None) -> str:
    return said.host if said is not None and said.host != socket.gethostname() else ""
