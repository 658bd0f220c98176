"""What is sent to the tools of others: numbers of an iteration, episodes, epochs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from drcli.exchange.episode_metrics import EpisodeMetrics, TrialMetrics

EPISODE_S = 1.0
"""Most seconds between the times of two episodes that were driven side by side and ended together.
The server of the Grafana board keeps only one line of equal tags in each second."""


@dataclass(frozen=True)
class TrainingFacts:
    """What identifies a training.

    Attributes:
        model: Prefix of the model in the bucket.
        run_id: DR_RUN_ID.
        first_step: Steps learned from before this start: figures of later steps were given up.
        texts: What people want to read beside the curves, by name: hyperparameters, settings.
    """

    model: str
    run_id: int
    first_step: int = 0
    texts: Mapping[str, str] | None = None


@dataclass(frozen=True)
class Point:
    """Numbers of an iteration or of an evaluation.

    Attributes:
        step: Steps learned from, which is what CleanRL draws its curves over.
        time_s: Unix time.
        values: Finite numbers by the names that CleanRL gives them.
        is_evaluation: Whether a checkpoint was evaluated; else an iteration was learned.
    """

    step: int
    time_s: float
    values: Mapping[str, float]
    is_evaluation: bool = False


@dataclass(frozen=True)
class EpisodePoint:
    """A driven episode.

    Attributes:
        time_s: Unix time.
        phase: training or evaluation.
        status: How it ended, in the words of the metrics files.
        worker: Simulation worker, from 0.
        reward: Sum of the rewards, rounded as in the metrics files.
        progress: Percent of the lap, rounded down likewise.
        elapsed_ms: Simulated milliseconds.
        resets: How often a stand-alone evaluation put the car back; None in a training.
    """

    time_s: float
    phase: str
    status: str
    worker: int
    reward: int
    progress: int
    elapsed_ms: int
    resets: int | None = None


@dataclass(frozen=True)
class EpochPoint:
    """An epoch of an update: the policy's entropy, nats."""

    time_s: float
    entropy: float


@dataclass(frozen=True)
class Ended:
    """The training has ended or was stopped; `finished` says whether it is complete."""

    time_s: float
    finished: bool


Event = Point | EpisodePoint | EpochPoint | Ended


class Sink(Protocol):
    """Where events go. Its methods are called by one thread only, and may fail.

    Attributes:
        name: What the log calls it.
    """

    name: str

    @property
    def takes(self) -> tuple[type, ...]:
        """Classes of the events that it gets."""

    def send(self, event: Event) -> None:
        """Send an event of these classes."""

    def miss(self, event: Event) -> bool:
        """Take note of an event while the sink is left alone; whether it is sent later."""

    def close(self) -> None:
        """Send what is left and free everything."""


def episode_points(
    records: Sequence[EpisodeMetrics], worker: int, wall_clock: tuple[float, float]
) -> list[EpisodePoint]:
    """Episodes of an iteration as if one had ended after the other.

    Args:
        records: The episodes.
        worker: Simulation worker, from 0.
        wall_clock: Unix times between which they were driven.
    """
    return [
        EpisodePoint(
            time_s,
            record.phase,
            record.episode_status,
            worker,
            int(record.reward_score),
            int(record.completion_percentage),
            int(record.elapsed_time_in_milliseconds),
        )
        for time_s, record in zip(_times(len(records), wall_clock), records, strict=True)
    ]


def trial_points(
    trials: Sequence[TrialMetrics], wall_clock: tuple[float, float]
) -> list[EpisodePoint]:
    """The trials of a stand-alone evaluation, likewise."""
    return [
        EpisodePoint(
            time_s,
            "evaluation",
            trial.episode_status,
            0,
            0,
            int(trial.completion_percentage),
            int(trial.elapsed_time_in_milliseconds),
            resets=trial.reset_count,
        )
        for time_s, trial in zip(_times(len(trials), wall_clock), trials, strict=True)
    ]


def _times(count: int, wall_clock: tuple[float, float]) -> list[float]:
    """Times of so many episodes, the last one at the end."""
    began_s, ended_s = wall_clock
    apart_s = min(EPISODE_S, max(0.0, ended_s - began_s) / max(1, count))
    return [ended_s - apart_s * (count - 1 - place) for place in range(count)]
