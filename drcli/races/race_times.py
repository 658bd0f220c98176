"""Reads when a race opens and closes."""

import re
from datetime import UTC, datetime, timedelta

from drcli.base.errors import SettingsError
from drcli.base.problems import shown

_SPAN = re.compile(r"(\d{1,6})\s*([mhdw])")
_LATEST_S = 1e10
_UNITS = {"m": "minutes", "h": "hours", "d": "days", "w": "weeks"}


def parse_time(option: str, text: str, now_s: float) -> float:
    """Unix seconds of 2026-11-20T18:30 (UTC), 2026-11-20T18:30+01:00, or 90m, 2h, 7d from now.

    Raises:
        SettingsError: It is none of these.
    """
    words = text.strip()
    span = _SPAN.fullmatch(words.casefold())
    try:
        if span is not None:
            at = now_s + timedelta(**{_UNITS[span[2]]: int(span[1])}).total_seconds()
        else:
            read = datetime.fromisoformat(words)
            at = (read if read.tzinfo is not None else read.replace(tzinfo=UTC)).timestamp()
        if not 0.0 <= at <= _LATEST_S:
            raise ValueError
        return at
    except (ValueError, OverflowError):
        raise SettingsError(
            f"{option} {shown(text)} is neither a date nor a time from now.",
            remedy="Write a date in UTC such as 2026-11-20T18:30, or a time from now such as 2h.",
        ) from None
