"""What commands show about sweeps."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

from drcli.base.report import Col, View, bold, table
from drcli.bucket.bucket import Bucket, ObjectDamaged, ObjectNewer
from drcli.model.model_store import ModelStore
from drcli.model.notes import write_description
from drcli.sweeps import sweep_record
from drcli.sweeps.stored_sweep import put_sweep, read_sweep, refuse_other_trials, varied_now
from drcli.sweeps.sweep_file import SweepFile
from drcli.sweeps.sweep_record import SweepRecord, TrialRecord, TrialState
from drcli.sweeps.trial_files import TrialFiles
from drcli.sweeps.trial_score import best_of, rank
from drcli.sweeps.trials import Trial

_STYLES = {
    "running": "green",
    "failed": "red",
    "paused": "dim",
    "waiting": "dim",
    "stopped early": "dim",
}


def _varied(key: str) -> Col:
    return Col(key, of=lambda trial: trial.varied.get(key, ""), side="left")


@dataclass(frozen=True)
class TrialReport:
    """One training of a sweep."""

    name: Annotated[str, "Of its experiment.", Col("training")]
    model: Annotated[str, "Prefix in the bucket."]
    varied: Annotated[dict[str, str], "What distinguishes it from the others, by name."]
    state: Annotated[
        TrialState,
        "waiting, running, paused, finished, stopped early, stopped or failed.",
        Col("state", style=_STYLES),
    ]
    amount: Annotated[float, "How much of its budget it has used."]
    laps: Annotated[
        int,
        "Completed laps of its best evaluation.",
        Col(
            "clean laps", of=lambda each: f"{each.laps}/{each.episodes}" if each.episodes else None
        ),
    ] = 0
    episodes: Annotated[int, "Episodes of that; 0 without one."] = 0
    progress: Annotated[
        float | None,
        "Mean progress of that, percent; null before the first iteration.",
        Col("progress", "{:.0f} %"),
    ] = None
    lap_s: Annotated[
        float | None,
        "Median time of the clean laps, simulated seconds, or null.",
        Col("median clean lap", "{:.2f} s"),
    ] = None
    reward: Annotated[float | None, "Mean of an episode in its best iteration, or null."] = None
    checkpoint: Annotated[int | None, "Number of the evaluated checkpoint, or null."] = None
    best: Annotated[
        bool,
        "Whether it is the best training.",
        Col("", lambda best: "*" if best else "", style="bold", side="left"),
    ] = False
    message: Annotated[str, "Why it ended."] = ""
    remedy: Annotated[str, "What to do then."] = ""


@dataclass(frozen=True)
class SweepReport:
    """A sweep."""

    name: Annotated[str, "Of the sweep.", Col("sweep")]
    bucket: Annotated[str, "Name of the bucket."]
    metric: Annotated[str, "What decides: lap_time, progress or reward."]
    resource: Annotated[str, "What the budget counts: minutes, steps, episodes or iterations."]
    most: Annotated[float, "How much each training gets."]
    checks: Annotated[int, "Comparisons so far."]
    ended: Annotated[
        bool,
        "Whether all trainings are over.",
        Col("state", lambda ended: "ended" if ended else "not ended", side="left"),
    ]
    best: Annotated[str, "Name of the best training, or empty.", Col("best")]
    trials: Annotated[
        list[TrialReport],
        "The best first.",
        Col("trainings", lambda trials: str(len(trials)), side="right"),
    ]
    comparison: Annotated[str | None, "The page that compares them, or null."] = None

    def best_model(self) -> str:
        return next((trial.model for trial in self.trials if trial.best), "")

    def view(self) -> View:
        over = sum(trial.state not in ("waiting", "running", "paused") for trial in self.trials)
        state = "ended" if self.ended else f"{over} of {len(self.trials)} over"
        unit = self.resource if self.most != 1 else self.resource[:-1]
        first = f"best {self.metric.replace('_', ' ')} first, {self.most:,.12g} {unit} each"
        digits = 1 if self.resource == "minutes" else 0
        varied = dict.fromkeys(key for trial in self.trials for key in trial.varied)
        columns: list[str | Col] = [
            "best",
            "name",
            *map(_varied, varied),
            "state",
            Col(self.resource, of=lambda trial: f"{trial.amount:,.{digits}f}"),
            "laps",
            "progress",
            "lap_s",
        ]
        word = "best" if self.ended else "best so far"
        return [
            (bold(f"Sweep {self.name}"), f" ({state}), {first}"),
            table(self.trials, *columns),
            *(
                f"{trial.name}: {trial.message} {trial.remedy}".rstrip()
                for trial in self.trials
                if trial.state == "failed"
            ),
            self.best and f"* {word}; its model is {self.best_model()}",
            self.ended and not self.best and "None is the best: no training was evaluated.",
            self.comparison is not None and f"Comparison: {self.comparison}",
        ]


@dataclass(frozen=True)
class SweepList:
    """The sweeps of a bucket."""

    bucket: Annotated[str, "Name of the bucket."]
    sweeps: Annotated[list[SweepReport], "The newest first."]
    damaged: Annotated[list[str], "A sentence about each unreadable record."] = field(
        default_factory=list
    )

    def view(self) -> View:
        none = f"s3://{self.bucket} has no sweeps. `dr-sweep init` writes an example."
        model = Col("model", of=lambda sweep: sweep.best_model(), side="left")
        shown = ("name", "ended", "trials", "best", model)
        return [table(self.sweeps, *shown) if self.sweeps else none]


def report_of(record: SweepRecord, bucket: str) -> SweepReport:
    ranked = sorted(record.trials, key=lambda trial: rank(trial.score, record.metric), reverse=True)
    return SweepReport(
        name=record.name,
        bucket=bucket,
        metric=record.metric,
        resource=record.resource,
        most=record.most,
        checks=record.checks,
        ended=record.ended_at is not None,
        best=record.best,
        trials=[_trial(trial, best=trial.name == record.best) for trial in ranked],
    )


def list_sweeps(bucket: Bucket) -> SweepList:
    """The newest first; raises StorageError."""
    found: list[SweepRecord] = []
    damaged: list[str] = []
    for info in bucket.list(sweep_record.FOLDER):
        name = sweep_record.sweep_of(info.key)
        if name is None:
            continue
        try:
            record = read_sweep(bucket, name)
        except (ObjectDamaged, ObjectNewer) as error:
            damaged.append(str(error))
            continue
        if record is not None:
            found.append(record)
    found.sort(key=lambda record: record.began_at, reverse=True)
    reports = [report_of(record, bucket.name) for record in found]
    return SweepList(bucket.name, reports, damaged)


def _trial(trial: TrialRecord, *, best: bool) -> TrialReport:
    score = trial.score
    return TrialReport(
        name=trial.name,
        model=trial.prefix,
        varied=dict(varied_now(trial)),
        state=trial.state,
        amount=trial.amount,
        laps=0 if score is None else score.laps,
        episodes=0 if score is None else score.episodes,
        progress=None if score is None else score.progress,
        lap_s=None if score is None else score.lap_s,
        reward=None if score is None else score.reward,
        checkpoint=None if score is None else score.checkpoint,
        best=best,
        message=trial.message,
        remedy=trial.remedy,
    )


# The record of a sweep's progress, and its experiments.


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
            write_description(ModelStore(self._bucket, trial.prefix), text)

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
