"""Whether rectangles overlap, with shapely as the judge."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import assume, example, given
from hypothesis import strategies as st

from drsim.race.traffic import overlaps

CAR_M = (0.32352, 0.1961)
BOX_M = (0.5, 0.4)

places = st.floats(-1.0, 1.0)
angles = st.floats(-7.0, 7.0)
sizes = st.floats(0.05, 1.0)


def overlap(pose, size_m, other_pose, other_size_m) -> bool:
    """The kernel's answer for one pair of poses (x, y, yaw)."""
    out = overlaps(
        (
            np.array([pose[:2]], np.float64),
            np.array([pose[2]], np.float64),
            np.array(size_m, np.float64),
        ),
        (
            np.array([[other_pose[:2]]], np.float64),
            np.array([[other_pose[2]]], np.float64),
            np.array([other_size_m], np.float64),
        ),
    )
    return bool(out[0, 0])


def polygon(pose, size_m) -> shapely.Polygon:
    x, y, yaw_rad = pose
    box = shapely.box(-size_m[0] / 2, -size_m[1] / 2, size_m[0] / 2, size_m[1] / 2)
    turned = shapely.affinity.rotate(box, yaw_rad, origin=(0, 0), use_radians=True)
    return shapely.affinity.translate(turned, x, y)


@given(
    st.tuples(places, places, angles),
    st.tuples(sizes, sizes),
    st.tuples(places, places, angles),
    st.tuples(sizes, sizes),
)
@example((0.0, 0.0, 0.0), (1.0, 0.1), (0.0, 0.0, math.pi / 2), (1.0, 0.1))
def test_the_answer_is_that_of_shapely(pose, size_m, other_pose, other_size_m) -> None:
    one, other = polygon(pose, size_m), polygon(other_pose, other_size_m)
    shared_m2 = one.intersection(other).area
    assume(shared_m2 > 1e-9 or one.distance(other) > 1e-9)

    found = overlap(pose, size_m, other_pose, other_size_m)

    assert found == (shared_m2 > 1e-9)


def test_a_corner_of_the_box_in_the_side_of_the_car_is_an_overlap() -> None:
    corner_m = math.hypot(*BOX_M) / 2
    turned_rad = -math.pi / 2 + math.atan2(BOX_M[1], BOX_M[0])
    ahead = (0.0, CAR_M[1] / 2 + corner_m - 0.02, turned_rad)
    assert not any(
        polygon(ahead, BOX_M).contains(shapely.Point(xy))
        for xy in polygon((0, 0, 0), CAR_M).exterior.coords
    ), "no corner of the car is in the box"

    found = overlap((0.0, 0.0, 0.0), CAR_M, ahead, BOX_M)

    assert found


@pytest.mark.parametrize(("apart_m", "overlapping"), [(0.4117, True), (0.4118, False)])
def test_a_car_overlaps_a_box_ahead_from_half_of_both_lengths_on(apart_m, overlapping) -> None:
    found = overlap((0.0, 0.0, 0.0), CAR_M, (apart_m, 0.0, 0.0), BOX_M)

    assert found is overlapping


def test_a_place_that_is_no_number_overlaps_nothing() -> None:
    found = overlap((math.nan, 0.0, 0.0), CAR_M, (0.0, 0.0, 0.0), BOX_M)

    assert found is False


def test_every_car_is_compared_with_its_own_objects() -> None:
    xy = np.array([[0.0, 0.0], [5.0, 0.0]])
    others = np.array([[[0.1, 0.0], [5.0, 0.0], [9.0, 0.0]], [[0.1, 0.0], [5.0, 0.0], [5.2, 0.1]]])

    out = overlaps(
        (xy, np.zeros(2), np.array(CAR_M)),
        (others, np.zeros((2, 3)), np.full((3, 2), 0.4)),
    )

    assert out.tolist() == [[True, False, False], [False, True, True]]
