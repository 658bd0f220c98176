"""The computed camera: geometry by hand, robustness, and agreement with reference frames."""

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drsim.car.car import FRONT, CameraModel, CarBatch
from drsim.sensing.scene import Scene, build_scene, lens_pose, render
from drsim.track.appearance import Look, Paint, Walls
from drsim.track.track import Track
from drsim.track.worlds import load_track

SHARED = Path(__file__).resolve().parents[4] / "shared"

FLAT = Look(
    road=Paint(50.0),
    line=Paint(200.0),
    dash=Paint(50.0),
    field=Paint(100.0),
    start_depth_m=0.0,
    walls=Walls(greys=(10.0, 10.0, 10.0, 10.0)),
)

NOSE_UP_RAD = np.radians(1.39)


def square_track() -> Track:
    """A square road around the origin; its outer border lies 2.5 m away, its inner one 1.5 m."""
    corners = np.array([[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0], [-2.0, 2.0], [-2.0, -2.0]])
    return Track("square", corners, corners * 0.75, corners * 1.25, closed=True)


def car_axes(yaw_rad: float, nose_up_rad: float = NOSE_UP_RAD, roll_rad: float = 0.0) -> np.ndarray:
    """Axes of a car in the world, columns forward, left, up. Shape (1, 3, 3)."""
    cy, sy = np.cos(yaw_rad), np.sin(yaw_rad)
    cp, sp = np.cos(nose_up_rad), np.sin(nose_up_rad)
    cr, sr = np.cos(roll_rad), np.sin(roll_rad)
    turn = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    pitch = np.array([[cp, 0.0, -sp], [0.0, 1.0, 0.0], [sp, 0.0, cp]])
    roll = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return (turn @ pitch @ roll)[None]


def look_from(scene: Scene, lens_pos: np.ndarray, lens_mat: np.ndarray) -> np.ndarray:
    """One frame. Shape (rows, columns)."""
    out = np.zeros((1, FRONT.rows, FRONT.columns), np.uint8)
    render(scene, lens_pos, lens_mat, out)
    return out[0]


