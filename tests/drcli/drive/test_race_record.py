"""What an evaluation leaves for its videos."""

import json

import numpy as np

from drcli.base.json_record import from_json
from drcli.drive.driving import Driven
from drcli.drive.evaluator import recording_of_race
from drcli.records.evaluation_task import RaceRecording
from drcli.records.trace import Episode
from drsim.race.solids import SHAPES


def driven(number: int, objects: list[np.ndarray]) -> Driven:
    return Driven(number, "evaluation", rows=[object()] * len(objects), objects=objects)


def recorded(racer, drives, episodes=None, shapes=("box_obstacle",)):
    racer.run_env("DR_WORLD_NAME=reinvent_base", "DR_CAR_COLOR=Blue", "DR_RACER_NAME=Ada")
    made = recording_of_race(
        racer.settings().run, "m", [SHAPES[name] for name in shapes], drives, episodes or drives
    )
    return from_json(RaceRecording, json.loads(made.encode()))


def test_boxes_are_recorded_once_and_bots_in_every_row(racer):
    box, bot = np.array([1.0, 2.0, 0.5]), np.array([0.0, 0.0, 0.0])
    moving = [np.stack([box, np.array([0.1 * k, 0.0, 0.0])]) for k in range(4)]
    still = [np.stack([box, bot])] * 3

    found = recorded(
        racer, [driven(0, moving), driven(1, still)], None, ("box_obstacle", "bot_car")
    )

    assert (found.world, found.color, found.racer) == ("reinvent_base", "Blue", "Ada")
    assert found.shapes == ["box_obstacle", "bot_car"]
    assert [len(episode.poses) for episode in found.episodes] == [4, 1]
    assert found.episodes[0].poses[3][1] == [0.3, 0.0, 0.0]


def test_the_laps_of_a_continuous_race_get_their_own_rows(racer):
    rows = [np.array([[float(k), 0.0, 0.0]]) for k in range(5)]
    race = driven(0, rows)
    parts = race.rows[:2], race.rows[2:]
    laps = [Episode(k, "evaluation", rows=part) for k, part in enumerate(parts)]

    found = recorded(racer, [race], laps)

    assert [episode.poses[0][0][0] for episode in found.episodes] == [0.0, 2.0]
    assert len(found.episodes[1].poses) == 3


def test_a_race_without_objects_has_none(racer):
    found = recorded(racer, [Driven(0, "evaluation", rows=[object()] * 3)], None, ())

    assert (found.shapes, found.episodes) == ([], [])
