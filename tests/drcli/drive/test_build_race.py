"""Settings as the simulation understands them: races, disturbances, lights, and reward trials."""

import logging
import sys
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from drcli.base.errors import SettingsError
from drcli.config.loading import load_settings
from drcli.config.run_config import DriveConfig
from drcli.config.settings import catalogue
from drcli.drive import build_race
from drcli.drive.build_race import (
    build_simulation,
    car_parameters_of,
    load_race,
    race_of,
    race_warnings,
    randomize_of,
    realism_of,
)
from drcli.model.files.model_metadata import ModelMetadata
from drcli.rewards.sandbox.sample_calls import sample_params
from drsim.car.car import CarBatch
from drsim.car.car_parameters import CAR_SETS, DEFAULT_CAR
from drsim.car.conditions import Realism
from drsim.episode.episode_rules import EpisodeRules
from drsim.race.race import TIME_TRIAL, BotRules, ObstacleRules, Race
from drsim.track.track import Track
from drsim.track.worlds import load_track

METADATA = ModelMetadata.from_bytes(
    b'{"sensor": ["FRONT_FACING_CAMERA"], "version": "5", '
    b'"action_space": [{"steering_angle": 0, "speed": 2}]}'
)


@pytest.fixture
def settings(tmp_path):
    def load(*lines: str) -> DriveConfig:
        (tmp_path / "run.env").write_text("\n".join(lines))
        (tmp_path / "system.env").write_text("")
        return load_settings(tmp_path, environ={}).race

    return load


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (("DR_RACE_TYPE=OBJECT_AVOIDANCE",), ()),
        (("DR_RACE_TYPE=OBJECT_AVOIDANCE", "DR_OA_RANDOMIZE_OBSTACLE_LOCATIONS=True"), ()),
        (
            (
                "DR_RACE_TYPE=OBJECT_AVOIDANCE",
                "DR_OA_RANDOMIZE_OBSTACLE_LOCATIONS=True",
                "DR_OA_MIN_DISTANCE_BETWEEN_OBSTACLES=0",
            ),
            ("of 20 drawn episodes",),
        ),
        (
            (
                "DR_RACE_TYPE=OBJECT_AVOIDANCE",
                "DR_OA_OBJECT_POSITIONS=0.25,1;0.29,-1;0.5,1;0.5,1",
            ),
            ("in the same place, 0.5,1", "nobody can pass the obstacles at 0.250"),
        ),
        *(
            (("DR_RACE_TYPE=OBJECT_AVOIDANCE", f"DR_OA_OBJECT_POSITIONS={places}", *more), words)
            for places, more, words in (
                (
                    "0.01,1;0.01,-1",
                    ("DR_TRAIN_CHANGE_START_POSITION=False",),
                    ("pass the obstacles at 0.010 of the lap; a car needs", "at the place where"),
                ),
                (
                    "0.01,1;0.01,-1",
                    (),
                    ("a car needs a gap of 0.30 m", "at 1 of 20 places where episodes start"),
                ),
                ("0.2,-1;0.2,-1", (), ("in the same place, 0.2,-1",)),
                ("0.5,0", (), ("lane 0 of 0.5,0 is neither 1 nor -1",)),
                ("0.2,-1;0.5,1", (), ()),
            )
        ),
        (("DR_RACE_TYPE=HEAD_TO_BOT",), ()),
        (
            (
                "DR_RACE_TYPE=HEAD_TO_BOT",
                "DR_H2B_NUMBER_OF_BOT_CARS=80",
                "DR_H2B_MIN_DISTANCE_BETWEEN_BOT_CARS=0.1",
            ),
            ("nobody can pass the bots at",),
        ),
        ((), ()),
    ],
)
def test_a_race_in_which_nobody_can_pass_is_told(settings, lines, words):
    track = load_track("reinvent_base")

    found = race_warnings(settings(*lines), track, race_of(settings(*lines)))

    assert {problem.severity for problem in found} <= {"warning"}
    assert len(found) == len(words)
    assert all(word in problem.message for word, problem in zip(words, found, strict=True))


def test_a_wide_road_leaves_a_way_between_two_obstacles(settings):
    narrow = load_track("reinvent_base")
    inner, outer = (2 * border - narrow.center for border in (narrow.inner, narrow.outer))
    wide = replace(narrow, inner=inner, outer=outer)
    side_by_side = Race(obstacles=ObstacleRules(positions=((0.27, 1), (0.27, -1))))

    def is_closed(track: Track) -> bool:
        found = race_warnings(settings(), track, side_by_side)
        return any("nobody can pass" in problem.message for problem in found)

    assert is_closed(narrow)
    assert is_closed(load_track("bean"))  # leaves 20 cm
    assert not is_closed(wide)


