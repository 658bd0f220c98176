"""The environments as Gymnasium sees them: ids, spaces, checks, seeds, pictures."""

import copy
import importlib.util
import pickle
import sys
import tomllib
import warnings
from functools import partial
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled, ResetNeeded
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import drsim
from drsim import ContinuousActions, EpisodeRules, Race, RacerEnv, RacerVectorEnv, Sensors, Track
from drsim.gym import racer
from drsim.track.appearance import LUMA

SENSORS = [
    ("FRONT_FACING_CAMERA",),
    ("LEFT_CAMERA",),
    ("observation",),
    ("STEREO_CAMERAS",),
    ("FRONT_FACING_CAMERA", "LIDAR"),
    ("STEREO_CAMERAS", "SECTOR_LIDAR"),
    ("DISCRETIZED_SECTOR_LIDAR", "FRONT_FACING_CAMERA"),
]
RACES = ["time_trial", "object_avoidance", "head_to_bot"]


@pytest.fixture(scope="module")
def oval() -> Track:
    """A loop of 19 m on which the default objects fit."""
    turn = np.linspace(0.0, 2 * np.pi, 80)
    lines = [
        np.stack([(a + s) * np.cos(turn), (2.5 + s) * np.sin(turn)], axis=1)
        for a, s in ((3.5, 0.0), (3.5, -0.5), (3.5, 0.5))
    ]
    for line in lines:
        line[-1] = line[0]
    return Track("oval", *lines, closed=True)


@pytest.mark.parametrize("sensors", SENSORS, ids="+".join)
def test_every_sensor_suite_passes_gymnasiums_own_checks(oval, sensors):
    _check(RacerEnv(oval, sensors=sensors))


@pytest.mark.parametrize("race", RACES)
def test_every_race_passes_gymnasiums_own_checks(oval, race):
    _check(RacerEnv(oval, race=race, randomize="textures", realism=drsim.Realism(image_noise=3)))


@pytest.mark.parametrize("sensors", [SENSORS[0], SENSORS[4]], ids="+".join)
def test_colour_frames_pass_gymnasiums_own_checks(oval, sensors):
    _check(RacerEnv(oval, sensors=sensors, color=True, randomize="textures"))


def _check(env: RacerEnv) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Said of every environment that is built without `gymnasium.make`.
        warnings.filterwarnings("ignore", message=".*not having an env.spec.*")
        check_env(env, skip_render_check=True)
    env.close()


@pytest.mark.nightly
@pytest.mark.parametrize("name", racer.ENVIRONMENTS)
def test_every_id_passes_gymnasiums_own_checks_without_a_warning(name, oval):
    env = gym.make(name, world=oval, render_mode="rgb_array")

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if importlib.util.find_spec("pygame") is None:
            env.unwrapped.metadata = {**RacerEnv.metadata, "render_modes": ["rgb_array"]}
        check_env(env.unwrapped)
    env.close()


LIKE_GREYS = {
    "nothing": {},
    "boxes": {"race": "object_avoidance"},
    "textures": {"randomize": "textures", "race": "object_avoidance"},
    "lights": {"randomize": "lights"},
    "brightness": {"realism": drsim.Realism(brightness=0.3)},
    "noise and blur": {"realism": drsim.Realism(image_noise=6, blur_px=2)},
    "lamps": {"realism": drsim.Realism(glare=0.7, reflections=0.6)},
    "camera": {"realism": drsim.Realism(camera_angle_deg=3, camera_shift_m=0.01)},
}