def resting_lens(x_m: float, y_m: float, yaw_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """Pose of a resting car's lens that stands above a point."""
    pos, mat = lens_of_car_at(0.0, 0.0, yaw_rad)
    return np.array([[x_m, y_m, pos[0, 2]]]), mat


def lens_of_car_at(x_m: float, y_m: float, yaw_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """Pose of the lens of a resting car whose origin is above a point."""
    car = CarBatch(1, 1)
    car.place(np.array([0]), np.array([[x_m, y_m, yaw_rad]]))
    return car.lens_pos, car.lens_mat


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build_scene(square_track(), FLAT)


@pytest.fixture(scope="module")
def grainy_scene() -> Scene:
    return build_scene(square_track())


def test_focal_length_is_126_pixels():
    assert FRONT.focal_px == pytest.approx(126.2, abs=0.05)


def test_a_resting_lens_is_13_centimetres_up_and_looks_13_6_degrees_down():
    pos, mat = lens_pose(np.array([[1.0, 2.0, -0.001]]), car_axes(0.0))

    assert pos[0] == pytest.approx([1.142, 2.0, 0.1328], abs=1e-3)
    assert np.degrees(np.arcsin(-mat[0, 2, 0])) == pytest.approx(13.61, abs=0.01)


def test_the_lens_of_a_car_that_drives_is_where_the_mount_says():
    pos, mat = lens_pose(np.array([[1.0, 2.0, -0.001]]), car_axes(0.7))

    driven_pos, driven_mat = lens_of_car_at(1.0, 2.0, 0.7)

    np.testing.assert_allclose(driven_pos, pos, atol=1e-3)
    np.testing.assert_allclose(driven_mat, mat, atol=1e-3)


def test_the_lens_turns_with_the_car():
    pos, mat = lens_pose(np.zeros((1, 3)), car_axes(np.pi / 2, nose_up_rad=0.0))

    assert pos[0] == pytest.approx([0.0, 0.145294, 0.130326])
    assert mat[0, :, 1] == pytest.approx([-1.0, 0.0, 0.0])


def test_a_camera_mounted_to_the_left_moves_the_lens_only():
    left = replace(FRONT, mount_m=(0.145294, 0.03, 0.130326))

    pos, mat = lens_pose(np.zeros((1, 3)), car_axes(0.0), left)

    middle_pos, middle_mat = lens_pose(np.zeros((1, 3)), car_axes(0.0))
    assert pos[0] - middle_pos[0] == pytest.approx([0.0, 0.03, 0.0])
    np.testing.assert_array_equal(mat, middle_mat)


def test_the_horizon_of_a_resting_car_lies_in_row_26_to_29():
    far = replace(FLAT, walls=replace(FLAT.walls, margin_m=200.0), sky_grey=10.0)
    wide = build_scene(square_track(), far)

    frame = look_from(wide, *resting_lens(0.0, 0.0, 0.3))

    horizon = int(np.argmax(frame[:, 80] > 30))
    assert 26 <= horizon <= 29
    assert (frame[horizon + 1 :, 80] >= 49).all()


def test_the_centre_ray_meets_the_ground_half_a_metre_ahead(scene):
    # Looking at the outer border across the road: its white strip is 0.0762 m deep.
    pos, mat = resting_lens(2.5 - 0.0381 - 0.549, 0.0, 0.0)

    frame = look_from(scene, pos, mat)

    white = np.flatnonzero(frame[:, 80] > 125)
    assert white.mean() == pytest.approx(59.5, abs=0.5)
    assert 0.49 < -pos[0, 2] * mat[0, 0, 0] / mat[0, 2, 0] < 0.55


@pytest.mark.parametrize("row", [60, 80, 100])
def test_a_line_at_a_known_distance_to_the_side_appears_in_the_predicted_columns(scene, row):
    # Along the road at x = 2.3; the white strip spans x = 2.4238 to 2.5, to the right.
    pos, mat = resting_lens(2.3, -1.0, np.pi / 2)
    below = (row + 0.5 - 60.0) / FRONT.focal_px
    depth_m = pos[0, 2] / (-mat[0, 2, 0] + below * mat[0, 2, 2])
    left_edge, right_edge = 80.0 + FRONT.focal_px * np.array([0.1238, 0.2]) / depth_m - 0.5

    frame = look_from(scene, pos, mat)

    white = np.flatnonzero(frame[row] > 125)
    assert white[0] == pytest.approx(left_edge, abs=1.0)
    assert white[-1] == pytest.approx(min(right_edge, 159.0), abs=1.0)


def test_a_wall_is_as_high_as_it_should_be(scene):
    # Half a metre up, 1.2 m before the wall at x = 3.262, looking level.
    frame = look_from(scene, np.array([[2.062, 0.0, 0.5]]), car_axes(0.0, nose_up_rad=0.0))

    wall = np.flatnonzero(frame[:, 80] == 10)
    assert wall[0] == pytest.approx(60.0 - FRONT.focal_px * 0.5 / 1.2, abs=1.5)
    assert wall[-1] + 1 == pytest.approx(60.0 + FRONT.focal_px * 0.5 / 1.2, abs=1.5)
    assert (frame[: wall[0] - 1, 80] == 178).all()


def test_a_symmetric_world_gives_a_mirrored_frame(scene):
    left = look_from(scene, *resting_lens(-0.5, 0.3, 0.4)).astype(int)
    right = look_from(scene, *resting_lens(-0.5, -0.3, -0.4)).astype(int)

    difference = np.abs(left - right[:, ::-1])
    assert difference.mean() < 0.3
    assert (difference > 20).mean() < 0.001


def test_a_rolled_car_sees_a_tilted_horizon(scene):
    _, mat = lens_pose(np.zeros((1, 3)), car_axes(0.0, roll_rad=np.radians(5.0)))

    frame = look_from(scene, np.array([[0.0, 0.0, 0.13]]), mat)

    left, right = (int(np.argmax(frame[10:, column] > 55)) for column in (5, 154))
    # Rolled to the right, so the world turns to the left: its left side sinks.
    assert left - right == pytest.approx(149 * np.tan(np.radians(5.0)), abs=2.0)


def test_the_same_pose_gives_the_same_bytes(grainy_scene):
    pose = resting_lens(2.1, 0.4, 1.0)

    first, second = look_from(grainy_scene, *pose), look_from(grainy_scene, *pose)

    np.testing.assert_array_equal(first, second)


def test_the_grain_of_the_road_can_be_seen(grainy_scene):
    frame = look_from(grainy_scene, *resting_lens(2.15, -1.0, np.pi / 2))

    assert 2.0 < frame[100:118, 60:75].std() < 8.0


def test_two_threads_with_a_slice_each_draw_what_one_thread_draws(grainy_scene):
    random = np.random.default_rng(3)
    poses = [resting_lens(*random.uniform(-2.0, 2.0, 2), random.uniform(-3, 3)) for _ in range(12)]
    pos, mat = (np.concatenate(parts) for parts in zip(*poses, strict=True))
    alone = np.zeros((12, FRONT.rows, FRONT.columns), np.uint8)
    shared = np.zeros_like(alone)

    render(grainy_scene, pos, mat, alone)
    threads = [
        threading.Thread(target=render, args=(grainy_scene, pos[part], mat[part], shared[part]))
        for part in (slice(0, 5), slice(5, 12))
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    np.testing.assert_array_equal(shared, alone)


@pytest.mark.parametrize("x_m", [3.262, 4.0, 500.0, -1e9])
@pytest.mark.parametrize("z_m", [-2.0, 0.0, 0.13, 50.0])
@pytest.mark.parametrize("roll_deg", [0.0, 90.0, 180.0])
def test_a_car_thrown_anywhere_gets_a_frame(scene, x_m, z_m, roll_deg):
    _, mat = lens_pose(np.zeros((1, 3)), car_axes(0.7, roll_rad=np.radians(roll_deg)))

    frame = look_from(scene, np.array([[x_m, 0.0, z_m]]), mat)

    assert frame.max() <= 200


def test_a_car_on_its_roof_sees_the_sky_below_the_ground(scene):
    _, mat = lens_pose(np.zeros((1, 3)), car_axes(0.0, nose_up_rad=-0.2618, roll_rad=np.pi))

    frame = look_from(scene, np.array([[0.0, 0.0, 0.13]]), mat)

    assert frame[5, 80] in (50, 100)
    assert frame[-5, 80] in (10, 178)


def test_a_pose_that_is_no_number_gives_a_black_frame(scene):
    frame = look_from(scene, np.array([[np.nan, 0.0, 0.13]]), car_axes(0.0))

    assert not frame.any()


def test_frames_of_another_size_are_refused(scene):
    out = np.zeros((1, 100, 100), np.uint8)

    with pytest.raises(ValueError, match="120 x 160"):
        render(scene, np.zeros((1, 3)), car_axes(0.0), out)


def test_another_camera_model_draws_its_own_size(scene):
    small = CameraModel(columns=80, rows=60)
    out = np.zeros((1, 60, 80), np.uint8)
    pos, mat = resting_lens(0.5, 0.2, 0.5)

    render(scene, pos, mat, out, small)

    large = look_from(scene, pos, mat).reshape(60, 2, 80, 2).mean(axis=(1, 3))
    assert np.abs(large - out[0]).mean() < 2.0


# Lens x, y, height in metres, yaw, pitch down and roll to the right in degrees, found by search.
REFERENCE_POSES = {
    1: (5.2523, 0.5919, 0.1314, 1.22, 13.63, 0.03),
    2: (4.9248, 2.9436, 0.1323, 158.20, 13.65, -0.07),
    3: (1.3160, 1.2453, 0.1306, -60.76, 13.48, 0.57),
}


@pytest.mark.parametrize(("index", "correlation"), [(1, 0.985), (2, 0.985), (3, 0.965)])
def test_frames_look_like_those_of_the_reference_simulator(index, correlation):
    picture = SHARED / "reference-images" / f"gazebo-camera-{index}.png"
    route = SHARED / "tracks" / "reinvent_base.npy"
    if not (picture.exists() and route.exists()):
        pytest.skip("the reference frames do not lie beside the project")
    image = pytest.importorskip("PIL.Image")
    with image.open(picture) as opened:
        small = opened.convert("RGB").resize((160, 120), image.Resampling.BILINEAR)
    expected = np.trunc(np.asarray(small) @ np.array([0.2989, 0.5870, 0.1140]))
    x_m, y_m, z_m, *degrees = REFERENCE_POSES[index]
    yaw_rad, down_rad, roll_rad = np.radians(degrees)

    frame = look_from(
        build_scene(load_track(str(route))),
        np.array([[x_m, y_m, z_m]]),
        car_axes(yaw_rad, -down_rad, roll_rad),
    )

    ground = slice(36, None)  # below 30 %: no sky, no wall
    assert np.corrcoef(frame[ground].ravel(), expected[ground].ravel())[0, 1] > correlation
    assert np.abs(frame - expected).mean() < 4.5
