"""Speed of the simulation, compared with other simulators.

    python scripts/bench sim [--world NAME] [--cars 16] [--threads 2] [--rounds 7] [--json]

Everything is measured in turns, round by round, because other programs slow a machine down for a
while; ratios are medians over the rounds. With --json the last line of stdout is one object with

    camera_frames_per_s        160 x 120 frames/s of the computed camera on one thread
    camera_ratio_to_renderer   over those of `mujoco.Renderer` drawing the same ground
    env_steps_per_s            driven steps/s (motion, camera, reward, rules, resets), random
                               actions
    lapping_steps_per_s        the same with cars that follow the centre line
    env_ratio_to_usual         env_steps_per_s over those of the usual build: a Gymnasium
                               environment with `mujoco.Renderer` in each of as many processes as
                               threads
    env_ratio_to_limit         env_steps_per_s over those of bare motion and bare camera after one
                               another, without anything around them, on the very same drive:
                               cars that slide cost more than cars that roll
    lapping_ratio_to_limit     the same for cars that follow the centre line
    oa_ratio, h2b_ratio, stereo_ratio, lidar_ratio
                               time of a step with 6 boxes, 3 bots, two eyes, a lidar, over that of
                               a time trial
    glare_ratio, reflections_ratio, battery_ratio, steering_ratio, noise_ratio, blur_ratio, ...
                               time of a step with one sim-to-real extra, over that without any;
                               off_ratio is that of a second run without any

Figures that need OpenGL are null where none works.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
from machine import print_json
from numpy.typing import NDArray
from opengl_scene import OpenGLCamera, choose_opengl

from drsim import CONTROL_HZ, CarBatch, Simulation, Track, centre_line_reward, load_track
from drsim.car.car import car_model, motor_commands
from drsim.car.car_parameters import CarParameters
from drsim.car.conditions import Realism
from drsim.race.race import BotRules, ObstacleRules, Race
from drsim.sensing.observations import Channel, FrameRenderer
from drsim.sensing.scene import Scene, build_scene, lens_pose, render
from drsim.sensing.sensors import Sensors

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

STEPS = 60
USUAL_STEPS = 40
LEAST, MOST = (-30.0, 1.0), (30.0, 2.0)
"""Random actions: degrees and m/s."""

VARIANTS: dict[str, dict[str, Any]] = {
    "oa": {"race": Race(obstacles=ObstacleRules(count=6))},
    "h2b": {"race": Race(bots=BotRules(count=3))},
    "stereo": {"sensors": Sensors(("STEREO_CAMERAS",))},
    "lidar": {"sensors": Sensors(("FRONT_FACING_CAMERA", "LIDAR"))},
}

EXTRAS: dict[str, dict[str, Any]] = {
    "off": {},
    "glare": {"realism": Realism(glare=1.0)},
    "reflections": {"realism": Realism(reflections=1.0)},
    "battery": {"realism": Realism(battery=0.2)},
    "steering": {"realism": Realism(steering_trim_deg=3.0, steering_lock=0.1)},
    "own_car": {"car_parameters": CarParameters(steering_left_deg=25.0, battery=0.9)},
    "noise": {"realism": Realism(image_noise=4.0)},
    "blur": {"realism": Realism(blur_px=1.0)},
    "brightness": {"realism": Realism(brightness=0.2)},
    "overlay": {"realism": Realism(gray_overlay=1.0)},
    "camera": {"realism": Realism(camera_angle_deg=1.0, camera_shift_m=0.005)},
    "latency": {"realism": Realism(latency_s=0.02, latency_jitter_s=0.05)},
    "grip": {"realism": Realism(friction=0.15, mass=0.1)},
}
"""One disturbance each."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--world", default="reinvent_base", help="world to drive in")
    parser.add_argument("--tracks-dir", type=Path, help="folder with further routes")
    parser.add_argument("--cars", type=int, default=16, help="cars in the batch")
    parser.add_argument("--threads", type=int, default=2, help="threads, ours and theirs")
    parser.add_argument("--rounds", type=int, default=7, help="how often everything is measured")
    parser.add_argument("--extras", action="store_true", help="sim-to-real extras only")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()

    track = load_track(options.world, options.tracks_dir)
    if options.extras:
        figures = measure_extras(track, options.cars, options.threads, options.rounds)
    else:
        opengl = choose_opengl() != "disable"
        figures = measure(track, options.cars, options.threads, options.rounds, opengl=opengl)
    for name, value in figures.items():
        print(f"{name:26} {'-' if value is None else f'{value:,.2f}'}", file=sys.stderr)
    if options.json:
        print_json(figures)


