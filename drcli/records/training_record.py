"""The record of a training in the bucket, which outlives its model."""

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta

from drcli.base.files import FileRecord, load_record, save_record
from drcli.base.json_record import Amount, JsonRecord, SafeInt, Seconds, Text
from drcli.config.run_config import UnattendedConfig
from drcli.records.run_record import State

# How a training was started: `ip/run.json`.


@dataclass(frozen=True)
class GitState:
    commit: str
    dirty: bool


@dataclass(frozen=True)
class Pretrained:
    """Weights to start from.

    Attributes:
        prefix: Their model.
        checkpoint: Which one: last, best, the word of a milestone, or a number.
        name: That checkpoint, such as `12_Step-7824.ckpt`.
        metric: Mean score of its evaluation; None without one.
        sha256: Fingerprint of the weights.
    """

    prefix: str
    checkpoint: str
    name: str
    metric: float | None
    sha256: str

    def source(self) -> str:
        return f"{self.prefix} ({self.checkpoint} checkpoint {self.name})"


@dataclass(frozen=True)
class TrainingStart(JsonRecord):
    """One start of a training. The first versions wrote the seed only.

    Attributes:
        settings: DR_ settings that differ from their defaults.
        cars: DR_SIM_CAR of the first worker, and of others with their own race.
        workers: What worker-N.env changes, from the second worker on.
        versions: None if not installed.
        git: Of the `working_folder` and our own `package`; None outside git.
        machine: `platform`, `processor`, `cores`, `threads` if OMP_NUM_THREADS is set.
    """

    seed: SafeInt
    started_at: str = ""
    settings: dict[str, Any] | None = None
    cars: list[str] = field(default_factory=list)
    workers: list[dict[str, Any]] = field(default_factory=list)
    versions: dict[str, str | None] = field(default_factory=dict)
    git: dict[str, GitState | None] = field(default_factory=dict)
    machine: dict[str, Any] = field(default_factory=dict)
    pretrained: Pretrained | None = None
    earlier: list["TrainingStart"] = field(default_factory=list)
    training: str = ""

    def to_json(self) -> dict[str, Any]:
        fields = super().to_json()
        for start in fields["earlier"]:
            del start["earlier"]
        return fields


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
    started_at: Seconds = 0.0
    ended_at: Seconds | None = None
    state: TrainingState = "unknown"
    message: str = ""
    resumes: str | None = None
    seed: SafeInt | None = None
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

    iterations: SafeInt = 0
    episodes: SafeInt = 0
    steps: SafeInt = 0
    elapsed_s: Seconds = 0.0
    mean_reward: float | None = None
    mean_progress: float | None = None
    full_laps: SafeInt = 0
    evaluated_laps: SafeInt = 0
    best_lap_s: Seconds | None = None
    best_training_lap_s: Seconds | None = None
    best_progress: float | None = None
    best_checkpoint: str | None = None
    best_score: float | None = None
    last_checkpoint: str | None = None
    evaluations: SafeInt = 0
    trials: SafeInt = 0
    best_trial_lap_s: Seconds | None = None
    clean_trial_lap_s: Mapping[str, Seconds] | None = None

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

    id: Annotated[str, Meta(pattern=r"^[0-9a-f]{8}\Z")]
    prefix: Text
    began_at: Seconds = 0.0
    updated_at: Seconds = 0.0
    state: TrainingState = "unknown"
    message: str = ""
    ended_at: Seconds | None = None
    number_of_starts: SafeInt = 0
    starts: tuple[RecordedStart, ...] = ()
    results: TrainingResults = field(default_factory=TrainingResults)
    hours: float | None = None
    usd: float | None = None
    parent: Pretrained | None = None
    parent_training: str = ""
    description: str = ""
    world: str = ""
    race_type: str = ""
    workers: SafeInt | None = None
    algorithm: str = ""
    action_space: str = ""
    network: str = ""
    sensors: tuple[str, ...] = ()
    hyperparameters: dict[str, Any] = field(default_factory=dict)
    metric: str = ""
    stages: SafeInt = 0
    gone_at: Seconds | None = None
    derived: bool = False

    @property
    def newest(self) -> RecordedStart:
        """The newest start."""
        return self.starts[-1] if self.starts else RecordedStart()


@dataclass(frozen=True)
class TrainingFiles(JsonRecord):
    texts: Mapping[str, str] = field(default_factory=dict)


# What the newest start of a run came to, for the next one.


@dataclass(frozen=True)
class RunOutcome(JsonRecord):
    """The newest start of a run, written at its begin and end; "running" if its machine vanished.

    Attributes:
        began_at: Of the very first start.
        goals: With others, a finished run may go on.
        stays_ended: Only `--resume` continues it.
        left: Work at the end that is still to do.
    """

    session: str
    host: str
    began_at: Seconds
    started_at: Seconds
    state: State = "running"
    goals: str = ""
    code: SafeInt | None = None
    message: str = ""
    remedy: str = ""
    ended_at: Seconds | None = None
    stays_ended: bool = False
    left: tuple[str, ...] = ()

    @property
    def ended(self) -> bool:
        return self.state != "running"


# What the starts of a training have cost.


