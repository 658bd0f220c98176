"""What the starts of a training have cost."""

from dataclasses import dataclass, field
from pathlib import Path

from drcli.base.atomic_file import load_record, save_record
from drcli.base.json_record import JsonRecord

_FILE = "spending.json"


@dataclass(frozen=True)
class StartSpending(JsonRecord):
    session: str
    host: str
    hours: float
    usd: float | None = None
    usd_per_hour: float | None = None


@dataclass(frozen=True)
class Spending:
    """All starts of a training, as its supervisor last knew it.

    Attributes:
        session: Of the newest start.
        starts: How many there were.
        hours: Machine hours of all of them together.
        usd: What these cost; None if no price is known.
        unpriced_hours: Hours without a known price.
        usd_per_hour: Present price; None if not known.
        price_of: Where that comes from, for people.
        max_usd: DR_MAX_COST; 0 for no limit.
        own_hours: Machine hours of the newest start.
        max_minutes: Limit of its time; None for none.
        damaged: Unreadable objects of earlier starts, whose cost is missing.
    """

    session: str
    starts: int
    hours: float
    usd: float | None = None
    unpriced_hours: float = 0.0
    usd_per_hour: float | None = None
    price_of: str = ""
    max_usd: float = 0.0
    own_hours: float = 0.0
    max_minutes: float | None = None
    damaged: list[str] = field(default_factory=list)

    def write(self, folder: Path) -> None:
        """Raises OSError."""
        save_record(folder / _FILE, self)

    @staticmethod
    def read(folder: Path) -> "Spending | None":
        """None if missing or unreadable."""
        return load_record(Spending, folder / _FILE)
