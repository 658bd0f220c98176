"""What all trainings of a working folder used on a day."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from drcli.base.atomic_file import load_record, save_record
from drcli.config.run_config import UnattendedConfig

FOLDER = "data/budget"


@dataclass(frozen=True)
class DaySpending:
    hours: float = 0.0
    usd: float = 0.0


@dataclass(frozen=True)
class DayBudget:
    """The limits of a day for all trainings of a folder, and what is used.

    Attributes:
        day: YYYY-MM-DD, in this machine's time zone.
        hours: Machine hours until now.
        usd: What they cost, USD, where the price was known.
        max_hours: DR_DAILY_BUDGET_HOURS; 0 for no limit.
        max_usd: DR_DAILY_BUDGET_MONEY; 0 for no limit.
        starts: Starts that trained on that day.
        damaged: Unreadable files, whose hours are missing.
    """

    day: str
    hours: float = 0.0
    usd: float = 0.0
    max_hours: float = 0.0
    max_usd: float = 0.0
    starts: int = 0
    damaged: int = 0

    @property
    def limited(self) -> bool:
        """Whether there is one."""
        return self.max_hours > 0.0 or self.max_usd > 0.0

    @property
    def used_up(self) -> str | None:
        """The reached limit, as a sentence, or None."""
        if 0.0 < self.max_hours <= self.hours:
            return (
                f"The budget of {self.day} is used up: all trainings of this folder together took "
                f"{self.hours:.2f} machine hours, DR_DAILY_BUDGET_HOURS is {self.max_hours:g}."
            )
        if 0.0 < self.max_usd <= self.usd:
            return (
                f"The budget of {self.day} is used up: all trainings of this folder together cost "
                f"{self.usd:.2f} USD, DR_DAILY_BUDGET_MONEY is {self.max_usd:g}."
            )
        return None

    @property
    def remedy(self) -> str:
        """How to go on after that."""
        hours = 0.0 < self.max_hours <= self.hours
        name = "DR_DAILY_BUDGET_HOURS" if hours else "DR_DAILY_BUDGET_MONEY"
        return (
            "The next day begins at midnight by this machine's clock; continue then with "
            f"`dr-start-training --resume-or-start`, or raise {name} in system.env."
        )

    def __str__(self) -> str:
        """As in "budget of 2026-05-01: 3.20 of 8 hours, 1.10 of 5 USD"."""
        parts = []
        if self.max_hours:
            parts.append(f"{self.hours:.2f} of {self.max_hours:g} hours")
        if self.max_usd:
            parts.append(f"{self.usd:.2f} of {self.max_usd:g} USD")
        text = f"budget of {self.day}: {', '.join(parts)}"
        if self.damaged:
            text += f" ({self.damaged} unreadable in {FOLDER}/{self.day}, left out)"
        return text


def day_of(seconds: float) -> str:
    return time.strftime("%Y-%m-%d", time.localtime(seconds))


def write_day(directory: Path, day: str, session: str, spent: DaySpending) -> None:
    folder = directory / FOLDER / day
    folder.mkdir(parents=True, exist_ok=True)
    save_record(folder / f"{session}.json", spent)


def read_day(
    directory: Path, day: str, *, max_hours: float = 0.0, max_usd: float = 0.0
) -> DayBudget:
    found = list(_starts(directory / FOLDER / day))
    known = [each for each in found if each is not None]
    return DayBudget(
        day,
        sum(each.hours for each in known),
        sum(each.usd for each in known),
        max_hours,
        max_usd,
        len(known),
        len(found) - len(known),
    )


def budget_of(directory: Path, settings: UnattendedConfig, now_s: float) -> DayBudget:
    return read_day(
        directory,
        day_of(now_s),
        max_hours=settings.daily_budget_hours,
        max_usd=settings.daily_budget_money,
    )


def _starts(folder: Path) -> Iterator[DaySpending | None]:
    try:
        paths = sorted(folder.glob("*.json"))
    except OSError:
        return
    for path in paths:
        spent = load_record(DaySpending, path)
        if spent is not None and not (spent.hours >= 0.0 and spent.usd >= 0.0):
            spent = None
        if spent is None and not path.exists():
            continue  # somebody deleted it meanwhile
        yield spent
