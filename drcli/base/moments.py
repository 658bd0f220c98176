"""Times as people write them on a command line."""

import re
from datetime import UTC, datetime, timedelta

from drcli.base.errors import SettingsError

_AGE = re.compile(r"(\d{1,5})\s*([mhdw])")
_UNITS = {"m": "minutes", "h": "hours", "d": "days", "w": "weeks"}


def moment(option: str, text: str, now: datetime) -> datetime:
    """A UTC date such as 2026-11-20T08:30, or an age: 30m, 12h, 7d, 3w.

    Raises:
        SettingsError: It is neither.
    """
    age = _AGE.fullmatch(text.strip().casefold())
    try:
        if age is not None:
            return now - timedelta(**{_UNITS[age[2]]: int(age[1])})
        read = datetime.fromisoformat(text.strip())
        return read.replace(tzinfo=UTC) if read.tzinfo is None else read.astimezone(UTC)
    except (ValueError, OverflowError):
        raise SettingsError(
            f"{option} {text} is neither a date nor an age.",
            remedy="Write a date such as 2026-11-20, or an age such as 30m, 12h, 7d or 3w.",
        ) from None
