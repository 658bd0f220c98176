"""PPO in one file in the manner of CleanRL, on our vector environment, for `bench learn`.

The structure and the usual details: frames kept as float numbers, orthogonal weights, Adam with
epsilon 1e-5, a learning rate that falls, advantages normalised in each minibatch, a clipped value
loss, gradients clipped at 0.5, `approx_kl` and `clipfrac` noted at every step. For continuous
actions, as in `ppo_continuous_action.py`: a Gaussian whose log standard deviation does not depend
on the picture, and rewards divided by the spread of the returns so far, within -10 and 10.
"""

import time
from typing import Any

import numpy as np
import torch
from gymnasium.wrappers.vector import ClipReward, NormalizeReward
from learn_peers import Choice, plain_body, serve
from learn_runs import Pace, Work
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.distributions import Categorical, Distribution, Independent, Normal

from drcli.learn.policy import PolicySpec
from drsim import RacerVectorEnv

UPDATES = 1_000
"""Iterations until the learning rate would be 0."""


class Agent(nn.Module):
    """Policy and value on the layers of our network."""

    def __init__(self, spec: PolicySpec, *, autocast: bool) -> None:
        super().__init__()
        self.network, features = plain_body(spec, autocast=autocast)
        for layer in self.network:
            if isinstance(layer, nn.Conv2d | nn.Linear):
                _prepare(layer)
        self.actor = _prepare(nn.Linear(features, spec.num_actions), 0.01)
        self.critic = _prepare(nn.Linear(features, 1), 1.0)
        self.log_std = nn.Parameter(torch.zeros(spec.num_actions)) if spec.continuous else None

    def value(self, frames: Tensor) -> Tensor:
        """Values, shape (n, 1), of frames of shape (n, 1, 120, 160)."""
        values: Tensor = self.critic(self.network(frames / 255.0))
        return values

    def choose(
        self, frames: Tensor, actions: Tensor | None = None
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Actions, drawn unless given, their log-probabilities, entropies, and values (n, 1)."""
        hidden = self.network(frames / 255.0)
        chances = self._chances(hidden)
        if actions is None:
            actions = chances.sample()
        return actions, chances.log_prob(actions), chances.entropy(), self.critic(hidden)

    def likeliest(self, frames: Tensor) -> Tensor:
        """The most likely actions, shape (n,) or (n, dims)."""
        return self._chances(self.network(frames / 255.0)).mode

    def _chances(self, hidden: Tensor) -> Distribution:
        outputs = self.actor(hidden)
        if self.log_std is None:
            return Categorical(logits=outputs)
        return Independent(Normal(outputs, self.log_std.exp()), 1)


class CleanRlTraining:
    """The script's loop, one iteration at a time."""

    def __init__(self, work: Work, steps: int, choice: Choice, seed: int = 0) -> None:
        """Begin.

        Args:
            work: What to train.
            steps: Of an iteration, all cars together. Those in which a car starts again count.
            choice: How it runs.
            seed: Of everything that is random.
        """
        cars = choice.cars
        self._p = work.parameters
        self._device = work.compute.device
        self._cars, self._length = cars, steps // cars
        envs = RacerVectorEnv(
            cars,
            work.track,
            # The simulation behind it takes one for each car.
            reward_function=work.rewards(cars),  # type: ignore[arg-type]
            actions=work.actions,
            rules=work.rules,
            num_threads=work.threads,
        )
        gamma = self._p.discount_factor
        scaled = ClipReward(NormalizeReward(envs, gamma), -10.0, 10.0)
        self._envs = scaled if work.spec.continuous else envs
        self._random = np.random.default_rng(seed)
        torch.manual_seed(seed)
        self._agent = Agent(work.spec, autocast=choice.autocast).to(self._device)
        self._optimizer = torch.optim.Adam(self._agent.parameters(), lr=self._p.lr, eps=1e-5)
        self._updates = 0
        shape = (self._length, cars)
        self._frames = torch.zeros((*shape, 1, 120, 160), device=self._device)
        self._log_probs, self._rewards, self._dones, self._values = (
            torch.zeros(shape, device=self._device) for _ in range(4)
        )
        one = torch.as_tensor(work.actions.space().sample())
        self._actions = torch.zeros((*shape, *one.shape), dtype=one.dtype, device=self._device)
        self._next_frame = self._tensor(self._envs.reset(seed=seed)[0])
        self._next_done = torch.zeros(cars, device=self._device)

    def iterate(self) -> Pace:
        """Drive and learn as many steps as an iteration has."""
        started_s = time.perf_counter()
        self._optimizer.param_groups[0]["lr"] = (1.0 - self._updates / UPDATES) * self._p.lr
        self._updates += 1
        self._drive()
        self._learn(*self._advantages())
        return Pace(self._length * self._cars, time.perf_counter() - started_s)

    def likeliest(self, frames: NDArray[np.uint8]) -> NDArray[Any]:
        """The most likely actions, (n,) or (n, dims), for frames of shape (n, 1, 120, 160)."""
        with torch.no_grad():
            actions = self._agent.likeliest(torch.tensor(frames, device=self._device))
        return actions.cpu().numpy()

    def close(self) -> None:
        """Free the threads."""
        self._envs.close()

    def _drive(self) -> None:
        for step in range(self._length):
            self._frames[step] = self._next_frame
            self._dones[step] = self._next_done
            with torch.no_grad():
                action, log_prob, _, value = self._agent.choose(self._next_frame)
            self._values[step] = value.flatten()
            self._actions[step] = action
            self._log_probs[step] = log_prob
            frame, reward, ended, cut, _ = self._envs.step(action.cpu().numpy())
            self._rewards[step] = torch.tensor(reward, dtype=torch.float32)
            self._next_frame = self._tensor(frame)
            self._next_done = torch.tensor(ended | cut, dtype=torch.float32, device=self._device)

    def _advantages(self) -> tuple[Tensor, Tensor]:
        """Advantages and returns. Each of shape (length, cars)."""
        gamma, lam = self._p.discount_factor, self._p.gae_lambda
        advantages = torch.zeros_like(self._rewards)
        with torch.no_grad():
            value = self._agent.value(self._next_frame).flatten()
        goes_on, last = 1.0 - self._next_done, torch.zeros_like(value)
        for step in reversed(range(self._length)):
            delta = self._rewards[step] + gamma * value * goes_on - self._values[step]
            advantages[step] = last = delta + gamma * lam * goes_on * last
            goes_on, value = 1.0 - self._dones[step], self._values[step]
        return advantages, advantages + self._values

    def _learn(self, advantages: Tensor, returns: Tensor) -> None:
        p = self._p
        frames, actions = self._frames.flatten(0, 1), self._actions.flatten(0, 1)
        old_log_probs, old_values, advantages, returns = (
            column.flatten() for column in (self._log_probs, self._values, advantages, returns)
        )
        rows = np.arange(len(returns))
        clipped = []
        for _ in range(p.num_epochs):
            self._random.shuffle(rows)
            for start in range(0, len(rows), p.batch_size):
                chosen = rows[start : start + p.batch_size]
                _, log_probs, entropy, values = self._agent.choose(frames[chosen], actions[chosen])
                log_ratio = log_probs - old_log_probs[chosen]
                ratio = log_ratio.exp()
                with torch.no_grad():
                    approx_kl = ((ratio - 1) - log_ratio).mean()
                    clipped += [((ratio - 1.0).abs() > p.clip_range).float().mean().item()]
                share = advantages[chosen]
                share = (share - share.mean()) / (share.std() + 1e-8)
                bounded = ratio.clamp(1 - p.clip_range, 1 + p.clip_range)
                policy_loss = torch.max(-share * ratio, -share * bounded).mean()
                values = values.flatten()
                near = old_values[chosen] + (values - old_values[chosen]).clamp(
                    -p.clip_range, p.clip_range
                )
                target = returns[chosen]
                value_loss = 0.5 * torch.max((values - target) ** 2, (near - target) ** 2).mean()
                loss = policy_loss - p.beta_entropy * entropy.mean() + 0.5 * value_loss
                self._optimizer.zero_grad()
                torch.autograd.backward(loss)
                nn.utils.clip_grad_norm_(self._agent.parameters(), 0.5)
                self._optimizer.step()
        self.charts = {"approx_kl": approx_kl.item(), "clipfrac": float(np.mean(clipped))}

    def _tensor(self, frame: NDArray[np.uint8]) -> Tensor:
        """Frames as float numbers. Shape (n, 1, 120, 160)."""
        return torch.tensor(frame, dtype=torch.float32, device=self._device).permute(0, 3, 1, 2)


def _prepare(layer: nn.Conv2d | nn.Linear, gain: float = 2.0**0.5) -> nn.Module:
    nn.init.orthogonal_(layer.weight, gain)
    assert layer.bias is not None
    nn.init.zeros_(layer.bias)
    return layer


if __name__ == "__main__":
    serve(CleanRlTraining)
