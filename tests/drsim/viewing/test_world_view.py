"""The coloured view of a track: lines, cars and boxes where they belong, in their colours."""

import math
from dataclasses import replace

import numpy as np
import pytest

from drsim.race.solids import SHAPES
from drsim.track.worlds import load_track
from drsim.viewing.car_eye import FollowingCamera, lens_above
from drsim.viewing.placed_objects import PlacedObject, has_wheels, meshes_of, wheel
from drsim.viewing.world_view import WorldView

TRACK = load_track("reinvent_base")
ROWS, COLUMNS = 120, 160
RACE_CAR = SHAPES["race_car"]
BLUE = (68.0, 95.0, 229.0)


@pytest.fixture(scope="module")
def view():
    made = WorldView(TRACK, columns=COLUMNS, rows=ROWS, threads=2)
    yield made
    made.close()


@pytest.fixture(scope="module")
def above():
    return lens_above(TRACK, (ROWS, COLUMNS))


def pixel_of(lens, xy):
    """Row and column of a point of the ground from above."""
    pixel_m = 2.0 * lens.pos[2] * math.tan(0.5 * lens.field_of_view_rad) / COLUMNS
    column = COLUMNS / 2 + (xy[0] - lens.pos[0]) / pixel_m
    row = ROWS / 2 - (xy[1] - lens.pos[1]) / pixel_m
    return int(row), int(column)


def pose(fraction, lane="center"):
    return tuple(TRACK.pose_at(np.array([fraction * TRACK.length_m]), lane)[0].tolist())


def test_road_and_field_have_the_colours_of_the_world(view, above):
    frame = view.frame(above, []).astype(int)

    inner = TRACK.pose_at(np.linspace(0, TRACK.length_m, 40)[:-1], "inner")[:, :2]
    road = np.array([frame[pixel_of(above, xy)] for xy in inner])
    field = frame[ROWS // 2, 55]
    assert np.abs(np.median(road, axis=0) - (40, 55, 71)).max() < 14
    assert field[1] > field[0] + 15
    assert field[1] > field[2] + 10


def test_threads_change_nothing(view, above):
    things = [
        PlacedObject(RACE_CAR, pose(0.2), BLUE),
        PlacedObject(SHAPES["box_obstacle"], pose(0.4)),
    ]
    alone = WorldView(TRACK, columns=COLUMNS, rows=ROWS, threads=1)

    np.testing.assert_array_equal(view.frame(above, things), alone.frame(above, things))


def test_a_car_is_where_its_pose_says_in_its_colour(view):
    camera = FollowingCamera()
    lens = camera.lens(pose(0.3))

    empty = view.frame(lens, []).astype(int)
    frame = view.frame(lens, [PlacedObject(RACE_CAR, pose(0.3), BLUE)]).astype(int)

    changed = (frame != empty).any(axis=2)
    rows, columns = np.nonzero(changed)
    assert columns.mean() == pytest.approx(COLUMNS / 2, abs=6)
    assert rows.min() > ROWS * 0.4
    blue = (frame[..., 2] > frame[..., 0] + 60) & changed
    assert blue.sum() > 60


def test_a_ghost_lets_the_ground_shine_through(view):
    lens = FollowingCamera().lens(pose(0.3))
    empty = view.frame(lens, []).astype(int)

    solid = np.abs(view.frame(lens, [PlacedObject(RACE_CAR, pose(0.3), BLUE)]).astype(int) - empty)
    ghost = np.abs(
        view.frame(lens, [PlacedObject(RACE_CAR, pose(0.3), BLUE, ghost=True)]).astype(int) - empty
    )

    assert 0.2 * solid.sum() < ghost.sum() < 0.6 * solid.sum()


def test_what_stands_nearer_hides_what_is_behind(view):
    lens = FollowingCamera().lens(pose(0.3))
    box = replace(SHAPES["box_obstacle"], boxes=SHAPES["box_obstacle"].boxes)
    ahead = TRACK.pose_at(np.array([0.3 * TRACK.length_m + 0.9]))[0]
    hidden = PlacedObject(SHAPES["bot_car"], tuple(ahead.tolist()))
    crate = PlacedObject(
        box, tuple(ahead - [0.35 * math.cos(ahead[2]), 0.35 * math.sin(ahead[2]), 0])
    )

    with_car = view.frame(lens, [crate, hidden])
    without = view.frame(lens, [crate])

    changed = (with_car != without).any(axis=2).sum()
    alone = (view.frame(lens, [hidden]) != view.frame(lens, [])).any(axis=2).sum()
    assert changed < 0.5 * alone


def test_things_cast_shadows(view):
    lens = FollowingCamera().lens(pose(0.3))
    nothing_to_see = replace(SHAPES["box_obstacle"], name="box")
    frame = view.frame(lens, [PlacedObject(nothing_to_see, pose(0.35))]).astype(int)
    empty = view.frame(lens, []).astype(int)

    darker = (frame < 0.75 * empty).all(axis=2) & (empty.sum(axis=2) > 60)
    assert darker.sum() > 20


def test_the_horizon_is_level_and_the_sky_above_it(view):
    frame = view.frame(FollowingCamera().lens(pose(0.1)), []).astype(int)

    sky = frame[:8].reshape(-1, 3)
    assert (sky[:, 2] > sky[:, 0]).mean() > 0.9
    ground = frame[-20:].reshape(-1, 3)
    assert sky.mean() > ground.mean() + 40


@pytest.mark.parametrize("place", [(1e4, 0.0, 0.0), (0.0, 0.0, 0.0), (3.0, -40.0, 1.0)])
def test_a_car_far_off_the_track_is_filmed_too(view, place):
    frame = view.frame(FollowingCamera().lens(place), [PlacedObject(RACE_CAR, place, BLUE)])

    assert frame.std() > 5


@pytest.mark.parametrize("name", SHAPES)
def test_a_mesh_is_as_large_as_the_shape_and_closed_outwards(name):
    shape = SHAPES[name]
    mesh = meshes_of(shape)[0]

    length_m, width_m = shape.footprint_m
    assert np.ptp(mesh.corners[:, 0]) == pytest.approx(length_m, rel=0.35)
    assert np.ptp(mesh.corners[:, 1]) <= width_m
    a, b, c = (mesh.corners[mesh.faces[:, k]] for k in range(3))
    facing = (np.cross(b - a, c - a) * mesh.normals[mesh.faces].sum(axis=1)).sum(axis=1)
    assert (facing >= 0.0).all()
    assert has_wheels(shape) == name.endswith("_car")


def test_a_wheel_stands_on_the_ground_and_turns_about_its_axle():
    corners = wheel().corners

    assert corners[:, 2].min() == pytest.approx(-0.036, abs=0.001)
    assert np.hypot(corners[:, 0], corners[:, 2]).max() == pytest.approx(0.036, abs=1e-6)