def test_every_setting_of_obstacles_reaches_the_simulation(settings):
    s = settings(
        "DR_RACE_TYPE=OBJECT_AVOIDANCE",
        "DR_OA_NUMBER_OF_OBSTACLES=4",
        "DR_OA_MIN_DISTANCE_BETWEEN_OBSTACLES=1.5",
        "DR_OA_RANDOMIZE_OBSTACLE_LOCATIONS=True",
        "DR_OA_OBSTACLE_TYPE=amazon_box_obstacle",
        'DR_OA_OBJECT_POSITIONS="0.25,-1;0.5,1"',
        "DR_EVAL_RESET_BEHIND_DIST=0.8",
    )

    assert race_of(s) == Race(
        obstacles=ObstacleRules(
            count=4,
            kind="amazon_box_obstacle",
            min_gap_m=1.5,
            randomize=True,
            positions=((0.25, -1), (0.5, 1)),
            reset_behind_m=0.8,
        )
    )


def test_obstacles_can_be_parked_cars(settings):
    race = race_of(settings("DR_RACE_TYPE=OBJECT_AVOIDANCE", "DR_OA_IS_OBSTACLE_BOT_CAR=True"))

    assert race.obstacles is not None
    assert race.obstacles.kind == "bot_car"


def test_every_setting_of_bots_reaches_the_simulation(settings):
    s = settings(
        "DR_RACE_TYPE=HEAD_TO_BOT",
        "DR_H2B_IS_LANE_CHANGE=True",
        "DR_H2B_LOWER_LANE_CHANGE_TIME=2.0",
        "DR_H2B_UPPER_LANE_CHANGE_TIME=2.5",
        "DR_H2B_LANE_CHANGE_DISTANCE=0.7",
        "DR_H2B_NUMBER_OF_BOT_CARS=2",
        "DR_H2B_MIN_DISTANCE_BETWEEN_BOT_CARS=3.0",
        "DR_H2B_RANDOMIZE_BOT_CAR_LOCATIONS=True",
        "DR_H2B_BOT_CAR_SPEED=0.4",
        "DR_H2B_BOT_CAR_PENALTY=1.0",
    )

    assert race_of(s) == Race(
        bots=BotRules(
            count=2,
            speed_mps=0.4,
            min_gap_m=3.0,
            randomize=True,
            lane_change=True,
            lane_change_time_s=(2.0, 2.5),
            lane_change_distance_m=0.7,
            penalty_s=1.0,
        )
    )


@pytest.mark.parametrize(
    ("race_type", "race"), [("TIME_TRIAL", TIME_TRIAL), ("HEAD_TO_MODEL", Race(racers=2))]
)
def test_other_races_have_no_objects_of_their_own(settings, race_type, race):
    assert race_of(settings(f"DR_RACE_TYPE={race_type}", "DR_OA_NUMBER_OF_OBSTACLES=3")) == race


def test_bots_that_do_not_fit_are_refused_with_file_line_and_remedy(settings):
    s = settings("DR_RACE_TYPE=HEAD_TO_BOT", "DR_H2B_NUMBER_OF_BOT_CARS=40")

    with pytest.raises(SettingsError) as caught:
        load_race(s, load_track("reinvent_base"))

    assert str(caught.value).startswith("run.env line 2: DR_H2B_NUMBER_OF_BOT_CARS: 40 objects")
    assert "DR_H2B_MIN_DISTANCE_BETWEEN_BOT_CARS" in caught.value.remedy


def test_every_sim_to_real_setting_reaches_the_simulation(settings):
    s = settings(
        "DR_SIM_IMAGE_NOISE=4",
        "DR_SIM_BRIGHTNESS=0.2",
        "DR_SIM_BLUR=1.5",
        "DR_SIM_CAMERA_ANGLE=2",
        "DR_SIM_CAMERA_SHIFT=0.01",
        "DR_SIM_LATENCY=0.05",
        "DR_SIM_LATENCY_JITTER=0.02",
        "DR_SIM_FRICTION=0.1",
        "DR_SIM_MASS=0.15",
        "DR_SIM_BATTERY=0.3",
        "DR_SIM_STEERING_TRIM=4",
        "DR_SIM_STEERING_LOCK=0.25",
        "DR_SIM_GLARE=0.6",
        "DR_SIM_REFLECTIONS=0.7",
        "DR_SIM_GRAY_OVERLAY=0.5",
    )

    assert realism_of(s, "training") == realism_of(s, "evaluation")
    assert realism_of(s, "training") == Realism(
        image_noise=4,
        brightness=0.2,
        blur_px=1.5,
        camera_angle_deg=2,
        camera_shift_m=0.01,
        latency_s=0.05,
        latency_jitter_s=0.02,
        friction=0.1,
        mass=0.15,
        battery=0.3,
        steering_trim_deg=4,
        steering_lock=0.25,
        glare=0.6,
        reflections=0.7,
        gray_overlay=0.5,
    )


