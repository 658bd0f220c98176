"""Route files: what is read, what is drawn beside a centre line, and what is refused."""

import io
import warnings
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from drsim.errors import TrackError
from drsim.sensing.scene import build_scene
from drsim.track.route_files import read_route, write_route
from drsim.track.track import Track
from drsim.track.worlds import known_worlds, load_track
from square_route import saved, square_rows

SQUARE = "0,0\n6,0\n6,6\n0,6\n0,0\n"


def read(path: str) -> Track:
    return read_route(Path(path))


def written(folder: Path, text: str, name: str = "mine.csv") -> Path:
    file = folder / name
    file.write_text(text, encoding="utf-8")
    return file


def svg(shape: str) -> str:
    return f'<svg xmlns="http://www.w3.org/2000/svg">{shape}</svg>'


def width_m(track: Track) -> float:
    """Width of the road away from its corners."""
    return float(np.median(track.locate(track.center).track_width_m))


def assert_sound(track: Track) -> None:
    """The borders of a loop neither cross nor leave the loop."""
    inner, outer = (
        shapely.LinearRing(shapely.remove_repeated_points(shapely.LineString(line), 1e-9))
        for line in (track.inner, track.outer)
    )
    assert inner.is_simple
    assert outer.is_simple
    assert shapely.Polygon(outer).contains(shapely.Polygon(inner))
    assert track.on_road(track.center).all()


def test_a_missing_route_file_and_a_folder_in_its_place_are_named(tmp_path):
    folder = tmp_path / "folder.npy"
    folder.mkdir()

    for path in (str(tmp_path / "nothing.npy"), str(folder)):
        with pytest.raises(TrackError, match="the route file does not exist") as failure:
            read(path)
        assert path in str(failure.value)


def test_a_path_too_long_for_the_file_system_is_refused_in_a_sentence():
    with pytest.raises(TrackError, match="cannot be read"):
        read("x" * 5000 + ".npy")


@pytest.mark.parametrize("ending", [".npy", ".csv"])
def test_a_repeated_row_stays_a_waypoint_from_reading_to_writing_and_back(tmp_path, ending):
    twice = square_rows()[[0, 0, 1, 1, 2, 3, 3, 4, 4]]
    if ending == ".npy":
        file = Path(saved(tmp_path, twice))
    else:
        file = written(tmp_path, "\n".join(",".join(map(str, row)) for row in twice.tolist()))

    track = read_route(file)
    write_route(track, tmp_path / "copy.npy")
    write_route(track.reversed(), tmp_path / "turned.npy")

    np.testing.assert_array_equal(track.center, twice[:, :2])
    assert track.closed
    assert track.length_m == 16.0
    np.testing.assert_array_equal(np.load(tmp_path / "copy.npy"), twice)
    np.testing.assert_array_equal(np.load(tmp_path / "turned.npy"), twice[::-1])


@pytest.mark.parametrize("columns", [2, 3])
def test_a_centre_line_with_repeated_rows_gets_even_waypoints_like_one_without(tmp_path, columns):
    rows = 3 * square_rows()[:, [0, 1, 1]]
    rows[:, 2] = 1.0
    twice = rows[[0, 0, 1, 1, 2, 3, 3, 4, 4]]

    plain = read(saved(tmp_path, rows[:, :columns], "plain"))
    track = read(saved(tmp_path, twice[:, :columns], "twice"))

    np.testing.assert_array_equal(track.center, plain.center)
    assert np.hypot(*np.diff(track.center, axis=0).T).min() > 0.1


def test_a_loop_that_closes_up_to_rounding_is_closed_exactly(tmp_path):
    rows = square_rows()
    rows[-1] += 1e-12

    track = read(saved(tmp_path, rows))

    assert track.closed
    assert track.waypoints[0] == track.waypoints[-1]


@pytest.mark.parametrize("off_m", [1e-7, 1e-3])
def test_a_loop_written_with_few_digits_is_closed_exactly(tmp_path, off_m):
    rows = square_rows()
    rows[-1] += off_m

    track = read(saved(tmp_path, rows))

    assert (track.closed, track.joined_m) == (True, 0.0)
    assert track.waypoints[0] == track.waypoints[-1]
    assert len(track.waypoints) == len(rows)


@pytest.mark.parametrize("turned", [False, True])
def test_a_ring_without_its_first_row_repeated_is_joined(tmp_path, turned):
    angle = np.linspace(0, 2 * np.pi, 41)[:-1]
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rows = np.concatenate([3 * ring, 2.5 * ring, 3.5 * ring], axis=1)
    if turned:
        rows = rows[::-1]

    track = read(saved(tmp_path, rows))

    assert track.closed
    assert len(track.waypoints) == len(rows) + 1
    assert track.waypoints[-1] == track.waypoints[0]
    assert track.joined_m == pytest.approx(6 * np.sin(np.pi / 40))


