"""Looks up the state of a run: in its record here and in the bucket."""

import socket
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

from drcli.base.errors import StorageError
from drcli.base.json_record import RecordError
from drcli.base.processes import exists
from drcli.base.report import Styled, View, abridged, clock, counted
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
from drcli.model.milestones import NO_MILESTONES, MilestoneReport, with_history
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
from drcli.run.heartbeat_monitor import WorkerHealth
from drcli.run.seen_in_bucket import SeenRun, distant_run, ended_elsewhere, trained_by
from drcli.run.worker_processes import TRAINER
from drcli.tracks.track_limit import limit_of_race, limit_text

# The phase of a training with a teacher.


@dataclass(frozen=True)
class PhaseReport:
    """A phase of a training with a teacher."""

    name: Annotated[Phase, "teacher, distillation or ppo."]
    number: Annotated[int, "Its place among the phases, from 1."]
    count: Annotated[int, "How many phases there are."]
    iterations: Annotated[int, "Of the phase, until now."]
    laps: Annotated[int, "Training episodes of its newest iteration that completed a lap."]
    episodes: Annotated[int, "All training episodes of that iteration."]
    best_lap_s: Annotated[
        float | None, "The fastest of these laps, simulated seconds; None without one."
    ]
    imitation_loss: Annotated[
        float | None, "How far the student is from its teacher; None where it is not taught."
    ]
    text: Annotated[str, "The same in words."]

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
    """One worker process."""

    name: Annotated[str, '"trainer", "sim-0", "sim-1", ...']
    pid: Annotated[int | None, "Its process; None before it started."]
    alive: Annotated[bool, "Whether that process runs."]
    restarts: Annotated[int, "How often the supervisor has restarted it."]
    activity: Annotated[str, "What it does or waits for, in a few words."]
    log: Annotated[str, "Path of its log file on this machine."]
    health: Annotated[WorkerHealth | None, "Its progress and memory; null if it does not run."] = (
        None
    )
    host: Annotated[str, "Machine on which it works; empty for this one."] = ""

    def line(self, *, ending: bool) -> str:
        if self.pid is None and self.host:
            return f"{self.name} on {self.host}: {self.activity}"
        if self.pid is None:
            return f"{self.name}: not started, or left out"
        gone = "ended" if ending else "DEAD"
        state = f"{'alive' if self.alive else gone}, process {self.pid}"
        state += f", restarted {self.restarts} x" if self.restarts else ""
        health = f" ({self.health.words(self.name)})" if self.health and self.alive else ""
        host = f" on {self.host}" if self.host else ""
        activity = "" if ending and not self.alive else f": {self.activity}{health}"
        return f"{self.name} ({state}){host}{activity}"


@dataclass(frozen=True)
class JoinedReport:
    """A simulation worker on another machine."""

    name: Annotated[str, 'Its number, as in "sim-2".']
    host: Annotated[str, "Its machine."]
    activity: Annotated[str, "What it does or waits for, in a few words."]
    alive: Annotated[bool, "Whether it was heard from lately."]
    episodes: Annotated[int, "How many training episodes it drives in an iteration now."]

    def __str__(self) -> str:
        part = counted(self.episodes, "episode") if self.episodes else "no episodes now"
        silent = "" if self.alive else ", silent"
        return f"{self.name} on {self.host}: {self.activity or 'starting'} ({part}{silent})"


@dataclass(frozen=True)
class CheckpointLaps:
    """Laps of a checkpoint in evaluations during the training, which end at the first violation."""

    checkpoint: Annotated[int, "Its number; --checkpoint takes it."]
    laps: Annotated[int, "How many it drove."]
    clean: Annotated[int, "How many of them are clean: completed without a violation."]
    median_s: Annotated[
        float | None, "Median time of the clean ones, simulated seconds; None without one."
    ]
    fastest_s: Annotated[float | None, "The fastest clean one."]
    text: Annotated[str, "The same in words."]

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


_NOTES = 3
_STATE_STYLES = {
    "running": "green",
    "starting": "cyan",
    "finished": "bold green",
    "stopped": "yellow",
    "interrupted": "bold yellow",
    "failed": "bold red",
    "lost": "bold red",
}


