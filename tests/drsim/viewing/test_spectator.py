"""The cameras for videos: where they stand, what they show and in which colours."""

from dataclasses import replace

import numpy as np
import pytest

from drsim.race.solids import SHAPES, Shape
from drsim.track.appearance import Look, Paint, Walls
from drsim.track.track import Track
from drsim.viewing.spectator import Spectator

RED, GREEN, BLUE = (200.0, 10.0, 10.0), (20.0, 160.0, 20.0), (20.0, 20.0, 220.0)

NOTHING = Shape("nothing", (), (0.0, 0.0))

PLAIN = Look(
    road=Paint(60.0, color=RED),
    line=Paint(60.0, color=RED),
    dash=Paint(60.0, color=RED),
    field=Paint(100.0, color=GREEN),
    start_depth_m=0.0,
    walls=Walls(margin_m=6.0),
)


def square_track(half_m: float = 2.0) -> Track:
    """A square road 1 m wide around the origin."""
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])
    inner, outer = corners * (half_m - 0.5), corners * (half_m + 0.5)
    return Track("square", corners * half_m, inner, outer, closed=True)


def is_color(pixels: np.ndarray, color: tuple[float, float, float]) -> np.ndarray:
    return (np.abs(pixels - np.array(color)) < 3.0).all(axis=-1)


def middle_of(pixels: np.ndarray) -> tuple[float, float]:
    """Mean row and column of some pixels."""
    rows, columns = np.nonzero(pixels)
    return float(rows.mean()), float(columns.mean())


@pytest.fixture(scope="module")
def empty() -> Spectator:
    return Spectator(square_track(), look=PLAIN, car=NOTHING)


@pytest.fixture(scope="module")
def only_spectator() -> Spectator:
    return Spectator(square_track(), look=PLAIN)


@pytest.fixture
def spectator(only_spectator: Spectator) -> Spectator:
    only_spectator.cut()
    return only_spectator


def test_frames_are_rgb_of_640_by_480(spectator):
    pose = np.array([0.0, -2.0, 0.0])

    for frame in (spectator.chase(pose), spectator.top(pose)):
        assert frame.shape == (480, 640, 3)
        assert frame.dtype == np.uint8


def test_from_above_the_whole_track_is_in_view(spectator):
    # The road reaches 2.5 m to all sides; the picture is 5 m high with a quarter of that to spare.
    frame = spectator.top(np.array([0.0, -2.0, 0.0]))

    road = np.flatnonzero(is_color(frame[240], RED))
    assert road[0] == pytest.approx(320 - 2.5 * 480 / 6.25, abs=2)
    assert road[-1] == pytest.approx(320 + 2.5 * 480 / 6.25, abs=2)
    assert is_color(frame[240, 320], GREEN)


def test_from_above_a_car_stands_where_its_pose_says(spectator, empty):
    pose = np.array([2.0, 1.0, 0.5])

    car = (spectator.top(pose) != empty.top(pose)).any(axis=2)

    pixels_per_m = 480 / 6.25
    row, column = middle_of(car)
    assert column == pytest.approx(320 + 2.0 * pixels_per_m, abs=4)
    assert row == pytest.approx(240 - 1.0 * pixels_per_m, abs=4)
    assert car.sum() == pytest.approx(0.32 * 0.19 * pixels_per_m**2, rel=0.35)


def test_from_behind_the_car_stands_in_the_lower_middle(spectator, empty):
    pose = np.array([-1.0, -2.0, 0.7])

    car = (spectator.chase(pose) != empty.chase(pose)).any(axis=2)

    # 1.5 m ahead and about 0.9 m below a lens that is pitched 0.314 rad down.
    row, column = middle_of(car)
    focal_px = 320.0 / np.tan(0.5 * 1.13)
    assert column == pytest.approx(320, abs=3)
    assert row == pytest.approx(240 + focal_px * np.tan(np.arctan2(0.9, 1.5) - 0.314), abs=12)
    assert 40 < np.ptp(np.nonzero(car)[1]) < 90


def test_from_behind_the_horizon_lies_where_the_pitch_puts_it(spectator):
    far = Look(walls=Walls(margin_m=300.0, height_m=0.0, greys=4 * (178.0,)))
    wide = Spectator(square_track(), look=far)

    frame = wide.chase(np.array([-1.0, -2.0, 0.0]))

    sky = (frame[:, 20] == 178).all(axis=1)
    focal_px = 320.0 / np.tan(0.5 * 1.13)
    assert np.flatnonzero(sky)[-1] == pytest.approx(240 - focal_px * np.tan(0.314), abs=3)


def test_the_camera_behind_swings_after_a_turning_car(spectator):
    straight, turned = np.array([-1.0, -2.0, 0.0]), np.array([-1.0, -2.0, 0.6])
    spectator.chase(straight)

    views = [spectator.chase(turned).astype(int) for _ in range(30)]

    spectator.cut()
    settled = spectator.chase(turned)
    away = [np.abs(view - settled).mean() for view in views]
    assert away[0] > away[3] > away[29]
    assert away[29] < 0.5


def test_a_car_put_elsewhere_is_seen_along_its_new_direction_at_once(spectator):
    spectator.chase(np.array([0.0, -2.0, 0.0]))

    jumped = spectator.chase(np.array([2.0, 0.0, 1.5]))

    spectator.cut()
    np.testing.assert_array_equal(jumped, spectator.chase(np.array([2.0, 0.0, 1.5])))


def test_the_camera_turns_the_short_way_where_the_yaw_wraps(spectator):
    spectator.chase(np.array([1.0, 2.0, np.pi - 0.01]))

    wrapped = spectator.chase(np.array([1.0, 2.0, -np.pi + 0.01]))

    spectator.cut()
    after = spectator.chase(np.array([1.0, 2.0, np.pi]))
    assert np.abs(wrapped.astype(int) - after).mean() < 3.0


def test_objects_stand_where_their_poses_say_in_their_colour():
    crate = SHAPES["box_obstacle"]
    blue_crate = replace(crate, boxes=tuple(replace(box, color=BLUE) for box in crate.boxes))
    spectator = Spectator(square_track(), [blue_crate], look=PLAIN)
    pose, objects = np.array([-1.0, -2.0, 0.0]), np.array([[0.4, -2.3, 0.0]])

    frame = spectator.chase(pose, objects).astype(int)

    blue = frame[..., 2] > 2 * frame[..., :2].max(axis=-1) + 10
    assert blue.sum() > 1000
    assert middle_of(blue)[1] > 340
    assert frame[330:400, 320, 0].max() > 100  # the car stays red


def test_a_pose_for_each_shape_is_asked_for(spectator):
    with pytest.raises(ValueError, match="one for each shape"):
        spectator.top(np.zeros(3), np.zeros((2, 3)))


def test_a_long_track_is_seen_with_a_wide_angle_but_less_than_half_a_circle():
    frame = Spectator(square_track(40.0), look=PLAIN, car=NOTHING).top(np.zeros(3))

    assert is_color(frame[240, [20, 320, 620]], GREEN).all()