def test_a_ring_that_runs_past_its_start_is_refused(tmp_path):
    angle = np.linspace(0, 2 * np.pi, 41)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ring = np.concatenate([ring[:-1], ring[:1], ring[1:2] * 1.01])
    rows = np.concatenate([3 * ring, 2.5 * ring, 3.5 * ring], axis=1)

    with pytest.raises(TrackError, match="Remove the rows at the end that run past the first one"):
        read(saved(tmp_path, rows))


def test_a_route_whose_ends_differ_is_an_open_track(tmp_path):
    x = np.arange(5.0)
    rows = np.stack([x, 0 * x, x, 0 * x + 1, x, 0 * x - 1], axis=1)

    track = read(saved(tmp_path, rows))

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
        (square_rows() * [[1], [1], [np.nan], [1], [1]], "row 2 contains"),
        (square_rows() * [[1], [np.inf], [1], [1], [1]], "row 1 contains"),
        (square_rows() * 1e9, "within 1e"),
        (square_rows()[:, [0, 1, 4, 5, 2, 3]], "between the borders"),
        (square_rows()[:, [2, 3, 0, 1, 4, 5]], "between the borders"),
        (square_rows() * [1, 1, 0, 0, 0, 0], "between the borders"),
    ],
)
def test_a_file_whose_numbers_make_no_track_is_refused_with_the_reason(tmp_path, rows, problem):
    path = saved(tmp_path, rows)

    with pytest.raises(TrackError) as failure:
        read(path)

    assert path in str(failure.value)
    assert problem in str(failure.value)


def test_a_pickle_in_a_route_file_is_never_opened(tmp_path):
    class Trap:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "sprung",))

    file = tmp_path / "trap.npy"
    np.save(file, np.array([[Trap()] * 6] * 4, dtype=object), allow_pickle=True)

    with pytest.raises(TrackError, match="not a route file"):
        read(str(file))

    assert not (tmp_path / "sprung").exists()


def attempt(path: str) -> str:
    """What became of loading a file, in a sentence; anything but a TrackError passes through."""
    try:
        return f"{path} is {read(path).length_m} m long"
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
        read(str(file))


def test_a_table_of_a_centre_line_gets_borders_beside_it(tmp_path):
    track = read_route(written(tmp_path, SQUARE), name="box")

    assert (track.name, track.closed, track.is_ccw) == ("box", True, True)
    assert track.length_m == 24.0
    assert len(track.center) == 121
    assert width_m(track) == pytest.approx(1.07)
    assert_sound(track)
    np.testing.assert_allclose(track.inner.min(axis=0), 0.535)  # sharp corners inside
    np.testing.assert_allclose(track.outer.max(axis=0), 6.535)


@pytest.mark.parametrize(
    "text",
    [
        "x,y\n" + SQUARE,
        "# a comment\n\n x ; y\n" + SQUARE.replace(",", " ; "),
        SQUARE.replace(",", ",0").replace(",", ";").replace("6", "6,0"),
        "\ufeff" + SQUARE.replace("\n", "\r\n"),
        SQUARE.removesuffix("0,0\n") + "0,0.5\n",
        SQUARE + "0.4,0\n",
        SQUARE + SQUARE[:4],
    ],
    ids=["headings", "semicolons", "decimal commas", "windows", "a gap", "too far", "repeated"],
)
def test_tables_are_read_as_people_write_them(tmp_path, text):
    track = read_route(written(tmp_path, text))

    assert track.closed
    assert track.length_m == pytest.approx(24.0, abs=0.05)


def test_a_clockwise_centre_line_has_its_inner_border_inside_too(tmp_path):
    rows = SQUARE.splitlines()

    track = read_route(written(tmp_path, "\n".join(rows[::-1])))

    assert not track.is_ccw
    assert_sound(track)


def test_a_third_column_is_the_width_along_the_road(tmp_path):
    text = "x,y,width\n0,0,0.6\n6,0,0.6\n6,6,1.2\n0,6,1.2\n0,0,0.6\n"

    track = read_route(written(tmp_path, text))

    along = track.locate(np.array([[2.0, 0.0], [6.0, 3.0], [2.0, 6.0]]))
    np.testing.assert_allclose(along.track_width_m, [0.6, 0.9, 1.2], atol=0.01)
    assert_sound(track)


def test_a_width_that_is_asked_for_wins_over_that_of_the_file(tmp_path):
    narrow = read_route(Path(saved(tmp_path, square_rows())), width_m=0.8)
    wide = read_route(written(tmp_path, SQUARE), width_m=1.4)

    assert width_m(narrow) == pytest.approx(0.8)
    assert width_m(wide) == pytest.approx(1.4)


