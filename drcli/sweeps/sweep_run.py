"""Runs the trainings of a sweep, several at a time, compared at some amounts of their budget.

The one engine for this machine and for a cluster: where a training runs is known to its `Run`
alone (`trial_run`, or `ray_trials`). All get to the same amount before they are compared, so they
may take turns. One that is interrupted for it loses its current episodes, and some seconds for a
new start.
"""

import random
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

from drcli.base.errors import BudgetUsedUp, DrError, StorageError, TrainedElsewhere
from drcli.base.processes import NotedSignals
from drcli.bucket.bucket import Bucket, ObjectDamaged
from drcli.model.lease import STALE_S
from drcli.model.model_store import ModelStore
from drcli.run.take_model import LONG_LOOK_S
from drcli.sweeps.stored_sweep import copy_of
from drcli.sweeps.sweep_file import Span, SweepFile
from drcli.sweeps.sweep_record import SweepRecord, TrialRecord
from drcli.sweeps.sweep_report import SweepProgress, text_of
from drcli.sweeps.trial_run import (
    Ended,
    Limits,
    NothingLeft,
    Run,
    how_it_ended,
    nothing_to_do,
    refused_start,
)
from drcli.sweeps.trial_score import (
    Rank,
    Replacement,
    amount_of,
    comparable,
    kept_of,
    levels_of,
    rank,
    replacements,
    score_of,
    until,
)

POLL_S = 1.0
MOST_STARTS = 3
"""For failures that may pass."""

END_S = 60.0
ELSEWHERE_S = STALE_S + 60.0
"""For taking over when a machine may be gone."""


@dataclass(frozen=True)
class Pace:
    """How many train at a time, each with how many cores.

    Attributes:
        room: Trainings at a time now.
        threads: Cores of each (0: their settings).
        waits: Whether a training at a check waits for the others also with `asha`.
    """

    room: Callable[[], int]
    threads: int = 0
    waits: bool = True


