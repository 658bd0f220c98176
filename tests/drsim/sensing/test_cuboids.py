"""Cuboids in frames: numbers by hand, agreement with brute force, and lenses at and in boxes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drsim.car.car import FRONT, CameraModel
from drsim.race.solids import CUBOID, SHAPES, Box, Shape, Solids
from drsim.sensing.scene import Light, Scene, build_scene, render
from drsim.track.appearance import AMBIENT, LUMA, SUN, Look, Paint, Walls
from drsim.track.track import Track

SMALL = CameraModel(columns=80, rows=60)
TO_SUN = np.array([0.5, -0.1, 0.9]) / np.linalg.norm([0.5, -0.1, 0.9])
NEAR_M = 0.02

BOX = Shape("box", (Box((0.0, 0.0), (0.4, 0.3), 0.0, 0.25, (200.0, 100.0, 50.0)),), (0.5, 0.4))
BOX_GREY = 200 * 0.2989 + 100 * 0.5870 + 50 * 0.1140

EYE = np.array([0.0, 0.0, 0.13])


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A large field of one grey with a road far away."""
    corners = np.array([[-8.0, -8.0], [8.0, -8.0], [8.0, 8.0], [-8.0, 8.0], [-8.0, -8.0]])
    flat = Look(
        road=Paint(50.0),
        line=Paint(220.0),
        dash=Paint(50.0),
        field=Paint(120.0),
        start_depth_m=0.0,
        walls=Walls(greys=(20.0, 30.0, 40.0, 25.0)),
    )
    return build_scene(Track("square", corners, corners * 0.9, corners * 1.1, closed=True), flat)


def axes(yaw_deg: float = 0.0, down_deg: float = 0.0, roll_deg: float = 0.0) -> np.ndarray:
    """Axes of a lens in the world, columns forward, left, up. Shape (3, 3)."""
    turns = np.radians([yaw_deg, down_deg, roll_deg])
    (cy, cp, cr), (sy, sp, sr) = np.cos(turns), np.sin(turns)
    turned = np.array([[cy * cp, -sy, cy * sp], [sy * cp, cy, sy * sp], [-sp, 0.0, cp]])
    return turned @ np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])


def placed(*things: tuple[Shape, float, float, float]) -> np.ndarray:
    """Cuboids of shapes at x, y and yaw in degrees. Shape (1, m)."""
    solids = Solids(1, [shape for shape, *_ in things])
    poses = np.array([pose for _, *pose in things]).reshape(1, -1, 3)
    solids.move(np.array([0]), poses[:, :, :2], np.radians(poses[:, :, 2]))
    return solids.boxes


def seen(
    scene: Scene,
    pos: np.ndarray,
    mat: np.ndarray,
    boxes: np.ndarray | None,
    camera: CameraModel = SMALL,
) -> np.ndarray:
    """One frame. Shape (rows, columns)."""
    out = np.zeros((1, camera.rows, camera.columns), np.uint8)
    render(scene, pos[None], mat[None], out, camera, boxes=boxes)
    return out[0]