@pytest.mark.parametrize("options", LIKE_GREYS.values(), ids=LIKE_GREYS)
def test_colours_weighted_give_the_grey_frames(options):
    drives = []
    for color in (False, True):
        env = RacerEnv("reinvent_base", color=color, start=0.05, **options)
        seen = [env.reset(seed=seed)[0] for seed in range(4)] + [env.step(3)[0] for _ in range(8)]
        drives.append(seen)
        env.close()
    greys = np.stack(drives[0])[..., 0].astype(float)
    colors = np.stack([frames["FRONT_FACING_CAMERA"] for frames in drives[1]])

    apart = np.abs(np.einsum("tchw,c->thw", colors, LUMA) - (greys + 0.5))  # greys are cut off

    assert colors.shape == (12, 3, 120, 160)
    assert colors.dtype == np.uint8
    assert apart.mean() < 0.5
    # Greys that two materials share get the light of one of them where a picture is grey.
    assert (apart > 2.0).mean() < (0.02 if options.get("randomize") == "lights" else 0.002)
    assert np.ptp(colors[0].astype(int), axis=0).max() > 100  # the dashes are orange
    assert colors[0, 0].mean() < colors[0, 1].mean()


def test_colours_of_many_cars_are_those_of_one(oval):
    one = RacerEnv(oval, color=True, start=0.3)
    many = RacerVectorEnv(3, oval, color=True, start=0.3, num_threads=2)

    seen, _ = one.reset(seed=0)
    all_seen, _ = many.reset(seed=0)
    step, many_step = one.step(2)[0], many.step(np.array([2, 2, 2]))[0]

    assert many.observation_space["FRONT_FACING_CAMERA"].shape == (3, 3, 120, 160)
    for car in range(3):
        np.testing.assert_array_equal(
            all_seen["FRONT_FACING_CAMERA"][car], seen["FRONT_FACING_CAMERA"]
        )
        np.testing.assert_array_equal(
            many_step["FRONT_FACING_CAMERA"][car], step["FRONT_FACING_CAMERA"]
        )
    one.close()
    many.close()


def test_the_view_of_the_camera_is_in_the_colours_of_its_frames(oval):
    env = RacerEnv(oval, color=True, render_mode="rgb_array")

    seen, _ = env.reset(seed=0)

    np.testing.assert_array_equal(env.render(), np.moveaxis(seen["FRONT_FACING_CAMERA"], 0, -1))
    env.close()


def test_two_eyes_have_no_colours(oval):
    with pytest.raises(ValueError, match="color is True; it must be False with STEREO_CAMERAS"):
        RacerEnv(oval, sensors="STEREO_CAMERAS", color=True)


@pytest.mark.parametrize("name", racer.ENVIRONMENTS)
def test_every_id_makes_one_car_and_many(name, oval):
    env = gym.make(name, world=oval)
    many = gym.make_vec(name, num_envs=4, world=oval)

    frame, info = env.reset(seed=1)
    frames, infos = many.reset(seed=1)
    step = many.step(many.action_space.sample())

    assert env.observation_space.contains(frame)
    assert info["status"] == "prepare"
    assert many.observation_space.contains(frames)
    assert isinstance(many.unwrapped, RacerVectorEnv)
    assert infos["progress"].shape == step[1].shape == (4,)
    env.close()
    many.close()


def test_an_id_can_name_the_module_that_registers_it(oval):
    env = gym.make("drsim:drsim/DeepRacer-v0", world=oval)

    assert isinstance(env.unwrapped, RacerEnv)
    env.close()


def test_arguments_can_all_be_words():
    envs = gym.make_vec(
        "drsim/DeepRacer-v0",
        num_envs=2,
        world="reinvent_base",
        sensors=["STEREO_CAMERAS", "LIDAR"],
        race="object_avoidance",
        randomize="textures",
    )

    seen, _ = envs.reset(seed=0)

    assert {name: values.shape for name, values in seen.items()} == {
        "STEREO_CAMERAS": (2, 120, 160, 2),
        "LIDAR": (2, 64),
    }
    envs.close()


