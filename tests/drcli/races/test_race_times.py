"""When a race opens and closes."""

import pytest

from drcli.base.errors import SettingsError
from drcli.races.race_options import parse_time


@pytest.mark.parametrize(
    ("text", "at"),
    [
        ("2h", 7200.0),
        ("90m", 5400.0),
        (" 1D ", 86400.0),
        ("1970-01-01T00:00:30", 30.0),
        ("1970-01-01T01:00:30+01:00", 30.0),
        ("1970-01-02", 86400.0),
    ],
)
def test_dates_and_times_from_now(text, at):
    assert parse_time("--closes", text, 0.0) == at


@pytest.mark.parametrize("text", ["", "tomorrow", "2y", "-2h", "999999w", "2026-13-01"])
def test_anything_else_is_refused(text):
    with pytest.raises(SettingsError, match="neither a date nor a time from now"):
        parse_time("--closes", text, 0.0)
