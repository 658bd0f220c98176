"""The lidar: ray order, walls, boxes, range; against shapely and numbers worked by hand."""

import math

import numpy as np
import pytest
import shapely
from shapely import affinity

from drsim.race.solids import CUBOID, SHAPES, Solids
from drsim.sensing.sensors import LIDAR, LidarModel, scan

ROOM_M = np.array([-2.0, 3.0, -1.5, 1.5], np.float32)
FORWARD = LidarModel(yaw_rad=0.0)
NO_BOXES = np.empty((1, 0), CUBOID)


def scan_one(boxes=NO_BOXES, xy=(0.0, 0.0), yaw_rad=0.0, wall_height_m=0.0, lidar=LIDAR):
    return scan(ROOM_M, wall_height_m, boxes, np.array([xy]), np.array([yaw_rad]), lidar)[0]


def boxes_at(*poses, shape="box_obstacle"):
    """Rows of objects of one shape around one car; poses of x, y and yaw."""
    places = np.array([poses], np.float64)
    solids = Solids(1, [SHAPES[shape]] * len(poses))
    solids.move(np.array([0]), places[:, :, :2], places[:, :, 2])
    return solids.boxes


def ray_towards(degrees, lidar=LIDAR):
    """Index of the ray next to a bearing from the car's nose, left positive."""
    away = (np.degrees(lidar.bearings_rad) - degrees + 180.0) % 360.0 - 180.0
    return int(np.abs(away).argmin())


def test_rays_go_from_30_degrees_left_round_by_the_rear_to_30_degrees_right():
    degrees = np.degrees(LIDAR.bearings_rad)

    np.testing.assert_allclose(degrees[[0, -1]], [30.0, 330.0], atol=1e-3)
    np.testing.assert_allclose(np.diff(degrees), 300 / 63, atol=1e-3)


def test_an_empty_floor_gives_infinite_distances():
    assert np.isinf(scan_one()).all()


def test_what_stands_straight_ahead_is_in_the_blind_wedge():
    assert np.isinf(scan_one(boxes_at((0.8, 0.0, 0.0)))).all()


@pytest.mark.parametrize(("bearing_deg", "place"), [(90, (0.03, 0.8)), (-90, (0.03, -0.8))])
def test_left_is_left_and_right_is_right(bearing_deg, place):
    rays_m = scan_one(boxes_at((*place, 0.0)))

    # The near side of the box is 0.8 - 0.15 m away, seen 2 degrees from the perpendicular at most.
    assert rays_m[ray_towards(bearing_deg)] == pytest.approx(0.65, abs=0.01)
    assert np.isinf(rays_m[ray_towards(-bearing_deg)])


def test_a_scanner_turned_round_measures_what_is_ahead():
    rays_m = scan_one(boxes_at((0.8, 0.0, 0.0)), lidar=FORWARD)

    # Scanner at 0.029, near side of the box at 0.6; the rays beside the middle are 2.4 degrees off.
    at = ray_towards(0.0, FORWARD)
    assert rays_m[at] == pytest.approx((0.6 - 0.02913) / math.cos(math.radians(2.38)), abs=1e-3)


def test_distances_turn_with_the_car():
    ahead_m = scan_one(boxes_at((-0.9, 0.2, 0.3)))

    turned_m = scan_one(boxes_at((-0.2, -0.9, 0.3 + math.pi / 2)), yaw_rad=math.pi / 2)

    assert np.isfinite(ahead_m).any()
    np.testing.assert_allclose(turned_m, ahead_m, rtol=1e-5)


def test_walls_are_met_where_they_are_higher_than_the_scanner():
    low = scan_one(wall_height_m=0.18)
    high = scan_one(wall_height_m=0.5)

    assert np.isinf(low).all()
    # Straight back 2.03 m; a ray 2.4 degrees off the axis meets the rear wall a little later.
    rear = high[ray_towards(180.0)]
    assert rear == pytest.approx(2.02913 / math.cos(math.radians(2.38)), abs=1e-3)


