"""The frames of many cars: eyes, what stands around each car, extras, and threads."""

import threading

import numpy as np
import pytest

from drsim.car.car import FRONT, CarBatch
from drsim.race.solids import SHAPES, Solids
from drsim.sensing.lighting import Lighting
from drsim.sensing.observations import Channel, FrameRenderer
from drsim.sensing.scene import Scene, build_scene, render
from drsim.track.appearance import look_of
from drsim.track.track import Track
from drsim.track.worlds import load_track

CARS = 11
OF_SCENE = np.zeros(CARS, np.int64)


@pytest.fixture(scope="module")
def track() -> Track:
    return load_track("reinvent_base")


@pytest.fixture(scope="module")
def scene(track) -> Scene:
    return build_scene(track)


@pytest.fixture(scope="module")
def lenses(track) -> tuple[np.ndarray, np.ndarray]:
    """Lenses of cars along the lap."""
    cars = CarBatch(CARS, 1)
    along_m = np.linspace(0.0, track.length_m, CARS, endpoint=False)
    cars.place(np.arange(CARS), track.pose_at(along_m))
    return cars.lens_pos, cars.lens_mat


def ahead_of(lens_pos: np.ndarray, lens_mat: np.ndarray, kind: str, depth_m: float) -> Solids:
    """One solid before each lens, turned as the lens is."""
    solids = Solids(CARS, [SHAPES[kind]])
    yaw = np.arctan2(lens_mat[:, 1, 0], lens_mat[:, 0, 0])
    xy = lens_pos[:, :2] + depth_m * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    solids.move(np.arange(CARS), xy[:, None], yaw[:, None])
    return solids


def test_one_eye_sees_what_the_camera_draws(scene, lenses):
    expected = np.zeros((CARS, FRONT.rows, FRONT.columns), np.uint8)
    render(scene, *lenses, expected)
    renderer = FrameRenderer([Channel([scene])], OF_SCENE, 1)

    renderer.start(np.arange(CARS), *lenses)
    renderer.finish()

    assert renderer.frames.shape == (CARS, 1, 120, 160)
    np.testing.assert_array_equal(renderer.frames[:, 0], expected)


def test_two_eyes_look_from_3_centimetres_to_either_side_and_round_their_greys(scene, lenses):
    pos, mat = lenses
    expected = np.zeros((2, CARS, FRONT.rows, FRONT.columns), np.uint8)
    for eye, to_left_m in enumerate((0.03, -0.03)):
        render(scene, pos + to_left_m * mat[:, :, 1], mat, expected[eye], rounding=True)
    renderer = FrameRenderer([Channel([scene])], OF_SCENE, 1, eyes=2)

    renderer.start(np.arange(CARS), pos, mat)
    renderer.finish()

    assert renderer.frames.shape == (CARS, 2, 120, 160)
    np.testing.assert_array_equal(renderer.frames.swapaxes(0, 1), expected)


def test_a_near_box_lies_further_right_for_the_left_eye(scene, lenses):
    solids = ahead_of(*lenses, "box_obstacle", 0.8)
    plain = FrameRenderer([Channel([scene])], OF_SCENE, 1, eyes=2)
    boxed = FrameRenderer([Channel([scene])], OF_SCENE, 1, eyes=2, solids=solids)

    for renderer in (plain, boxed):
        renderer.start(np.arange(CARS), *lenses)
        renderer.finish()

    changed = (boxed.frames != plain.frames).any(axis=2)  # which columns of which eye
    middles = [[np.flatnonzero(eye).mean() for eye in car] for car in changed]
    # Nearest is the upper edge of its front, 0.6 m ahead and 0.12 m up, for a lens tilted by 15
    # degrees. The eyes are 0.06 m apart.
    depth_m = 0.6 * np.cos(FRONT.pitch_rad) - 0.12 * np.sin(FRONT.pitch_rad)
    apart_px = FRONT.focal_px * 0.06 / depth_m
    assert np.diff(middles, axis=1).mean() == pytest.approx(-apart_px, abs=0.5)


