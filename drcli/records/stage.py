"""The stages of a training, and which one a model is in."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from drcli.base.files import FileRecord
from drcli.base.json_record import JsonRecord, SafeInt, Seconds
from drcli.config.run_config import DriveConfig
from drcli.learn.phases import Phase
from drcli.records.iteration import IterationRecord


@dataclass(frozen=True)
class StageGoal:
    """When a stage ends: all targets are reached, or one limit. None: not asked for.

    Evaluations of one checkpoint decide; for `mean_reward`, the last 100 training episodes.

    Attributes:
        laps: Target: all evaluation laps completed, at least so many.
        lap_time: Target: all completed, mean in simulated seconds.
        progress: Target: mean, percent.
        evaluations: How many in a row must reach these.
        steps: Limit, as all others.
        minutes: Without stops.
    """

    laps: SafeInt | None = None
    lap_time: float | None = None
    progress: float | None = None
    evaluations: SafeInt = 1
    mean_reward: float | None = None
    steps: SafeInt | None = None
    episodes: SafeInt | None = None
    iterations: SafeInt | None = None
    minutes: float | None = None

    @property
    def evaluated(self) -> bool:
        return any(each is not None for each in (self.laps, self.lap_time, self.progress))

    @property
    def empty(self) -> bool:
        limits = (self.mean_reward, self.steps, self.episodes, self.iterations, self.minutes)
        return not self.evaluated and all(each is None for each in limits)

    def __str__(self) -> str:
        targets, limits = [], []
        if self.laps is not None:
            targets.append(f"all evaluation laps are completed, at least {self.laps}")
        if self.lap_time is not None:
            targets.append(f"all evaluation laps take {self.lap_time:g} s or less on average")
        if self.progress is not None:
            targets.append(f"evaluations reach {self.progress:g} %")
        if self.evaluations > 1 and targets:
            targets[-1] += f" in {self.evaluations} evaluations in a row"
        if self.mean_reward is not None:
            targets.append(f"the mean reward of 100 episodes is {self.mean_reward:g}")
        for value, words in (
            (self.steps, "steps"),
            (self.episodes, "episodes"),
            (self.iterations, "iterations"),
            (self.minutes, "minutes"),
        ):
            if value is not None:
                limits.append(f"after {value:,g} {words if value != 1 else words[:-1]}")
        ways = [f"once {' and '.join(targets)}"] if targets else []
        return " or ".join([*ways, *limits]) or "with the training"


@dataclass(frozen=True)
class Stage:
    """One stage.

    Attributes:
        name: A resumed training finds its stage by it.
        races: Of the first worker and of others with their own.
        reward: Source text.
    """

    name: str
    races: tuple[DriveConfig, ...]
    reward: str
    reward_name: str
    hyperparameters: str
    goal: StageGoal

    def race(self, worker: int = 0) -> DriveConfig:
        return self.races[worker if worker < len(self.races) else 0]


@dataclass(frozen=True)
class StageMark:
    """The stage that a checkpoint belongs to, and what was counted when the stage began.

    Attributes:
        name: Of the stage.
        number: Its place in the curriculum, from 1.
        count: How many stages there are.
        world: Its track.
        goal: Its end, for people.
        iteration: Number of its first checkpoint.
        steps: Steps learned from before it.
        episodes: Training episodes before it.
        elapsed_s: Wall time of training before it.
    """

    name: str
    number: SafeInt = 1
    count: SafeInt = 1
    world: str = ""
    goal: str = ""
    iteration: SafeInt = 0
    steps: SafeInt = 0
    episodes: SafeInt = 0
    elapsed_s: Seconds = 0.0

    def __str__(self) -> str:
        """As in "stage 2 of 4 (base)"."""
        return f"stage {self.number} of {self.count} ({self.name})"


# What the trainer tells its supervisor when a stage or phase begins.


@dataclass(frozen=True)
class StageNote(FileRecord):
    FILE = "stage.json"

    session: str
    stage: str
    checkpoint: str
    text: str

    @staticmethod
    def of_session(folder: Path, session: str) -> "StageNote | None":
        found = StageNote.read(folder)
        return found if found is not None and found.session == session else None


# The phase that a training with a teacher is in.


PHASES: Mapping[Phase, str] = {
    "teacher": "sees the track, no camera",
    "distillation": "teaches the camera",
    "ppo": "the camera, by itself",
}


@dataclass(frozen=True)
class PhaseMark:
    name: Phase
    iteration: SafeInt = 0
    steps: SafeInt = 0

    @property
    def number(self) -> int:
        return list(PHASES).index(self.name) + 1

    def __str__(self) -> str:
        """Such as "phase 1 of 3, teacher (sees the track, no camera)"."""
        return f"phase {self.number} of {len(PHASES)}, {self.name} ({PHASES[self.name]})"


@dataclass(frozen=True)
class RangesMark:
    """From which `share` of the DR_SIM_ ranges episodes draw, since the checkpoint `iteration`."""

    share: Annotated[float, Meta(gt=0.0, le=1.0)]
    iteration: SafeInt = 0


def is_untaught(history: Sequence[IterationRecord], number: int) -> bool:
    """Whether only the teacher had learned before this checkpoint, by the whole history."""
    earlier = (record for record in history if record.iteration < number)
    return any(record.phase for record in history) and all(
        record.phase == "teacher" for record in earlier
    )


# The copy of a curriculum in the bucket, to resume on any machine.


@dataclass(frozen=True)
class FrozenCurriculum(JsonRecord):
    name: str
    text: str
    files: Mapping[str, str] = field(default_factory=dict)