def test_gymnasiums_own_vector_of_single_environments_takes_ours(oval):
    envs = gym.make_vec(
        "drsim/DeepRacer-v0", num_envs=2, vectorization_mode="sync", world=oval, start=0.0
    )
    ours = RacerVectorEnv(2, oval, start=0.0)

    theirs_seen, ours_seen = envs.reset(seed=3)[0], ours.reset(seed=3)[0]
    theirs, own = envs.step(np.array([3, 6])), ours.step(np.array([3, 6]))

    np.testing.assert_array_equal(theirs_seen, ours_seen)
    np.testing.assert_array_equal(theirs[0], own[0])
    np.testing.assert_array_equal(theirs[1], own[1])
    envs.close()
    ours.close()


def test_gymnasiums_record_of_episodes_counts_those_of_many_cars(oval):
    envs = RecordEpisodeStatistics(RacerVectorEnv(3, oval, rules=EpisodeRules(max_steps=4)))
    envs.reset(seed=0)

    lengths = []
    for _ in range(3):
        *_, info = envs.step(np.array([4, 5, 4]))
        lengths.append(info.get("episode", {}).get("l", np.zeros(3)).tolist())

    assert lengths == [[0, 0, 0], [0, 0, 0], [3, 3, 3]]
    envs.close()
    envs.close()


def test_registering_twice_changes_nothing(recwarn):
    racer.register()

    assert not recwarn


@pytest.mark.parametrize("race", RACES)
def test_the_same_seed_gives_the_same_episode_however_many_threads(oval, race):
    def drive(num_threads: int) -> list[np.ndarray]:
        env = RacerVectorEnv(
            6,
            oval,
            race=race,
            randomize="lights",
            num_threads=num_threads,
            sensors=("FRONT_FACING_CAMERA", "LIDAR"),
            realism=drsim.Realism(image_noise=2.0),
        )
        seen, _ = env.reset(seed=5)
        kept = [*seen.values()]
        actions = np.random.default_rng(0).integers(0, 10, (30, 6))
        for action in actions:
            seen, reward, *_ = env.step(action)
            kept += [*seen.values(), reward]
        env.close()
        return kept

    for one, two in zip(drive(1), drive(2), strict=True):
        np.testing.assert_array_equal(one, two)


def test_another_seed_gives_another_start(oval):
    env = RacerEnv(oval)

    places = [env.reset(seed=seed)[1]["x"] for seed in (1, 2, 1)]

    assert places[0] == places[2] != places[1]
    env.close()


def test_options_choose_start_and_direction(oval):
    env = RacerEnv(oval, start=0.5)

    forth = env.reset(seed=0, options={"start": 0.0})[1]
    back = env.reset(seed=0, options={"start": 0.0, "reverse": True})[1]

    turned = (forth["yaw_deg"] - back["yaw_deg"]) % 360
    assert turned == pytest.approx(180, abs=8)
    env.close()


def test_a_step_before_reset_or_after_the_end_asks_for_a_reset(oval):
    env = RacerEnv(oval, rules=EpisodeRules(max_steps=2))

    with pytest.raises(ResetNeeded, match="reset"):
        env.step(0)
    env.reset(seed=0)
    *_, truncated, _ = env.step(0)
    with pytest.raises(ResetNeeded, match="over"):
        env.step(0)

    assert truncated
    env.close()
    env.close()


def test_options_that_are_none_are_named(oval):
    env = RacerEnv(oval)

    with pytest.raises(ValueError, match="An option of reset is 'strat'"):
        env.reset(options={"strat": 0.5})
    with pytest.raises(ValueError, match=r"start is 1\.5"):
        env.reset(options={"start": 1.5})
    env.close()


def test_many_cars_ask_for_a_reset_before_the_first_step(oval):
    env = RacerVectorEnv(2, oval)

    with pytest.raises(ResetNeeded, match="reset"):
        env.step(np.array([0, 0]))
    env.close()


@pytest.mark.parametrize("actions", [[0, 10], [0, -1], [0.0, 1.0], [0], [[0, 1]], 0])
def test_actions_of_many_cars_outside_their_space_are_named(oval, actions):
    env = RacerVectorEnv(2, oval)
    env.reset(seed=0)

    with pytest.raises(ValueError, match=r"not an action of Discrete\(10\) for 2 cars"):
        env.step(actions)
    env.close()


