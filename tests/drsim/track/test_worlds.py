"""Worlds by name: which file a name stands for, which way round it runs, and what is said of it."""

from pathlib import Path

import numpy as np
import pytest
import shapely

from drsim.errors import TrackError
from drsim.track.worlds import describe, directed, known_worlds, load_track
from square_route import saved, square_rows

ROUTES = Path(__file__).resolve().parents[4] / "shared" / "tracks"

needs_routes = pytest.mark.skipif(
    not ROUTES.is_dir(), reason="there is no folder of reference routes beside the repository"
)


def test_a_route_file_is_loaded_by_its_path(tmp_path):
    track = load_track(saved(tmp_path, square_rows()))

    assert track.name == "mine"
    assert track.closed
    assert track.is_ccw
    assert track.length_m == 16.0
    np.testing.assert_array_equal(track.outer, square_rows()[:, 4:])


def test_a_route_file_is_loaded_by_its_name_in_the_tracks_folder(tmp_path):
    saved(tmp_path, square_rows())

    assert load_track("mine", tmp_path).length_m == 16.0
    assert set(known_worlds(tmp_path)) - set(known_worlds()) == {"mine"}


def test_a_route_file_is_loaded_by_its_name_with_the_ending_too(tmp_path):
    saved(tmp_path, square_rows())
    (tmp_path / "table.csv").write_text("0,0\n4,0\n4,4\n0,4\n0,0\n", encoding="utf-8")

    assert load_track("mine.npy", tmp_path).name == "mine"
    assert load_track("table.csv", tmp_path).length_m == 16.0
    assert load_track("table", tmp_path).length_m == 16.0
    assert load_track(str(tmp_path / "table.csv")).length_m == 16.0


def test_a_world_of_ours_may_be_named_with_an_ending_while_there_is_no_such_file(tmp_path):
    without_file = load_track("reinvent_base.npy", tmp_path)
    saved(tmp_path, square_rows(), "reinvent_base")

    assert without_file.length_m == load_track("reinvent_base").length_m
    assert load_track("reinvent_base_cw.npy", tmp_path).name == "reinvent_base_cw"
    assert load_track("reinvent_base.npy", tmp_path).length_m == 16.0


def test_an_array_wins_over_a_table_of_its_name(tmp_path):
    saved(tmp_path, 2 * square_rows())
    (tmp_path / "mine.csv").write_text("0,0\n4,0\n4,4\n0,4\n0,0\n", encoding="utf-8")

    assert load_track("mine", tmp_path).length_m == 32.0


@needs_routes
def test_the_straight_track_is_that_of_the_community_to_a_micrometre():
    track = load_track("Straight_track")

    lines = np.concatenate([track.center, track.inner, track.outer], axis=1)
    np.testing.assert_allclose(lines, np.load(ROUTES / "Straight_track.npy"), atol=1e-6)
    assert not track.closed


def test_all_known_worlds_load_under_their_names():
    assert {"reinvent_base", "reinvent_wood", "bean", "switchback"} <= set(known_worlds())
    assert [load_track(name).name for name in known_worlds()] == known_worlds()


@pytest.mark.parametrize("ground", ["carpet", "concrete", "wood"])
def test_the_grounds_of_reinvent_share_its_route_unless_there_is_a_file(tmp_path, ground):
    world = f"reinvent_{ground}"
    base = load_track("reinvent_base")

    without_file = load_track(world, tmp_path)
    saved(tmp_path, square_rows(), world)

    assert without_file.name == world
    np.testing.assert_array_equal(without_file.center, base.center)
    assert load_track(world, tmp_path).length_m == 16.0


@pytest.mark.parametrize("base", ["reinvent_base", "reinvent_wood", "willow", "mine"])
def test_an_ending_chooses_the_direction_of_any_world(tmp_path, base):
    saved(tmp_path, square_rows())

    plain = load_track(base, tmp_path)
    clockwise = load_track(f"{base}_cw", tmp_path)
    counter = load_track(f"{base}_ccw", tmp_path)

    assert not clockwise.is_ccw
    assert counter.is_ccw
    assert (clockwise.name, counter.name) == (f"{base}_cw", f"{base}_ccw")
    turned, kept = (clockwise, counter) if plain.is_ccw else (counter, clockwise)
    np.testing.assert_array_equal(kept.center, plain.center)
    np.testing.assert_array_equal(turned.center, plain.center[::-1])
    np.testing.assert_array_equal(turned.inner, plain.inner[::-1])
    assert not turned.reverse  # another world, not this one in reverse


