"""Builds track, race, simulation and reward function; loads torch only to choose a GPU."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import numpy as np

from drcli.base.errors import Problem, ProblemsError
from drcli.base.installation import lazy_imports
from drcli.base.log import get_logger
from drcli.config.run_config import DriveConfig
from drcli.config.track_names import remedy, track_problem
from drcli.drive.reward_client import RewardProcess
from drcli.model import keys
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.model_store import ModelStore
from drcli.records.stage import Stage
from drcli.workers.reward_failures import reward_failure
from drsim.car.actions import Actions, ContinuousActions, DiscreteActions
from drsim.car.car import CONTROL_HZ
from drsim.car.car_parameters import MIN_SPEED_MPS, CarParameters, car_of
from drsim.car.conditions import Realism
from drsim.episode.episode_rules import EpisodeRules
from drsim.episode.placing import Placing
from drsim.episode.reward import RewardFunction, RewardHost
from drsim.episode.simulation import Simulation
from drsim.errors import RewardError, TrackError
from drsim.race.objects import WAY_M, closed_at_m
from drsim.race.race import TIME_TRIAL, BotRules, ObstacleRules, Race
from drsim.race.traffic import Traffic
from drsim.sensing.observations import Randomize
from drsim.sensing.sensors import Sensors
from drsim.track.track import Track
from drsim.track.ways import Ways
from drsim.track.worlds import load_track

with lazy_imports():
    import torch

_logger = get_logger(__name__)

SLACK = 2.5
"""Times the slowest lap's duration: cars do not drive straight."""

MAX_EPISODE_STEPS = 10_000
"""The reference has no limit, but nothing is learned from a car that never completes its lap."""


def load_world(config: DriveConfig) -> Track:
    """ProblemsError if the track is not installed, or damaged (V-05)."""
    try:
        return load_track(config.world_name, config.tracks_folder)
    except TrackError as error:
        problem = track_problem(config)
        if problem is None:
            name, place = "DR_WORLD_NAME", config.place("DR_WORLD_NAME")
            what = f"{name}={config.world_name:.80}: {error}"
            problem = Problem("V-05", "error", *place, what, remedy(config), name)
        raise ProblemsError([replace(problem, severity="error")]) from None


def race_of(config: DriveConfig) -> Race:
    if config.race_type == "OBJECT_AVOIDANCE":
        return Race(
            obstacles=ObstacleRules(
                count=config.oa_number_of_obstacles,
                kind="bot_car" if config.oa_is_obstacle_bot_car else config.oa_obstacle_type,
                min_gap_m=config.oa_min_distance_between_obstacles,
                randomize=config.oa_randomize_obstacle_locations,
                positions=config.oa_object_positions,
                reset_behind_m=config.eval_reset_behind_dist,
            )
        )
    if config.race_type == "HEAD_TO_BOT":
        return Race(
            bots=BotRules(
                count=config.h2b_number_of_bot_cars,
                speed_mps=config.h2b_bot_car_speed,
                min_gap_m=config.h2b_min_distance_between_bot_cars,
                randomize=config.h2b_randomize_bot_car_locations,
                lane_change=config.h2b_is_lane_change,
                lane_change_time_s=(
                    config.h2b_lower_lane_change_time,
                    config.h2b_upper_lane_change_time,
                ),
                lane_change_distance_m=config.h2b_lane_change_distance,
                penalty_s=config.h2b_bot_car_penalty,
            )
        )
    return Race(racers=2) if config.race_type == "HEAD_TO_MODEL" else TIME_TRIAL


def load_race(config: DriveConfig, track: Track) -> Race:
    """ProblemsError if there is no room for obstacles or bots (V-07)."""
    try:
        race = race_of(config)
        if race != TIME_TRIAL:
            Traffic(Ways([track], race.racers), race)
    except ValueError as error:
        if config.race_type == "OBJECT_AVOIDANCE":
            number, gap = "DR_OA_NUMBER_OF_OBSTACLES", "DR_OA_MIN_DISTANCE_BETWEEN_OBSTACLES"
        else:
            number, gap = "DR_H2B_NUMBER_OF_BOT_CARS", "DR_H2B_MIN_DISTANCE_BETWEEN_BOT_CARS"
        place, remedy = config.place(number), f"Set a smaller {number} or a smaller {gap}."
        problem = Problem("V-07", "error", *place, f"{number}: {error}", remedy, number)
        raise ProblemsError([problem]) from None
    return race


DRAWS = 20
LEAST_ADVANCE = 0.01
"""Of starts that are tried, as a fraction of the lap."""