def measure_extras(track: Track, cars: int, threads: int, rounds: int) -> dict[str, float | None]:
    """Processor time of a step with each sim-to-real extra, over that without any."""
    scene = build_scene(track)
    runs = {
        name: EnvRun(track, scene, cars, threads, **kind)
        for name, kind in {"env": {}, **EXTRAS}.items()
    }
    costs: dict[str, list[float]] = {name: [] for name in runs}
    for round_number in range(rounds + 1):
        for name, run in runs.items():
            before = time.process_time()
            run.random()
            if round_number > 0:  # the first one compiles and warms up
                costs[name].append(time.process_time() - before)
    for run in runs.values():
        run.close()
    return {
        f"{name}_ratio": round(
            statistics.median(
                one / plain for one, plain in zip(costs[name], costs["env"], strict=True)
            ),
            3,
        )
        for name in EXTRAS
    }


def measure(
    track: Track, cars: int, threads: int, rounds: int, *, opengl: bool
) -> dict[str, float | None]:
    """All figures."""
    scene = build_scene(track)
    laps = {
        name: EnvRun(track, scene, cars, threads, **kind)
        for name, kind in {"env": {}, **VARIANTS}.items()
    }
    bare = BareRun(scene, cars, threads)
    camera = CameraRun(track, scene, opengl=opengl)
    usual = UsualRun(track.name, threads) if opengl else None
    jobs: dict[str, Callable[[], float]] = {
        **{f"{name}_random": run.random for name, run in laps.items()},
        "bare_random": lambda: bare.repeat(laps["env"].drive),
        "env_lapping": laps["env"].lapping,
        "bare_lapping": lambda: bare.repeat(laps["env"].drive),
        "camera": camera.ours,
    }
    if usual is not None:
        jobs |= {"renderer": camera.theirs, "usual": usual.steps_per_s}
    rates: dict[str, list[float]] = {name: [] for name in jobs}
    for round_number in range(rounds + 1):
        for name, job in jobs.items():
            rate = job()
            if round_number > 0:  # the first one compiles and warms up
                rates[name].append(rate)
    for run in laps.values():
        run.close()
    bare.close()
    if usual is not None:
        usual.close()

    def ratio(name: str, to: str) -> float | None:
        if to not in rates:
            return None
        pairs = zip(rates[name], rates[to], strict=True)
        return round(statistics.median(one / other for one, other in pairs), 3)

    best = {name: round(max(values), 1) for name, values in rates.items()}
    return {
        "cars": cars,
        "threads": threads,
        "camera_frames_per_s": best["camera"],
        "camera_ratio_to_renderer": ratio("camera", "renderer"),
        "env_steps_per_s": best["env_random"],
        "lapping_steps_per_s": best["env_lapping"],
        "bare_steps_per_s": best["bare_random"],
        "usual_steps_per_s": best.get("usual"),
        "env_ratio_to_usual": ratio("env_random", "usual"),
        "env_ratio_to_limit": ratio("env_random", "bare_random"),
        "lapping_ratio_to_limit": ratio("env_lapping", "bare_lapping"),
        **{f"{name}_ratio": ratio("env_random", f"{name}_random") for name in VARIANTS},
        "simulated_seconds_per_s": round(best["env_random"] / CONTROL_HZ, 1),
    }