def test_a_file_of_one_direction_wins_over_its_base(tmp_path):
    saved(tmp_path, square_rows())
    saved(tmp_path, 2 * square_rows(), "mine_cw")

    assert load_track("mine_cw", tmp_path).length_m == 32.0
    assert load_track("mine_cw", tmp_path).is_ccw  # as the file says, whatever its name
    assert load_track("mine_ccw", tmp_path).length_m == 16.0


@pytest.mark.parametrize("world", ["_cw", "nowhere_cw", "mine_ccw_cw", "minecw", "mine_CW"])
def test_an_ending_without_its_world_is_unknown(tmp_path, world):
    saved(tmp_path, square_rows())

    with pytest.raises(TrackError, match="There is no track"):
        load_track(world, tmp_path)


def test_directions_are_chosen_before_the_track_is_reversed():
    track = load_track("reinvent_base")

    clockwise = directed(track, clockwise=True)
    both = directed(track, clockwise=True, reverse=True)
    again = directed(track, clockwise=False, reverse=True)

    assert directed(track) is track
    assert directed(track, clockwise=False) is track
    assert (clockwise.is_ccw, clockwise.reverse) == (False, False)
    assert (both.is_ccw, both.reverse) == (True, True)
    assert (again.is_ccw, again.reverse) == (False, True)
    np.testing.assert_array_equal(both.center, track.center)


def test_an_open_track_can_be_reversed_but_has_no_direction(tmp_path):
    x = np.arange(5.0)
    saved(tmp_path, np.stack([x, 0 * x, x, 0 * x + 1, x, 0 * x - 1], axis=1))
    track = load_track("mine", tmp_path)

    assert directed(track, reverse=True).reverse
    with pytest.raises(TrackError, match="not a loop"):
        directed(track, clockwise=False)
    with pytest.raises(TrackError, match="not a loop"):
        load_track("mine_cw", tmp_path)


def test_a_route_file_is_described_by_its_numbers(tmp_path):
    path = saved(tmp_path, square_rows(), "Monaco")

    info = describe("Monaco_cw", tmp_path)

    assert info.name == "Monaco_cw"
    assert info.length_m == 16.0
    assert info.width_m == pytest.approx(3 * (5**0.5,))  # between two corners
    assert (info.direction, info.waypoints, info.spacing_m) == ("clockwise", 5, 4.0)
    assert info.repeated == []
    assert (info.line_family, info.source) == ("out", path)
    assert (info.difficulty, info.about) == (None, "")


def test_waypoints_that_repeat_the_one_before_are_named(tmp_path):
    saved(tmp_path, square_rows()[[0, 0, 1, 2, 2, 2, 3, 4]])

    info = describe("mine", tmp_path)

    assert (info.waypoints, info.repeated, info.spacing_m) == (8, [1, 4, 5], 4.0)


def test_a_world_of_ours_is_described_in_words_too():
    info = describe("reinvent_wood_ccw")

    assert (info.name, info.source, info.direction) == (
        "reinvent_wood_ccw",
        "own",
        "counterclockwise",
    )
    assert (info.difficulty, info.waypoints, info.line_family) == ("easy", 119, "in")
    assert info.about.startswith("the route of reinvent_base")
    assert "lap" in describe("reinvent_base_ccw").about
    assert info.width_m.mean == pytest.approx(0.761, abs=0.002)


@pytest.mark.parametrize("ground", ["carpet", "concrete", "wood"])
def test_a_world_with_the_route_of_another_says_so(ground, tmp_path):
    saved(tmp_path, square_rows(), "reinvent_base")

    info, ours = describe(f"reinvent_{ground}", tmp_path), describe(f"reinvent_{ground}")

    assert info.about == ours.about == "the route of reinvent_base on other ground"
    assert (info.difficulty, info.source) == (None, str(tmp_path / "reinvent_base.npy"))


def test_an_open_route_is_described_as_such(tmp_path):
    x = np.arange(5.0)
    saved(tmp_path, np.stack([x, 0 * x, x, 0 * x + 1, x, 0 * x - 1], axis=1))

    assert describe("mine", tmp_path).direction == "open"