def test_rounded_greys_are_half_a_grey_brighter_than_cut_ones(scene, lenses):
    cut, rounded = (np.zeros((CARS, FRONT.rows, FRONT.columns), np.uint8) for _ in range(2))

    render(scene, *lenses, cut)
    render(scene, *lenses, rounded, rounding=True)

    difference = rounded.astype(int) - cut
    assert set(np.unique(difference)) == {0, 1}
    assert difference[:, 60:].mean() == pytest.approx(0.5, abs=0.05)


def test_only_the_named_cars_get_new_frames(scene, lenses):
    renderer = FrameRenderer([Channel([scene])], OF_SCENE, 2)
    renderer.frames[:] = 7

    renderer.start(np.array([1, 2, 5, 9]), *lenses)
    renderer.finish()
    renderer.close()

    same = (renderer.frames == 7).all(axis=(1, 2, 3))
    assert np.flatnonzero(~same).tolist() == [1, 2, 5, 9]


def test_each_car_sees_its_own_solids_in_its_own_light(scene, lenses):
    pos, mat = (np.repeat(part[3:4], CARS, axis=0) for part in lenses)
    solids = ahead_of(pos, mat, "race_car", 0.7)
    solids.boxes["x"][:6] += 100.0  # none before the first six
    lighting = Lighting(CARS, [look_of("reinvent_base")])
    lighting.draw(4, np.random.default_rng(0))
    lighting.draw(8, np.random.default_rng(0))
    renderer = FrameRenderer([Channel([scene], lighting)], OF_SCENE, 1, solids=solids)

    renderer.start(np.arange(CARS), pos, mat)
    renderer.finish()

    kinds = [renderer.frames[car].tobytes() for car in (0, 4, 6, 8)]
    assert len(set(kinds)) == 4
    for car, kind in enumerate([0, 0, 0, 0, 1, 0, 2, 2, 3, 2, 2]):
        assert renderer.frames[car].tobytes() == kinds[kind]


def test_frames_are_the_same_bytes_on_one_two_and_three_threads(scene, lenses):
    solids = ahead_of(*lenses, "bot_car", 0.6)
    lighting = Lighting(CARS, [look_of("reinvent_base")], textures=True)
    for car in range(CARS):
        lighting.draw(car, np.random.default_rng(car))
    pictures = []

    for num_threads in (1, 2, 3):
        renderer = FrameRenderer(
            [Channel([scene], lighting)], OF_SCENE, num_threads, eyes=2, solids=solids
        )
        for _ in range(5):
            renderer.start(np.arange(CARS), *lenses)
            renderer.finish()
        pictures.append(renderer.frames)
        renderer.close()

    np.testing.assert_array_equal(pictures[1], pictures[0])
    np.testing.assert_array_equal(pictures[2], pictures[0])


@pytest.mark.parametrize("num_threads", [1, 2])
def test_the_hook_gets_each_new_frame_once_and_can_change_it(scene, lenses, num_threads):
    cars = np.array([0, 1, 2, 3, 4, 7, 8, 10])
    lock, told = threading.Lock(), []
    expected = FrameRenderer([Channel([scene])], OF_SCENE, 1, eyes=2)
    expected.start(cars, *lenses)
    expected.finish()

    def negative(rows: slice) -> None:
        renderer.frames[rows] = 255 - renderer.frames[rows]
        with lock:
            told.extend(range(CARS)[rows])

    renderer = FrameRenderer([Channel([scene])], OF_SCENE, num_threads, eyes=2, after=negative)
    renderer.start(cars, *lenses)
    renderer.finish()
    renderer.close()

    assert sorted(told) == cars.tolist()
    np.testing.assert_array_equal(renderer.frames[cars], 255 - expected.frames[cars])


@pytest.mark.parametrize("num_threads", [1, 2])
def test_a_failing_hook_fails_where_frames_are_awaited(scene, lenses, num_threads):
    def fail(rows: slice) -> None:
        raise ZeroDivisionError(f"frames {rows}")

    renderer = FrameRenderer([Channel([scene])], OF_SCENE, num_threads, after=fail)
    renderer.start(np.arange(CARS), *lenses)

    with pytest.raises(ZeroDivisionError):
        renderer.finish()
    renderer.close()