class EnvRun:
    """The whole environment: motion, sensors, reward, rules and resets.

    Attributes:
        drive: What was done last, in order: cars and the poses they were put at, or the actions of
            all cars.
    """

    def __init__(self, track: Track, scene: Scene, cars: int, threads: int, **kind: Any) -> None:
        self._track, self._cars = track, cars
        self._simulation = Simulation(
            track,
            num_cars=cars,
            reward_function=centre_line_reward,
            num_threads=threads,
            scene=scene,
            **kind,
        )
        self._random = np.random.default_rng(0)
        self.drive: list[tuple[Ints | None, Floats]] = []

    def random(self) -> float:
        """Driven steps/s with random actions: cars leave the track all the time and start again."""
        actions = self._random.uniform(LEAST, MOST, (STEPS, self._cars, 2))
        return self._drive(lambda step, _: actions[step])

    def lapping(self) -> float:
        """Driven steps/s with cars that follow the centre line."""
        return self._drive(lambda _, poses: follow(self._track, poses))

    def _drive(self, act: Callable[[int, Floats], Floats]) -> float:
        everybody = np.arange(self._cars)
        row = self._simulation.reset(everybody, self._random.random(self._cars))
        self.drive = [(everybody, self._simulation.poses)]
        driven, spent_s = 0, 0.0
        for step in range(STEPS):
            poses = np.stack([row.x, row.y, np.radians(row.yaw_deg)], axis=1)
            action = act(step, poses)  # the policy's time is not ours
            self.drive.append((None, action))
            started_s = time.perf_counter()
            row = self._simulation.step(action[:, 0], action[:, 1])
            driven += int(row.driven.sum())
            over = np.flatnonzero(row.done)
            if len(over):
                self._simulation.reset(over, self._random.random(len(over)))
            spent_s += time.perf_counter() - started_s
            if len(over):
                self.drive.append((over, self._simulation.poses[over]))
        return driven / spent_s

    def close(self) -> None:
        """Free the threads."""
        self._simulation.close()


class BareRun:
    """Motion, then camera, and nothing else: what an environment on this core cannot beat."""

    def __init__(self, scene: Scene, cars: int, threads: int) -> None:
        self._everybody = np.arange(cars)
        self._cars = CarBatch(cars, threads)
        self._renderer = FrameRenderer([Channel([scene])], np.zeros(cars, np.int64), threads)

    def repeat(self, drive: Sequence[tuple[Ints | None, Floats]]) -> float:
        """Control steps/s of all cars together, on a drive that an environment has made."""
        steps = sum(placed is None for placed, _ in drive)
        started_s = time.perf_counter()
        for placed, values in drive:
            if placed is None:
                self._cars.drive(values[:, 0], values[:, 1])
            else:
                self._cars.place(placed, values)
            cars = self._everybody if placed is None else placed
            self._renderer.start(cars, self._cars.lens_pos, self._cars.lens_mat)
            self._renderer.finish()
        return steps * len(self._everybody) / (time.perf_counter() - started_s)

    def close(self) -> None:
        """Free the threads."""
        self._renderer.close()


class CameraRun:
    """The computed camera and `mujoco.Renderer`, on one thread each, from places along the lap."""

    def __init__(self, track: Track, scene: Scene, *, opengl: bool, frames: int = 64) -> None:
        cars = CarBatch(frames, 1)
        distances_m = np.linspace(0.0, track.length_m, frames, endpoint=False)
        cars.place(np.arange(frames), track.pose_at(distances_m))
        self._lens_pos, self._lens_mat = cars.lens_pos, cars.lens_mat
        self._scene = scene
        self._out = np.empty((frames, 120, 160), np.uint8)
        self._renderer = OpenGLCamera(scene) if opengl else None

    def ours(self) -> float:
        """Frames/s of the computed camera."""
        started_s = time.perf_counter()
        for _ in range(4):
            render(self._scene, self._lens_pos, self._lens_mat, self._out)
        return 4 * len(self._out) / (time.perf_counter() - started_s)

    def theirs(self) -> float:
        """Frames/s of `mujoco.Renderer`, turned to grey."""
        assert self._renderer is not None, "only asked for where OpenGL works"
        started_s = time.perf_counter()
        for index in range(len(self._out)):
            self._out[index] = self._renderer.draw(self._lens_pos[index], self._lens_mat[index])
        return len(self._out) / (time.perf_counter() - started_s)