def test_what_is_unknown_is_not_described_either(tmp_path):
    with pytest.raises(TrackError, match="There is no track"):
        describe("mine", tmp_path)


@pytest.mark.parametrize("ending", [".npy", ".csv"])
def test_a_file_of_the_racer_wins_over_our_world_of_its_name(tmp_path, ending):
    rows = square_rows()
    if ending == ".npy":
        saved(tmp_path, rows, "reinvent_base")
    else:
        np.savetxt(tmp_path / "reinvent_base.csv", rows, delimiter=",")

    for world in ("reinvent_base", "reinvent_base_cw", "reinvent_wood", "reinvent_wood_ccw"):
        assert load_track(world, tmp_path).length_m == 16.0
    assert describe("reinvent_base", tmp_path).source == str(tmp_path / f"reinvent_base{ending}")
    assert load_track("reinvent_base").length_m == pytest.approx(17.71, abs=0.005)
    assert load_track("bean", tmp_path).length_m == load_track("bean").length_m


@needs_routes
def test_in_a_folder_of_community_routes_reinvent_base_is_the_route_itself():
    rows = np.load(ROUTES / "reinvent_base.npy")

    np.testing.assert_array_equal(load_track("reinvent_base", ROUTES).center, rows[:, :2])


def test_an_unknown_world_names_the_closest_ones_and_where_to_put_the_file(tmp_path):
    saved(tmp_path, square_rows(), "reInvent2019_wide")

    with pytest.raises(TrackError) as failure:
        load_track("reinvent_bsae", tmp_path)

    sentence = str(failure.value)
    assert "reinvent_bsae" in sentence
    assert sentence.index("reinvent_base") < sentence.index("reInvent2019_wide")
    assert str(tmp_path) in sentence


@pytest.mark.parametrize("world", ["", "..", "../mine", "/", "*", "mine/", "mine\0"])
def test_a_world_name_is_never_taken_for_a_path(tmp_path, world):
    (tmp_path / "sub").mkdir()
    saved(tmp_path, square_rows())

    with pytest.raises(TrackError, match="There is no track"):
        load_track(world, tmp_path / "sub")


def test_a_tracks_folder_that_does_not_exist_holds_no_worlds(tmp_path):
    assert known_worlds(tmp_path / "nowhere") == known_worlds()


def test_reinvent_base_is_a_loop_of_119_rows_17_71_m_long():
    track = load_track("reinvent_base")

    assert len(track.waypoints) == 119
    assert track.closed
    assert track.is_ccw
    assert round(track.length_m, 2) == 17.71
    assert track.on_road(track.center).all()


@needs_routes
def test_reinvent_base_keeps_to_the_route_that_racers_know_within_2_cm():
    ours, known = load_track("reinvent_base"), load_track(str(ROUTES / "reinvent_base.npy"))

    apart_m = np.hypot(*(ours.center - known.center).T)

    assert apart_m.max() < 0.02  # waypoint by waypoint: their numbers stand in reward functions
    for line in ("center", "inner", "outer"):
        mine = shapely.LinearRing(getattr(ours, line))
        theirs = shapely.LinearRing(getattr(known, line))
        assert shapely.hausdorff_distance(mine, theirs, densify=0.05) < 0.02
    assert ours.length_m == pytest.approx(known.length_m, abs=0.01)
    yaw_apart_rad = (ours.pose_at(np.zeros(1)) - known.pose_at(np.zeros(1)))[0, 2]
    assert abs(yaw_apart_rad) < np.radians(1)


@needs_routes
def test_every_reference_route_loads_with_all_its_rows():
    files = sorted(ROUTES.glob("*.npy"))

    routes = [load_track(str(file)) for file in files]

    assert len(routes) == 127
    for file, route in zip(files, routes, strict=True):
        lines = np.concatenate([route.center, route.inner, route.outer], axis=1)
        np.testing.assert_array_equal(lines, np.load(file))
    assert [route.name for route in routes if not route.closed] == ["Straight_track"]
    assert sum(route.closed and route.is_ccw for route in routes) == 88
    assert {route.name for route in routes} <= set(known_worlds(ROUTES))