def brute_force(
    scene: Scene, pos: np.ndarray, mat: np.ndarray, boxes: np.ndarray, camera: CameraModel = SMALL
) -> np.ndarray:
    """The same frame with many rays in each pixel, each of which finds the first box it meets."""
    rays = 5
    tall, wide = (rays * (side + 2) for side in (camera.rows, camera.columns))
    y, x = np.meshgrid((np.arange(tall) + 0.5) / rays - 1, (np.arange(wide) + 0.5) / rays - 1)
    left, up = 0.5 * camera.columns - x.T, 0.5 * camera.rows - y.T
    depth_1 = np.full(left.shape, camera.focal_px)
    ways = np.stack([depth_1, left, up], axis=-1) / camera.focal_px @ mat.T + 1e-12
    nearest, greys = np.full(left.shape, np.inf), np.zeros(left.shape)
    for x_m, y_m, cos, sin, half_x, half_y, low, high, color in boxes[0].tolist():
        frame = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        start, way = (pos - (x_m, y_m, 0.0)) @ frame, ways @ frame
        one = (np.array([-half_x, -half_y, low]) - start) / way
        other = (np.array([half_x, half_y, high]) - start) / way
        enter, leave = np.minimum(one, other), np.maximum(one, other).min(axis=-1)
        first = enter.max(axis=-1)
        hit = (first >= NEAR_M) & (first < np.minimum(leave, nearest))
        side = enter.argmax(axis=-1)
        normals = frame.T[side] * -np.sign(np.take_along_axis(way, side[..., None], axis=-1))
        light = AMBIENT + SUN * np.maximum(normals @ TO_SUN, 0.0)
        greys = np.where(hit, np.minimum(np.dot(color, LUMA) * light, 255.0), greys)
        nearest = np.where(hit, first, nearest)
    tents = [_tents(side, rays) for side in (camera.rows, camera.columns)]
    share = tents[0] @ np.isfinite(nearest) @ tents[1].T
    behind = seen(scene, pos, mat, None, camera)
    return behind * (1.0 - share) + tents[0] @ greys @ tents[1].T


def _tents(pixels: int, rays: int) -> np.ndarray:
    """Weights of rays, which begin a pixel before the frame, in each pixel."""
    places = (np.arange(rays * (pixels + 2)) + 0.5) / rays - 1.0
    weights = np.maximum(1.0 - np.abs(places - np.arange(pixels)[:, None] - 0.5), 0.0)
    return weights / weights.sum(axis=1, keepdims=True)


def test_a_box_covers_the_pixels_and_has_the_grey_worked_by_hand(scene):
    # Its front is 0.8 m before the lens: 0.3 m wide, from 0.13 m below to 0.12 m above the middle.
    frame = seen(scene, EYE, axes(), placed((BOX, 1.0, 0.0, 0.0)), FRONT)

    # Front looks to -x, away from the sun: ambient light only, 123.1 / 2.
    inside = np.argwhere(frame == int(0.5 * BOX_GREY))
    (top, left), (bottom, right) = inside.min(axis=0), inside.max(axis=0)
    assert left == pytest.approx(80 - FRONT.focal_px * 0.15 / 0.8, abs=1.5)
    assert right + 1 == pytest.approx(80 + FRONT.focal_px * 0.15 / 0.8, abs=1.5)
    assert top == pytest.approx(60 - FRONT.focal_px * 0.12 / 0.8, abs=1.5)
    assert bottom + 1 == pytest.approx(60 + FRONT.focal_px * 0.13 / 0.8, abs=1.5)


@pytest.mark.parametrize(
    ("lens", "turn", "facing"),
    [
        ((1.0, 0.0, 0.125), axes(180.0), 0.4834),  # at the side that looks to +x
        ((0.0, -1.0, 0.125), axes(90.0), 0.0967),
        ((0.0, 1.0, 0.125), axes(-90.0), 0.0),
        ((-1.0, 0.0, 0.125), axes(0.0), 0.0),
        ((0.0, 0.0, 1.5), axes(0.0, 90.0), 0.8701),  # at its top
    ],
)
def test_each_side_is_as_bright_as_it_faces_the_sun(scene, lens, turn, facing):
    frame = seen(scene, np.array(lens), turn, placed((BOX, 0.0, 0.0, 0.0)))

    assert frame[30, 40] == pytest.approx(BOX_GREY * (0.5 + 0.7075 * facing), abs=1.0)


def test_every_lens_sees_its_own_boxes_in_its_own_light(scene):
    boxes = np.concatenate([placed((BOX, 1.0, 0.0, 0.0)), placed((BOX, -1.0, 0.0, 0.0))] * 2)
    dim = np.array([1.0, 1.0, 0.5, 0.5], np.float32)[:, None]
    light = Light(
        palettes=np.tile(np.arange(256, dtype=np.uint8), (4, 1)),
        wall_greys=np.zeros((4, 4), np.float32),
        sky_greys=np.zeros(4, np.float32),
        ambient=AMBIENT * dim * np.ones(3, np.float32),
        sun=np.full((4, 3), SUN, np.float32),
    )
    out = np.zeros((4, 120, 160), np.uint8)

    render(scene, np.tile(EYE, (4, 1)), np.tile(axes(), (4, 1, 1)), out, boxes=boxes, light=light)

    assert out[:, 65, 80].tolist() == [int(0.5 * BOX_GREY), 120, int(0.25 * BOX_GREY), 120]


