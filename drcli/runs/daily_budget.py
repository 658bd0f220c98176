"""Counts what all trainings of a folder use on a day, and ends them at the limit.

Each start writes a file for each day: nobody waits for a lock, and a vanished start loses ten
seconds.
"""

import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from drcli.base.log import get_logger
from drcli.exchange.daily_spending import (
    FOLDER,
    DayBudget,
    DaySpending,
    budget_of,
    day_of,
    write_day,
)
from drcli.exchange.job import Job
from drcli.runs.duty import Duty, RunningTraining
from drcli.runs.outcome import INTERRUPTED, Ending, Outcome
from drcli.runs.periodic import Periodic

_logger = get_logger(__name__)

COUNT_S = 10.0
KEPT_DAYS = 62


class Meter(Protocol):
    """Counts the present start."""

    @property
    def own_hours(self) -> float:
        """Machine hours until now."""

    @property
    def own_usd(self) -> float:
        """What they cost, as far as the price is known."""


class DailyBudget(Duty):
    name = "daily budget"

    def __init__(self, job: Job, meter: Meter, *, now: Callable[[], float] = time.time) -> None:
        self._job = job
        self._meter = meter
        self._now = now
        self._day = day_of(now())
        self._hours_before = self._usd_before = 0.0
        self._budget: DayBudget | None = None
        self._failed = False
        self._thread = Periodic("daily budget", self.step, COUNT_S)

    def start(self, run: RunningTraining) -> None:
        forget_old_days(self._job.directory)
        self._thread.start()

    def check(self) -> Outcome | None:
        budget = self._budget
        if budget is None or budget.used_up is None:
            return None
        return Outcome(INTERRUPTED, budget.used_up, budget.remedy)

    def finish(self, ending: Ending) -> None:
        self._thread.stop()
        self.step()

    def leave(self, ending: Ending) -> None:
        self._thread.stop()

    def step(self) -> None:
        self._write()
        today = day_of(self._now())
        if today != self._day:
            self._day = today
            self._hours_before, self._usd_before = self._meter.own_hours, self._meter.own_usd
        self._budget = budget_of(self._job.directory, self._job.config.unattended, self._now())

    def _write(self) -> None:
        spent = DaySpending(
            max(0.0, self._meter.own_hours - self._hours_before),
            max(0.0, self._meter.own_usd - self._usd_before),
        )
        try:
            write_day(self._job.directory, self._day, self._job.session, spent)
        except OSError as error:
            if not self._failed:
                _logger.warning(
                    "%s cannot be written, so the budget does not count on: %s",
                    self._job.directory / FOLDER,
                    error,
                )
            self._failed = True
        else:
            self._failed = False


def forget_old_days(directory: Path, keep: int = KEPT_DAYS) -> None:
    with suppress(OSError):
        days = sorted(path for path in (directory / FOLDER).iterdir() if path.is_dir())
        for path in days[:-keep]:
            shutil.rmtree(path, ignore_errors=True)
