"""What cars perceive of lights, colours and boxes, and when that changes."""

import hashlib

import numpy as np
import pytest

from drsim.car.car import EYES_APART_M, FRONT
from drsim.car.conditions import Conditions, Realism, draw_gray_overlay
from drsim.episode.simulation import Simulation
from drsim.race.race import BotRules, ObstacleRules, Race
from drsim.sensing.sensors import Sensors
from drsim.track.track import Track
from simulations import simulations

LENS_M = FRONT.mount_m[0]


def straight(length_m: float = 12.0) -> Track:
    """A straight open road 1 m wide along the x axis."""
    x = np.linspace(0.0, length_m, 25)
    center, inner, outer = (np.column_stack([x, np.full(25, y)]) for y in (0.0, 0.5, -0.5))
    return Track("straight", center, inner, outer, closed=False)


ROAD = straight()


@pytest.fixture(scope="module")
def simulate():
    """Build simulations of the straight road that share its scene."""
    with simulations(ROAD) as simulate:
        yield simulate


def frames_at(simulation: Simulation, start: float = 0.1, seeds=None) -> np.ndarray:
    """First frames of new episodes of all cars. Shape (n, eyes, 120, 160)."""
    everybody = np.arange(simulation.num_cars)
    simulation.reset(everybody, np.full(simulation.num_cars, start), seeds=seeds)
    return simulation.frames.copy()


def seeds(*numbers: int) -> np.ndarray:
    return np.array(numbers, np.uint64)


def box(at_m: float) -> Race:
    """A box on the left lane, whose middle is 0.25 m to the left of the line."""
    return Race(obstacles=ObstacleRules(positions=((at_m / ROAD.length_m, 1),)))


def test_the_left_eye_comes_first_and_a_box_is_shifted_by_its_disparity(simulate) -> None:
    stereo = Sensors(("STEREO_CAMERAS",))
    start_m, depth_m = 1.2, 0.8
    # The box is 0.4 m long, 0.3 m wide and 0.25 m high.
    with_box = simulate(sensors=stereo, race=box(start_m + LENS_M + depth_m + 0.2))
    without = simulate(sensors=stereo)
    place = start_m / ROAD.length_m

    eyes = (frames_at(with_box, place) != frames_at(without, place))[0]

    # A row that meets the rear of the box; its left edge is upright, so both eyes see it there.
    row = FRONT.rows // 3
    left, right = (int(np.flatnonzero(eye[row]).min()) for eye in eyes)
    tilt_rad = FRONT.pitch_rad - np.radians(1.39)
    beside_axis_rad = np.arctan((FRONT.rows / 2 - row) / FRONT.focal_px)
    along_axis_m = depth_m * np.cos(beside_axis_rad) / np.cos(tilt_rad - beside_axis_rad)
    assert left - right == pytest.approx(FRONT.focal_px * EYES_APART_M / along_axis_m, abs=1.0)


def test_two_eyes_of_a_car_alone_see_the_line_of_the_road_from_two_places(simulate) -> None:
    (left, right) = frames_at(simulate(sensors=Sensors(("STEREO_CAMERAS",))))[0].astype(float)
    one = frames_at(simulate())[0, 0].astype(float)

    mirrored = right[:, ::-1]

    assert np.abs(left - right).mean() > 2
    assert np.abs(left - one).mean() > 1
    assert np.abs(left[40:] - mirrored[40:]).mean() < 6, "the road is alike on both sides"


@pytest.mark.parametrize("randomize", ["lights", "textures"])
def test_randomised_light_is_that_of_the_seed_and_another_in_each_episode(
    simulate, randomize
) -> None:
    simulation, again = (simulate(2, randomize=randomize) for _ in range(2))

    first = frames_at(simulation, seeds=seeds(5, 6))
    second = frames_at(simulation, seeds=seeds(7, 8))
    repeated = frames_at(again, seeds=seeds(5, 8))

    np.testing.assert_array_equal(repeated[0], first[0])
    np.testing.assert_array_equal(repeated[1], second[1])
    assert (first[0] != first[1]).mean() > 0.2
    assert (first[0] != second[0]).mean() > 0.2


def test_episodes_without_a_seed_of_their_own_differ_too(simulate) -> None:
    simulation = simulate(2, randomize="lights")

    first, second = frames_at(simulation), frames_at(simulation)

    assert (first[0] != first[1]).any()
    assert (first[0] != second[0]).any()


@pytest.mark.parametrize("options", [{}, {"race": Race()}, {"realism": Realism()}])
def test_without_randomisation_every_episode_looks_the_same(simulate, options) -> None:
    plain = frames_at(simulate(2))

    simulation = simulate(2, seed=9, **options)
    first, second = frames_at(simulation, seeds=seeds(1, 2)), frames_at(simulation)

    np.testing.assert_array_equal(first, plain)
    np.testing.assert_array_equal(second, plain)


@pytest.mark.parametrize("randomize", ["lights", "textures"])
def test_lines_stay_brighter_than_the_road_in_every_light(simulate, randomize) -> None:
    simulation = simulate(20, randomize=randomize)
    usual = frames_at(simulate())[0, 0, 60:].astype(float)
    line, road = usual > 150, usual < 80

    frames = frames_at(simulation)[:, 0, 60:]

    assert min(line.sum(), road.sum()) > 100
    assert all(frame[line].mean() > frame[road].mean() + 15 for frame in frames)


