"""Lines in drawings: every path command, transforms, and drawings that are refused."""

import time

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from drsim.errors import TrackError
from drsim.track.svg_file import read_line

FULL_CIRCLE = "M 20 10 A 10 10 0 0 1 0 10 A 10 10 0 0 1 20 10 Z"


def drawing(path: str, transform: str = "") -> str:
    return (
        '<?xml version="1.0" encoding="UTF-8"?><!DOCTYPE svg>'
        '<svg xmlns="http://www.w3.org/2000/svg"><defs><path d="M 0 0 H 99"/></defs>'
        f'<g transform="{transform}"><path fill="none" d="{path}"/></g></svg>'
    )


def corners(path: str, transform: str = "") -> list[list[float]]:
    """The points of a path of straight lines, y up."""
    return read_line(drawing(path, transform), 1).round(9).tolist()


def same_line(one: str, other: str) -> bool:
    lines = [shapely.LineString(read_line(drawing(path), 400)) for path in (one, other)]
    return bool(shapely.hausdorff_distance(*lines) < 0.02)


@pytest.mark.parametrize(
    "path",
    [
        "M 1 1 L 4 1 L 4 3 L 1 3 Z",
        "M1,1 4,1 4,3 1,3z",
        "m1 1h3v2h-3z",
        "M1 1H4V3H1Z",
        "m 1 1 3 0 0 2 -3 0 z",
        "M1 1l3 0l0+2l-3-0l.0-2.e0",
        "M1 1C2 1 3 1 4 1 L4 3 L1 3Z",
    ],
)
def test_all_ways_to_write_a_rectangle_are_one(path):
    line = shapely.LineString(read_line(drawing(path), 1))

    assert line.is_ring
    assert shapely.equals(shapely.Polygon(line), shapely.box(1, -3, 4, -1))


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("M 0 0 C 0 10 10 10 10 0", "m 0 0 c 0 10 10 10 10 0"),
        ("M 0 0 C 0 5 5 5 5 0 S 10 -5 10 0", "M 0 0 C 0 5 5 5 5 0 C 5 -5 10 -5 10 0"),
        ("M 0 0 C 0 5 5 5 5 0 s 5 -5 5 0", "M 0 0 C 0 5 5 5 5 0 C 5 -5 10 -5 10 0"),
        ("M 0 0 S 5 5 5 0", "M 0 0 C 0 0 5 5 5 0"),
        ("M 0 0 H 1 S 5 5 5 0", "M 0 0 L 1 0 C 1 0 5 5 5 0"),
        ("M 0 0 Q 3 6 6 0", "M 0 0 C 2 4 4 4 6 0"),
        ("M 0 0 Q 3 6 6 0 T 12 0", "M 0 0 Q 3 6 6 0 Q 9 -6 12 0"),
        ("M 0 0 q 3 6 6 0 t 6 0", "M 0 0 Q 3 6 6 0 Q 9 -6 12 0"),
        ("M 0 0 A 5 5 0 0 1 10 0", "M 0 0 a 5 5 0 1 1 10 0"),
        ("M 0 0 A 1 1 0 0 1 10 0", "M 0 0 A 5 5 0 0 1 10 0"),
        ("M 0 0 A 5 3 90 0 1 6 0", "M 0 0 A 3 5 0 0 1 6 0"),
        ("M 0 0 A 0 5 0 0 1 6 0", "M 0 0 L 6 0"),
        ("M0 0a5 5 0 0110 0", "M 0 0 A 5 5 0 0 1 10 0"),
    ],
)
def test_curves_follow_the_rules_of_the_format(one, other):
    assert same_line(one, other)


@pytest.mark.parametrize("large", ["0", "1"])
@pytest.mark.parametrize("sweep", ["0", "1"])
def test_the_flags_of_an_arc_choose_one_of_four(large, sweep):
    # A circle of radius 5, cut by a chord of 8: the cap has 25 acos(0.6) - 12.
    cap = 25 * np.arccos(0.6) - 12

    ring = shapely.LinearRing(read_line(drawing(f"M 0 0 A 5 5 0 {large} {sweep} 8 0 Z"), 400))

    area = 25 * np.pi - cap if large == "1" else cap
    assert shapely.Polygon(ring).area == pytest.approx(area, rel=1e-3)
    assert ring.is_ccw == (sweep == "0")  # sweeping is clockwise where y runs downwards


def test_a_circle_of_arcs_is_round():
    points = read_line(drawing(FULL_CIRCLE), 200)

    np.testing.assert_allclose(np.hypot(*(points - [10, -10]).T), 10.0, atol=0.003)
    assert np.hypot(*np.diff(points, axis=0).T).max() < 0.4


