"""Many cars on one track as a Gymnasium vector environment."""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from drsim.arrays import Bools, Bytes
from drsim.car.actions import DEFAULT_ACTIONS, Actions
from drsim.car.car import CONTROL_HZ
from drsim.car.car_parameters import DEFAULT_CAR, CarParameters
from drsim.car.conditions import Realism
from drsim.episode.episode_rules import EpisodeRules
from drsim.episode.reward import RewardFunction, centre_line_reward
from drsim.gym.racer import (
    Perceived,
    Racers,
    check_choice,
    checked_actions,
    info_of,
)
from drsim.race.race import Race
from drsim.sensing.observations import Randomize
from drsim.sensing.sensors import Sensors
from drsim.track.track import Track


class RacerVectorEnv(Racers, VectorEnv[Perceived, Any, NDArray[Any]]):
    """Many cars on one track, each with its own episodes; spaces and rules as in `RacerEnv`.

    Observations have one more axis in front; rewards, flags and info are arrays of shape (n,), and
    `status` holds `Status` numbers. After an episode's end the next step begins another, ignores
    the action and gives no reward (`AutoresetMode.NEXT_STEP`). Two racers (`Race(racers=2)`) are
    cars 2i and 2i + 1; they begin together.
    """

    # Not a ClassVar, because Gymnasium declares it without.
    metadata = {  # noqa: RUF012
        "render_modes": ["rgb_array"],
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
        sensors: Sensors | str | Sequence[str] = ("FRONT_FACING_CAMERA",),
        race: Race | str = "time_trial",
        start: float | None = None,
        reverse: bool = False,
        randomize: Randomize = "nothing",
        realism: Realism | None = None,
        longest_latency_s: float = 0.0,
        color: bool = False,
        car: CarParameters | str = DEFAULT_CAR,
        render_mode: str | None = None,
        view: str = "camera",
        num_threads: int = 2,
    ) -> None:
        """Build the world for `num_envs` cars; arguments and errors as in `RacerEnv`.

        `render_mode` is "rgb_array" or None; `num_threads` compute physics and camera, the
        caller's included.
        """
        check_choice("render_mode", render_mode, (None, "rgb_array"))
        self._set_up(
            num_envs,
            num_threads,
            world,
            race,
            sensors,
            actions,
            (start, reverse),
            car,
            (render_mode, view),
            reward_function=reward_function,
            rules=rules,
            realism=realism,
            randomize=randomize,
            longest_latency_s=longest_latency_s,
            color=color,
        )
        self.num_envs = num_envs
        self.single_action_space = actions.space()
        self.single_observation_space = self._sensors.space(color=color)
        self.action_space = gym.vector.utils.batch_space(self.single_action_space, num_envs)
        self.observation_space = gym.vector.utils.batch_space(
            self.single_observation_space, num_envs
        )
        self._begun = False
        self._over = np.zeros(num_envs, np.bool_)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Perceived, dict[str, Any]]:
        """Begin an episode in every car, to which alone the options apply."""
        super().reset(seed=seed)
        self._over[:] = False
        self._begun = True
        result = self._begin(np.arange(self.num_envs), options)
        return self._seen(slice(None)), info_of(result)

    def step(
        self, actions: Any
    ) -> tuple[Perceived, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """As in `RacerEnv.step`, with a row for each car."""
        if not self._begun:
            raise ResetNeeded("Call reset before step: no episode has begun.")
        requests = checked_actions(actions, self.single_action_space, (self.num_envs,))
        begins = np.flatnonzero(self._begins())
        result = self._simulation.step(*self._actions.requests(requests))
        info = info_of(result)
        if len(begins):
            begun = info_of(self._begin(begins, None))
            for name, values in begun.items():
                info[name] = info[name].copy()
                info[name][begins] = values[begins]
            self._over[begins] = False
        # A racer that is done waits for its opponent: both begin their next episodes together.
        self._over |= result.done
        seen = self._seen(slice(None))
        return seen, result.reward, result.terminated, result.truncated, info

    def render(self) -> tuple[Bytes, ...] | None:
        """One picture for each car, or None without a render mode."""
        if self.render_mode is None:
            return None
        return tuple(self._pictures.cut_to(car) for car in range(self.num_envs))

    def close_extras(self, **_: Any) -> None:
        self._simulation.close()

    def _begins(self) -> Bools:
        return np.repeat(self._over.reshape(-1, self._race.racers).all(axis=1), self._race.racers)