class UsualRun:
    """The usual build: a Gymnasium environment with `mujoco.Renderer` in each process."""

    def __init__(self, world: str, processes: int) -> None:
        self._processes = processes
        self._envs = gym.vector.AsyncVectorEnv(
            [lambda: UsualEnv(world)] * processes, context="spawn"
        )
        self._envs.reset(seed=0)
        self._random = np.random.default_rng(0)

    def steps_per_s(self) -> float:
        """Steps/s with random actions, all processes together."""
        actions = self._random.uniform(LEAST, MOST, (USUAL_STEPS, self._processes, 2))
        started_s = time.perf_counter()
        for action in actions:
            self._envs.step(action.astype(np.float32))
        return USUAL_STEPS * self._processes / (time.perf_counter() - started_s)

    def close(self) -> None:
        """End the processes."""
        self._envs.close()


class UsualEnv(gym.Env[NDArray[np.uint8], NDArray[np.float32]]):
    """One car, written the way most people would: MuJoCo step by step, a rendered frame, rules."""

    def __init__(self, world: str) -> None:
        self.observation_space = gym.spaces.Box(0, 255, (120, 160), np.uint8)
        self.action_space = gym.spaces.Box(np.float32(LEAST), np.float32(MOST), dtype=np.float32)
        self._track = load_track(world)
        self._parameters = CarParameters()
        self._model = car_model(self._parameters)
        self._data = mujoco.MjData(self._model)
        self._camera = OpenGLCamera(build_scene(self._track))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        """Put the car anywhere on the centre line."""
        super().reset(seed=seed)
        start_m = np.array([self.np_random.random() * self._track.length_m])
        x, y, yaw_rad = self._track.pose_at(start_m)[0]
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:2] = x, y
        self._data.qpos[3:7] = np.cos(yaw_rad / 2), 0.0, 0.0, np.sin(yaw_rad / 2)
        mujoco.mj_forward(self._model, self._data)
        return self._frame(), {}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        """Drive for 1/15 s."""
        steering, wheels = motor_commands(
            np.float64(action[0]), np.float64(action[1]), self._parameters
        )
        self._data.ctrl[:2], self._data.ctrl[2:] = steering, wheels
        mujoco.mj_step(self._model, self._data, self._parameters.substeps)
        mujoco.mj_kinematics(self._model, self._data)
        wheel_ids = [self._model.body(name).id for name in WHEELS]
        off = not self._track.on_road(self._data.xpos[wheel_ids, :2]).any()
        where = self._track.locate(self._data.qpos[None, :2])
        reward = centre_line_reward(
            {
                "track_width": float(where.track_width_m[0]),
                "distance_from_center": float(where.from_center_m[0]),
            }
        )
        return self._frame(), reward, off, False, {}

    def _frame(self) -> NDArray[np.uint8]:
        body_mat = self._data.body("car").xmat.reshape(1, 3, 3)
        lens_pos, lens_mat = lens_pose(self._data.body("car").xpos[None], body_mat)
        return self._camera.draw(lens_pos[0], lens_mat[0]).astype(np.uint8)


WHEELS = ("rear_left", "rear_right", "front_left", "front_right")


def follow(track: Track, poses: Floats) -> Floats:
    """Actions of cars that aim at the centre line 0.6 m ahead, at 1.5 m/s. Shape (n, 2)."""
    where = track.locate(poses[:, :2])
    goal = track.pose_at(where.distance_m + 0.6)[:, :2] - poses[:, :2]
    turn = np.arctan2(goal[:, 1], goal[:, 0]) - poses[:, 2]
    steering_deg = 1.2 * np.degrees((turn + np.pi) % (2 * np.pi) - np.pi)
    return np.column_stack([steering_deg, np.full(len(poses), 1.5)])


if __name__ == "__main__":
    main()
