"""What a training has left of its limits, and its requests."""

from dataclasses import dataclass

from drcli.config.bucket_config import StorageConfig
from drcli.exchange.spending import Spending
from drcli.store.request_count import NIGHT_HOURS, RequestCount

LEAST_HOURS = 0.1


@dataclass(frozen=True)
class RequestReport:
    """Requests to S3 servers, and their bytes, of one start of a training.

    Attributes:
        puts: Requests that Amazon bills as PUT, COPY, POST or LIST.
        gets: GET, HEAD and all others.
        deletes: Requests that delete, which are free.
        sent_bytes: In bodies of requests.
        received_bytes: In bodies of answers.
        hours: Time in which they were made.
        night_usd: What the requests of ten hours cost at Amazon's list prices; null if the bucket
            is not at Amazon, or the time is too short to tell.
    """

    puts: int
    gets: int
    deletes: int
    sent_bytes: int
    received_bytes: int
    hours: float
    night_usd: float | None

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
