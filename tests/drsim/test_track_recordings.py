"""Waypoints and progress, derived again from positions that the reference simulator recorded."""

import csv
from pathlib import Path

import numpy as np
import pytest

from drsim.progress import advance_progress
from drsim.worlds import load_track

SHARED = Path(__file__).resolve().parents[3] / "shared"

START_ADVANCE = 0.05
"""Share of a lap that the start moves on after an episode. Source: the reference simulator."""


def recording(run: str) -> list[dict[str, str]]:
    file = SHARED / "reference-runs" / run / "training-simtrace" / "0-iteration.csv"
    if not file.is_file():
        pytest.skip(f"there is no recorded reference run {run} beside the repository")
    with file.open(newline="", encoding="utf-8") as lines:
        return list(csv.DictReader(lines))


def numbers(rows: list[dict[str, str]], *columns: str) -> np.ndarray:
    return np.array([[float(row[column]) for column in columns] for row in rows])


@pytest.mark.parametrize(
    ("run", "world"),
    [("drfc-time-trial", "reinvent_base"), ("simapp6-continuous", "reInvent2019_wide_cw")],
)
def test_every_recorded_row_gets_its_recorded_waypoint_and_progress(run, world):
    rows = recording(run)
    track = load_track(str(SHARED / "tracks" / f"{world}.npy"))
    episode = numbers(rows, "episode")[:, 0]

    where = track.locate(numbers(rows, "X", "Y"))

    np.testing.assert_array_equal(where.nearest, numbers(rows, "closest_waypoint")[:, 0])
    progress, previous = np.empty(len(rows)), 0.0
    for k, fraction in enumerate(where.distance_m / track.length_m):
        if k == 0 or episode[k] != episode[k - 1] or previous == 100.0:
            previous = 0.0
        start = np.array([episode[k] * START_ADVANCE % 1.0])
        previous = advance_progress(np.array([previous]), np.array([fraction]), start)[0]
        progress[k] = previous
    np.testing.assert_allclose(progress, numbers(rows, "progress")[:, 0], atol=1e-9)