def race_warnings(config: DriveConfig, track: Track, race: Race) -> list[Problem]:
    """V-07: what no car can pass, and obstacles in the same place."""
    rules = race.obstacles or race.bots
    if rules is None:
        return []
    is_obstacle = race.obstacles is not None
    places = race.obstacles.positions if race.obstacles is not None else ()
    drawn = rules.randomize and not places
    name = "DR_OA_NUMBER_OF_OBSTACLES" if is_obstacle else "DR_H2B_NUMBER_OF_BOT_CARS"
    remedy = "Set a smaller number or a larger least distance."
    if places:
        name, remedy = "DR_OA_OBJECT_POSITIONS", "Move one of them."
    found = []
    known: set[tuple[float, bool]] = set()
    for fraction, lane in places:
        where = (fraction % 1.0 if track.closed else fraction, lane == -1)
        if where in known:
            found.append(f"two obstacles stand in the same place, {fraction:g},{lane:g}")
        known.add(where)
        if lane not in (1, -1):
            found.append(f"lane {lane:g} of {fraction:g},{lane:g} is neither 1 nor -1; 1 is taken")
    traffic = Traffic(Ways([track], DRAWS if drawn else 1), race)
    cars = np.arange(len(traffic.xy))
    traffic.begin(cars, np.zeros(len(cars)), np.arange(len(cars), dtype=np.uint64))
    closed_m = closed_at_m(track, traffic.objects())
    closed_m = closed_m[~np.isnan(closed_m)]
    what = "obstacles" if is_obstacle else "bots"
    needs = f"; a car needs a gap of {WAY_M:.2f} m"
    if drawn and len(closed_m):
        often = f"in {len(closed_m)} of {DRAWS} drawn episodes"
        found.append(f"nobody can pass some {what} {often}, because they close both lanes{needs}")
    elif len(closed_m):
        fraction = round(closed_m[0] / track.length_m, 3) % 1.0
        found.append(f"nobody can pass the {what} at {fraction:.3f} of the lap{needs}")
    if is_obstacle and not drawn:
        found += _blocked_starts(config, track, race)
    place = config.place(name)
    return [Problem("V-07", "warning", *place, f"{name}: {text}.", remedy, name) for text in found]


def _blocked_starts(config: DriveConfig, track: Track, race: Race) -> Iterator[str]:
    """Starts of training episodes at which the car touches an obstacle."""
    advance = config.train_round_robin_advance_dist
    moves = config.train_change_start_position and advance > 0.0
    fractions = np.arange(0.0, 1.0, max(advance, LEAST_ADVANCE)) if moves else np.zeros(1)
    cars = np.arange(len(fractions))
    ways = Ways([track], len(cars))
    traffic = Traffic(ways, race)
    traffic.begin(cars, fractions, np.zeros(len(cars), np.uint64))
    poses = Placing(ways).on_each(cars, fractions, traffic.start_lane(cars))
    active = np.ones(len(cars), np.bool_)
    at_m = fractions * track.length_m
    crashed = traffic.contacts(active, poses[:, :2], poses[:, 2], at_m).crashed
    if crashed.any():
        often = f"{crashed.sum()} of {len(cars)} places" if moves else "the place"
        first = f"{fractions[crashed][0]:.3f} of the lap"
        yield f"at {often} where episodes start the car touches an obstacle, such as {first}"


def realism_of(config: DriveConfig, job: Literal["training", "evaluation"]) -> Realism:
    if config.sim_extras_in not in ("both", job):
        return Realism()
    return Realism(
        image_noise=config.sim_image_noise,
        brightness=config.sim_brightness,
        blur_px=config.sim_blur,
        camera_angle_deg=config.sim_camera_angle,
        camera_shift_m=config.sim_camera_shift,
        latency_s=config.sim_latency,
        latency_jitter_s=config.sim_latency_jitter,
        friction=config.sim_friction,
        mass=config.sim_mass,
        glare=config.sim_glare,
        reflections=config.sim_reflections,
        gray_overlay=config.sim_gray_overlay,
        battery=config.sim_battery,
        steering_trim_deg=config.sim_steering_trim,
        steering_lock=config.sim_steering_lock,
    )


def car_parameters_of(config: DriveConfig) -> CarParameters:
    """As DR_SIM_CAR says, with the properties of the racer's own car."""
    return replace(
        car_of(config.sim_car),
        steering_left_deg=config.car_steering_left,
        steering_right_deg=config.car_steering_right,
        steering_trim_deg=config.car_steering_trim,
        max_speed_mps=config.car_max_speed,
        battery=config.car_battery,
    )


def randomize_of(config: DriveConfig) -> Randomize:
    if not config.enable_domain_randomization:
        return "nothing"
    return "textures" if config.randomize_textures else "lights"