@dataclass(frozen=True)
class RunReport:
    """Everything `dr-status` knows."""

    run_id: Annotated[int, "DR_RUN_ID."]
    bucket: Annotated[str, "Name of the bucket."]
    prefix: Annotated[str, "Model prefix in the bucket."]
    world: Annotated[str, "DR_WORLD_NAME."]
    state: Annotated[State, "Whether the run is starting or running, or how it ended."]
    message: Annotated[str, "Why it ended."] = ""
    remedy: Annotated[str, "What to do if it failed."] = ""
    exit_code: Annotated[int | None, "Exit code of the supervisor once it has ended."] = None
    started_at: Annotated[float | None, "Unix seconds of the start."] = None
    elapsed_s: Annotated[float, "Wall time of training so far."] = 0.0
    pid: Annotated[int | None, "The supervisor."] = None
    workers: Annotated[list[WorkerReport], "All worker processes of this machine."] = field(
        default_factory=list
    )
    history: Annotated[list[IterationRecord], "All finished iterations, oldest first."] = field(
        default_factory=list
    )
    best: Annotated[
        CheckpointEntry | None, "The best checkpoint by DR_TRAIN_BEST_MODEL_METRIC."
    ] = None
    last: Annotated[CheckpointEntry | None, "The newest checkpoint."] = None
    best_laps: Annotated[
        CheckpointLaps | None, "All evaluation laps of the best checkpoint; None without any."
    ] = None
    newest_laps: Annotated[
        CheckpointLaps | None, "The newest evaluation; None before the first."
    ] = None
    warning: Annotated[str, "Problems with the learning curve; empty if there is none."] = ""
    damaged: Annotated[
        list[str],
        "What is wrong with each damaged object that this needs, and what to do about it; "
        "what it told is worked out from others, as far as possible.",
    ] = field(default_factory=list)
    unreachable: Annotated[
        str,
        "Why the bucket cannot be read; iterations and checkpoints are then missing. "
        "Empty if it can be.",
    ] = ""
    iterations: Annotated[int, "Finished iterations."] = 0
    iterations_left: Annotated[
        int | None, "Until DR_TRAIN_MAX_ITERATIONS; None without that limit."
    ] = None
    time_left_s: Annotated[float | None, "Until the time limit; None without one."] = None
    spending: Annotated[
        Spending | None, "Machine hours and money of all starts; None before the first count."
    ] = None
    money_left: Annotated[float | None, "Until DR_MAX_COST, USD; None without that limit."] = None
    requests: Annotated[
        RequestReport | None,
        "Requests to the bucket of the newest start; None before the first count.",
    ] = None
    watches: Annotated[
        list[str],
        "What the watches of the training warn of, a sentence each: memory, disk, stalls.",
    ] = field(default_factory=list)
    advice: Annotated[list[str], "What to do about them, a sentence for each."] = field(
        default_factory=list
    )
    reward_errors: Annotated[
        RewardCounts | None,
        "Failures of the reward function that all workers have counted, and episodes "
        "that it declared broken; None if nothing was counted.",
    ] = None
    rollbacks: Annotated[
        list[Rollback], "When the training went back to an older checkpoint, oldest first."
    ] = field(default_factory=list)
    convergence: Annotated[
        Convergence | None,
        "How near training and evaluation are; None before there are five evaluations.",
    ] = None
    milestones: Annotated[
        list[MilestoneReport],
        "Checkpoints of the first lap, the first three laps, the fastest lap, as far as "
        "they were reached; `dr-list-checkpoints` says whether they are still there.",
    ] = field(default_factory=list)
    notes: Annotated[list[str], "What the racer wrote about the model; only in `dr-status`."] = (
        field(default_factory=list)
    )
    stage: Annotated[
        StageMark | None, "Stage of the newest checkpoint; None without a curriculum."
    ] = None
    phase: Annotated[
        PhaseReport | None, "Phase of the newest checkpoint; None without a teacher."
    ] = None
    ranges: Annotated[
        float | None, "Share of the DR_SIM_ ranges that it draws from; None without DR_SIM_GROW."
    ] = None
    budget: Annotated[
        DayBudget | None, "Of today, for all trainings of the folder; None without a limit."
    ] = None
    priority: Annotated[str, "DR_PRIORITY at the start."] = "normal"
    threads: Annotated[int, "DR_THREADS at the start; 0 for all cores."] = 0
    joined: Annotated[list[JoinedReport], "Simulation workers of other machines."] = field(
        default_factory=list
    )
    ending: Annotated[
        bool, "Whether the run is ending its workers: none of them is missed then."
    ] = False
    elsewhere: Annotated[
        str,
        "A sentence about the training of the model on another machine, if nothing was "
        "started on this one.",
    ] = ""
    limit: Annotated[
        str,
        "How far the fastest lap of the best checkpoint is from the limit of the car on "
        "the track; empty if unknown.",
    ] = ""

    @property
    def dead(self) -> list[str]:
        """Workers that should run but do not."""
        if self.state not in LIVE_STATES or self.ending:
            return []
        return [worker.name for worker in self.workers if worker.pid and not worker.alive]

    def state_text(self) -> tuple[str, ...]:
        place = f"  s3://{self.bucket}/{self.prefix}  on {self.world}"
        stage = f"  {self.stage}" if self.stage is not None else ""
        return Styled(self.state, _STATE_STYLES.get(self.state, "")), place, stage

    def phase_text(self) -> str:
        phase = "" if self.phase is None else self.phase.text
        ranges = self.ranges
        drawn = "" if ranges is None else f"{ranges:.0%} of the DR_SIM_ ranges (DR_SIM_GROW)"
        text = ", ".join(filter(None, (phase, drawn)))
        return f"{text[:1].upper()}{text[1:]}"

    def checkpoints_text(self) -> str:
        best, last = self.best, self.last
        if best is None or last is None:
            return "No checkpoint yet."
        number = last.name.partition("_")[0]
        if best.metric is not None:
            return f"best {best.text}   last {number}"
        if self.phase is not None and self.phase.name == "teacher":
            return f"last {number}; checkpoints are evaluated from the next phase on"
        return f"last {number}, none was evaluated yet"

    def nothing_here(self) -> str:
        model = f"s3://{self.bucket}/{self.prefix}"
        if self.unreachable:
            return (
                f"Nothing runs here. Whether {model} was trained, or another machine trains it, is "
                f"unknown: {self.unreachable}"
            )
        if self.elsewhere:
            return f"Nothing was started here. {self.elsewhere}"
        return (
            "Nothing was started here yet. Start with `dr-start-training`, or continue a model "
            "that exists with `dr-start-training --resume`."
        )

    def end_text(self) -> str:
        best, counts = self.best, self.reward_errors
        untaught = (
            "It ended in the phase teacher: the camera policy learns from the next phase on "
            "(`dr-start-training --resume`)."
        )
        words = (
            self.message,
            f"Best checkpoint {best.text}." if best is not None and best.metric is not None else "",
            untaught if self.phase is not None and self.phase.name == "teacher" else "",
            f"{counts.failures()}." if counts is not None and counts.failed else "",
            self.remedy,
        )
        return " ".join(filter(None, words))

    def before_history(self) -> View:
        live = self.state in ("starting", "running")
        limits = ["low priority (DR_PRIORITY)"] if self.priority == "low" else []
        limits += [f"at most {counted(self.threads, 'core')} (DR_THREADS)"] if self.threads else []
        unknown = f"Iterations and checkpoints are unknown: {self.unreachable}"
        yield (f"Run {self.run_id}: ", *self.state_text())
        yield self.message
        ended = self.state in ("failed", "interrupted", "finished")
        yield [ended and self.remedy and f"Try: {self.remedy}"]
        if live:
            yield [worker.line(ending=self.ending) for worker in self.workers]
            yield [*map(str, self.joined), limits and f"processor: {', '.join(limits)}"]
        yield from (Styled(f"Warning: {text}", "bold yellow") for text in self.watches)
        yield self.unreachable and Styled(unknown, "bold yellow")
        yield self._stage()
        yield self.phase_text()

    def after_history(self) -> View:
        if self.history:
            last, found = self.history[-1], self.convergence
            laps = sum(record.full_laps for record in self.history)
            episodes = counted(sum(record.episodes for record in self.history), "training episode")
            pace = f"{last.steps_per_s:.0f} steps/s, {last.real_time_factor:.0f} x real time"
            newest = self.newest_laps
            yield f"{last.total_steps:,} steps in {clock(self.elapsed_s)}, {pace}."
            yield f"{laps:,} of {episodes} completed a lap."
            yield newest and f"newest evaluation {newest.checkpoint}: {newest.text}"
            yield self.checkpoints_text()
            yield self.limit and f"best lap {self.limit}"
            if found is not None:
                gap = "converged" if found.reached else f"a gap of {abs(found.gap):.0f} points"
                both = f"training {found.training:.0f} %, evaluations {found.evaluation:.0f} %"
                yield f"Completion: {both}: {gap}."
            yield from self._milestones()
            if self.warning:
                yield Styled(f"Warning: {self.warning}", "bold yellow")
                yield [f"Try: {each}" for each in self.advice]
        yield from (f"Rollback: {rollback.sentence}" for rollback in self.rollbacks)
        yield from self._reward_failures()
        yield self._spent()
        yield self._left()
        yield str(self.requests or "")
        budget = str(self.budget or "")
        yield budget and f"{budget[:1].upper()}{budget[1:]}."
        yield from (f"Note: {abridged(text)}" for text in self.notes[-_NOTES:])

    def _stage(self) -> str:
        stage = self.stage
        if stage is None:
            return ""
        number = self.history[-1].iteration + 1 - stage.iteration if self.history else 0
        text = f"Stage {stage.number} of {stage.count}: {stage.name}, on {stage.world}, "
        return f"{text}{counted(max(0, number), 'iteration')} so far; it ends {stage.goal}."

    def _milestones(self) -> View:
        words: dict[str, list[str]] = {}
        for each in self.milestones:
            words.setdefault(each.checkpoint, []).append(each.word)
        for name, found in {each.checkpoint: each for each in self.milestones}.items():
            laps = f"{found.laps} of {found.episodes} laps clean, best {found.best_lap_s:.2f} s"
            yield f"{', '.join(words[name])}: {name.partition('_')[0]} ({laps})"

    def _reward_failures(self) -> View:
        counts = self.reward_errors
        if counts is None or not (counts.failed or counts.discarded):
            return
        calls = f"{counts.failed:,} of {counts.calls:,} calls failed ({100.0 * counts.share:.2g} %)"
        broken = f"{counted(counts.discarded, 'episode')} declared broken"
        parts = [calls] * bool(counts.failed) + [broken] * bool(counts.discarded)
        yield f"Reward function: {', '.join(parts)}."
        for entry in counts.errors:
            params = entry.params and f"params = {entry.params}"
            yield [f"{entry.text} ({counted(entry.count, 'time')})", [entry.source, params]]

    def _spent(self) -> str:
        spending = self.spending
        if spending is None:
            return ""
        text = (
            f"Spent: {counted(self.iterations, 'iteration')}, {spending.hours:.2f} machine hours "
        )
        text += f"in {counted(spending.starts, 'start')}"
        if spending.usd is not None:
            text += f", {spending.usd:.4g} USD"
            if spending.usd_per_hour is not None:
                text += f" ({spending.usd_per_hour:.4g} USD per hour, {spending.price_of})"
            if spending.unpriced_hours:
                text += f"; the price of {spending.unpriced_hours:.2f} hours is not known"
        if spending.damaged:
            text += f"; the cost of {counted(len(spending.damaged), 'start')} is lost"
        return f"{text}."

    def _left(self) -> str:
        if self.state not in ("starting", "running"):
            return ""
        money, spending = "", self.spending
        if self.money_left is not None and spending is not None:
            money = f"{self.money_left:.4g} of {spending.max_usd:.4g} USD"
            price = spending.usd_per_hour
            money += f" (for {self.money_left / price:.2f} machine hours)" if price else ""
        parts = (
            "" if self.iterations_left is None else counted(self.iterations_left, "iteration"),
            "" if self.time_left_s is None else clock(self.time_left_s),
            money,
        )
        return f"Left: {', '.join(filter(None, parts))}." if any(parts) else ""


