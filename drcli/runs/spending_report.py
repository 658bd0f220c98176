"""What a training has left of its limits, and its requests per hour, for `dr-status`."""

from dataclasses import dataclass
from pathlib import Path

from drcli.exchange.spending import Spending
from drcli.store.request_count import NIGHT_HOURS, read_counts


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
        night_usd: What the requests of ten hours cost at Amazon's list prices.
    """

    puts: int
    gets: int
    deletes: int
    sent_bytes: int
    received_bytes: int
    hours: float
    night_usd: float


def time_left_s(spending: Spending | None) -> float | None:
    """Seconds until the time limit; None without one."""
    if spending is None or spending.max_minutes is None:
        return None
    return max(0.0, 60.0 * spending.max_minutes - 3600.0 * spending.own_hours)


def money_left(spending: Spending | None) -> float | None:
    """USD until DR_MAX_COST; None without that limit."""
    if spending is None or not spending.max_usd or spending.usd is None:
        return None
    return max(0.0, spending.max_usd - spending.usd)


def request_report(folder: Path, session: str, spending: Spending | None) -> RequestReport | None:
    """The requests of the newest start; None before they can be related to a time."""
    count = read_counts(folder, session)
    if spending is None or not count.requests or spending.own_hours <= 0.0:
        return None
    hours = spending.own_hours
    return RequestReport(
        count.puts,
        count.gets,
        count.deletes,
        count.sent_bytes,
        count.received_bytes,
        hours,
        count.list_price_usd / hours * NIGHT_HOURS,
    )
