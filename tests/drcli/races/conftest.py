"""A bucket with models, and races whose laps exist only on paper."""

from pathlib import Path

import pytest

from home_races import COMPLETE, RACE, Home, home_in, lap

__all__ = ["COMPLETE", "RACE", "Home", "home", "lap"]


@pytest.fixture
def home(working_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Home:
    """Three models, and a race folder without a race."""
    return home_in(working_folder, monkeypatch)