def test_continuous_actions_beyond_the_limits_count_as_the_limits_and_no_numbers_are_refused(oval):
    env = RacerEnv(oval, actions=ContinuousActions(), start=0.0)

    ends = []
    for steering in (1.0, 7.0):
        env.reset(seed=0)
        ends.append([env.step([steering, 0.0])[4]["yaw_deg"] for _ in range(5)])

    assert ends[0] == ends[1]
    for action in ([np.nan, 0.0], [0.0], ["left", "fast"]):
        with pytest.raises(ValueError, match=r"not an action of Box"):
            env.step(action)
    env.close()


@pytest.mark.parametrize("action", [10, -1, 2.5, "left", [0.0, 0.0]])
def test_an_action_outside_its_space_is_named(oval, action):
    env = RacerEnv(oval)
    env.reset(seed=0)

    with pytest.raises(ValueError, match=r"not an action of Discrete\(10\)"):
        env.step(action)
    env.close()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"race": "drifting"}, "'drifting' is not a race"),
        ({"sensors": ("RADAR",)}, "RADAR is not a sensor"),
        ({"sensors": "RADAR"}, "RADAR is not a sensor"),
        ({"view": "inside"}, "view is 'inside'"),
        ({"start": -0.1}, "start is -0.1"),
        ({"start": "line"}, "start is 'line'"),
        ({"render_mode": "ascii"}, "render_mode is 'ascii'"),
        ({"race": Race(racers=2)}, "two drivers"),
        ({"world": "nowhere"}, "There is no track 'nowhere' here"),
    ],
)
def test_arguments_that_make_no_sense_are_refused_in_a_sentence(oval, arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        RacerEnv(**{"world": oval, **arguments})


@pytest.mark.parametrize(
    ("view", "shape"), [("camera", (120, 160, 3)), ("chase", (480, 640, 3)), ("top", (480, 640, 3))]
)
def test_every_view_gives_a_picture_of_the_car_and_its_surroundings(oval, view, shape):
    env = RacerEnv(oval, race="object_avoidance", render_mode="rgb_array", view=view)
    env.reset(seed=0)

    picture = env.render()

    assert picture.shape == shape
    assert picture.dtype == np.uint8
    assert picture.std() > 10
    env.close()


def test_many_cars_give_one_picture_each(oval):
    env = RacerVectorEnv(3, oval, render_mode="rgb_array")
    env.reset(seed=0)

    pictures = env.render()

    assert [picture.shape for picture in pictures] == [(120, 160, 3)] * 3
    assert not np.array_equal(pictures[0], pictures[1])
    env.close()


def test_the_view_from_behind_one_of_many_cars_does_not_depend_on_the_others(oval):
    env = RacerVectorEnv(2, oval, race=Race(racers=2), render_mode="rgb_array", view="chase")
    env.reset(seed=0)

    once, twice = env.render(), env.render()

    assert not np.array_equal(once[0], once[1])
    np.testing.assert_array_equal(once[0], twice[0])
    np.testing.assert_array_equal(once[1], twice[1])
    env.close()


def test_without_pygame_a_window_is_refused_with_the_remedy(oval, monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    env = RacerEnv(oval, render_mode="human")

    with pytest.raises(DependencyNotInstalled, match='extra "rendering"'):
        env.reset(seed=0)
    env.close()


def test_the_extra_for_rendering_brings_what_windows_and_videos_need():
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text("utf-8"))

    needed = " ".join(project["project"]["optional-dependencies"]["rendering"])

    assert "pygame" in needed
    assert "moviepy" in needed


def distance_m(env) -> float:
    """How far a car gets in a second with the fastest straight action."""
    first = env.reset(seed=1, options={"start": 0.0})[1]
    for _ in range(15):
        info = env.step(5)[4]
    env.close()
    return float(np.hypot(info["x"] - first["x"], info["y"] - first["y"]))


def test_a_car_of_another_year_is_chosen_by_name(oval):
    default, old = (distance_m(RacerEnv(oval, **chosen)) for chosen in ({}, {"car": "2022"}))

    assert old < 0.8 * default
    assert distance_m(RacerEnv(oval, car="release-6")) == default
    assert distance_m(gym.make("drsim/DeepRacer-v0", world=oval, car="2022")) == old


def test_parameters_of_your_own_make_a_car(oval):
    slow = drsim.CarParameters(speed_scale=0.5)

    assert distance_m(RacerEnv(oval, car=slow)) < 0.6 * distance_m(RacerEnv(oval))


def test_many_cars_are_of_the_chosen_year_too(oval):
    def xs(**chosen) -> np.ndarray:
        envs = gym.make_vec(
            "drsim/DeepRacerContinuous-v0", num_envs=2, world=oval, start=0.0, **chosen
        )
        envs.reset(seed=1)
        for _ in range(10):
            info = envs.step(np.ones((2, 2), np.float32))[4]
        envs.close()
        return info["x"]

    np.testing.assert_array_equal(xs(), xs(car="release-6"))
    assert (np.abs(xs() - xs(car="2022")) > 0.01).all()


@pytest.mark.parametrize("build", [RacerEnv, partial(RacerVectorEnv, 2)])
def test_an_unknown_car_is_refused_with_a_suggestion(oval, build):
    with pytest.raises(ValueError, match=r"'low_grip' is not a car. Did you mean low-grip\?"):
        build(oval, car="low_grip")


COPIES = [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))]

