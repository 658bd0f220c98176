"""Counts hours and money of all starts of a training, and ends it at the limit."""

import shutil
import socket
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Protocol

from drcli.base.errors import DrError
from drcli.base.json_record import RecordError
from drcli.base.log import get_logger
from drcli.bucket.bucket import ObjectMissing
from drcli.bucket.request_count import NIGHT_HOURS, RequestCount, read_counts
from drcli.config.run_config import StorageConfig
from drcli.model import keys
from drcli.outside.aws.prices import SpotPrice, own_spot_price
from drcli.records.training_record import (
    FOLDER,
    DayBudget,
    DaySpending,
    Spending,
    StartSpending,
    budget_of,
    day_of,
    write_day,
)
from drcli.run.duty import Duty, RunningTraining
from drcli.run.outcome import INTERRUPTED, Ending, Outcome
from drcli.run.periodic import within

# Counts what all trainings of a folder use on a day, and ends them at the limit.
#
# Each start writes a file for each day: nobody waits for a lock, and a vanished start loses ten
# seconds.


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
    every_s = COUNT_S

    def __init__(
        self, run: RunningTraining, meter: Meter, *, now: Callable[[], float] = time.time
    ) -> None:
        super().__init__(run)
        self._meter = meter
        self._now = now
        self._day = day_of(now())
        self._hours_before = self._usd_before = 0.0
        self._budget: DayBudget | None = None
        self._failed = False

    def start(self) -> None:
        forget_old_days(self.run.job.directory)

    def check(self) -> Outcome | None:
        budget = self._budget
        if budget is None or budget.used_up is None:
            return None
        return Outcome(INTERRUPTED, budget.used_up, budget.remedy)

    def finish(self, ending: Ending) -> None:
        self.stop()
        self.work()

    def work(self) -> None:
        self._write()
        today = day_of(self._now())
        if today != self._day:
            self._day = today
            self._hours_before, self._usd_before = self._meter.own_hours, self._meter.own_usd
        self._budget = budget_of(
            self.run.job.directory, self.run.job.config.unattended, self._now()
        )

    def _write(self) -> None:
        spent = DaySpending(
            max(0.0, self._meter.own_hours - self._hours_before),
            max(0.0, self._meter.own_usd - self._usd_before),
        )
        try:
            write_day(self.run.job.directory, self._day, self.run.job.session, spent)
        except OSError as error:
            if not self._failed:
                _logger.warning(
                    "%s cannot be written, so the budget does not count on: %s",
                    self.run.job.directory / FOLDER,
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


# What a training has left of its limits, and its requests.


LEAST_HOURS = 0.1


@dataclass(frozen=True)
class RequestReport:
    """Requests to S3 servers, and their bytes, of one start of a training."""

    puts: Annotated[int, "Requests that Amazon bills as PUT, COPY, POST or LIST."]
    gets: Annotated[int, "GET, HEAD and all others."]
    deletes: Annotated[int, "Requests that delete, which are free."]
    sent_bytes: Annotated[int, "In bodies of requests."]
    received_bytes: Annotated[int, "In bodies of answers."]
    hours: Annotated[float, "Time in which they were made."]
    night_usd: Annotated[
        float | None,
        "What the requests of ten hours cost at Amazon's list prices; null if the "
        "bucket is not at Amazon, or the time is too short to tell.",
    ]

    def __str__(self) -> str:
        """Requests and bytes per hour, or until now, and what a night of them costs."""
        short = self.hours < LEAST_HOURS
        time = f"in {3600.0 * self.hours:.0f} s" if short else "per hour"
        share = 1.0 if short else 1.0 / self.hours
        text = (
            f"Requests to the bucket {time}: {share * self.puts:,.0f} that write or list, "
            f"{share * self.gets:,.0f} that read; {share * self.sent_bytes / 1e6:,.0f} MB sent, "
            f"{share * self.received_bytes / 1e6:,.0f} MB received."
        )
        if self.night_usd is None:
            return text
        return (
            f"{text} At Amazon's list prices, the requests of a night of {NIGHT_HOURS:g} hours "
            f"cost {usd_text(self.night_usd)}."
        )


def time_left_s(spending: Spending | None) -> float | None:
    if spending is None or spending.max_minutes is None:
        return None
    return max(0.0, 60.0 * spending.max_minutes - 3600.0 * spending.own_hours)


def money_left(spending: Spending | None) -> float | None:
    if spending is None or not spending.max_usd or spending.usd is None:
        return None
    return max(0.0, spending.max_usd - spending.usd)


def request_report(
    count: RequestCount, hours: float, storage: StorageConfig
) -> RequestReport | None:
    if not count.requests or hours <= 0.0:
        return None
    billed = storage.at_amazon and hours >= LEAST_HOURS
    return RequestReport(
        count.puts,
        count.gets,
        count.deletes,
        count.sent_bytes,
        count.received_bytes,
        hours,
        count.list_price_usd / hours * NIGHT_HOURS if billed else None,
    )


def usd_text(amount: float) -> str:
    return f"{amount:.2f} USD" if amount >= 0.1 or amount == 0.0 else f"{amount:.4f} USD"


WRITE_S = 300.0
PRICE_S = 3600.0
LOG_S = 1800.0
_PATIENCE_S = 3.0
_MOST_STEP_S = 60.0
"""A sleeping machine is not counted."""


class Cost(Duty):
    """Counts on the monotonic clock, because the wall clock may jump."""

    name = "cost"
    every_s = COUNT_S

    def __init__(
        self,
        run: RunningTraining,
        *,
        ask_price: Callable[[str | None], SpotPrice] = own_spot_price,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(run)
        settings = run.job.config.unattended
        self._profile = run.job.config.storage.aws_profile
        self._ask = ask_price
        self._clock = clock
        self._lock = threading.Lock()
        self._auto = settings.spot_price == "auto"
        self._max_usd = settings.max_cost
        self._price = None if settings.spot_price in ("", "auto") else float(settings.spot_price)
        self._price_of = "" if self._price is None else "DR_SPOT_PRICE"
        self._began_s = self._counted_s = clock()
        self._hours = self._usd = self._unpriced = 0.0
        self._earlier: list[StartSpending] | None = None
        self._damaged: list[str] = []
        self._key = keys.spending(run.job.config.model.prefix, run.job.term, run.job.session)
        self._written_s = self._priced_s = -float("inf")
        self._logged_s = self._began_s

    def check(self) -> Outcome | None:
        if not self._max_usd:
            return None
        spending = self.spending
        if spending.usd is None or spending.usd < self._max_usd:
            return None
        return Outcome(
            0,
            f"Training is complete: the money limit ({usd_text(self._max_usd)}) was reached; "
            f"{spending.hours:.1f} machine hours cost {usd_text(spending.usd)}.",
        )

    def finish(self, ending: Ending) -> None:
        self.stop()
        self._count()
        within(min(_PATIENCE_S, ending.left_s(0.2)), self._write, ending.hurried)
        self._write_file()
        for line in self.sentences():
            _logger.info("%s", line)

    @property
    def spending(self) -> Spending:
        earlier = self._earlier or []
        usd = sum(each.usd for each in earlier if each.usd is not None) + self._usd
        unpriced = self._unpriced + sum(each.hours for each in earlier if each.usd is None)
        hours = self._hours + sum(each.hours for each in earlier)
        known = self._price is not None or usd > 0.0
        return Spending(
            session=self.run.job.session,
            starts=1 + len(earlier),
            hours=hours,
            usd=usd if known else None,
            unpriced_hours=unpriced if known else 0.0,
            usd_per_hour=self._price,
            price_of=self._price_of,
            max_usd=self._max_usd,
            own_hours=self._hours,
            max_minutes=self.run.job.max_minutes,
            damaged=list(self._damaged),
        )

    @property
    def own_hours(self) -> float:
        return self._hours

    @property
    def own_usd(self) -> float:
        return self._usd

    def end_facts(self) -> Mapping[str, object]:
        spending, requests = self.spending, self._requests()
        facts: dict[str, object] = {
            "machine_hours": round(spending.hours, 3),
            "starts": spending.starts,
            "cost": None if spending.usd is None else round(spending.usd, 4),
            "cost_limit": spending.max_usd or None,
            "requests": requests.requests,
            "sent_mb": round(requests.sent_bytes / 1e6, 1),
            "received_mb": round(requests.received_bytes / 1e6, 1),
        }
        return {name: value for name, value in facts.items() if value is not None}

    def sentences(self) -> list[str]:
        spending = self.spending
        text = f"{spending.hours:.2f} machine hours in {spending.starts} start"
        text += "s" if spending.starts > 1 else ""
        if spending.usd is not None:
            text += f", {usd_text(spending.usd)}"
            text += f" of {usd_text(spending.max_usd)}" if spending.max_usd else ""
            if spending.unpriced_hours:
                text += f" (the price of {spending.unpriced_hours:.2f} hours is not known)"
        lines = [f"{text}."]
        requests = request_report(self._requests(), self._hours, self.run.job.config.storage)
        return lines if requests is None else [*lines, str(requests)]

    def work(self) -> None:
        """Do whatever is due; DrError if the bucket does not answer."""
        self._count()
        now_s = self._clock()
        if self._auto and now_s - self._priced_s >= PRICE_S:
            self._priced_s = now_s
            self._ask_price()
        self._write_file()
        if now_s - self._logged_s >= LOG_S:
            self._logged_s = now_s
            for line in self.sentences():
                _logger.info("%s", line)
        if self._earlier is None:
            self._read_earlier()
        if now_s - self._written_s >= WRITE_S:
            self._put()
            self._written_s = now_s

    def _count(self) -> None:
        with self._lock:
            now_s = self._clock()
            hours = min(max(0.0, now_s - self._counted_s), _MOST_STEP_S) / 3600.0
            self._counted_s = now_s
            self._hours += hours
            if self._price is None:
                self._unpriced += hours
            else:
                self._usd += self._price * hours

    def _ask_price(self) -> None:
        try:
            found = self._ask(self._profile)
        except DrError as error:
            if self._price is None:
                limit = " DR_MAX_COST cannot be kept." if self._max_usd else ""
                _logger.warning("%s %s%s", error, error.remedy, limit)
            return
        if self._price is None:  # the first minutes cost the same
            self._usd += found.usd_per_hour * self._unpriced
            self._unpriced = 0.0
        if found.usd_per_hour != self._price:
            price = usd_text(found.usd_per_hour)
            _logger.info("Spot price of %s: %s per hour.", found.place, price)
        self._price, self._price_of = found.usd_per_hour, f"spot price of {found.place}"

    def _read_earlier(self) -> None:
        bucket, found = self.bucket, []
        for info in bucket.list(keys.spending_folder(self.run.job.config.model.prefix)):
            if info.key == self._key:
                continue
            try:
                found.append(StartSpending.decode(bucket.get(info.key)))
            except ObjectMissing:
                continue
            except RecordError as error:
                self._damaged.append(f"{bucket.name}/{info.key}")
                _logger.warning(
                    "%s/%s is damaged: %s. The cost of that start is missing.",
                    bucket.name,
                    info.key,
                    error,
                )
        self._earlier = found

    def _put(self) -> None:
        priced = self._price is not None or self._usd > 0.0
        own = StartSpending(
            self.run.job.session,
            socket.gethostname(),
            self._hours,
            self._usd if priced else None,
            self._price,
        )
        self.bucket.put(self._key, own.encode())

    def _write(self) -> None:
        try:
            self._put()
        except DrError as error:
            _logger.warning("The cost of this start could not be written: %s", error)

    def _write_file(self) -> None:
        with suppress(OSError):  # a full disk: `dr-status` shows an older state
            self.spending.write(self.run.job.folder)

    def _requests(self) -> RequestCount:
        return read_counts(self.run.job.folder, self.run.job.session)
