"""The stages of a training: what each drives and learns, its goal, and which one a model is in."""

from dataclasses import dataclass

from drcli.config.run_config import RaceConfig


@dataclass(frozen=True)
class StageGoal:
    """When a stage ends: all targets together are reached, or one of the limits.

    Targets are judged by the evaluations of one checkpoint; those of `mean_reward` by training
    episodes. A value of None is not asked for.

    Attributes:
        laps: Target: all evaluation laps of a checkpoint are completed, so many at least.
        lap_time: Target: all its laps are completed, in so many simulated seconds on average.
        progress: Target: mean progress of its evaluation, percent.
        evaluations: How many evaluations in a row must reach these targets.
        mean_reward: Target: mean reward of the stage's last 100 training episodes.
        steps: Limit: steps of the stage.
        episodes: Limit: training episodes of the stage.
        iterations: Limit: iterations of the stage.
        minutes: Limit: minutes of training in the stage, without the time it was stopped.
    """

    laps: int | None = None
    lap_time: float | None = None
    progress: float | None = None
    evaluations: int = 1
    mean_reward: float | None = None
    steps: int | None = None
    episodes: int | None = None
    iterations: int | None = None
    minutes: float | None = None

    @property
    def evaluated(self) -> bool:
        """Whether evaluations decide."""
        return any(each is not None for each in (self.laps, self.lap_time, self.progress))

    @property
    def empty(self) -> bool:
        """Whether the stage ends only with the training."""
        limits = (self.mean_reward, self.steps, self.episodes, self.iterations, self.minutes)
        return not self.evaluated and all(each is None for each in limits)

    def __str__(self) -> str:
        """Everything that ends the stage, to be read after "ends"."""
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
    """One stage, with everything that its processes need.

    Attributes:
        name: Unique in its curriculum; a resumed training finds its stage by it.
        races: For the first worker, and for all others that have a race of their own.
        reward: Source of the reward function.
        reward_name: What its author calls that file.
        hyperparameters: `hyperparameters.json` with all values of the stage.
    """

    name: str
    races: tuple[RaceConfig, ...]
    reward: str
    reward_name: str
    hyperparameters: str
    goal: StageGoal

    def race(self, worker: int = 0) -> RaceConfig:
        """What a simulation worker drives, counted from 0."""
        return self.races[worker if worker < len(self.races) else 0]


@dataclass(frozen=True)
class StageMark:
    """The stage that a checkpoint belongs to, and what was counted when the stage began.

    Attributes:
        name: Of the stage.
        number: Its place in the curriculum, from 1.
        count: How many stages there are.
        world: Its track.
        goal: Its end, as a phrase for people.
        iteration: Number of its first checkpoint.
        steps: Steps learned from before it.
        episodes: Training episodes before it.
        elapsed_s: Wall time of training before it.
    """

    name: str
    number: int = 1
    count: int = 1
    world: str = ""
    goal: str = ""
    iteration: int = 0
    steps: int = 0
    episodes: int = 0
    elapsed_s: float = 0.0

    def __str__(self) -> str:
        """As in "stage 2 of 4 (base)"."""
        return f"stage {self.number} of {self.count} ({self.name})"