def test_a_car_outside_the_walls_does_not_see_them():
    assert np.isinf(scan_one(xy=(9.0, 0.0), wall_height_m=1.0)).all()


def test_low_things_are_not_met_and_of_a_car_only_its_cabin():
    follower = boxes_at((-0.6, 0.0, 0.0), shape="race_car")

    rays_m = scan_one(follower)

    # From the scanner at 0.029 to the front of the cabin at -0.55; the cabin is 0.11 m wide, so two
    # of the rays, 4.8 degrees apart, meet it. The hood, 0.1 m nearer, is too low.
    assert rays_m.min() == pytest.approx(0.02913 + 0.55, abs=0.005)
    assert np.isfinite(rays_m).sum() == 2


def test_nothing_beyond_12_m_is_measured():
    near, far = boxes_at((-12.1, 0.0, 0.0)), boxes_at((-12.3, 0.0, 0.0))
    straight_back = LidarModel(samples=1, sweep_rad=0.0, yaw_rad=math.pi)

    measured = [scan_one(boxes, lidar=straight_back).min() for boxes in (near, far)]

    assert measured[0] == pytest.approx(12.1 + 0.02913 - 0.2, abs=1e-3)
    assert np.isinf(measured[1])


def test_what_is_nearer_than_15_cm_is_looked_through_to_its_far_side():
    rays_m = scan_one(boxes_at((0.02913, 0.2, 0.0)))  # from 0.05 to 0.35 m to the left

    assert rays_m[ray_towards(90.0)] == pytest.approx(0.35, abs=0.01)


def test_random_rooms_and_boxes_measure_as_shapely_does():
    random = np.random.default_rng(3)
    room = shapely.box(ROOM_M[0], ROOM_M[2], ROOM_M[1], ROOM_M[3]).exterior
    compared = 0

    for _ in range(25):
        poses = np.column_stack(
            [random.uniform(-1.8, 2.8, 3), random.uniform(-1.3, 1.3, 3), random.uniform(0, 6.3, 3)]
        )
        xy, yaw_rad = random.uniform(-1.2, 1.2, 2), random.uniform(-4, 4)
        eye = xy + LIDAR.mount_m[0] * np.array([math.cos(yaw_rad), math.sin(yaw_rad)])
        crates = [
            affinity.translate(
                affinity.rotate(shapely.box(-0.2, -0.15, 0.2, 0.15), yaw, "center", True), x, y
            )
            for x, y, yaw in poses
        ]
        if min(shapely.Point(eye).distance(crate) for crate in crates) < 0.2:
            continue
        sides = shapely.union_all([room, *(crate.exterior for crate in crates)])

        rays_m = scan_one(boxes_at(*poses), xy, yaw_rad, wall_height_m=2.0)

        for bearing_rad, ray_m in zip(LIDAR.bearings_rad, rays_m, strict=True):
            away = np.array([math.cos(yaw_rad + bearing_rad), math.sin(yaw_rad + bearing_rad)])
            met = shapely.LineString([eye, eye + 12 * away]).intersection(sides)
            assert ray_m == pytest.approx(shapely.Point(eye).distance(met), abs=2e-3)
            compared += 1
    assert compared > 1000


def test_a_batch_measures_what_each_car_measures_alone():
    random = np.random.default_rng(0)
    boxes = np.concatenate([boxes_at(*random.uniform(-1.5, 1.5, (6, 3))) for _ in range(8)])
    xy, yaw_rad = random.uniform(-1, 1, (8, 2)), random.uniform(-3, 3, 8)

    out = scan(ROOM_M, 1.0, boxes, xy, yaw_rad)

    alone = [scan_one(boxes[i : i + 1], xy[i], yaw_rad[i], wall_height_m=1.0) for i in range(8)]
    np.testing.assert_array_equal(out, alone)


def test_a_pose_that_is_no_number_measures_nothing_instead_of_failing():
    rays_m = scan_one(boxes_at((0.5, 0.5, 0.0)), xy=(math.nan, 0.0), wall_height_m=1.0)

    assert np.isinf(rays_m).all()
