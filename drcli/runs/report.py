"""What there is to say about a run, as plain data for people and programs alike."""

from dataclasses import dataclass, field

from drcli.exchange.iteration import IterationRecord
from drcli.exchange.run_record import State

__all__ = [
    "CheckpointReport",
    "EvaluationReport",
    "IterationRecord",
    "RunReport",
    "State",
    "TrialReport",
    "WorkerReport",
]


@dataclass(frozen=True)
class WorkerReport:
    """One worker process.

    Attributes:
        name: "trainer", "sim-0", "sim-1", ...
        pid: Its process, or None before it started.
        alive: Whether that process runs.
        restarts: How often the supervisor has brought it back.
        activity: What it is doing or waiting for, in a few words.
        log: Path of its log file on this machine.
    """

    name: str
    pid: int | None
    alive: bool
    restarts: int
    activity: str
    log: str


@dataclass(frozen=True)
class CheckpointReport:
    """A checkpoint that a user may want.

    Attributes:
        name: Such as "12_Step-7824.ckpt".
        metric: What its evaluation episodes scored on average, or None before an evaluation.
    """

    name: str
    metric: float | None


@dataclass(frozen=True)
class RunReport:
    """Everything `dr-status` knows.

    Attributes:
        run_id: DR_RUN_ID.
        bucket: Name of the bucket.
        prefix: Model prefix in the bucket.
        world: DR_WORLD_NAME.
        state: Where the run is in its life.
        message: Why it ended, when it has.
        remedy: What to do about it, when it failed.
        exit_code: Exit code of the supervisor, when it has ended.
        started_at: Unix seconds of the start.
        elapsed_s: Wall time of training so far.
        pid: The supervisor.
        workers: All worker processes.
        history: All iterations learned, oldest first.
        best: The best checkpoint by DR_TRAIN_BEST_MODEL_METRIC.
        last: The newest checkpoint.
        warning: What is wrong with the learning curve; empty when nothing is.
        damaged: What is damaged of the model in the bucket, a sentence each; the curve and the
            checkpoints are then what could be rebuilt.
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
    best: CheckpointReport | None = None
    last: CheckpointReport | None = None
    warning: str = ""
    damaged: list[str] = field(default_factory=list)

    @property
    def dead(self) -> list[str]:
        """Workers that should run and do not."""
        if self.state not in ("running", "starting"):
            return []
        return [worker.name for worker in self.workers if worker.pid and not worker.alive]


@dataclass(frozen=True)
class TrialReport:
    """One evaluation lap or trial.

    Attributes:
        trial: From 1.
        progress: Percent of the lap.
        lap_s: Simulated seconds, penalties included.
        status: "Lap complete", "Off track", ...
        off_track: How often the car left the track.
        crashes: How often it hit something.
        resets: How often it was put back.
    """

    trial: int
    progress: float
    lap_s: float
    status: str
    off_track: int
    crashes: int
    resets: int


@dataclass(frozen=True)
class EvaluationReport:
    """The outcome of `dr-evaluate`.

    Attributes:
        prefix: Model prefix in the bucket.
        world: Where it drove.
        checkpoint: Which checkpoint drove.
        trials: All trials, in order.
        simtrace: Key of the trace in the bucket.
        metrics: Key of the metrics in the bucket.
        opponent: How the other model of a HEAD_TO_MODEL race fared in the same trials.
    """

    prefix: str
    world: str
    checkpoint: str
    trials: list[TrialReport]
    simtrace: str
    metrics: str
    opponent: "EvaluationReport | None" = None

    @property
    def completed(self) -> int:
        """How many trials completed the lap."""
        return sum(trial.status == "Lap complete" for trial in self.trials)

    @property
    def total_s(self) -> float | None:
        """Simulated seconds of all trials together, None unless every lap was completed."""
        if self.completed < len(self.trials):
            return None
        return sum(trial.lap_s for trial in self.trials)

    @property
    def best_lap_s(self) -> float | None:
        """Fastest completed lap, simulated seconds."""
        laps = [trial.lap_s for trial in self.trials if trial.status == "Lap complete"]
        return min(laps, default=None)