def test_every_property_of_ones_own_car_reaches_the_simulation(settings):
    s = settings(
        "DR_SIM_CAR=2022",
        "DR_CAR_STEERING_LEFT=25",
        "DR_CAR_STEERING_RIGHT=22",
        "DR_CAR_STEERING_TRIM=-1.5",
        "DR_CAR_MAX_SPEED=2.2",
        "DR_CAR_BATTERY=0.8",
    )

    assert car_parameters_of(s) == replace(
        CAR_SETS["2022"].parameters,
        steering_left_deg=25,
        steering_right_deg=22,
        steering_trim_deg=-1.5,
        max_speed_mps=2.2,
        battery=0.8,
    )
    assert car_parameters_of(settings("")) == CAR_SETS[DEFAULT_CAR].parameters


@pytest.mark.parametrize("job", ["training", "evaluation"])
@pytest.mark.parametrize("car", CAR_SETS)
def test_the_car_of_the_settings_drives(settings, car, job):
    simulation = build_simulation(
        settings(f"DR_SIM_CAR={car}"),
        job,
        METADATA,
        load_track("reinvent_base"),
        num_cars=1,
        reward=lambda _: 1.0,
        rules=EpisodeRules(),
        num_threads=1,
        seed=0,
    )
    expected = CarBatch(1, 1, CAR_SETS[car].parameters)
    begun = simulation.reset(np.array([0]), np.array([0.0]))
    for _ in range(8):
        row = simulation.step(np.array([0.0]), np.array([2.0]))
        expected.drive(np.array([0.0]), np.array([2.0]))
    simulation.close()

    moved_m = np.hypot(row.x[0] - begun.x[0], row.y[0] - begun.y[0])
    assert moved_m == pytest.approx(expected.origin_xy[0, 0], abs=1e-3)


def built(race, *, num_cars=1, gpu=False):
    """A simulation of a training with these settings."""
    return build_simulation(
        race,
        "training",
        METADATA,
        load_track("reinvent_base"),
        num_cars=num_cars,
        reward=lambda _: 1.0,
        rules=EpisodeRules(),
        num_threads=1,
        seed=0,
        gpu=gpu,
    )


def test_the_log_says_what_moves_the_cars(settings, monkeypatch, caplog):
    monkeypatch.setattr(build_race, "_logger", logging.getLogger("build_race"))
    caplog.set_level("INFO", "build_race")

    built(settings("DR_PHYSICS=mujoco"), num_cars=2).close()

    said = [record.getMessage() for record in caplog.records]
    assert said == ["2 cars are moved by MuJoCo on 1 thread, as asked for (DR_PHYSICS=mujoco)"]


def test_every_car_can_be_named_in_the_settings_and_the_same_one_is_the_default():
    setting = catalogue()["DR_SIM_CAR"]

    assert setting.choices == tuple(CAR_SETS)
    assert setting.default == DEFAULT_CAR


def test_a_misspelt_car_is_refused_with_its_line_and_a_suggestion(settings):
    with pytest.raises(SettingsError) as caught:
        settings("DR_RUN_ID=1", "DR_SIM_CAR=lowgrip")

    assert str(caught.value).startswith("run.env line 2: DR_SIM_CAR=lowgrip is not one of")
    assert "Did you mean low-grip?" in caught.value.remedy


@pytest.mark.parametrize("job", ["training", "evaluation"])
def test_extras_act_only_where_they_are_wanted(settings, job):
    s = settings("DR_SIM_LATENCY=0.05", f"DR_SIM_EXTRAS_IN={job}")
    other = "evaluation" if job == "training" else "training"

    assert realism_of(s, job) == Realism(latency_s=0.05)
    assert realism_of(s, other) == Realism()


@pytest.mark.parametrize(
    ("lines", "what"),
    [
        ([], "nothing"),
        (["DR_RANDOMIZE_TEXTURES=True"], "nothing"),
        (["DR_ENABLE_DOMAIN_RANDOMIZATION=True"], "lights"),
        (["DR_ENABLE_DOMAIN_RANDOMIZATION=True", "DR_RANDOMIZE_TEXTURES=True"], "textures"),
    ],
)
def test_textures_are_part_of_domain_randomisation(settings, lines, what):
    assert randomize_of(settings(*lines)) == what


def test_a_reward_function_is_tried_among_the_objects_of_its_race():
    race = Race(obstacles=ObstacleRules(count=3), bots=BotRules(count=1))

    calls = sample_params(load_track("reinvent_base"), race)

    assert {len(params["objects_location"]) for params in calls} == {4}
    assert {params["is_crashed"] for params in calls} == {True, False}


def test_where_the_gpu_cannot_draw_the_processor_does_and_the_log_says_why(
    settings, monkeypatch, caplog
):
    monkeypatch.setattr(build_race, "_logger", logging.getLogger("build_race"))
    module = ModuleType("drsim.sensing.cuda_camera")
    module.CudaCamera = _no_camera
    monkeypatch.setitem(sys.modules, "drsim.sensing.cuda_camera", module)

    simulation = built(settings(), gpu=True)
    simulation.reset(np.array([0]), np.array([0.0]))
    simulation.close()

    assert simulation.device_frames is None
    assert simulation.frames.any()
    said = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert said == ["The processor draws the frames, because the GPU cannot: no driver"]


def _no_camera(*_arguments, **_more):
    raise OSError("no driver")
