"""What one simulation worker has to drive, and how much of its time evaluations may take."""

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Share:
    """Which training episodes of an iteration this worker drives.

    Attributes:
        worker: Index from 0.
        workers: Number of workers.
        episodes: Training episodes of an iteration over all workers.
    """

    worker: int
    workers: int
    episodes: int

    @property
    def count(self) -> int:
        """Episodes of this worker in every iteration."""
        return self.episodes // self.workers + (self.worker < self.episodes % self.workers)

    @property
    def most(self) -> int:
        """Episodes in every iteration of those workers that drive most; worker 0 is one."""
        return -(-self.episodes // self.workers)

    def numbers(self, iteration: int) -> range:
        """Numbers of this worker's episodes in one iteration, counted from 0 for its whole life."""
        return range(iteration * self.count, (iteration + 1) * self.count)

    def position(self, number: int) -> int:
        """Place of an episode in the order of all workers' episodes; decides where it starts."""
        return number * self.workers + self.worker


class EvaluationBudget:
    """Keeps evaluations within a share of a training's time."""

    def __init__(self, share: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._share = share
        self._clock = clock
        self._began_s = clock()
        self._spent_s = 0.0

    def allows_another(self) -> bool:
        """Whether the evaluations so far took less than their share; true before the first."""
        return self._spent_s <= self._share * (self._clock() - self._began_s)

    def spend(self, seconds: float) -> None:
        """Count how long an evaluation took."""
        self._spent_s += seconds
