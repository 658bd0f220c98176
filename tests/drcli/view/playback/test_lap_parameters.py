"""Parameters that are worked out from a trace, beside those that the reward function really got."""

import numpy as np
import pytest

from drcli.records.trace import Episode, Row, csv_text
from drcli.view.playback.lap_parameters import (
    OBJECT_KEYS,
    KnownRace,
    directed_track,
    lap_parameters,
)
from drcli.view.video.recorded_lap import read_laps
from drsim.episode.episode_rules import Status
from drsim.episode.simulation import Simulation
from drsim.race.race import TIME_TRIAL, ObstacleRules, Race
from drsim.race.solids import SHAPES
from drsim.track.worlds import load_track

TRACK = load_track("reinvent_base")
STEPS = 40
BOXES = Race(obstacles=ObstacleRules(count=3))


def drive(race=TIME_TRIAL, *, reverse=False):
    """What a reward function got at each step, the lap of the trace, and the objects."""
    got = []

    def reward(params):
        got.append(dict(params))
        return 1.5

    simulation = Simulation(TRACK, num_cars=1, reward_function=reward, race=race)
    episode = Episode(0, "training", clock_s=7.0, track_length_m=TRACK.length_m)
    try:
        result = simulation.reset(np.array([0]), np.array([0.1]), reverse=reverse)
        for step in range(STEPS):
            steering = 8.0 * np.sin(step / 6.0)
            if step:
                result = simulation.step(np.array([steering]), np.array([1.5]))
            episode.rows.append(
                Row(
                    steps=int(result.steps[0]),
                    x=float(result.x[0]),
                    y=float(result.y[0]),
                    yaw_deg=float(result.yaw_deg[0]),
                    steering_deg=float(steering),
                    speed_mps=1.5,
                    action="0",
                    reward=float(result.reward[0]),
                    done=bool(result.done[0]),
                    all_wheels_on_track=bool(result.all_wheels_on_track[0]),
                    progress=float(result.progress[0]),
                    closest_waypoint=int(result.closest_waypoint[0]),
                    status=Status(result.status[0]).name.lower(),
                    pause_s=0.0,
                    time_s=float(step) / 15.0,
                )
            )
            if result.done[0]:
                break
        objects = None
        if simulation.traffic is not None:
            traffic = simulation.traffic
            objects = np.concatenate([traffic.xy[0], traffic.yaw_rad[0][:, None]], axis=1)
    finally:
        simulation.close()
    text = csv_text([episode], (0.0, 1.0))
    [lap], notes = read_laps(text.encode(), "trace")
    assert not notes
    return got, lap, objects


def compared(got, found, first):
    """Names whose values differ from what the reward function got at a step."""
    at = {**{name: values[first] for name, values in found.columns.items()}, **found.constants}
    wrong = []
    for name, value in at.items():
        told = got[name]
        same = (
            np.allclose(value, told, atol=1e-6)
            if isinstance(value, float) or (isinstance(value, list) and value)
            else value == told
        )
        if not same:
            wrong.append((name, value, told))
    return wrong


@pytest.mark.parametrize("reverse", [False, True])
def test_all_parameters_but_the_clock_are_those_that_the_function_got(reverse):
    got, lap, _ = drive(reverse=reverse)
    race = KnownRace("TIME_TRIAL")
    track = directed_track(TRACK, lap, race)

    found = lap_parameters(track, lap, race, 1, len(lap.time_s))

    assert track.reverse == reverse
    assert len(got) == len(lap.time_s) - 1
    missing = set(got[0]) - set(found.columns) - set(found.constants) - {"waypoints"}
    assert missing == set(found.unknown) == {"sim_time"}
    # A car that drives leans, by which the wheels of one that stands are elsewhere: millimetres.
    assert not [pair for k in range(len(got)) for pair in compared(got[k], found, k)]


def test_recorded_objects_are_told_as_the_function_got_them():
    got, lap, objects = drive(BOXES)
    names = ["box_obstacle"] * 3
    race = KnownRace("OBJECT_AVOIDANCE", tuple(SHAPES[name] for name in names))
    lap = type(lap)(**{**vars(lap), "objects": np.tile(objects, (len(lap.time_s), 1, 1))})

    found = lap_parameters(directed_track(TRACK, lap, race), lap, race, 1, len(lap.time_s))

    assert set(found.unknown) == {"sim_time"}
    assert len(found.columns["objects_location"][0]) == 3
    assert not [pair for k in range(len(got)) for pair in compared(got[k], found, k)]


def test_objects_that_nobody_recorded_are_not_guessed():
    _, lap, _ = drive()

    for race_type, word in (("HEAD_TO_BOT", "HEAD_TO_BOT"), ("", "Nobody recorded")):
        found = lap_parameters(TRACK, lap, KnownRace(race_type), 0, 3)
        assert set(found.unknown) == {*OBJECT_KEYS, "sim_time"}
        assert word in found.unknown["objects_location"]
        assert not set(found.columns) & set(OBJECT_KEYS)


def test_the_speed_of_bots_is_not_known():
    _, lap, _ = drive()
    race = KnownRace("HEAD_TO_BOT", (SHAPES["bot_car"],))
    lap = type(lap)(
        **{**vars(lap), "objects": np.tile([[[1.0, 1.0, 0.5]]], (len(lap.time_s), 1, 1))}
    )

    found = lap_parameters(TRACK, lap, race, 0, 2)

    assert set(found.unknown) == {"objects_speed", "sim_time"}
    assert found.columns["objects_heading"] == [[0.5], [0.5]]


def test_a_car_that_stood_drives_in_the_recorded_direction():
    _, lap, _ = drive()
    still = {**vars(lap), "poses": np.tile(lap.poses[:1], (len(lap.time_s), 1))}
    lap = type(lap)(**still)

    assert directed_track(TRACK, lap, KnownRace("", (), reverse=True)).reverse
    assert not directed_track(TRACK, lap, KnownRace("")).reverse
