"""What stands on the floor: sizes of the shapes, places of their parts, and paint."""

import numpy as np
import pytest

from drsim.race.solids import SHAPES, Box, Shape, Solids

POST = Shape("post", (Box((0.5, 0.0), (0.2, 0.1), 0.1, 0.9, (10.0, 20.0, 30.0)),), (0.2, 0.1))


def bounds(shape: Shape) -> tuple[float, float, float]:
    """Length, width and height of everything that a shape is made of."""
    (x, y), (length, width) = (
        np.array([getattr(box, name) for box in shape.boxes]).T for name in ("center_m", "size_m")
    )
    return (
        float((x + length / 2).max() - (x - length / 2).min()),
        float((y + width / 2).max() - (y - width / 2).min()),
        max(box.high_m for box in shape.boxes),
    )


@pytest.mark.parametrize(
    ("name", "size_m", "footprint_m"),
    [
        ("box_obstacle", (0.4, 0.3, 0.25), (0.5, 0.4)),
        ("deepracer_box_obstacle", (0.36, 0.265, 0.24), (0.5, 0.4)),
        ("amazon_box_obstacle", (0.4, 0.3, 0.25), (0.5, 0.4)),
        ("bot_car", (0.324, 0.195, 0.218), (0.32352, 0.1961)),
        ("race_car", (0.324, 0.195, 0.218), (0.32352, 0.1961)),
    ],
)
def test_a_shape_has_the_size_of_the_reference_and_its_margin(name, size_m, footprint_m):
    shape = SHAPES[name]

    assert shape.name == name
    assert bounds(shape) == pytest.approx(size_m, abs=1e-6)
    assert shape.footprint_m == footprint_m


@pytest.mark.parametrize("name", ["bot_car", "race_car"])
def test_a_car_stands_on_four_wheels_and_its_parts_only_touch(name):
    boxes = SHAPES[name].boxes

    wheels = [box for box in boxes if box.low_m == 0.0]
    assert len(wheels) == 4
    for i, one in enumerate(boxes):
        for other in boxes[:i]:
            aside = np.abs(np.subtract(one.center_m, other.center_m))
            apart = aside >= np.add(one.size_m, other.size_m) / 2 - 1e-9
            assert apart.any() or one.low_m >= other.high_m or other.low_m >= one.high_m


def test_a_turned_shape_carries_its_parts_around_the_point_that_its_pose_names():
    solids = Solids(1, [POST])

    solids.move(np.array([0]), np.array([[[3.0, 4.0]]]), np.array([[np.pi / 2]]))

    row = solids.boxes[0, 0]
    # Half a metre ahead of (3, 4) when looking to +y, and seen from there turned by 90 degrees.
    *place, half_length, half_width, low, high, color = row.tolist()
    assert place == pytest.approx([3.0, 4.5, 0.0, 1.0], abs=1e-6)
    assert [half_length, half_width, low, high] == pytest.approx([0.1, 0.05, 0.1, 0.9])
    assert list(color) == [10.0, 20.0, 30.0]


def test_every_car_has_its_own_places():
    solids = Solids(3, [POST, POST])
    before = solids.boxes.copy()
    xy = np.arange(8.0).reshape(2, 2, 2)

    solids.move(np.array([0, 2]), xy, np.zeros((2, 2)))

    np.testing.assert_array_equal(solids.boxes[1], before[1])
    moved = np.stack([solids.boxes[axis][[0, 2]] for axis in ("x", "y")], axis=-1)
    np.testing.assert_allclose(moved, xy + np.array([0.5, 0.0]))
    for name in ("half_length", "half_width", "low", "high", "color"):
        np.testing.assert_array_equal(solids.boxes[name], before[name])


def test_paint_colours_whole_objects_of_one_car_but_not_their_tyres():
    solids = Solids(2, [POST, SHAPES["bot_car"]])
    before = solids.boxes.copy()

    solids.paint(np.array([1]), np.array([[[1.0, 2.0, 3.0], [200.0, 100.0, 50.0]]]))

    np.testing.assert_array_equal(solids.boxes[0], before[0])
    colors = solids.boxes["color"][1].tolist()
    assert colors[0] == [1.0, 2.0, 3.0]
    assert colors[1:5] == [[25.5] * 3] * 4
    assert colors[5:] == [[200.0, 100.0, 50.0]] * 2


def test_no_shapes_make_no_boxes():
    solids = Solids(4, [])

    solids.move(np.arange(4), np.zeros((4, 0, 2)), np.zeros((4, 0)))

    assert solids.boxes.shape == (4, 0)