CAR, BOT, CRATE = SHAPES["race_car"], SHAPES["bot_car"], SHAPES["box_obstacle"]


@pytest.mark.parametrize("yaw_deg", range(0, 360, 45))
def test_the_parts_of_a_car_hide_each_other_as_in_a_brute_force_picture(scene, yaw_deg):
    *wheels, body, cabin = CAR.boxes
    white = [replace(box, color=(250.0, 250.0, 250.0)) for box in (body, cabin)]
    pale = replace(CAR, boxes=(*wheels, *white))
    boxes = placed((pale, 0.6, 0.1, yaw_deg + 10.0))
    pos, mat = np.array([0.0, 0.0, 0.25]), axes(5.0, 15.0)

    frame = seen(scene, pos, mat, boxes)

    difference = np.abs(frame - np.floor(brute_force(scene, pos, mat, boxes)))
    assert difference.mean() < 0.5
    assert difference.max() < 40


@pytest.mark.parametrize("seed", range(5))
def test_a_crowd_on_the_road_looks_as_in_a_brute_force_picture(scene, seed):
    random = np.random.default_rng(seed)
    shapes = [CRATE, BOT, CAR, BOX, BOT, CRATE]
    things = [
        (shape, 0.6 + 0.55 * index, random.uniform(-0.4, 0.4), random.uniform(-180, 180))
        for index, shape in enumerate(shapes)
    ]
    random.shuffle(things)
    boxes = placed(*things)
    mat = axes(random.normal(0.0, 10.0), 13.6, random.normal(0.0, 2.0))

    frame = seen(scene, EYE, mat, boxes)

    difference = np.abs(frame - np.floor(brute_force(scene, EYE, mat, boxes)))
    assert difference.mean() < 0.5
    assert difference.max() < 40


def test_the_order_of_the_boxes_does_not_matter(scene):
    things = [(CRATE, 0.7, 0.1, 20.0), (CAR, 1.1, -0.1, 80.0), (BOX, 1.6, 0.0, 0.0)]

    forward, backward = (seen(scene, EYE, axes(), placed(*t)) for t in (things, things[::-1]))

    np.testing.assert_array_equal(forward, backward)


# Distance from the lens to the middle of a box that is 0.4 m long: it stands before the lens, its
# front within and beyond the near plane, around the lens, its back at the lens, and behind it.
@pytest.mark.parametrize("ahead_m", [0.3, 0.23, 0.215, 0.2, 0.1, 0.0, -0.1, -0.2, -0.3])
@pytest.mark.parametrize("aside_m", [0.0, 0.17])
def test_a_lens_at_and_in_a_box_sees_what_is_before_its_near_plane(scene, ahead_m, aside_m):
    boxes, mat = placed((BOX, ahead_m, aside_m, 0.0)), axes(3.0, 13.6)

    frame = seen(scene, EYE, mat, boxes)

    difference = np.abs(frame - np.floor(brute_force(scene, EYE, mat, boxes)))
    assert difference.mean() < 0.5
    assert difference.max() < 40


def test_a_lens_above_and_in_a_turned_box_sees_what_is_before_its_near_plane(scene):
    boxes = placed((BOX, 0.15, 0.05, 33.0), (CAR, 0.1, -0.2, -70.0))

    for height_m in (0.2, 0.24, 0.26, 0.3):
        pos, mat = np.array([0.0, 0.0, height_m]), axes(-4.0, 20.0, 3.0)
        difference = np.abs(
            seen(scene, pos, mat, boxes) - np.floor(brute_force(scene, pos, mat, boxes))
        )
        assert difference.mean() < 0.5


