"""Tries all named cars: `python -m drcli.drive.try_cars CHECKPOINT STARTS`."""

import sys
from collections.abc import Callable

import torch

from drcli.base.log import plain
from drcli.bucket.connect import open_bucket
from drcli.drive.build_race import actions_of, load_world, longest_episode, sensors_of_model
from drcli.drive.driving import Driver, Plan, Racer
from drcli.drive.evaluator import Entry, enter
from drcli.learn.policy import Policy
from drcli.model.files.model_metadata import ModelMetadata
from drcli.records.evaluation_task import CarTrial, DrivenCars
from drcli.records.job import Job
from drcli.workers import worker_process
from drcli.workers.cores import usable_cores
from drcli.workers.worker_process import StopSignal
from drsim.car.car_parameters import CAR_SETS
from drsim.episode.episode_rules import EpisodeRules
from drsim.episode.reward import centre_line_reward
from drsim.episode.simulation import Simulation
from drsim.sensing.scene import Scene, build_scene
from drsim.track.track import Track


def drive_car(
    car: str,
    track: Track,
    scene: Scene,
    policy: Policy,
    metadata: ModelMetadata,
    starts: int,
    num_threads: int,
    should_stop: Callable[[], bool] = lambda: False,
) -> CarTrial:
    """Drive an episode from each of the starts, spread evenly over the lap."""
    actions = actions_of(metadata)
    simulation = Simulation(
        track,
        num_cars=starts,
        reward_function=centre_line_reward,
        rules=EpisodeRules(max_steps=longest_episode(track, actions)),
        num_threads=num_threads,
        scene=scene,
        car_parameters=CAR_SETS[car].parameters,
        sensors=sensors_of_model(metadata),
    )
    plans = [Plan(start, "evaluation", start / starts) for start in range(starts)]
    try:
        driven = Driver(simulation, [Racer(policy, actions)], 0).driven(plans, should_stop)
    finally:
        simulation.close()
    lap_times_s = [round(float(episode.duration_s), 3) for episode in driven if episode.completed]
    progress = [float(episode.progress) for episode in driven]
    mean = round(sum(progress) / starts, 3)
    return CarTrial(car, len(lap_times_s), starts, mean, lap_times_s)


def main(job: Job, stop_signal: StopSignal) -> None:
    checkpoint, starts = sys.argv[1], int(sys.argv[2])
    torch.set_num_threads(1)
    bucket = open_bucket(job.config.storage, hurried=stop_signal.should_stop)
    racer, metadata = enter(bucket, Entry(job.config.model.prefix, checkpoint, "", ""), job.config)
    track = load_world(job.config.race())
    scene = build_scene(track)
    threads = usable_cores(job.config.train)
    trials = []
    for car in CAR_SETS:
        trial = drive_car(
            car, track, scene, racer.model, metadata, starts, threads, stop_signal.should_stop
        )
        laps = "lap" if starts == 1 else "laps"
        plain.info(f"{car}: {trial.laps} of {starts} {laps} clean, {trial.mean_progress:.1f} %")
        trials.append(trial)
    DrivenCars(trials).write(job.folder)


if __name__ == "__main__":
    worker_process.run("cars", main)
