"""Worlds by name, and route files that are not what they should be."""

import io
import warnings
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from drsim.errors import TrackError
from drsim.worlds import known_worlds, load_track

ROUTES = Path(__file__).resolve().parents[3] / "shared" / "tracks"

needs_routes = pytest.mark.skipif(
    not ROUTES.is_dir(), reason="there is no folder of reference routes beside the repository"
)


def square_rows() -> np.ndarray:
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]], dtype=np.float64)
    return np.concatenate([2 * corners, corners, 3 * corners], axis=1)


def saved(folder: Path, rows: np.ndarray, name: str = "mine") -> str:
    file = folder / f"{name}.npy"
    np.save(file, rows)
    return str(file)


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
    assert known_worlds(tmp_path) == ["mine", "reinvent_base"]


def test_our_own_world_wins_over_a_file_of_its_name_unless_the_path_is_given(tmp_path):
    path = saved(tmp_path, square_rows(), "reinvent_base")

    assert load_track("reinvent_base", tmp_path).length_m == pytest.approx(17.71, abs=0.005)
    assert load_track(path).length_m == 16.0


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

    with pytest.raises(TrackError, match="No world is called"):
        load_track(world, tmp_path / "sub")


def test_a_tracks_folder_that_does_not_exist_holds_no_worlds(tmp_path):
    assert known_worlds(tmp_path / "nowhere") == known_worlds()


def test_a_missing_route_file_and_a_folder_in_its_place_are_named(tmp_path):
    folder = tmp_path / "folder.npy"
    folder.mkdir()

    for path in (str(tmp_path / "nothing.npy"), str(folder)):
        with pytest.raises(TrackError, match="There is no route file") as failure:
            load_track(path)
        assert path in str(failure.value)


def test_a_path_too_long_for_the_file_system_is_refused_in_a_sentence():
    with pytest.raises(TrackError, match="cannot be read"):
        load_track("x" * 5000 + ".npy")


def test_repeated_rows_are_dropped_and_the_closing_row_is_kept(tmp_path):
    rows = square_rows()
    twice = rows[[0, 0, 1, 1, 2, 3, 3, 4, 4]]

    track = load_track(saved(tmp_path, twice))

    np.testing.assert_array_equal(track.center, rows[:, :2])
    assert track.closed


def test_a_loop_that_closes_up_to_rounding_is_closed_exactly(tmp_path):
    rows = square_rows()
    rows[-1] += 1e-12

    track = load_track(saved(tmp_path, rows))

    assert track.closed
    assert track.waypoints[0] == track.waypoints[-1]


def test_a_route_whose_ends_differ_is_an_open_track(tmp_path):
    x = np.arange(5.0)
    rows = np.stack([x, 0 * x, x, 0 * x + 1, x, 0 * x - 1], axis=1)

    track = load_track(saved(tmp_path, rows))

    assert not track.closed
    assert track.is_ccw
    assert not track.reversed().is_ccw
    assert track.on_road(np.array([[2.0, 0.9], [2.0, 1.1], [-0.1, 0.0]])).tolist() == [
        True,
        False,
        False,
    ]


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        (np.zeros((5, 4)), "6 columns"),
        (np.zeros(6), "6 columns"),
        (np.zeros((5, 6), dtype=complex), "type complex128"),
        (np.full((5, 6), "x"), "6 columns of numbers"),
        (np.zeros((0, 6)), "shape (0, 6)"),
        (np.zeros((50_000, 6)), "larger than 1000000 bytes"),
        (square_rows()[:2], "at least 4"),
        (np.zeros((50, 6)), "1 distinct rows"),
        (square_rows() * [[1], [1], [np.nan], [1], [1]], "row 2 holds"),
        (square_rows() * [[1], [np.inf], [1], [1], [1]], "row 1 holds"),
        (square_rows() * 1e9, "within 1e"),
        (square_rows()[:, [0, 1, 4, 5, 2, 3]], "between the borders"),
        (square_rows()[:, [2, 3, 0, 1, 4, 5]], "between the borders"),
        (square_rows() * [1, 1, 0, 0, 0, 0], "between the borders"),
    ],
)
def test_a_file_whose_numbers_make_no_track_is_refused_with_the_reason(tmp_path, rows, problem):
    path = saved(tmp_path, rows)

    with pytest.raises(TrackError) as failure:
        load_track(path)

    assert path in str(failure.value)
    assert problem in str(failure.value)


def test_a_pickle_in_a_route_file_is_never_opened(tmp_path):
    class Trap:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "sprung",))

    file = tmp_path / "trap.npy"
    np.save(file, np.array([[Trap()] * 6] * 4, dtype=object), allow_pickle=True)

    with pytest.raises(TrackError, match="no route file"):
        load_track(str(file))

    assert not (tmp_path / "sprung").exists()


def attempt(path: str) -> str:
    """What became of loading a file, in a sentence; anything but a TrackError passes through."""
    try:
        return f"{path} is {load_track(path).length_m} m long"
    except TrackError as refusal:
        return str(refusal)


def npy_bytes() -> bytes:
    stream = io.BytesIO()
    np.save(stream, square_rows())
    return stream.getvalue()


@settings(max_examples=80)
@given(
    changes=st.lists(st.tuples(st.integers(0, len(npy_bytes()) - 1), st.integers(0, 255))),
    length=st.integers(0, len(npy_bytes())) | st.just(len(npy_bytes())),
)
def test_a_damaged_route_file_either_loads_or_is_refused_in_a_sentence(tmp_path, changes, length):
    data = bytearray(npy_bytes())
    for place, value in changes:
        data[place] = value
    file = tmp_path / "damaged.npy"
    file.write_bytes(bytes(data[:length]))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # numpy warns about old or odd headers
        outcome = attempt(str(file))

    assert str(file) in outcome


@settings(max_examples=40)
@given(
    header=st.sampled_from(
        [
            "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 6), }",
            "{'descr': '<f8', 'fortran_order': False, 'shape': (-1, 6), }",
            "{'descr': '|V0', 'fortran_order': False, 'shape': (99999999999, 6), }",
            "{'descr': '<f8', 'fortran_order': False, 'shape': (2**99, 6), }",
            "{'descr': '<f8', 'fortran_order': False, 'shape': (1" + "0" * 40 + ", 6), }",
            "{'descr': '|O', 'fortran_order': False, 'shape': (4, 6), }",
            "[" * 5000,
            "{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (), }",
        ]
    ),
    tail=st.binary(max_size=64),
)
def test_a_hostile_header_is_refused_in_a_sentence(tmp_path, header, tail):
    text = (header + "\n").encode()
    file = tmp_path / "hostile.npy"
    file.write_bytes(b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + tail)

    with pytest.raises(TrackError, match=r"hostile\.npy"):
        load_track(str(file))


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
def test_every_reference_route_loads_and_59_of_them_lose_one_repeated_row():
    files = sorted(ROUTES.glob("*.npy"))

    routes = [load_track(str(file)) for file in files]

    assert len(routes) == 127
    dropped = [
        len(np.load(file)) - len(route.center) for file, route in zip(files, routes, strict=True)
    ]
    assert sorted(dropped) == [0] * 68 + [1] * 59
    assert [route.name for route in routes if not route.closed] == ["Straight_track"]
    assert sum(route.closed and route.is_ccw for route in routes) == 88
    assert set(known_worlds(ROUTES)) == {route.name for route in routes}