def test_a_table_of_six_columns_is_the_array_as_text(tmp_path):
    text = "\n".join(",".join(map(str, row)) for row in square_rows().tolist())

    track = read_route(written(tmp_path, text))

    np.testing.assert_array_equal(track.center, square_rows()[:, :2])
    np.testing.assert_array_equal(track.outer, square_rows()[:, 4:])


def test_an_array_may_hold_the_centre_line_alone(tmp_path):
    track = read(saved(tmp_path, square_rows()[:, :2]))

    assert track.length_m == 16.0
    assert width_m(track) == pytest.approx(1.07)


def test_length_m_scales_a_centre_line_but_not_its_width(tmp_path):
    track = read_route(written(tmp_path, "0,0\n900,0\n900,700\n0,700\n0,0"), length_m=20.0)

    assert track.length_m == pytest.approx(20.0, abs=1e-9)
    assert width_m(track) == pytest.approx(1.07)


def test_length_m_scales_the_borders_of_a_file_too(tmp_path):
    track = read_route(Path(saved(tmp_path, square_rows())), length_m=8.0)

    assert track.length_m == 8.0
    np.testing.assert_array_equal(track.outer, square_rows()[:, 4:] / 2)


def test_an_open_line_is_an_open_track_and_its_inner_border_on_the_left(tmp_path):
    track = read_route(written(tmp_path, "0,0\n2,0\n4,1\n6,1\n"), width_m=1.0)

    assert not track.closed
    np.testing.assert_allclose(track.inner[0], [0.0, 0.5])
    np.testing.assert_allclose(track.outer[0], [0.0, -0.5])


@pytest.mark.parametrize("spikes", [4, 5, 8])
def test_sharp_bends_are_cut_where_the_border_would_cross_itself(tmp_path, spikes):
    angle = np.arange(2 * spikes + 1) * np.pi / spikes
    radius_m = np.where(np.arange(2 * spikes + 1) % 2, 6.0, 3.8)
    points = np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle)], axis=1)

    track = read(saved(tmp_path, points))

    assert_sound(track)
    assert track.locate(track.center).track_width_m.min() > 0.9
    assert build_scene(track).level(0).max() > 200  # repeated border points do no harm there


def test_a_circle_of_a_drawing_becomes_a_round_road(tmp_path):
    circle = svg('<path d="M0 0 a10 10 0 0 1 20 0a10 10 0 0 1-20 0z"/>')

    track = read_route(written(tmp_path, circle, "round.svg"), length_m=30.0, width_m=0.8)

    middle = track.center[:-1].mean(axis=0)
    assert (track.name, track.closed, track.is_ccw) == ("round", True, False)
    assert track.length_m == pytest.approx(30.0, abs=1e-9)
    for line, radius_m in ((track.center, 0.0), (track.inner, -0.4), (track.outer, 0.4)):
        apart_m = np.hypot(*(line - middle).T)
        np.testing.assert_allclose(apart_m, 15 / np.pi + radius_m, atol=0.002)


def test_a_drawing_needs_a_length(tmp_path):
    with pytest.raises(TrackError, match="length_m"):
        read_route(written(tmp_path, svg('<path d="M 0 0 H 9"/>'), "line.svg"))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "2, 3 or 6 columns"),
        ("x,y\n", "2, 3 or 6 columns"),
        ("1,2,3,4\n" * 5, "2, 3 or 6 columns"),
        ("1\n2\n3\n", "2, 3 or 6 columns"),
        ("x,y\n0,0\n1,oops\n", "line 3: could not convert"),
        ("0,0\n1,1\n\n2,2,2\n", "line 4 has 3 values"),
        ("0,0\n1,nan\n", "row 1 contains"),
        ("0,0\n9e99,0\n", "row 1 contains"),
        ("0,0\n9,0\n", "2 distinct rows"),
        ("0,0\n4000,0\n4000,4000\n0,4000\n", "12000 m long"),
        ("0,0\n0.2,0\n0.2,0.2\n0,0.2\n", "0.6 m long"),
        ("0,0\n6,6\n6,0\n0,6\n0,0\n", "borders of the road cross"),
        ("0,0\n6,0\n6,0.4\n0,0.4\n0,0\n", "overlaps itself"),
        ("0,0\n6,0\n2,0\n2,6\n0,6\n0,0", "turns back on itself"),
        ("0,0,0.1\n6,0,0.1\n6,6,0.1\n0,6,0.1\n", "values from 0.1 to 0.1, but there it is the"),
        ("0,0,1\n6,0,-1\n6,6,1\n0,6,1\n", "values from -1 to 1, but there it is the width"),
        ("0,0,2.5\n6,0,4\n6,6,4\n0,6,2.5\n", "A racing line with speeds is no track"),
        ("0,0,1.1\n6,0,2.6\n6,6,2.6\n0,6,1.1\n", "values from 1.1 to 2.6"),
        ("x,y,speed\n0,0,1\n6,0,1\n6,6,1\n0,6,1\n", "third column is called speed"),
        ("x;y;v (m/s)\n0;0;1\n6;0;1\n6;6;1\n0;6;1\n", "third column is called v (m/s)"),
    ],
)
def test_a_table_that_makes_no_track_is_refused_with_the_reason(tmp_path, text, problem):
    file = written(tmp_path, text)

    with pytest.raises(TrackError) as failure:
        read_route(file)

    assert str(file) in str(failure.value)
    assert problem in str(failure.value)


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"width_m": 0.0}, "0 m wide"),
        ({"width_m": float("nan")}, "nan m wide"),
        ({"width_m": 7.0}, "smaller width_m"),
        ({"length_m": 0.0}, "0 m long"),
        ({"length_m": float("nan")}, "nan m long"),
        ({"length_m": 1e7}, "1e+07 m long"),
    ],
)
def test_a_wrong_width_or_length_is_refused_with_the_reason(tmp_path, options, problem):
    for file in (written(tmp_path, SQUARE), Path(saved(tmp_path, square_rows()))):
        with pytest.raises(TrackError) as failure:
            read_route(file, **options)
        assert problem in str(failure.value)