@dataclass(frozen=True)
class StartSpending(JsonRecord):
    session: str
    host: str
    hours: float
    usd: float | None = None
    usd_per_hour: float | None = None


@dataclass(frozen=True)
class Spending(FileRecord):
    """All starts of a training, as its supervisor last knew it.

    Attributes:
        session: Of the newest start.
        starts: How many there were.
        hours: Machine hours of all of them together.
        usd: What these cost; None if no price is known.
        unpriced_hours: Hours without a known price.
        usd_per_hour: Present price; None if not known.
        price_of: Where that comes from, for people.
        max_usd: DR_MAX_COST; 0 for no limit.
        own_hours: Machine hours of the newest start.
        max_minutes: Limit of its time; None for none.
        damaged: Unreadable objects of earlier starts, whose cost is missing.
    """

    FILE = "spending.json"

    session: str
    starts: SafeInt
    hours: float
    usd: float | None = None
    unpriced_hours: float = 0.0
    usd_per_hour: float | None = None
    price_of: str = ""
    max_usd: float = 0.0
    own_hours: float = 0.0
    max_minutes: float | None = None
    damaged: list[str] = field(default_factory=list)


# What all trainings of a working folder used on a day.


FOLDER = "data/budget"


@dataclass(frozen=True)
class DaySpending:
    hours: Amount = 0.0
    usd: Amount = 0.0


@dataclass(frozen=True)
class DayBudget:
    """The limits of a day for all trainings of a folder, and what is used.

    Attributes:
        day: YYYY-MM-DD, in this machine's time zone.
        hours: Machine hours until now.
        usd: What they cost, USD, where the price was known.
        max_hours: DR_DAILY_BUDGET_HOURS; 0 for no limit.
        max_usd: DR_DAILY_BUDGET_MONEY; 0 for no limit.
        starts: Starts that trained on that day.
        damaged: Unreadable files, whose hours are missing.
    """

    day: str
    hours: float = 0.0
    usd: float = 0.0
    max_hours: float = 0.0
    max_usd: float = 0.0
    starts: int = 0
    damaged: int = 0

    @property
    def limited(self) -> bool:
        """Whether there is one."""
        return self.max_hours > 0.0 or self.max_usd > 0.0

    @property
    def used_up(self) -> str | None:
        """The reached limit, as a sentence, or None."""
        if 0.0 < self.max_hours <= self.hours:
            return (
                f"The budget of {self.day} is used up: all trainings of this folder together took "
                f"{self.hours:.2f} machine hours, DR_DAILY_BUDGET_HOURS is {self.max_hours:g}."
            )
        if 0.0 < self.max_usd <= self.usd:
            return (
                f"The budget of {self.day} is used up: all trainings of this folder together cost "
                f"{self.usd:.2f} USD, DR_DAILY_BUDGET_MONEY is {self.max_usd:g}."
            )
        return None

    @property
    def remedy(self) -> str:
        """How to go on after that."""
        hours = 0.0 < self.max_hours <= self.hours
        name = "DR_DAILY_BUDGET_HOURS" if hours else "DR_DAILY_BUDGET_MONEY"
        return (
            "The next day begins at midnight by this machine's clock; continue then with "
            f"`dr-start-training --resume-or-start`, or raise {name} in system.env."
        )

    def __str__(self) -> str:
        """As in "budget of 2026-05-01: 3.20 of 8 hours, 1.10 of 5 USD"."""
        parts = []
        if self.max_hours:
            parts.append(f"{self.hours:.2f} of {self.max_hours:g} hours")
        if self.max_usd:
            parts.append(f"{self.usd:.2f} of {self.max_usd:g} USD")
        text = f"budget of {self.day}: {', '.join(parts)}"
        if self.damaged:
            text += f" ({self.damaged} unreadable in {FOLDER}/{self.day}, left out)"
        return text


def day_of(seconds: float) -> str:
    return time.strftime("%Y-%m-%d", time.localtime(seconds))


def write_day(directory: Path, day: str, session: str, spent: DaySpending) -> None:
    folder = directory / FOLDER / day
    folder.mkdir(parents=True, exist_ok=True)
    save_record(folder / f"{session}.json", spent)


def read_day(
    directory: Path, day: str, *, max_hours: float = 0.0, max_usd: float = 0.0
) -> DayBudget:
    found = list(_starts(directory / FOLDER / day))
    known = [each for each in found if each is not None]
    return DayBudget(
        day,
        sum(each.hours for each in known),
        sum(each.usd for each in known),
        max_hours,
        max_usd,
        len(known),
        len(found) - len(known),
    )


def budget_of(directory: Path, settings: UnattendedConfig, now_s: float) -> DayBudget:
    return read_day(
        directory,
        day_of(now_s),
        max_hours=settings.daily_budget_hours,
        max_usd=settings.daily_budget_money,
    )


def _starts(folder: Path) -> Iterator[DaySpending | None]:
    try:
        paths = sorted(folder.glob("*.json"))
    except OSError:
        return
    for path in paths:
        spent = load_record(DaySpending, path)
        if spent is None and not path.exists():
            continue  # somebody deleted it meanwhile
        yield spent