def test_each_object_gets_a_colour_of_its_own_in_each_episode(simulate) -> None:
    side_by_side = Race(obstacles=ObstacleRules(positions=((0.2, 1), (0.2, -1))))
    start = 1.2 / ROAD.length_m
    plain = simulate(race=side_by_side)
    painted = simulate(8, race=side_by_side, randomize="lights")

    usual, drawn = (
        frames_at(simulation, start)[:, 0, 40, [40, -41]].astype(float)
        for simulation in (plain, painted)
    )

    assert usual[0, 0] == usual[0, 1]
    assert np.ptp(drawn[:, 0] - drawn[:, 1]) > 20


def test_lights_do_not_change_what_a_lidar_measures(simulate) -> None:
    sensors = Sensors(("FRONT_FACING_CAMERA", "LIDAR"), lidar_forward=True)
    plain = simulate(race=box(2.0), sensors=sensors)
    lit = simulate(race=box(2.0), sensors=sensors, randomize="textures")

    for simulation in (plain, lit):
        frames_at(simulation, 0.08)

    assert (plain.scans < 1.0).any()
    np.testing.assert_array_equal(plain.scans, lit.scans)


def test_every_step_measures_anew_how_near_a_bot_is(simulate) -> None:
    sensors = Sensors(("FRONT_FACING_CAMERA", "LIDAR"), lidar_forward=True)
    race = Race(bots=BotRules(count=1, speed_mps=0.5))
    simulation = simulate(race=race, sensors=sensors)
    frames_at(simulation, 1.2 / ROAD.length_m)
    nearest_m = []

    for _ in range(8):
        simulation.step(np.zeros(1), np.full(1, 1.5))
        nearest_m.append(float(simulation.scans.min()))

    assert nearest_m == sorted(nearest_m, reverse=True)
    assert nearest_m[-1] < nearest_m[0] < 1.0


NO_DISTURBANCE = [{}, {"realism": Realism()}, {"longest_latency_s": 0.3}]


@pytest.mark.parametrize("options", NO_DISTURBANCE)
def test_what_is_switched_off_changes_no_bit_of_a_drive(simulate, options) -> None:
    """Frames, poses and rewards of a drive, also after an episode that was disturbed."""
    plain, other = simulate(2), simulate(2, **options)
    if options:
        everything = Conditions(
            image_noise=9.0,
            brightness=0.7,
            blur_px=1.0,
            glare=1.0,
            reflections=1.0,
            camera_turn_deg=(1.0, 2.0, 3.0),
            camera_shift_m=(0.01, 0.0, 0.0),
            friction=0.5,
            mass=1.5,
            battery=0.5,
            steering_trim_deg=4.0,
            steering_left=0.8,
            steering_right=1.2,
        )
        other.reset(np.arange(2), np.full(2, 0.3), conditions=everything)
        other.step(np.full(2, 10.0), np.full(2, 2.0))

    def drive(simulation: Simulation) -> str:
        digest = hashlib.sha256()
        simulation.reset(np.arange(2), np.array([0.1, 0.2]), seeds=seeds(3, 4))
        for angle_deg in np.linspace(-20.0, 20.0, 12):
            result = simulation.step(np.array([angle_deg, -angle_deg]), np.array([1.0, 3.0]))
            for values in (simulation.frames, simulation.poses, result.reward):
                digest.update(values.tobytes())
        return digest.hexdigest()

    assert drive(other) == drive(plain)


def test_given_conditions_take_the_place_of_drawn_ones(simulate) -> None:
    drawn = simulate(2, realism=Realism(brightness=0.5, glare=1.0, reflections=1.0))
    fixed = [Conditions(brightness=0.5), Conditions(brightness=1.5)]

    drawn.reset(np.arange(2), np.full(2, 0.1), seeds=seeds(1, 2), conditions=fixed)
    dark, bright = drawn.frames[:, 0].astype(float)
    usual = frames_at(simulate())[0, 0].astype(float)

    np.testing.assert_allclose(dark, 0.5 * usual, atol=1.0)
    np.testing.assert_allclose(bright, np.minimum(1.5 * usual, 255.0), atol=1.0)


def test_the_gray_overlay_lies_over_the_pictures_of_both_eyes(simulate) -> None:
    stereo = Sensors(("STEREO_CAMERAS",))
    plain = frames_at(simulate(sensors=stereo), seeds=seeds(5))

    overlaid = frames_at(
        simulate(sensors=stereo, realism=Realism(gray_overlay=1.0)), seeds=seeds(5)
    )

    draw_gray_overlay(plain)
    np.testing.assert_array_equal(overlaid, plain)
    assert (overlaid[:, :, :30] == 128).all()


def test_the_number_of_conditions_must_be_that_of_the_episodes(simulate) -> None:
    with pytest.raises(ValueError, match="1 conditions for 2 episodes"):
        simulate(2).reset(np.arange(2), np.zeros(2), conditions=[Conditions()])


def test_a_box_hides_what_the_floor_behind_it_mirrors(simulate) -> None:
    start = 1.2 / ROAD.length_m
    in_the_way = Race(obstacles=ObstacleRules(positions=((2.4 / ROAD.length_m, 1),)))
    simulation = simulate(16, race=in_the_way)
    everybody = np.arange(16)
    usual = frames_at(simulation, start)[:, 0].astype(float)
    box_px = usual != frames_at(simulate(16), start)[:, 0]

    conditions = [Conditions(reflections=1.0, pattern=number) for number in range(16)]
    simulation.reset(everybody, np.full(16, start), conditions=conditions)
    mirrored = simulation.observations - usual

    assert box_px.sum() > 16 * 100
    assert (mirrored[~box_px] > 20).sum() > 100
    assert (mirrored[box_px] > 20).mean() < 0.02, "soft edges aside"
