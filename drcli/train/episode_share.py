"""Decides which episodes a worker drives, and how long evaluations may take."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from drcli.records.job import Shares, WorkerShare


@dataclass(frozen=True)
class Share:
    """A worker's part of the `episodes` of an iteration.

    `numbered` is the largest number of episodes of any stage: each iteration gets as many
    numbers, so that they are unique. 0 means `episodes`.
    """

    worker: int
    workers: int
    episodes: int
    numbered: int = 0

    @property
    def count(self) -> int:
        return self.episodes // self.workers + (self.worker < self.episodes % self.workers)

    @property
    def most(self) -> int:
        """Of any worker; worker 0 drives that many."""
        return -(-max(self.episodes, self.numbered) // self.workers)

    @property
    def _stride(self) -> int:
        return self.most if self.numbered else self.count

    def numbers(self, iteration: int) -> range:
        """Counted from the first iteration."""
        first = iteration * self._stride
        return range(first, first + self.count)

    def position(self, number: int) -> int:
        """Among the episodes of all workers; decides where it starts."""
        iteration, place = divmod(number, self._stride)
        return (iteration * self.count + place) * self.workers + self.worker


@dataclass(frozen=True)
class AssignedShare:
    """The part of a worker where the trainer says who drives what.

    As long as all have equal parts, these are those of `Share`.
    """

    shares: Shares
    own: WorkerShare

    @property
    def evaluates(self) -> bool:
        return self.shares.workers[0] == self.own

    def numbers(self, iteration: int) -> range:
        first = self.own.first + (iteration - self.shares.iteration) * self.own.count
        return range(first, first + self.own.count)

    def position(self, number: int) -> int:
        return number * len(self.shares.workers) + self.shares.workers.index(self.own)


class EvaluationBudget:
    """Keeps evaluations within a share of the time, and `credit_s` beyond."""

    def __init__(
        self,
        share: float,
        credit_s: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._share, self._credit_s = share, credit_s
        self._clock = clock
        self._began_s = self._asked_s = clock()
        self._spent_s = self._last_s = 0.0

    def allows_another(self, left_s: float = math.inf, *, promising: bool = True) -> bool:
        """Whether to evaluate during a drive; to be asked before each.

        The checkpoint has to be promising, and one more evaluation has to stay within the
        share; or this is the last drive within the time that is left.
        """
        now_s = self._clock()
        cycle_s, self._asked_s = now_s - self._asked_s, now_s
        allowed_s = self._credit_s + self._share * (now_s - self._began_s)
        is_last = cycle_s <= left_s < 2.0 * cycle_s
        return is_last or (promising and self._spent_s + self._last_s <= allowed_s)

    def __str__(self) -> str:
        """Such as "4.1 s, 3.2 % of the time"."""
        passed_s = max(1e-9, self._clock() - self._began_s)
        return f"{self._spent_s:.1f} s, {100.0 * self._spent_s / passed_s:.1f} % of the time"

    def spend(self, seconds: float) -> None:
        self._spent_s += seconds
        self._last_s = seconds
