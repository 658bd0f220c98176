"""Track columns, derived again from the poses that the reference simulator recorded."""

import csv
from pathlib import Path

import numpy as np
import pytest

from drsim.episode.episode_rules import advance_progress
from drsim.fidelity.motion import all_wheels_on, compare_track_columns
from drsim.fidelity.recordings import load_recordings
from drsim.track.worlds import load_track

pytestmark = pytest.mark.nightly

SHARED = Path(__file__).resolve().parents[4] / "shared"

RUNS = [("drfc-time-trial", "reinvent_base"), ("simapp6-continuous", "reInvent2019_wide_cw")]

START_ADVANCE = 0.05
"""Share of a lap that the start moves on after an episode. Source: the reference simulator."""


def traces(run: str) -> Path:
    folder = SHARED / "reference-runs" / run
    if not folder.is_dir():
        pytest.skip(f"there is no recorded reference run {run} beside the repository")
    return folder


def route(world: str):
    file = SHARED / "tracks" / f"{world}.npy"
    if not file.is_file():
        pytest.skip(
            f"there is no folder of reference routes with {world}.npy beside the repository"
        )
    return load_track(str(file))


@pytest.mark.parametrize(("run", "world"), RUNS)
def test_all_recorded_rows_get_their_recorded_columns(run, world):
    drives = load_recordings(traces(run)).drives

    found = compare_track_columns(drives, route(world))

    assert found.fits
    assert not found.reverse
    assert found.rows > 10_000
    assert found.closest_waypoint == 1.0
    assert found.progress == 1.0
    assert found.all_wheels_on_track > 0.999
    assert found.length_m == pytest.approx(found.recorded_length_m, abs=1e-9)


@pytest.mark.parametrize(("run", "world"), RUNS)
def test_only_within_4_mm_of_a_border_or_while_the_car_is_put_are_wheels_judged_otherwise(
    run, world
):
    track = route(world)
    drives = load_recordings(traces(run)).drives
    poses = np.concatenate([drive.poses for drive in drives])
    recorded = np.concatenate([drive.wheels_on for drive in drives])
    held = np.concatenate([np.arange(len(d.poses)) < d.held for d in drives])

    wrong = np.flatnonzero((all_wheels_on(poses, track) != recorded) & ~held)

    assert 0 < len(wrong) < 10
    shifts_m = 0.004 * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    for pose, was_on in zip(poses[wrong], recorded[wrong], strict=True):
        nearby = np.column_stack([pose[:2] + shifts_m, np.full(4, pose[2])])
        assert (all_wheels_on(nearby, track) == was_on).any()


@pytest.mark.parametrize(("run", "world"), RUNS)
def test_progress_follows_from_the_position_and_the_turn_of_the_start_alone(run, world):
    with (traces(run) / "training-simtrace" / "0-iteration.csv").open(newline="") as lines:
        rows = list(csv.DictReader(lines))
    points, recorded, episode = (
        np.array([[float(row[name]) for name in names] for row in rows])
        for names in (("X", "Y"), ("progress",), ("episode",))
    )
    track = route(world)
    fractions = track.locate(points).distance_m / track.length_m

    progress, previous = np.empty(len(rows)), 0.0
    for k, fraction in enumerate(fractions):
        if k == 0 or episode[k] != episode[k - 1] or previous == 100.0:
            previous = 0.0
        start = episode[k] * START_ADVANCE % 1.0
        previous = advance_progress(np.array([previous]), np.array([fraction]), start)[0]
        progress[k] = previous

    np.testing.assert_allclose(progress, recorded[:, 0], atol=1e-9)


@pytest.mark.parametrize(("run", "world"), RUNS)
def test_in_each_recorded_episode_step_1_is_not_paid_and_step_2_is(run, world):
    """So the first call of a reward function has `steps` 2, in evaluations as well."""
    first, second = [], []
    for file in traces(run).rglob("*-iteration.csv"):
        with file.open(newline="") as lines:
            for row in csv.DictReader(lines):
                if float(row["steps"]) == 1.0:
                    first.append((row["episode_status"], float(row["reward"])))
                if float(row["steps"]) == 2.0:
                    second.append(float(row["reward"]))

    assert len(first) == len(second) >= 300
    assert set(first) == {("prepare", 0.0)}
    assert min(second) > 0.0
