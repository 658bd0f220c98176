"""Stable-Baselines3's PPO and SAC on our cars, for `bench learn`. Needs that library."""

import sys
import time
from typing import Any

import gymnasium as gym
import numpy as np
from learn_peers import Choice, plain_body, serve
from learn_runs import Pace, Work
from numpy.typing import NDArray
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnv, VecNormalize
from torch import Tensor

from drcli.learn.policy import PolicySpec
from drsim import Actions, Simulation

NO_LOG = sys.maxsize
"""Iterations or episodes from one line of the library's log to the next."""

SAC_BUFFER = 40_000
"""Steps in memory. Each has two pictures, 1.5 GB together; the library's million would need 38."""

SAC_PARTS = 8
"""An iteration has only a part of the steps: with SAC, each takes many times longer."""

SAC_FIRST_STEPS = 1_000
"""Driven at random before the first update."""


class CarVecEnv(VecEnv):
    """Our batch of cars as the library wants it: no processes, no wrappers, no pickling."""

    def __init__(self, simulation: Simulation, actions: Actions, seed: int) -> None:
        self._simulation = simulation
        self._actions = actions
        self._random = np.random.default_rng(seed)
        shape = simulation.frames.shape[1:]
        space = gym.spaces.Box(0, 255, shape, np.uint8)
        super().__init__(simulation.num_cars, space, actions.space())

    def reset(self) -> NDArray[np.uint8]:
        """Begin an episode in every car. Frames of shape (n, 1, 120, 160)."""
        self._begin(np.arange(self.num_envs))
        return self._simulation.frames.copy()

    def step_async(self, actions: NDArray[Any]) -> None:
        """Note the actions, of shape (n,) or (n, dims)."""
        self._chosen = actions

    def step_wait(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], list[dict[str, Any]]]:
        """Drive one step; cars whose episode ends begin the next one in the same step."""
        result = self._simulation.step(*self._actions.requests(self._chosen))
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        over = np.flatnonzero(result.done)
        for car in over.tolist():
            infos[car]["terminal_observation"] = self._simulation.frames[car].copy()
            infos[car]["TimeLimit.truncated"] = bool(result.truncated[car])
        if len(over):
            self._begin(over)
        rewards = result.reward.astype(np.float32)
        return self._simulation.frames.copy(), rewards, result.done, infos

    def close(self) -> None:
        """Free the threads."""
        self._simulation.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The library asks for `render_mode`: there is none."""
        return [None] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Cars have no attributes."""
        raise NotImplementedError

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Cars have no methods."""
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """No car is."""
        return [False] * self.num_envs

    def _begin(self, cars: NDArray[np.int64]) -> None:
        self._simulation.reset(cars, self._random.random(len(cars)))


class Body(BaseFeaturesExtractor):
    """The layers of our network as the library wants them."""

    def __init__(
        self, observation_space: gym.Space[Any], spec: PolicySpec, *, autocast: bool
    ) -> None:
        body, features = plain_body(spec, autocast=autocast)
        super().__init__(observation_space, features)
        self.body = body

    def forward(self, frames: Tensor) -> Tensor:
        """Features, shape (n, features), of frames of shape (n, 1, 120, 160) between 0 and 1."""
        features: Tensor = self.body(frames)
        return features


class Sb3Training:
    """The library's own training loop with PPO, one iteration at a time.

    Its features come from the layers of our network; policy and value stand on them. What the
    library adds by default (gradients clipped, advantages normalised in each minibatch) stays.
    With continuous actions, rewards are divided by the spread of the returns so far, as the
    library's guide and its tuned hyperparameters do.
    """

    _model: PPO | SAC

    def __init__(self, work: Work, steps: int, choice: Choice, seed: int = 0) -> None:
        """Begin.

        Args:
            work: What to train.
            steps: Of an iteration, all cars together.
            choice: How it runs.
            seed: Of everything that is random.
        """
        self._steps = steps
        self._envs = CarVecEnv(work.simulation(choice.cars), work.actions, seed)
        common = {
            "gamma": work.parameters.discount_factor,
            "policy_kwargs": {
                "features_extractor_class": Body,
                "features_extractor_kwargs": {"spec": work.spec, "autocast": choice.autocast},
            },
            "seed": seed,
            "device": work.compute.device,
        }
        self._build(work, common)

    def iterate(self) -> Pace:
        """Drive and learn as many steps as an iteration has."""
        started_s = time.perf_counter()
        self._model.learn(self._steps, log_interval=NO_LOG, reset_num_timesteps=False)
        return Pace(self._steps, time.perf_counter() - started_s)

    def likeliest(self, frames: NDArray[np.uint8]) -> NDArray[Any]:
        """The most likely actions, (n,) or (n, dims), for frames of shape (n, 1, 120, 160)."""
        actions, _ = self._model.predict(frames, deterministic=True)
        return actions

    def close(self) -> None:
        """Free the threads."""
        self._envs.close()

    def _build(self, work: Work, common: dict[str, Any]) -> None:
        """Set the model. The arguments in `common` are those of all algorithms."""
        p = work.parameters
        envs: VecEnv = self._envs
        if work.spec.continuous:
            envs = VecNormalize(envs, norm_obs=False, gamma=p.discount_factor)
        self._model = PPO(
            "CnnPolicy",
            envs,
            n_steps=self._steps // envs.num_envs,
            batch_size=p.batch_size,
            n_epochs=p.num_epochs,
            learning_rate=p.lr,
            gae_lambda=p.gae_lambda,
            clip_range=p.clip_range,
            ent_coef=p.beta_entropy,
            **common,
        )


class Sb3SacTraining(Sb3Training):
    """The same with SAC, for continuous actions: the library's defaults but for the memory.

    Of our hyperparameters it has the discount only, because the others are PPO's.
    """

    def _build(self, work: Work, common: dict[str, Any]) -> None:
        self._steps //= SAC_PARTS
        cars = self._envs.num_envs
        self._model = SAC(
            "CnnPolicy",
            self._envs,
            learning_rate=3e-4,
            batch_size=256,
            buffer_size=SAC_BUFFER,
            learning_starts=SAC_FIRST_STEPS,
            train_freq=1,
            # Between the default, one for a step of all cars, and one for that of each car.
            gradient_steps=max(1, cars // 4),
            **common,
        )


if __name__ == "__main__":
    serve(Sb3Training)