DIFFERENT = {
    "race": "object_avoidance",
    "sensors": ("STEREO_CAMERAS", "LIDAR"),
    "randomize": "textures",
    "realism": drsim.Realism(image_noise=3, latency_s=0.02, friction=0.2, mass=0.1),
}


@pytest.mark.nightly
@pytest.mark.parametrize("copied", COPIES, ids=["deepcopy", "pickle"])
@pytest.mark.parametrize("arguments", [{}, DIFFERENT, {"race": "head_to_bot"}])
def test_a_copy_made_in_the_middle_of_an_episode_goes_on_like_its_original(oval, arguments, copied):
    env = RacerEnv(oval, render_mode="rgb_array", **arguments)
    env.reset(seed=3)
    env.render()
    for action in (2, 7, 1):
        env.step(action)

    twin = copied(env)

    for action in [2, 3, 2, 0, 9] * 3 + [0] * 40:
        mine, its = env.step(action), twin.step(action)
        assert data_equivalence(mine, its)
        if mine[2]:
            assert data_equivalence(env.reset(), twin.reset())
    np.testing.assert_array_equal(env.render(), twin.render())
    env.close()
    assert twin.step(1)[0] is not None  # it has a simulation of its own
    twin.close()


@pytest.mark.parametrize("copied", COPIES, ids=["deepcopy", "pickle"])
def test_a_copy_of_many_cars_goes_on_like_its_original(oval, copied):
    envs = RacerVectorEnv(6, oval, race="head_to_bot", rules=EpisodeRules(max_steps=9))
    envs.reset(seed=1)
    envs.step(np.arange(6))

    twin = copied(envs)

    for _ in range(20):
        assert data_equivalence(envs.step(np.arange(6)), twin.step(np.arange(6)))
    envs.close()
    twin.close()


def test_a_copy_costs_no_second_picture_of_the_world_and_compiles_nothing_again(oval):
    env = RacerEnv(oval)
    scene = env._simulation._observations._channels[0].scenes[0]

    there = pickle.loads(pickle.dumps(scene))

    assert copy.deepcopy(env)._simulation._observations._channels[0].scenes[0] is scene
    assert (there.texels.strides, there.texels.dtype) == (scene.texels.strides, scene.texels.dtype)
    np.testing.assert_array_equal(there.texels, scene.texels)
    assert not pickle.loads(pickle.dumps(oval)).center.flags.writeable
    env.close()


