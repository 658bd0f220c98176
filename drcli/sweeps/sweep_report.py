"""What commands show about sweeps."""

from dataclasses import dataclass, field

from drcli.exchange.sweep_record import SweepRecord, TrialRecord, TrialState
from drcli.store import sweep_keys
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectNewer
from drcli.sweeps.stored_sweep import read_sweep, varied_now
from drcli.sweeps.trial_score import rank


@dataclass(frozen=True)
class TrialReport:
    """One training of a sweep.

    Attributes:
        name: Of its experiment.
        model: Prefix in the bucket.
        varied: What distinguishes it from the others, by name.
        state: waiting, running, paused, finished, stopped early, stopped or failed.
        amount: How much of its budget it has used.
        laps: Completed laps of its best evaluation.
        episodes: Episodes of that; 0 without one.
        progress: Mean progress of that, percent; null before the first iteration.
        lap_s: Median time of the clean laps, simulated seconds, or null.
        reward: Mean of an episode in its best iteration, or null.
        checkpoint: Number of the evaluated checkpoint, or null.
        best: Whether it is the best training.
        message: Why it ended.
        remedy: What to do then.
    """

    name: str
    model: str
    varied: dict[str, str]
    state: TrialState
    amount: float
    laps: int = 0
    episodes: int = 0
    progress: float | None = None
    lap_s: float | None = None
    reward: float | None = None
    checkpoint: int | None = None
    best: bool = False
    message: str = ""
    remedy: str = ""


@dataclass(frozen=True)
class SweepReport:
    """A sweep.

    Attributes:
        name: Of the sweep.
        bucket: Name of the bucket.
        metric: What decides: lap_time, progress or reward.
        resource: What the budget counts: minutes, steps, episodes or iterations.
        most: How much each training gets.
        checks: Comparisons so far.
        ended: Whether all trainings are over.
        best: Name of the best training, or empty.
        trials: The best first.
        comparison: The page that compares them, or null.
    """

    name: str
    bucket: str
    metric: str
    resource: str
    most: float
    checks: int
    ended: bool
    best: str
    trials: list[TrialReport]
    comparison: str | None = None


@dataclass(frozen=True)
class SweepList:
    """The sweeps of a bucket.

    Attributes:
        bucket: Name of the bucket.
        sweeps: The newest first.
        damaged: A sentence about each unreadable record.
    """

    bucket: str
    sweeps: list[SweepReport]
    damaged: list[str] = field(default_factory=list)


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
    for info in bucket.list(sweep_keys.FOLDER):
        name = sweep_keys.sweep_of(info.key)
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
