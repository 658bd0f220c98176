"""Gymnasium environments: one car, or many cars on one track, driven by what the camera sees."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from drsim.actions import DEFAULT_ACTIONS, Actions
from drsim.camera import FRONT
from drsim.car import CONTROL_HZ
from drsim.episode import EpisodeRules, Status
from drsim.reward import RewardFunction, centre_line_reward
from drsim.simulation import Simulation
from drsim.step import StepResult
from drsim.track import Track
from drsim.worlds import load_track

Frames = NDArray[np.uint8]

_FRAME_SPACE_SHAPE = (FRONT.rows, FRONT.columns, 1)


class RacerEnv(gym.Env[Frames, Any]):
    """A DeepRacer car on a track.

    ## Action space

    With `DiscreteActions` (the default: 5 angles, each with 1 and 2 m/s), `Discrete(n)`: a position
    in the list. With `ContinuousActions`, `Box(-1, 1, (2,), float32)`:

    | index | action   | -1                       | 1                     |
    | ----- | -------- | ------------------------ | --------------------- |
    | 0     | steering | least angle [degrees]    | greatest (left) angle |
    | 1     | speed    | least speed [m/s]        | greatest speed        |

    The car turns its wheels by 30 degrees at most and follows with a lag of about 0.1 s; it drives
    0.1 to about 3.6 m/s and cannot stop. One action lasts 1/15 s.

    ## Observation space

    `Box(0, 255, (120, 160, 1), uint8)`: the front camera in grey, first row at the top. Horizontal
    field of view 64.7 degrees, pitched 14 degrees down, 0.13 m above the ground.

    ## Reward

    Whatever the reward function returns for its 27 parameters; when left out, that of the
    centre line: 1.0 within 10 % of the track width from it, 0.5 within 25 %, 0.1 within 50 %, else
    0.001.

    ## Start

    At rest on the centre line, at `start` (0 .. 1 of the lap), or anywhere on the lap, drawn from
    the seed of `reset`, when `start` is None. `reset(options={"start": 0.25})` wins over both.

    ## End of an episode

    Terminated: a full lap (progress exactly 100), all four wheels off the track, 15 steps without
    motion, 15 steps of falling progress. Truncated: `rules.max_steps` reached. Rules that forgive
    violations put the car back and let it wait; its actions are then ignored.

    ## Info

    `progress` [%], `status` (word of the traces), `steps`, `laps`, `lap_time_s`, `x`, `y` [m],
    `yaw_deg`, `closest_waypoint`, `all_wheels_on_track`, `driven` (false where the action was
    ignored).

    ## Rendering

    `render_mode="rgb_array"` gives the camera frame as (120, 160, 3).
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": CONTROL_HZ}  # noqa: RUF012

    def __init__(
        self,
        world: str | Track = "reinvent_base",
        *,
        reward_function: RewardFunction = centre_line_reward,
        actions: Actions = DEFAULT_ACTIONS,
        rules: EpisodeRules | None = None,
        start: float | None = None,
        render_mode: str | None = None,
    ) -> None:
        """Build the world.

        Args:
            world: Name of a world, path of a route file, or a track.
            reward_function: Called after every driven step.
            actions: What the action numbers mean.
            rules: When episodes end; those of training when left out.
            start: Where on the lap episodes start, 0 .. 1; anywhere when None.
            render_mode: "rgb_array", or None for no pictures but the observations.

        Raises:
            TrackError: There is no such world.
        """
        self.render_mode = render_mode
        self.action_space = actions.space()
        self.observation_space = gym.spaces.Box(0, 255, _FRAME_SPACE_SHAPE, np.uint8)
        self._actions = actions
        self._start = start
        self._simulation = _simulation(world, 1, reward_function, rules, num_threads=1)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Frames, dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: Seed of the starting place; None goes on with the generator as it is.
            options: `{"start": 0 .. 1}` to start there.

        Returns:
            The first frame and its info.
        """
        super().reset(seed=seed)
        start = (options or {}).get("start", self._start)
        fraction = self.np_random.random() if start is None else float(start)
        result = self._simulation.reset(np.array([0]), np.array([fraction]))
        return self._frame(), _info_of_one(result)

    def step(self, action: Any) -> tuple[Frames, float, bool, bool, dict[str, Any]]:
        """Act for 1/15 s.

        Args:
            action: One action of the action space.

        Returns:
            Frame, reward, terminated, truncated and info.

        Raises:
            RewardError: The reward function failed.
        """
        result = self._simulation.step(*self._actions.requests(np.asarray(action)[None]))
        return (
            self._frame(),
            float(result.reward[0]),
            bool(result.terminated[0]),
            bool(result.truncated[0]),
            _info_of_one(result),
        )

    def render(self) -> Any:
        """The camera frame in three equal channels, or None without a render mode."""
        if self.render_mode is None:
            return None
        return np.repeat(self._frame(), 3, axis=2)

    def close(self) -> None:
        """Free the threads of the simulation."""
        self._simulation.close()

    def _frame(self) -> Frames:
        return self._simulation.observations[0, :, :, None].copy()


class RacerVectorEnv(VectorEnv[Frames, Any, NDArray[Any]]):
    """Many cars on one track, each with its own episodes; spaces and rules as in `RacerEnv`.

    Observations have the shape (n, 120, 160, 1), rewards and flags (n,). A car whose episode ended
    begins the next one with the step that follows, which ignores its action and pays nothing
    (`AutoresetMode.NEXT_STEP`). Info holds arrays of shape (n,); `status` holds `Status` numbers.
    """

    metadata = {  # noqa: RUF012
        "render_modes": [],
        "render_fps": CONTROL_HZ,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int,
        world: str | Track = "reinvent_base",
        *,
        reward_function: RewardFunction = centre_line_reward,
        actions: Actions = DEFAULT_ACTIONS,
        rules: EpisodeRules | None = None,
        start: float | None = None,
        num_threads: int = 2,
    ) -> None:
        """Build the world; arguments as in `RacerEnv`.

        Args:
            num_envs: How many cars.
            world: Name of a world, path of a route file, or a track.
            reward_function: Called after every driven step of every car.
            actions: What the action numbers mean.
            rules: When episodes end; those of training when left out.
            start: Where on the lap episodes start, 0 .. 1; anywhere when None.
            num_threads: Threads for physics and camera, the caller's included.

        Raises:
            TrackError: There is no such world.
        """
        self.num_envs = num_envs
        self.single_action_space = actions.space()
        self.single_observation_space = gym.spaces.Box(0, 255, _FRAME_SPACE_SHAPE, np.uint8)
        self.action_space = gym.vector.utils.batch_space(self.single_action_space, num_envs)
        self.observation_space = gym.vector.utils.batch_space(
            self.single_observation_space, num_envs
        )
        self._actions = actions
        self._start = start
        self._ended = np.zeros(num_envs, np.bool_)
        self._simulation = _simulation(world, num_envs, reward_function, rules, num_threads)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Frames, dict[str, Any]]:
        """Begin an episode in every car; arguments as in `RacerEnv.reset`."""
        super().reset(seed=seed)
        self._ended[:] = False
        start = (options or {}).get("start", self._start)
        result = self._begin(np.arange(self.num_envs), start)
        return self._frames(), _info_of_many(result)

    def step(
        self, actions: Any
    ) -> tuple[Frames, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Act for 1/15 s in every car; cars whose episode ended begin the next one."""
        result = self._simulation.step(*self._actions.requests(np.asarray(actions)))
        info = _info_of_many(result)
        if self._ended.any():
            begun = self._begin(np.flatnonzero(self._ended), self._start)
            for name, values in _info_of_many(begun).items():
                info[name] = np.where(self._ended, values, info[name])
        self._ended = result.done
        return self._frames(), result.reward, result.terminated, result.truncated, info

    def close_extras(self, **_: Any) -> None:
        """Free the threads of the simulation."""
        self._simulation.close()

    def _begin(self, cars: NDArray[np.int64], start: float | None) -> StepResult:
        if start is None:
            fractions = self.np_random.random(len(cars))
        else:
            fractions = np.full(len(cars), float(start))
        return self._simulation.reset(cars, fractions)

    def _frames(self) -> Frames:
        return self._simulation.observations[..., None].copy()


def _simulation(
    world: str | Track,
    num_cars: int,
    reward_function: RewardFunction,
    rules: EpisodeRules | None,
    num_threads: int,
) -> Simulation:
    return Simulation(
        load_track(world) if isinstance(world, str) else world,
        num_cars=num_cars,
        reward_function=reward_function,
        rules=rules,
        num_threads=num_threads,
    )


def _info_of_many(result: StepResult) -> dict[str, Any]:
    names = (
        "progress",
        "status",
        "steps",
        "laps",
        "lap_time_s",
        "x",
        "y",
        "yaw_deg",
        "closest_waypoint",
        "all_wheels_on_track",
        "driven",
    )
    return {name: getattr(result, name) for name in names}


def _info_of_one(result: StepResult) -> dict[str, Any]:
    info = {name: values[0].item() for name, values in _info_of_many(result).items()}
    info["status"] = Status(info["status"]).label
    return info
