"""The 127 routes that racers know, where they lie beside the repository: load, draw and drive."""

from pathlib import Path

import numpy as np
import pytest
import shapely

from drsim.sensing.scene import build_scene
from drsim.track.appearance import look_of
from drsim.track.route_files import read_route, write_route
from drsim.track.track import Track
from drsim.track.worlds import describe, load_track

ROUTES = Path(__file__).resolve().parents[4] / "shared" / "tracks"

pytestmark = pytest.mark.skipif(
    not ROUTES.is_dir(), reason="there is no folder of community routes beside the repository"
)

DRAWN = [
    "penbay_pro",  # the longest
    "Straight_track",  # the only open one, and a line outside of the road
    "China_track",  # kerbs
    "Monaco",  # kerbs of another width
    "2022_reinvent_champ_ccw",  # no walls
    "reinvent_wood",
]


@pytest.fixture(scope="module")
def tracks() -> list[Track]:
    return [read_route(file) for file in sorted(ROUTES.glob("*.npy"))]


def test_every_route_loads_and_is_as_long_as_its_ring(tracks):
    assert len(tracks) == 127
    for track in tracks:
        assert track.length_m == pytest.approx(shapely.LineString(track.center).length, abs=0.01)
        assert np.mean(track.on_road(track.center[1:-1])) > 0.95


def test_every_route_is_described(tracks):
    infos = [describe(track.name, ROUTES) for track in tracks]

    assert sum(info.line_family == "out" for info in infos) == 20
    assert [info.name for info in infos if info.direction == "open"] == ["Straight_track"]
    assert sum(info.direction == "clockwise" for info in infos) == 38
    assert max(info.length_m for info in infos) == pytest.approx(89.24, abs=0.01)
    for info in infos:
        assert 0.55 < info.width_m.least <= info.width_m.mean <= info.width_m.greatest < 1.55
        assert 0.08 < info.spacing_m < 0.75


def test_a_file_of_one_direction_wins_over_its_base_and_a_missing_one_is_made_from_it():
    own_file = load_track("reInvent2019_wide_cw", ROUTES)
    made = load_track("Bowtie_track_cw", ROUTES)

    assert len(own_file.center) != len(load_track("reInvent2019_wide", ROUTES).center)
    assert not made.is_ccw
    assert made.length_m == pytest.approx(load_track("Bowtie_track", ROUTES).length_m)


@pytest.mark.parametrize("world", DRAWN)
def test_a_route_can_be_drawn(world):
    track = load_track(world, ROUTES)

    ground = build_scene(track).level(0)

    assert ground.min() < ground.max() - 100  # both road and line
    assert look_of(world).line.grey == pytest.approx(float(ground.max()), abs=40)


def test_every_route_is_written_and_read_back_the_same(tracks, tmp_path):
    file = tmp_path / "copy.npy"
    for track in tracks:
        write_route(track, file)

        copy = read_route(file)

        assert copy.closed == track.closed
        for line in ("center", "inner", "outer"):
            np.testing.assert_array_equal(getattr(copy, line), getattr(track, line))


def test_a_car_drives_the_first_four_seconds_of_every_route(tracks, follow):
    drive = follow(tracks, speed_mps=1.0, steps=60)

    assert [track.name for track, off in zip(tracks, drive.off_road, strict=True) if off] == []
    assert drive.progress_m.min() > 3.0


def test_the_borders_of_a_route_can_be_drawn_anew_from_its_centre_line(tracks):
    apart_m = []
    for track in tracks[::5]:  # all of them would take 7 s
        width_m = float(np.median(track.locate(track.center).track_width_m))

        drawn = read_route(ROUTES / f"{track.name}.npy", width_m=width_m)

        assert (drawn.closed, drawn.is_ccw) == (track.closed, track.is_ccw)
        for line in ("inner", "outer"):
            known, ours = (shapely.LineString(getattr(t, line)) for t in (track, drawn))
            apart_m.append(shapely.hausdorff_distance(known, ours))

    assert np.median(apart_m) < 0.05  # all of it, where the road is equally wide everywhere
    assert max(apart_m) < 0.3
