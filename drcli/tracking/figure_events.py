"""What is sent to other tools."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol


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


class Sink(Protocol):
    """Where events go. One thread calls its methods, which may fail."""

    name: str

    @property
    def takes(self) -> tuple[type, ...]:
        """Classes of events."""

    def send(self, event: Event) -> None:
        """Send an event of these classes."""

    def miss(self, event: Event) -> bool:
        """Take note of an unsent event; whether it is sent later."""

    def close(self) -> None:
        """Send the rest and free everything."""
