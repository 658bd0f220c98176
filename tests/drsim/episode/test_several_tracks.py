"""Cars of one simulation that drive on several tracks."""

import numpy as np
import pytest

from drsim.car.conditions import Realism
from drsim.episode.simulation import Simulation
from drsim.episode.teacher_features import TEACHER_PLACE
from drsim.race.race import TIME_TRIAL, BotRules, ObstacleRules, Race
from drsim.sensing.sensors import Sensors
from drsim.track.worlds import load_track

TRACKS = [load_track(name) for name in ("reinvent_base", "bean", "switchback")]
CARS = np.arange(4)
REVERSE = np.array([False, True, False, True])
START = np.array([0.1, 0.5, 0.9, 0.3])
COLUMNS = ("reward", "progress", "x", "y", "done", "closest_waypoint", "status", "from_center_m")


def simulation(tracks, race, randomize) -> Simulation:
    return Simulation(
        tracks,
        num_cars=len(CARS),
        reward_function=lambda params: params["progress"] + params["track_length"],
        race=race,
        randomize=randomize,
        realism=Realism(glare=0.5, reflections=0.5, image_noise=3.0),
        sensors=Sensors(("STEREO_CAMERAS", "SECTOR_LIDAR")),
    )


@pytest.mark.parametrize(
    ("race", "randomize"),
    [
        (TIME_TRIAL, "nothing"),
        (Race(obstacles=ObstacleRules(count=3)), "textures"),
        (Race(bots=BotRules(count=2)), "lights"),
    ],
)
def test_each_car_drives_and_sees_as_if_all_drove_on_its_track(race, randomize) -> None:
    together = simulation(TRACKS, race, randomize)
    alone = [simulation(track, race, randomize) for track in TRACKS]
    random = np.random.default_rng(3)

    for episode, track in enumerate((np.array([0, 1, 1, 2]), np.array([2, 0, 1, 1]))):
        seeds = CARS.astype(np.uint64) + 5 * episode
        together.reset(CARS, START, track=track, reverse=REVERSE, seeds=seeds)
        for each in alone:
            each.reset(CARS, START, reverse=REVERSE, seeds=seeds)
        for _ in range(20):
            steering_deg, speed_mps = random.uniform(-20.0, 20.0, 4), random.uniform(1.0, 2.0, 4)
            found = together.step(steering_deg, speed_mps)
            expected = [each.step(steering_deg, speed_mps) for each in alone]
            for car, own in enumerate(track.tolist()):
                for name in COLUMNS:
                    column = getattr(expected[own], name)
                    np.testing.assert_array_equal(getattr(found, name)[car], column[car], name)
                np.testing.assert_array_equal(together.frames[car], alone[own].frames[car])
                np.testing.assert_array_equal(together.scans[car], alone[own].scans[car])
        states = [each.teacher_state(CARS) for each in alone]
        for state in states:  # which says nothing where there are several tracks
            state[:, TEACHER_PLACE] = 0.0
        for car, own in enumerate(track.tolist()):
            np.testing.assert_array_equal(together.teacher_state(CARS)[car], states[own][car])


def test_objects_must_fit_on_every_track() -> None:
    many = Race(bots=BotRules(count=8, min_gap_m=2.5))
    with pytest.raises(ValueError, match="are too many for reinvent_base"):
        simulation(TRACKS, many, "nothing")