def test_other_files_and_other_encodings_are_refused(tmp_path):
    latin = tmp_path / "latin.csv"
    latin.write_bytes("Länge,Höhe\n".encode("latin-1"))

    with pytest.raises(TrackError, match="UTF-8"):
        read_route(latin)
    with pytest.raises(TrackError, match=r"ends in \.npy, \.csv or \.svg"):
        read_route(tmp_path / "mine.json")


@pytest.mark.parametrize("world", known_worlds())
def test_a_written_track_is_read_back_the_same(tmp_path, world):
    track = load_track(world)

    write_route(track, tmp_path / f"{world}.npy")
    copy = read_route(tmp_path / f"{world}.npy")

    assert np.load(tmp_path / f"{world}.npy").dtype == np.float64
    assert (copy.name, copy.closed, copy.is_ccw) == (track.name, track.closed, track.is_ccw)
    for line in ("center", "inner", "outer"):
        np.testing.assert_array_equal(getattr(copy, line), getattr(track, line))


def test_a_route_is_only_written_as_an_array_and_where_there_is_a_folder(tmp_path):
    track = load_track("bean")

    with pytest.raises(TrackError, match=r"\.npy"):
        write_route(track, tmp_path / "bean.csv")
    with pytest.raises(TrackError, match="cannot be written"):
        write_route(track, tmp_path / "nowhere" / "bean.npy")

    assert list(tmp_path.iterdir()) == []


def read_or_refused(file: Path, **options: float) -> Track | None:
    """The track of a file, or None if it was refused in a sentence that names the file."""
    try:
        return read_route(file, **options)
    except TrackError as refusal:
        if not str(refusal).startswith(str(file)):
            raise
        return None


TABLE = b"x,y,width\n0,0,0.9\n6,0,0.9\n6.5,5,1.1\n0,6,1\n0,0,0.9\n"
DRAWING = svg('<g transform="scale(2)"><path d="M0 0h9q5 0 5 5v4a5 5 0 0 1-9 3z"/></g>').encode()


@settings(max_examples=150)
@given(
    original=st.sampled_from([(TABLE, "csv"), (DRAWING, "svg")]),
    changes=st.lists(st.tuples(st.integers(0, 200), st.binary(max_size=3)), max_size=6),
    length=st.integers(0, 200),
)
def test_a_damaged_table_or_drawing_is_read_or_refused(tmp_path, original, changes, length):
    data, suffix = original
    for place, piece in changes:
        data = data[:place] + piece + data[place + len(piece) :]
    file = tmp_path / f"damaged.{suffix}"
    file.write_bytes(data if length > 150 else data[:length])

    track = read_or_refused(file, length_m=25.0)

    if track:
        assert track.length_m == pytest.approx(25.0)
        assert np.isfinite(track.inner).all()


@settings(max_examples=80)
@given(
    points=st.lists(st.tuples(st.floats(-8, 8), st.floats(-8, 8)), min_size=4, max_size=9),
    width=st.floats(0.3, 2.0),
)
def test_any_centre_line_makes_a_sound_road_or_is_refused(tmp_path, points, width):
    file = Path(saved(tmp_path, np.array(points)))

    track = read_or_refused(file, width_m=width)

    if track and track.closed:
        assert_sound(track)