def test_nothing_changes_but_the_pixels_of_the_box(scene):
    boxes = placed((BOX, 1.0, 0.2, 30.0))
    before = seen(scene, EYE, axes(), None, FRONT)

    after = seen(scene, EYE, axes(), boxes, FRONT)

    rows, columns = np.nonzero(before != after)
    left, right = (80 - FRONT.focal_px * side / 0.75 for side in (0.46, -0.06))
    assert left - 2 < columns.min()
    assert columns.max() < right + 2
    assert rows.min() >= 60 - FRONT.focal_px * 0.12 / 0.75 - 2
    assert 400 < len(rows) < 3000


def test_a_box_behind_the_lens_is_not_drawn(scene):
    before = seen(scene, EYE, axes(), None)

    after = seen(scene, EYE, axes(), placed((BOX, -0.5, 0.0, 10.0), (CAR, -1.0, 0.3, 0.0)))

    np.testing.assert_array_equal(after, before)


@pytest.mark.parametrize("where", [np.nan, np.inf, -np.inf, 1e30])
def test_a_box_that_is_nowhere_is_not_drawn(scene, where):
    boxes = placed((BOX, 1.0, 0.0, 0.0))
    boxes["y"][0, 0] = where
    before = seen(scene, EYE, axes(), None)

    after = seen(scene, EYE, axes(), boxes)

    np.testing.assert_array_equal(after, before)


def test_a_lens_that_is_nowhere_sees_no_boxes(scene):
    frame = seen(scene, EYE * np.nan, axes(), placed((BOX, 1.0, 0.0, 0.0)))

    assert not frame.any()


def test_boxes_that_stand_within_each_other_are_drawn_all_the_same(scene):
    pale = Shape("pale", (Box((0.0, 0.0), (0.4, 0.3), 0.0, 0.5, (250.0, 250.0, 250.0)),), (1, 1))
    ring = [(BOX, 1.0 + 0.1 * k, 0.1 * k, 40.0 * k) for k in range(8)]

    frame = seen(scene, EYE, axes(), placed((pale, 1.1, 0.1, 7.0), *ring), FRONT)

    # The pale one is twice as high as the others, which it stands among.
    assert (frame[10:35, 60:75] == int(125 * np.sum(LUMA))).any()
    assert (frame[60:75, 75:85] == int(0.5 * BOX_GREY)).any()


metres = st.floats(-3.0, 3.0)
degrees = st.floats(-180.0, 180.0)


@given(pose=st.tuples(metres, metres, st.floats(-0.5, 2.0)), turn=st.tuples(*[degrees] * 3))
def test_any_lens_gets_a_frame_in_which_boxes_have_their_own_greys(scene, pose, turn):
    things = [(CRATE, 0.0, 0.0, 10.0), (CAR, 0.5, 0.5, 70.0), (BOX, 0.1, -0.4, 0.0)]
    before = seen(scene, np.array(pose), axes(*turn), None)

    after = seen(scene, np.array(pose), axes(*turn), placed(*things)).astype(int)

    # The brightest side is a top in full sun; a blend is no brighter than both of its parts.
    assert after.max() <= max(before.max(), BOX_GREY * (AMBIENT + SUN))
    assert after.min() >= min(before.min(), int(25.5 * AMBIENT * sum(LUMA))) - 1


def test_boxes_or_light_for_other_lenses_are_refused(scene):
    pos, mat = np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1))
    out = np.zeros((2, 120, 160), np.uint8)
    light = Light(
        palettes=np.zeros((1, 256), np.uint8),
        wall_greys=np.zeros((1, 4), np.float32),
        sky_greys=np.zeros(1, np.float32),
        ambient=np.zeros((1, 3), np.float32),
        sun=np.zeros((1, 3), np.float32),
    )

    with pytest.raises(ValueError, match="boxes for 3 lenses, but 2"):
        render(scene, pos, mat, out, boxes=np.zeros((3, 1), CUBOID))
    with pytest.raises(ValueError, match="light for 1 lenses, but 2"):
        render(scene, pos, mat, out, light=light)