@pytest.mark.nightly
def test_environments_work_in_processes_of_their_own_that_are_started_afresh(oval):
    plain, spare = RacerEnv(oval), RacerEnv(oval)
    envs = gym.vector.AsyncVectorEnv(
        [partial(copy.deepcopy, env) for env in (plain, spare)], context="spawn"
    )

    there, _ = envs.reset(seed=5)
    here = [env.reset(seed=5 + k)[0] for k, env in enumerate((plain, spare))]

    np.testing.assert_array_equal(there, np.stack(here))
    stepped = envs.step(np.array([1, 2]))
    np.testing.assert_array_equal(stepped[0][0], plain.step(1)[0])
    for env in (envs, plain, spare):
        env.close()


def test_with_pygame_a_window_shows_every_step(oval, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame = pytest.importorskip("pygame", reason="the window needs pygame")
    env = RacerEnv(oval, render_mode="human", view="camera")

    env.reset(seed=0)
    env.step(4)

    assert env.render() is None
    assert pygame.surfarray.array3d(pygame.display.get_surface()).std() > 10
    env.close()
    env.close()
    assert not pygame.display.get_init()


def test_two_racers_begin_together_and_meet(oval):
    env = RacerVectorEnv(2, oval, race=Race(racers=2), start=0.0, rules=EpisodeRules(max_steps=4))
    env.reset(seed=0)

    ends, steps = [], []
    for _ in range(7):
        *_, truncated, info = env.step(np.array([4, 4]))
        ends.append(truncated.tolist())
        steps.append(info["steps"].tolist())

    assert ends[2] == [True, True]
    assert steps[3] == [1, 1]
    env.close()


def test_sensors_can_be_given_as_an_object(oval):
    env = RacerEnv(oval, sensors=Sensors(("observation", "LIDAR"), lidar_forward=True))

    seen, _ = env.reset(seed=0)

    assert set(seen) == {"observation", "LIDAR"}
    env.close()


@pytest.mark.parametrize("part", ["battery", "steering_trim_deg", "steering_lock", "reflections"])
def test_each_disturbance_works_in_the_environments(oval, part):
    """004-09, 003-19."""
    realism = drsim.Realism(**{part: 0.9})

    def driven(**options) -> np.ndarray:
        env = RacerEnv(oval, start=0.2, actions=ContinuousActions(), **options)
        env.reset(seed=4)
        for _ in range(8):
            frame, *_, info = env.step(np.array([0.4, -0.5], np.float32))
        env.close()
        return np.append(frame.ravel(), [info["x"], info["y"]])

    disturbed = driven(realism=realism)

    assert (disturbed != driven()).any()
    np.testing.assert_array_equal(disturbed, driven(realism=realism))


def test_conditions_of_an_episode_are_an_option_of_reset(oval):
    env = RacerEnv(oval, start=0.0, realism=drsim.Realism(brightness=0.5), longest_latency_s=0.2)
    many = RacerVectorEnv(2, oval, start=0.0, longest_latency_s=0.2)
    options = {"conditions": drsim.Conditions(brightness=0.25, latency_s=0.2)}

    first, _ = env.reset(seed=1, options=options)
    second, _ = env.reset(seed=2, options=options)
    both, _ = many.reset(seed=3, options=options)

    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(both, np.stack([first, first]))
    dark, dim = (drsim.Conditions(brightness=factor) for factor in (0.25, 0.5))
    each, _ = many.reset(seed=4, options={"conditions": [dark, dim]})
    np.testing.assert_array_equal(each[0], first)
    assert each[1].mean() > 1.5 * each[0].mean()
    for wrong in ("night", ["night"]):
        with pytest.raises(ValueError, match="Conditions"):
            env.reset(options={"conditions": wrong})
    with pytest.raises(ValueError, match="3 conditions for 2 episodes"):
        many.reset(options={"conditions": [dark] * 3})
    env.close()
    many.close()