def build_simulation(
    config: DriveConfig,
    job: Literal["training", "evaluation"],
    metadata: ModelMetadata,
    track: Track | Sequence[Track],
    *,
    num_cars: int,
    reward: RewardFunction | list[RewardFunction] | RewardHost,
    rules: EpisodeRules,
    num_threads: int,
    seed: int,
    on_reward_error: Callable[[RewardError, int], float] | None = None,
    longest_latency_s: float = 0.0,
    gpu: bool = False,
) -> Simulation:
    """The simulation of a worker; with `gpu`, a GPU draws the frames if it can.

    `longest_latency_s` is that of conditions given to its `reset`.

    Raises:
        ProblemsError: There is no room for obstacles or bots (V-07).
    """
    for each in [track] if isinstance(track, Track) else track:
        race = load_race(config, each)
    build = partial(
        Simulation,
        track,
        num_cars=num_cars,
        reward_function=reward,
        rules=rules,
        num_threads=num_threads,
        seed=seed,
        car_parameters=car_parameters_of(config),
        race=race,
        sensors=sensors_of_model(metadata),
        realism=realism_of(config, job),
        randomize=randomize_of(config),
        on_reward_error=on_reward_error,
        longest_latency_s=longest_latency_s,
        physics=config.physics,
    )
    try:
        simulation = build(gpu=gpu)
    except OSError as error:
        if not gpu:
            raise
        _logger.warning("The processor draws the frames, because the GPU cannot: %s", error)
        simulation = build()
    cars = "1 car is" if num_cars == 1 else f"{num_cars} cars are"
    _logger.info("%s moved by %s (DR_PHYSICS=%s)", cars, simulation.physics, config.physics)
    return simulation


def load_reward(
    model: ModelStore,
    folder: Path,
    cars: int,
    stage: Stage | None = None,
    inputs: Mapping[str, str] | None = None,
) -> RewardProcess:
    """The reward function of a stage, of a start (`Job.inputs`), or the model's.

    It may keep values in globals, so each car needs its own copy. The simulation closes the
    process.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if stage is None:
        path = folder / keys.REWARD_FUNCTION_FILE
        own = (inputs or {}).get(keys.REWARD_FUNCTION_FILE)
        data = model.bucket.get(keys.reward_function(model.prefix)) if own is None else own.encode()
        path.write_bytes(data)
    else:
        name = Path(stage.reward_name).name  # errors name the file as its author calls it
        path = folder / (name if name.endswith(".py") else keys.REWARD_FUNCTION_FILE)
        path.write_text(stage.reward, encoding="utf-8")
    try:
        return RewardProcess(path, cars)
    except RewardError as error:
        raise reward_failure(error) from None


def actions_of(metadata: ModelMetadata) -> Actions:
    space = metadata.action_space
    if space.low is None or space.high is None:
        return DiscreteActions(space.values)
    steering_deg, speed_mps = zip(space.low, space.high, strict=True)
    return ContinuousActions(steering_deg, speed_mps)


def sensors_of_model(metadata: ModelMetadata) -> Sensors:
    return Sensors(
        metadata.sensor,
        num_sectors=metadata.lidar.num_sectors,
        values_per_sector=metadata.lidar.num_values_per_sector,
        clipping_m=metadata.lidar.clipping_dist,
    )


def longest_episode(track: Track, actions: Actions) -> int:
    """In steps, far more than the slowest lap takes."""
    if isinstance(actions, ContinuousActions):
        slowest_mps = actions.speed_mps[0]
    else:
        slowest_mps = min(speed_mps for _, speed_mps in actions.choices)
    lap_s = track.length_m / max(slowest_mps, MIN_SPEED_MPS)
    return min(MAX_EPISODE_STEPS, math.ceil(SLACK * lap_s * CONTROL_HZ))


# Where a worker computes cameras and policy: on a GPU, or on the processor.


INSTALL = "pip install 'drcli[gpu]'"


@dataclass(frozen=True)
class WorkerDevice:
    """The choice; `is_wanted`: it is what DR_WORKER_DEVICE asks for."""

    gpu: "torch.device | None"
    reason: str
    is_wanted: bool = True


def choose_worker_device(wanted: str, worker: int) -> WorkerDevice:
    """By DR_WORKER_DEVICE; several GPUs are given out in turn."""
    if wanted == "cpu":
        return WorkerDevice(None, "on the processor, as set")
    if not torch.cuda.is_available():
        why = "PyTorch finds no GPU"
        return WorkerDevice(None, f"on the processor: {why}", is_wanted=wanted == "auto")
    if find_spec("numba_cuda") is None:
        why = f"drawing on a GPU needs the package numba-cuda ({INSTALL})"
        return WorkerDevice(None, f"on the processor: {why}", is_wanted=wanted == "auto")
    number = worker % torch.cuda.device_count()
    torch.cuda.set_device(number)
    return WorkerDevice(torch.device("cuda", number), f"on {torch.cuda.get_device_name(number)}")