@pytest.mark.parametrize(
    ("transform", "end"),
    [
        ("translate(10)", [13, -2]),
        ("translate(10, 5)", [13, -7]),
        ("scale(2)", [6, -4]),
        ("scale(2 -1)", [6, 2]),
        ("rotate(90)", [-2, -3]),
        ("rotate(90, 1, 1)", [0, -3]),
        ("matrix(0 1 -1 0 5 6)", [3, -9]),
        ("translate(1,1) scale(2)", [7, -5]),
        ("scale(2), translate(1,1)", [8, -6]),
    ],
)
def test_transforms_move_the_line(transform, end):
    assert corners("M 0 0 L 3 2", transform)[-1] == end


def test_transforms_of_groups_and_elements_combine_from_the_outside_in():
    text = (
        '<svg><g transform="translate(1 0)"><g transform="scale(2)">'
        '<polyline transform="translate(0 3)" points="0,0 1 1,2-1"/></g></g></svg>'
    )

    assert read_line(text, 1).tolist() == [[1, -6], [3, -8], [5, -4]]


def test_a_polygon_is_closed_and_the_first_shape_wins():
    text = '<svg><circle r="3"/><polygon points="0,0 4,0 4,4"/><path d="M 0 0 L 9 9"/></svg>'

    assert read_line(text, 1).tolist() == [[0, 0], [4, 0], [4, -4], [0, 0]]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "not an SVG drawing"),
        ("<svg>", "not an SVG drawing"),
        ("<svg/>", "no path"),
        ("<svg><circle r='1'/></svg>", "no path"),
        ("<svg><path/></svg>", "is empty"),
        ("<svg><polygon points='1 1'/></svg>", "is a point"),
        (drawing("M 1 1 L 1 1"), "is empty"),
        (drawing("M 0 0 L 1"), "start with a usable number"),
        (drawing("M 0 0 L 1 1e999"), "start with a usable number"),
        (drawing("M 0 0 A 1 1 0 2 0 3 3"), "start with a usable number"),
        (drawing("M 0 0 X 1 1"), "start with a usable number"),
        (drawing("5 M 0 0 L 1 1"), "not a path command"),
        (drawing("M 0 0 H 5 M 0 3 H 5"), "several pieces"),
        (drawing("M 0 0 H 5 Z L 9 9"), "several pieces"),
        (drawing("M 0 0 L 1 1" + " 2 2 1 1" * 5001), "Simplify"),
        (drawing("M 0 0 L 1 1", "skewX(3)"), "skewX"),
        (drawing("M 0 0 L 1 1", "scale(1, 2, 3)"), "with 3 numbers"),
        (drawing("M 0 0 L 1 1", "scale(2) nonsense"), "nonsense"),
        (drawing("M 0 0 L 1 1", "scale(1e8) scale(1e8)"), "from the origin"),
        (drawing("M 0 0 L 1e8 1", "scale(1e3)"), "from the origin"),
    ],
)
def test_what_is_no_line_is_refused_with_the_reason(text, problem):
    with pytest.raises(TrackError, match=problem):
        read_line(text, 10)


def test_entities_are_refused_before_they_multiply():
    doubled = "".join(
        f'<!ENTITY e{k} "&e{k - 1};&e{k - 1};">' for k in range(1, 60)
    )  # the last one would hold 2 ** 59 letters
    text = f'<!DOCTYPE svg [<!ENTITY e0 "x">{doubled}]><svg><path d="&e59;"/></svg>'

    with pytest.raises(TrackError, match="entities"):
        read_line(text, 10)


@pytest.mark.parametrize(
    "text",
    [
        "<g>" * 100_000 + "</g>" * 100_000,
        drawing("M 0 0" + " " * 900_000 + "x"),
        drawing("M" + "9" * 900_000),
        drawing("M 0 0 L 1 1", "scale(" * 100_000),
        drawing("M 0 0 L" + " 1 2 3 4" * 110_000),
    ],
    ids=["deep", "blanks", "digits", "brackets", "nodes"],
)
def test_a_hostile_drawing_does_not_take_long(text):
    began_s = time.process_time()

    with pytest.raises(TrackError):
        read_line(text, 10)

    assert time.process_time() - began_s < 5


def line_or_refused(text: str) -> np.ndarray | None:
    """The line of a drawing, or None if it was refused in a sentence."""
    try:
        return read_line(text, 50)
    except TrackError as refusal:
        if not str(refusal).endswith("."):
            raise
        return None


@given(path=st.text(alphabet="MLHVCSQTAZmlhvcsqtaz0123456789.,-+e \n", max_size=60))
def test_any_path_is_a_line_or_refused_in_a_sentence(path):
    points = line_or_refused(drawing("M 1 2" + path))

    assert points is None or (len(points) >= 2 and np.isfinite(points).all())


@given(transform=st.text(alphabet="translaeicomx()0123456789.,- ", max_size=40))
def test_any_transform_is_applied_or_refused_in_a_sentence(transform):
    points = line_or_refused(drawing("M 1 2 L 3 4", transform))

    assert points is None or np.isfinite(points).all()
