"""How fast the simulation is on this machine: `python scripts/bench_sim.py [--json]`.

Each figure is the best of several short runs, because other programs can only make a run slower.
Cars take random actions and begin again when they leave the track, which is the dear case: standing
starts and resets cost more than a lap driven well.
"""

import argparse
import json
import os
import time
from collections.abc import Callable

import numpy as np

from drsim import (
    CONTROL_HZ,
    CarBatch,
    EpisodeRules,
    Simulation,
    Track,
    centre_line_reward,
    load_track,
)
from drsim.camera import render
from drsim.scene import Scene, build_scene

ROUNDS = 5


def best_of(run: Callable[[], float]) -> float:
    """Rate of the fastest of several runs, after one that compiles and warms up."""
    run()
    return max(run() for _ in range(ROUNDS))


def camera_frames_per_s(track: Track, scene: Scene, frames: int = 400) -> float:
    """Frames a second of the camera kernel on one thread, from places all along the lap."""
    cars = CarBatch(frames, 1)
    poses = track.pose_at(np.linspace(0.0, track.length_m, frames, endpoint=False))
    cars.place(np.arange(frames), poses)
    out = np.empty((frames, 120, 160), np.uint8)

    def run() -> float:
        start_s = time.perf_counter()
        render(scene, cars.lens_pos, cars.lens_mat, out)
        return frames / (time.perf_counter() - start_s)

    return best_of(run)


def physics_steps_per_s(num_cars: int, num_threads: int, steps: int = 60) -> float:
    """Control steps a second of the cars alone, all cars together."""
    cars = CarBatch(num_cars, num_threads)
    actions = np.random.default_rng(0).uniform([-30, 1], [30, 2], (steps, num_cars, 2))

    def run() -> float:
        start_s = time.perf_counter()
        for action in actions:
            cars.drive(action[:, 0], action[:, 1])
        return steps * num_cars / (time.perf_counter() - start_s)

    return best_of(run)


def env_steps_per_s(
    track: Track, scene: Scene, num_cars: int, num_threads: int, steps: int = 100
) -> float:
    """Driven environment steps a second: motion, camera, reward, rules and resets."""
    simulation = Simulation(
        track,
        num_cars=num_cars,
        reward_function=centre_line_reward,
        rules=EpisodeRules(),
        num_threads=num_threads,
        scene=scene,
    )
    random = np.random.default_rng(0)

    def run() -> float:
        simulation.reset(np.arange(num_cars), random.random(num_cars))
        driven = 0
        start_s = time.perf_counter()
        for _ in range(steps):
            action = random.uniform([-30, 1], [30, 2], (num_cars, 2))
            row = simulation.step(action[:, 0], action[:, 1])
            driven += int(row.driven.sum())
            over = np.flatnonzero(row.done)
            if len(over):
                simulation.reset(over, random.random(len(over)))
        return driven / (time.perf_counter() - start_s)

    try:
        return best_of(run)
    finally:
        simulation.close()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--world", default="reinvent_base", help="world to drive in")
    parser.add_argument("--cars", type=int, default=20, help="cars in the batch")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1, help="threads")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()

    track = load_track(options.world)
    scene = build_scene(track)
    rate = env_steps_per_s(track, scene, options.cars, options.threads)
    figures = {
        "cars": options.cars,
        "threads": options.threads,
        "camera_frames_per_s": camera_frames_per_s(track, scene),
        "physics_steps_per_s_one_thread": physics_steps_per_s(options.cars, 1),
        "physics_steps_per_s": physics_steps_per_s(options.cars, options.threads),
        "env_steps_per_s_one_thread": env_steps_per_s(track, scene, options.cars, 1),
        "env_steps_per_s": rate,
        "simulated_seconds_per_s": rate / CONTROL_HZ,
    }
    if options.json:
        print(json.dumps({name: round(value, 1) for name, value in figures.items()}))
        return
    for name, value in figures.items():
        print(f"{name.replace('_', ' '):34} {value:10,.0f}")


if __name__ == "__main__":
    main()