class SweepRun:
    """A sweep from start to best training."""

    def __init__(
        self,
        progress: SweepProgress,
        sweep: SweepFile,
        bucket: Bucket,
        pace: Pace,
        *,
        say: Callable[[str], None],
        signals: NotedSignals,
        open_run: Callable[[TrialRecord], Run],
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        self._progress = progress
        self._sweep = sweep
        self._plan = sweep.plan
        self._bucket = bucket
        self._pace = pace
        self._say = say
        self._signals = signals
        self._sleep = pause
        self._levels = levels_of(self._plan.budget, self._plan.early_stopping)
        self._rungs: dict[float, dict[str, Rank]] = {}
        if self._plan.early_stopping.method == "asha" and not pace.waits:
            self._rungs = {level: {} for level in self._levels[:-1]}
            self._levels = self._levels[-1:]
        self._elsewhere_since: dict[str, float] = {}
        self._asked: set[str] = set()
        self._open_run = open_run
        self._runs: dict[str, Run] = {}

    def run(self) -> SweepRecord:
        """Train all, and mark the best.

        Raises:
            StorageError: The bucket does not answer; nothing is lost.
            TrainedElsewhere: Another machine runs one of the trainings.
            BudgetUsedUp: That of the day.
            Stopped: SIGTERM came, and all are interrupted; or KeyboardInterrupt.
        """
        try:
            self._adopt()
            while self._progress.record.ended_at is None:
                level = self._levels[min(self._checks, len(self._levels) - 1)]
                if self._changes_nothing():
                    self._progress.note_check(self._checks + 1)
                    continue
                self._drive_to(level)
                self._compare(level)
        finally:
            self._end_all()
        return self._progress.record

    def _adopt(self) -> None:
        """A killed sweep may have left trainings running."""
        for trial in self._all:
            if trial.state == "running" and not self._run(trial).runs:
                self._progress.change(trial.name, state="paused")
            self._is_out(trial)

    # --- To the next comparison -------------------------------------------------------------

    def _drive_to(self, level: float) -> None:
        while True:
            for trial in self._progress.in_state("running"):
                self._look_at(trial)
            behind = [t for t in self._all if not t.is_over and t.amount < level]
            if not behind:
                return
            waiting = [t for t in behind if t.state != "running"]
            running = self._progress.in_state("running")
            room = self._pace.room()
            full = len(running) >= room
            # Weights that a population copies are of this amount; others may run ahead.
            if (waiting and full) or self._plan.early_stopping.method == "population":
                for trial in running:
                    if trial.amount >= level:
                        self._interrupt(trial.name)
            if waiting and not full:
                for trial in waiting[: room - len(running)]:
                    self._refuse_interruption()
                    self._start(trial)
            self._pause(POLL_S)

    def _start(self, trial: TrialRecord) -> None:
        self._asked.discard(trial.name)
        plan = self._plan
        left = plan.budget.most - trial.earlier
        limits = Limits(
            minutes=left if plan.budget.resource == "minutes" else None,
            goals=plan.goals,
            threads=self._pace.threads,
        )
        try:
            self._run(trial).start(limits)
        except DrError as error:
            self._refused(trial, error)
            return
        self._say(f"{trial.name} {'goes on' if trial.amount > 0.0 else 'begins'}: {text_of(trial)}")
        self._progress.change(trial.name, state="running")

    def _refused(self, trial: TrialRecord, error: DrError) -> None:
        if isinstance(error, TrainedElsewhere):
            first = self._elsewhere_since.setdefault(trial.name, time.monotonic())
            if time.monotonic() > first + ELSEWHERE_S:
                raise error
            self._say(f"{trial.name} waits: {error}")
            self._progress.change(trial.name, state="paused" if trial.amount > 0.0 else "waiting")
            self._pause(LONG_LOOK_S)
            return
        if isinstance(error, StorageError | BudgetUsedUp):
            raise error
        if isinstance(error, NothingLeft):
            ended = nothing_to_do(ModelStore(self._bucket, trial.prefix), str(error))
            self._measure(trial)
            self._progress.change(trial.name, state=ended.state, message=ended.message)
            return
        self._refuse_interruption()  # on a terminal, it has come to whatever ran here
        self._failed(trial, refused_start(error))

    def _look_at(self, trial: TrialRecord) -> None:
        run = self._run(trial)
        runs = run.runs  # before its iterations are read, so that none is missed
        self._measure(trial)
        trial = self._progress.trial(trial.name)
        out = self._is_out(trial)
        if runs:
            if out:
                level = max(level for level in self._rungs if trial.amount >= level)
                at = comparable(self._plan.budget.resource, level)
                self._stop_early(trial, f"ASHA ended it at the check at {at}.")
            return
        try:
            record = run.record()
        except DrError as error:
            self._refused(trial, error)
            return
        ended = how_it_ended(record, asked=trial.name in self._asked)
        if ended.state == "failed":
            self._failed(trial, ended)
            return
        self._progress.change(trial.name, state=ended.state, message=ended.message)
        if ended.message:
            self._say(f"{trial.name}: {ended.message}")

    def _measure(self, trial: TrialRecord) -> None:
        try:
            records = self._run(trial).iterations()
        except ObjectDamaged as error:
            self._say(f"{trial.name}: {error}")
            return
        amount = trial.earlier + amount_of(records, self._plan.budget.resource)
        score = score_of(records, self._plan.metric)
        if (amount, score) != (trial.amount, trial.score):
            self._elsewhere_since.pop(trial.name, None)
            self._progress.change(trial.name, amount=amount, score=score)

    def _failed(self, trial: TrialRecord, ended: Ended) -> None:
        message = ended.message
        if ended.may_pass and trial.starts < MOST_STARTS:
            self._say(f"{trial.name}: {message} It is started again.")
            self._progress.change(trial.name, state="paused", starts=trial.starts + 1)
            return
        self._say(f"{trial.name} has failed: {message}")
        self._progress.change(trial.name, state="failed", message=message, remedy=ended.remedy)

    # --- Comparisons ------------------------------------------------------------------------

    def _compare(self, level: float) -> None:
        number = self._checks + 1
        if number >= len(self._levels):
            self._finish()
            return
        stopping = self._plan.early_stopping
        ranked = self._ranked(level)
        if stopping.halves:
            self._halve(number, level, ranked)
        elif stopping.method == "population":
            self._replace_worst(number, level, ranked)
        self._progress.note_check(number)

    def _is_out(self, trial: TrialRecord) -> bool:
        """By ASHA: whether it is worse at a check than most that reached it before.

        Li et al., A System for Massively Parallel Hyperparameter Tuning (2020).
        """
        out = False
        for level, ranks in self._rungs.items():
            if trial.amount >= level and trial.name not in ranks and trial.state != "failed":
                own = ranks[trial.name] = self._rank(trial, level)
                better = sum(rank > own for rank in ranks.values())
                out |= better >= kept_of(len(ranks), self._plan.early_stopping.reduction_factor)
        return out

    def _changes_nothing(self) -> bool:
        """If all go on after a check, turns for it would cost time."""
        stopping = self._plan.early_stopping
        compared = [t for t in self._all if t.state not in ("failed", "stopped early")]
        is_last = self._checks + 1 >= len(self._levels)
        kept = kept_of(len(compared), stopping.reduction_factor)
        return stopping.halves and not is_last and kept >= len(compared)

    def _ranked(self, level: float) -> list[TrialRecord]:
        scores = {
            trial.name: self._rank(trial, level)
            for trial in self._all
            if trial.state not in ("failed", "stopped early")
        }
        names = sorted(scores, key=lambda name: scores[name], reverse=True)
        return [self._progress.trial(name) for name in names]

    def _rank(self, trial: TrialRecord, level: float) -> Rank:
        records = self._run(trial).iterations()
        within = until(records, self._plan.budget.resource, level - trial.earlier)
        return rank(score_of(within, self._plan.metric), self._plan.metric)

    def _halve(self, number: int, level: float, ranked: list[TrialRecord]) -> None:
        kept = kept_of(len(ranked), self._plan.early_stopping.reduction_factor)
        at = comparable(self._plan.budget.resource, level)
        self._say(f"Check {number} at {at}: {kept} of {len(ranked)} go on.")
        for place, trial in enumerate(ranked[kept:], kept + 1):
            if trial.is_over:
                continue
            message = f"Check {number} at {at}: place {place} of {len(ranked)}, {kept} go on."
            self._stop_early(trial, message)

    def _stop_early(self, trial: TrialRecord, message: str) -> None:
        self._interrupt(trial.name)
        self._progress.change(trial.name, state="stopped early", message=message)
        self._say(f"{trial.name} is stopped early: {message}")

    def _replace_worst(self, number: int, level: float, ranked: list[TrialRecord]) -> None:
        vary = {
            key: choices
            for key, choices in self._plan.vary.hyperparameters.items()
            if isinstance(choices, Span) or not any(isinstance(each, str) for each in choices)
        }
        going = [trial for trial in ranked if not trial.is_over and trial.score is not None]
        own = {}
        for trial in going:
            now = {**self._progress.trials[trial.name].hyperparameters, **trial.hyperparameters}
            own[trial.name] = {key: float(now[key]) for key in vary}
        chance = random.Random(f"{self._plan.seed} {number}")
        quantile = self._plan.early_stopping.quantile
        names = [trial.name for trial in going]
        at = comparable(self._plan.budget.resource, level)
        self._say(
            f"Check {number} at {at}: the best of {len(names)} is {names[0] if names else '-'}."
        )
        for each in replacements(names, own, vary, quantile, chance):
            self._copy(number, each)

    def _copy(self, number: int, each: Replacement) -> None:
        trial, source = self._progress.trial(each.name), self._progress.trial(each.source)
        self._interrupt(trial.name, wait=True)
        prefix = copy_of(trial, number)
        self._runs.pop(trial.name, None)
        copy = replace(
            trial,
            prefix=prefix,
            hyperparameters=dict(each.hyperparameters),
            source=source.prefix,
            state="waiting",
            earlier=trial.amount,
            score=None,
        )
        # First the experiment: the record says which model is trained with it.
        self._progress.write_experiment(copy)
        self._progress.replace(copy)
        changed = ", ".join(f"{key}={value:g}" for key, value in each.hyperparameters.items())
        self._say(f"{trial.name} goes on with the weights of {source.name} and {changed}.")

    def _finish(self) -> None:
        for trial in self._progress.in_state("running"):
            self._interrupt(trial.name, wait=True)
        for trial in self._all:
            if not trial.is_over:
                self._progress.change(
                    trial.name, state="finished", message="Its budget is used up."
                )
        self._progress.end()

    # --- Records and processes --------------------------------------------------------------

    def _pause(self, seconds: float) -> None:
        self._refuse_interruption()
        self._sleep(seconds)
        self._refuse_interruption()

    def _refuse_interruption(self) -> None:
        name = self._progress.record.name
        said = f"The sweep {name} was interrupted."
        self._signals.refuse(said, "Continue it with the same command.")

    @property
    def _all(self) -> tuple[TrialRecord, ...]:
        return self._progress.record.trials

    @property
    def _checks(self) -> int:
        return self._progress.record.checks

    def _run(self, trial: TrialRecord) -> Run:
        if trial.name not in self._runs:
            self._runs[trial.name] = self._open_run(trial)
        return self._runs[trial.name]

    def _interrupt(self, name: str, *, wait: bool = False) -> None:
        run = self._run(self._progress.trial(name))
        if name not in self._asked:
            self._asked.add(name)
            run.interrupt()
        while wait and run.runs:
            self._sleep(POLL_S)

    def _end_all(self) -> None:
        """Interrupt and wait: nobody looks after them any more."""
        running = [trial for trial in self._all if self._run(trial).runs]
        for trial in running:
            self._interrupt(trial.name)
        ends_s = time.monotonic() + END_S
        for trial in running:
            while self._run(trial).runs and time.monotonic() < ends_s and self._signals.count < 2:
                self._sleep(POLL_S)
            if self._progress.trial(trial.name).state == "running":
                with suppress(StorageError):  # the next start finds out by itself
                    self._progress.change(trial.name, state="paused")
