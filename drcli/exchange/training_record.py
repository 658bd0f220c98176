"""The record of a training in the bucket, which outlives its model."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from drcli.base.json_record import JsonRecord, RecordError
from drcli.exchange.training_start import GitState, Pretrained

TrainingState = Literal[
    "running", "finished", "stopped", "interrupted", "failed", "lost", "unknown"
]
""""lost": it left no reason; "unknown": nobody recorded it."""

MOST_STARTS = 60


@dataclass(frozen=True)
class RecordedStart:
    """One start of a training.

    Attributes:
        session: Unique name; empty if unknown.
        host: Name of its machine.
        started_at: Unix seconds; 0 if unknown.
        ended_at: Unix seconds; None if it has not ended, or unknown.
        state: How it ended.
        message: Why it ended.
        resumes: The checkpoint that it continued from; None for a new model.
        seed: Of its random numbers.
        settings: DR_ settings that differ from their defaults; None if unknown.
        worker_settings: What the file of each other worker changes, from the second worker on.
        versions: Of Python and important packages.
        git: State of the working folder and of our own package.
        machine: Platform, processor, cores.
        files: SHA-256 of each of its files; their texts are in `TrainingFiles`.
        hours: How long it trained; None if unknown.
        usd: What that cost; None if not known.
    """

    session: str = ""
    host: str = ""
    started_at: float = 0.0
    ended_at: float | None = None
    state: TrainingState = "unknown"
    message: str = ""
    resumes: str | None = None
    seed: int | None = None
    settings: dict[str, Any] | None = None
    worker_settings: list[dict[str, Any]] = field(default_factory=list)
    versions: dict[str, str | None] = field(default_factory=dict)
    git: dict[str, GitState | None] = field(default_factory=dict)
    machine: dict[str, Any] = field(default_factory=dict)
    files: dict[str, str] = field(default_factory=dict)
    hours: float | None = None
    usd: float | None = None


@dataclass(frozen=True)
class TrainingResults:
    """What a training has come to. Only laps on the track of its newest start are compared.

    Attributes:
        iterations: Finished iterations.
        episodes: Training episodes.
        steps: Steps learned from.
        elapsed_s: Wall time of training, without stops.
        mean_reward: Of the last iteration's episodes; None without one.
        mean_progress: Likewise, percent of a lap.
        full_laps: Completed laps of training episodes.
        evaluated_laps: Completed laps of evaluations during the training, all clean.
        best_lap_s: Fastest of these on the track, simulated seconds.
        best_training_lap_s: Fastest lap of a training episode on the track.
        best_progress: Highest mean progress of an evaluation on the track, percent.
        best_checkpoint: Name of the best checkpoint.
        best_score: Its score.
        last_checkpoint: Name of the newest one.
        evaluations: Stand-alone evaluations.
        trials: Their trials.
        best_trial_lap_s: Fastest of their finished laps on any track, penalties included.
        clean_trial_lap_s: Fastest of their clean laps by track, whose name is empty if unknown;
            None in records of version 0.1.0.
    """

    iterations: int = 0
    episodes: int = 0
    steps: int = 0
    elapsed_s: float = 0.0
    mean_reward: float | None = None
    mean_progress: float | None = None
    full_laps: int = 0
    evaluated_laps: int = 0
    best_lap_s: float | None = None
    best_training_lap_s: float | None = None
    best_progress: float | None = None
    best_checkpoint: str | None = None
    best_score: float | None = None
    last_checkpoint: str | None = None
    evaluations: int = 0
    trials: int = 0
    best_trial_lap_s: float | None = None
    clean_trial_lap_s: Mapping[str, float] | None = None

    @property
    def read_evaluations(self) -> int:
        """Stand-alone evaluations that need not be read again."""
        return 0 if self.clean_trial_lap_s is None else self.evaluations

    def clean_lap_s(self, world: str) -> float | None:
        """The fastest clean lap of an evaluation on the training's track."""
        laps = (self.best_lap_s, (self.clean_trial_lap_s or {}).get(world or "?"))
        return min((lap_s for lap_s in laps if lap_s is not None), default=None)


@dataclass(frozen=True)
class TrainingRecord(JsonRecord):
    """A training, from a model's first start until the model is deleted or begun anew.

    Attributes:
        id: Eight hexadecimal digits.
        prefix: Of the model.
        began_at: Unix seconds of the first start; 0 if unknown.
        updated_at: When the record was last written, Unix seconds.
        state: Of the newest start.
        message: Why that ended.
        ended_at: When it ended, Unix seconds.
        number_of_starts: All starts; `starts` has the first and the newest ones.
        starts: Oldest first.
        results: What it has come to.
        hours: Machine hours of all starts; None if unknown.
        usd: What these cost; None if not known.
        parent: The weights that it began with; None for fresh ones.
        parent_training: Id of the training that they come from; empty if unknown.
        description: DR_MODEL_DESCRIPTION.
        world: The track; empty if unknown.
        race_type: DR_RACE_TYPE.
        workers: Simulation workers.
        algorithm: clipped_ppo or sac; empty if unknown.
        action_space: Kind and number of actions.
        network: Of model_metadata.json.
        sensors: Of model_metadata.json.
        hyperparameters: All values.
        metric: DR_TRAIN_BEST_MODEL_METRIC, whose values are the scores.
        stages: Stages of its curriculum; 0 without one.
        gone_at: When the model was deleted or begun anew, Unix seconds; None if it was not.
        derived: Whether this was worked out from the model, as nobody wrote a record.
    """

    id: str
    prefix: str
    began_at: float = 0.0
    updated_at: float = 0.0
    state: TrainingState = "unknown"
    message: str = ""
    ended_at: float | None = None
    number_of_starts: int = 0
    starts: tuple[RecordedStart, ...] = ()
    results: TrainingResults = field(default_factory=TrainingResults)
    hours: float | None = None
    usd: float | None = None
    parent: Pretrained | None = None
    parent_training: str = ""
    description: str = ""
    world: str = ""
    race_type: str = ""
    workers: int | None = None
    algorithm: str = ""
    action_space: str = ""
    network: str = ""
    sensors: tuple[str, ...] = ()
    hyperparameters: dict[str, Any] = field(default_factory=dict)
    metric: str = ""
    stages: int = 0
    gone_at: float | None = None
    derived: bool = False

    def __post_init__(self) -> None:
        if not self.prefix or len(self.id) != 8 or set(self.id) - set("0123456789abcdef"):
            raise RecordError(f"'id' cannot be {self.id!r}")

    @property
    def newest(self) -> RecordedStart:
        """The newest start."""
        return self.starts[-1] if self.starts else RecordedStart()


@dataclass(frozen=True)
class TrainingFiles(JsonRecord):
    texts: Mapping[str, str] = field(default_factory=dict)
