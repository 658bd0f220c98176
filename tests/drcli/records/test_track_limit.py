"""How far laps are from the limit: the wording, which limit is served, and the places."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drcli.tracks.limit_store import StoredLimit, fingerprint, read_limits, write_limits
from drcli.tracks.track_limit import (
    LapRow,
    TrackLimit,
    above_limit,
    computed_limits,
    limit_of,
    limit_text,
    lost_places,
)

STATIONS = 60
LIMIT = StoredLimit(
    route="",
    reverse=False,
    car="release-6",
    world="oval",
    computed_s=6.0,
    driven_s=6.1,
    standing_s=6.3,
    seed=1,
    version=1,
    length_m=12.0,
    offset_mm=tuple(range(-30, 30)),
    speed_mmps=(2000,) * STATIONS,
    clock_ms=tuple(range(0, 6000, 100)),
)


def test_one_wording_for_all():
    name = "of this car on this track"
    slow, undriven = replace(LIMIT, driven_s=6.5), replace(LIMIT, driven_s=None)

    assert limit_text(8.1, LIMIT) == f"8.10 s: 35 % above the limit {name} (6.00 s)"
    assert limit_text(7.8, slow) == f"7.80 s: 20 % above the best known lap {name} (6.50 s)"
    assert limit_text(6.4, slow) == f"6.40 s: faster than the best known lap {name} (6.50 s)"
    assert limit_text(6.6, undriven) == (
        f"6.60 s: 10 % above the computed lap {name} (6.00 s, which no car has driven)"
    )
    assert limit_text(None, LIMIT) == limit_text(8.1, None) == ""
    assert above_limit(6.0, TrackLimit.of(LIMIT)).startswith("6.00 s: 0 % above the limit")


def test_a_lap_that_was_driven_faster_than_computed_makes_no_limit():
    assert not replace(LIMIT, driven_s=5.9).validated
    assert TrackLimit.of(replace(LIMIT, driven_s=5.9)).lap_s == 5.9


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A working folder with a track, clockwise, and its limits in both directions."""
    angle = np.linspace(0.0, -2.0 * np.pi, 40)
    rows = np.column_stack([r * f(angle) for r in (2.0, 1.5, 2.5) for f in (np.cos, np.sin)])
    (tmp_path / "tracks").mkdir()
    file = tmp_path / "tracks" / "oval.npy"
    np.save(file, rows)
    cache = computed_limits(tmp_path)
    cache.parent.mkdir(parents=True)
    forward = replace(LIMIT, route=fingerprint(file))
    write_limits(cache, [forward, replace(forward, reverse=True, computed_s=6.05)])
    return tmp_path


@pytest.mark.parametrize(
    ("world", "reverse", "lap_s"),
    [
        ("oval", False, 6.0),
        ("oval", True, 6.05),
        ("oval.npy", False, 6.0),
        ("tracks/oval.npy", False, 6.0),
        ("oval_cw", False, 6.0),
        ("oval_ccw", False, 6.05),
        ("oval_ccw", True, 6.0),
    ],
)
def test_a_limit_is_found_by_name_and_direction(folder, world, reverse, lap_s):
    found = limit_of(world, folder / "tracks", folder, reverse=reverse, car="release-6")

    assert found is not None
    assert found.computed_s == lap_s
    assert found.clock_ms == LIMIT.clock_ms
    assert found.offset_mm == LIMIT.offset_mm


def test_a_changed_file_and_another_car_have_no_limit(folder):
    file = folder / "tracks" / "oval.npy"
    other = limit_of("oval", folder / "tracks", folder, reverse=False, car="low-grip")
    rows = np.load(file)
    rows[3, 0] += 0.001
    np.save(file, rows)

    assert other is None
    assert limit_of("oval", folder / "tracks", folder, reverse=False, car="release-6") is None
    assert limit_of("nowhere", folder / "tracks", folder, reverse=False, car="release-6") is None


def test_a_damaged_file_of_limits_counts_as_none(folder):
    computed_limits(folder).write_bytes(b"PK\x03\x04 damaged")

    assert read_limits(computed_limits(folder)) == {}


def test_the_places_that_cost_most_time_are_named_by_waypoints():
    # 2 m/s like the line, but 1 m/s between 50 and 60 % of the lap; 120 waypoints.
    progress, rows = 0.0, []
    while progress < 100.0:
        rows.append(LapRow(progress, int(1.2 * progress)))
        speed = 1.0 if 50.0 <= progress < 60.0 else 2.0
        progress += 100.0 * speed / 15.0 / LIMIT.length_m
    rows.append(LapRow(100.0, 119))

    places = lost_places(rows, 0.0, LIMIT)

    assert sum(place.lost_s for place in places) == pytest.approx(0.6, abs=0.1)
    assert min(place.first_waypoint for place in places) >= 58
    assert max(place.last_waypoint for place in places) <= 82
    assert places == sorted(places, key=lambda place: -place.lost_s)
    assert str(places[0]).startswith(f"waypoints {places[0].first_waypoint} to ")
