"""Generated circuits: the same everywhere, drivable, and as varied as the community's."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
import shapely

from drsim.errors import TrackError
from drsim.track import zoo
from drsim.track.worlds import describe, load_track

CIRCUITS = 200
ROUTES = Path(__file__).resolve().parents[4] / "shared" / "tracks"
STRAIGHT_M = 6.7


@pytest.fixture(scope="module")
def tracks():
    return [zoo.circuit(number) for number in range(CIRCUITS)]


def turns_m(track) -> np.ndarray:
    """Radius of the circle through each waypoint and its neighbours; straight ones are inf."""
    center = track.center[:-1]
    behind, ahead = center - np.roll(center, 1, axis=0), np.roll(center, -1, axis=0) - center
    cross = np.abs(behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0])
    sides = np.hypot(*behind.T) * np.hypot(*ahead.T) * np.hypot(*(behind + ahead).T)
    with np.errstate(divide="ignore"):
        return sides / (2 * cross)


def test_every_circuit_is_a_road_that_neither_crosses_nor_overlaps_itself(tracks):
    for track in tracks:
        inner, outer = shapely.Polygon(track.inner), shapely.Polygon(track.outer)

        assert shapely.LinearRing(track.center).is_simple
        assert inner.is_valid
        assert outer.is_valid
        assert outer.contains_properly(inner)
        assert outer.area - inner.area == pytest.approx(
            shapely.LineString(track.center).length * describe(track.name).width_m.mean, rel=0.02
        )
        assert track.on_road(track.center[:-1]).all()


def test_stretches_of_a_circuit_have_ground_between_them(tracks):
    for track in tracks:
        center, width_m = track.center[:-1], np.hypot(*(track.inner - track.outer)[0])
        row = np.arange(len(center))
        away = np.abs(row[:, None] - row)
        away_m = np.minimum(away, len(row) - away) * track.length_m / len(row)
        apart_m = np.hypot(*(center[:, None] - center).transpose(2, 0, 1))

        assert apart_m[away_m > np.pi / 2 * (width_m + 1.0)].min() > width_m + 0.3


def test_turns_leave_room_for_the_inner_border_and_waypoints_are_even(tracks):
    for track in tracks:
        step_m = np.hypot(*np.diff(track.center, axis=0).T)
        width_m = np.hypot(*(track.inner - track.outer).T)

        assert turns_m(track).min() > width_m.max() / 2 + 0.05
        assert step_m.max() < 1.05 * np.median(step_m)
        assert 0.09 < np.median(step_m) < 0.5


def test_a_circuit_is_the_same_in_every_release_and_on_every_processor(tracks):
    told = hashlib.sha256()
    for track in tracks[:50]:
        for line in (track.center, track.inner, track.outer):
            told.update(np.rint(1e4 * line).astype("<i8").tobytes())
            np.testing.assert_array_equal(line, np.round(line, 4))

    assert told.hexdigest()[:16] == "def397951d9c2c9c"


def figures(track) -> dict[str, float]:
    """Length, width, tightest turn in metres, shares of straights and of the rarer side."""
    length_m = np.hypot(*np.diff(track.center, axis=0).T).cumsum()
    at_m = np.arange(0.0, length_m[-1], 0.1)
    along = np.concatenate([[0.0], length_m])
    x, y = (np.interp(at_m, along, values) for values in track.center.T)
    dx, dy = np.roll(x, -4) - x, np.roll(y, -4) - y
    before_x, before_y = np.roll(dx, 4), np.roll(dy, 4)
    turn = np.arctan2(before_x * dy - before_y * dx, before_x * dx + before_y * dy) / 0.4
    left, right = (turn > 1 / STRAIGHT_M).mean(), (turn < -1 / STRAIGHT_M).mean()
    return {
        "length_m": length_m[-1],
        "width_m": np.hypot(*(track.inner - track.outer).T).mean(),
        "tightest_m": 1 / np.quantile(np.abs(turn), 0.99),
        "straight": 1.0 - left - right,
        "rarer": min(left, right) / (left + right),
        "turning": np.abs(turn).mean(),
    }


@pytest.mark.skipif(not ROUTES.is_dir(), reason="the community's routes are not beside the project")
def test_circuits_cover_what_the_community_drives(tracks):
    ours = [figures(track) for track in tracks]
    theirs = [
        figures(track)
        for track in (load_track(str(file)) for file in sorted(ROUTES.rglob("*.npy")))
        if track.closed
    ]

    for name in ours[0]:
        low, high = np.quantile([each[name] for each in ours], [0.01, 0.99])
        covered = np.mean([low <= each[name] <= high for each in theirs])

        assert covered > 0.9, (name, low, high)
    assert 0.4 < np.mean([track.is_ccw for track in tracks]) < 0.6


def test_a_circuit_is_named_like_any_track(tmp_path):
    track = load_track("zoo-17", tmp_path)
    turned = load_track("zoo-17_cw" if track.is_ccw else "zoo-17_ccw")

    assert track.name == "zoo-17"
    assert load_track("zoo-17.npy").name == "zoo-17"
    np.testing.assert_array_equal(turned.center, track.center[::-1])
    assert describe("zoo-17").source == "own"
    for wrong in ("zoo-", "zoo-017", "zoo-x", "zoo--1", "zoo-12345678", "Zoo-1"):
        with pytest.raises(TrackError, match="There is no track"):
            load_track(wrong, tmp_path)


def test_a_file_in_the_tracks_folder_wins_over_the_circuit_of_its_name(tmp_path):
    other = load_track("bean")
    np.save(tmp_path / "zoo-3.npy", np.hstack([other.center, other.inner, other.outer]))

    assert load_track("zoo-3", tmp_path).length_m == other.length_m


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    ("length_m", "width_m", "turn_m"), [(20.0, 0.8, 0.7), (45.0, 1.07, 0.8), (60.0, 1.4, 1.6)]
)
def test_a_circuit_of_choice_has_its_length_width_and_turns(seed, length_m, width_m, turn_m):
    track = zoo.generate("mine", length_m=length_m, width_m=width_m, turn_m=turn_m, seed=seed)

    assert track.name == "mine"
    assert track.length_m == pytest.approx(length_m, rel=1e-3)
    np.testing.assert_allclose(np.hypot(*(track.inner - track.outer).T), width_m, atol=1e-3)
    assert turns_m(track).min() == pytest.approx(turn_m, rel=0.15)
    assert turns_m(track).min() >= turn_m


def test_a_circuit_of_choice_differs_by_seed_and_only_by_seed():
    first, second, other = (zoo.generate("mine", length_m=30.0, seed=seed) for seed in (1, 1, 2))

    np.testing.assert_array_equal(first.center, second.center)
    assert first.center.shape != other.center.shape or not np.allclose(first.center, other.center)


@pytest.mark.parametrize(
    ("wishes", "message"),
    [
        ({"length_m": 8.0, "turn_m": 3.0}, "length_m=8 is less than a circle"),
        (
            {"length_m": 8.0, "turn_m": 1.2},
            "No drivable loop with length_m=8, turn_m=1.2 was found",
        ),
        ({"width_m": 1.0, "turn_m": 0.5}, "turn_m=0.5 leaves no room .* Give turn_m=0.56 or more"),
        ({"length_m": 5.0}, "length_m=5 is outside 8 to 150"),
        ({"width_m": float("nan")}, "width_m=nan is outside"),
        ({"turn_m": -1.0}, "turn_m=-1 is outside"),
    ],
)
def test_a_circuit_that_cannot_be_is_refused(wishes, message):
    with pytest.raises(TrackError, match=message):
        zoo.generate("mine", **wishes)
