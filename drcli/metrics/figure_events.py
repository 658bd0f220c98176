"""What is sent to other tools."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from drcli.records.episode_metrics import EpisodeMetrics, TrialMetrics

EPISODE_S = 1.0
"""Most seconds between the times of two episodes that were driven side by side and ended together.
The server of the Grafana board keeps only one line of equal tags in each second."""


@dataclass(frozen=True)
class TrainingFacts:
    """What identifies a training.

    Attributes:
        first_step: Steps learned before; figures of later ones were given up.
        texts: For people, by name.
    """

    model: str
    run_id: int
    first_step: int = 0
    texts: Mapping[str, str] | None = None


@dataclass(frozen=True)
class Point:
    """Numbers of an iteration or of an evaluation.

    Attributes:
        step: Steps learned from, CleanRL's x-axis.
        values: Finite, by CleanRL's names.
    """

    step: int
    time_s: float
    values: Mapping[str, float]
    is_evaluation: bool = False


@dataclass(frozen=True)
class EpisodePoint:
    """A driven episode, in the words of the metrics files.

    Attributes:
        reward: Sum, rounded.
        progress: Percent, rounded down.
        elapsed_ms: Simulated.
        resets: None in a training.
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
    """An epoch of an update; entropy in nats."""

    time_s: float
    entropy: float


@dataclass(frozen=True)
class Ended:
    """A training has ended; `finished` if it is complete."""

    time_s: float
    finished: bool


Event = Point | EpisodePoint | EpochPoint | Ended


class Sink(ABC):
    """Where events of the classes `takes` go. One thread calls its methods, which may fail."""

    name: str
    takes: ClassVar[tuple[type, ...]]

    @abstractmethod
    def send(self, event: Event) -> None:
        """Send an event of these classes."""

    def miss(self, event: Event) -> bool:
        """Take note of an unsent event; whether it is sent later."""
        return False

    @abstractmethod
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
