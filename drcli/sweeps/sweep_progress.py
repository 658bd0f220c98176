"""The record of a sweep's progress, and its experiments."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from drcli.exchange.sweep_record import SweepRecord, TrialRecord, TrialState
from drcli.store.bucket import Bucket
from drcli.store.notes import write_description
from drcli.sweeps.stored_sweep import (
    put_sweep,
    read_sweep,
    refuse_other_trials,
    varied_now,
)
from drcli.sweeps.sweep_file import SweepFile
from drcli.sweeps.trial_files import TrialFiles
from drcli.sweeps.trial_score import best_of
from drcli.sweeps.trials import Trial


class SweepProgress:
    """The record of a sweep, new or continued, written to the bucket after each change.

    Raises:
        ProblemsError: An earlier start had other trainings.
        SettingsError: An experiment cannot be written.
    """

    def __init__(
        self,
        directory: Path,
        sweep: SweepFile,
        trials: list[Trial],
        files: TrialFiles,
        bucket: Bucket,
        *,
        say: Callable[[str], None],
        on_change: Callable[[SweepRecord], None] = lambda record: None,
    ) -> None:
        self.trials = {trial.name: trial for trial in trials}
        self._sweep = sweep
        self._files = files
        self._bucket = bucket
        self._on_change = on_change
        found = read_sweep(bucket, sweep.name)
        if found is None:
            self.put(self._new())
        else:
            refuse_other_trials(found, sweep, trials)
            self.put(self._continued(found, directory, say))

    def trial(self, name: str) -> TrialRecord:
        return next(trial for trial in self.record.trials if trial.name == name)

    def in_state(self, state: TrialState) -> list[TrialRecord]:
        return [trial for trial in self.record.trials if trial.state == state]

    def change(self, name: str, **values: object) -> None:
        trial = replace(self.trial(name), **values)  # type: ignore[arg-type]
        self.replace(trial)

    def replace(self, trial: TrialRecord) -> None:
        self.put(_with(self.record, trial))

    def note_check(self, number: int) -> None:
        self.put(replace(self.record, checks=number))

    def end(self) -> None:
        self.put(replace(self.record, ended_at=time.time()))
        if self.record.best:
            trial = self.trial(self.record.best)
            text = f"Best of sweep {self.record.name}: {text_of(trial)}"
            write_description(self._bucket, trial.prefix, text)

    def put(self, record: SweepRecord) -> None:
        """Also works out the best training."""
        record = replace(record, best=best_of(record.trials, record.metric))
        put_sweep(self._bucket, record)
        self.record = record
        self._on_change(record)

    def write_experiment(self, trial: TrialRecord) -> int:
        return self._files.write(
            self.trials[trial.name],
            trial.prefix,
            used=trial.earlier,
            hyperparameters=trial.hyperparameters,
            source=trial.source,
        )

    def _new(self) -> SweepRecord:
        trials = []
        for trial in self.trials.values():
            new = TrialRecord(trial.name, trial.name, 0, trial.varied)
            trials.append(replace(new, run_id=self.write_experiment(new)))
        plan = self._sweep.plan
        return SweepRecord(
            name=self._sweep.name,
            metric=plan.metric,
            resource=plan.budget.resource,
            most=plan.budget.most,
            began_at=time.time(),
            trials=tuple(trials),
        )

    def _continued(
        self, found: SweepRecord, directory: Path, say: Callable[[str], None]
    ) -> SweepRecord:
        plan = self._sweep.plan
        record = replace(
            found, metric=plan.metric, resource=plan.budget.resource, most=plan.budget.most
        )
        for trial in found.trials:
            failed = trial.state == "failed"
            if failed:
                say(f"{trial.name} has failed before, and is tried again.")
                trial = replace(trial, state="waiting", starts=0, message="", remedy="")
                record = replace(record, ended_at=None)
            there = (directory / "experiments" / trial.name).is_dir()
            if failed or not (trial.is_over or there):
                trial = replace(trial, run_id=self.write_experiment(trial))
            record = _with(record, trial)
        return record


def text_of(trial: TrialRecord) -> str:
    return ", ".join(f"{key}={value}" for key, value in varied_now(trial).items())


def _with(record: SweepRecord, trial: TrialRecord) -> SweepRecord:
    trials = tuple(trial if each.name == trial.name else each for each in record.trials)
    return replace(record, trials=trials)