def inspect(
    config: RunConfig, reader: HistoryReader | None = None, *, anywhere: bool = False
) -> RunReport:
    """A `reader` saves time if this is repeated.

    Args:
        config: Of the folder.
        reader: Remembers what it has read.
        anywhere: Whether a training of the model on another machine counts, too.
    """
    folder = run_folder(config.directory, config.run_id)
    record = RunRecord.read(folder)
    alive = record is not None and record.alive
    distant: list[WorkerReport] = []
    if not alive:
        record = RunRecord.read(folder)  # a supervisor records the outcome just before it exits
    if not alive and anywhere:
        distant, there = _elsewhere(config)
        if there is not None and (record is None or _replaces(there, record)):
            record, alive = there, there.state in LIVE_STATES
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
    ranges: float | None = None
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
            if config.train.curriculum_file or config.race().sim_grow or marked:
                counters = CheckpointStore(ModelStore(bucket, record.prefix)).counters_of_newest()
                stage, phase = counters.stage, PhaseReport.of(counters.phase, history)
                ranges = None if counters.ranges is None else counters.ranges.share
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
    workers += distant
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
        started_at=record.started_at or None,
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
        ranges=ranges,
        budget=_budget(config),
        priority=record.priority,
        threads=record.threads,
        joined=joined,
    )


def _replaces(found: RunRecord, record: RunRecord) -> bool:
    other = found.session != record.session
    return other and (found.state in LIVE_STATES or found.started_at > record.started_at)


def _elsewhere(config: RunConfig) -> tuple[list[WorkerReport], RunRecord | None]:
    """The workers of a training on another machine, and its record, also after its end."""
    prefix, world = config.model.prefix, config.race().world_name
    try:
        bucket = open_running_bucket(config.storage)
        if bucket is None:
            return [], None
        found = distant_run(SeenRun(ModelStore(bucket, prefix), prefix, world, alive=False))
        if not found.host:
            return [], ended_elsewhere(config, bucket)
    except StorageError:
        return [], None  # said below
    workers = [
        WorkerReport(each.name, None, True, 0, each.activity, "", host=each.host or found.host)
        for each in found.workers
    ]
    return workers, RunRecord(
        run_id=config.run_id,
        session=found.session,
        bucket=bucket.name,
        prefix=prefix,
        world=world,
        state="running",
        pid=0,
        pid_started=0.0,
        started_at=found.started_at,
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
