"""The networks of soft actor-critic: a tanh-squashed Gaussian, and twin critics."""

import math
from copy import deepcopy
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from drcli.learn.advantages import ReturnScale
from drcli.learn.distributions import log_prob_gaussian
from drcli.learn.encoders import Dense, Encoder, Head, Network
from drcli.learn.policy import Observation, PolicySpec

LOG_STD_RANGE = (-20.0, 2.0)
"""Source: the reference's SAC head."""

_LEAST_ALPHA = 1e-4
_SUMMARY = 50
"""Source: DrQ (Kostrikov et al., 2020)."""

_WIDTH = 256
"""Source: the reference's SAC heads."""


class SACAgent(Network):
    """Actor, critics and temperature.

    One body instead of the reference's three. It learns from the critics (Yarats et al., 2021,
    "DrQ-v2"), or from the actor if the critics see the state.
    """

    def __init__(self, spec: PolicySpec, sac_alpha: float = 0.2) -> None:
        super().__init__()
        self.spec = spec
        self.body = Encoder(spec)
        self.actor = nn.Sequential(
            _summary(self.body.features), _hidden_layers(_SUMMARY, 2 * spec.num_actions)
        )
        self.critics = _TwinCritic(spec.state_dims or self.body.features, spec.num_actions)
        self.targets = deepcopy(self.critics).requires_grad_(False)
        self.log_alpha = nn.Parameter(torch.tensor(math.log(max(sac_alpha, _LEAST_ALPHA))))
        self.returns = ReturnScale()

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log standard deviation before tanh. Shape (n, dims)."""
        mean, log_std = self.actor(features).chunk(2, dim=-1)
        return mean, log_std.clamp(*LOG_STD_RANGE)

    def features(self, seen: Observation) -> Tensor:
        features: Tensor = self.body(seen)
        return features.float()

    def critic_input(self, features: Tensor, seen: Observation) -> Tensor:
        return seen.state if self.spec.state_dims else features

    @torch.no_grad()
    def follow_returns(self, returns: Tensor, values: Tensor) -> None:
        """See `ReturnScale.follow`; in reward, predictions and temperature stay the same."""
        before = self.returns.scale.clone()
        size = torch.maximum(returns.abs().mean(), values.abs().mean())
        self.returns.follow(size, *self.critics.last_layers(), *self.targets.last_layers())
        if before > 0.0 and self.returns.scale > 0.0:
            self.log_alpha.add_((before / self.returns.scale).log())

    def act(
        self, seen: Observation, noise: Tensor, deterministic: Tensor, epsilon: float | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """See `Policy.act`; actions are in [-1, 1], `epsilon` is not used."""
        features = self.features(seen)
        mean, log_std = self(features)
        actions, log_probs = squash(mean, log_std, noise * ~deterministic.unsqueeze(-1))
        value = self.critics(self.critic_input(features, seen), actions).amin(0)
        return actions, log_probs, self.returns(value)

    def head(self, seen: Observation, *, judged: bool = False) -> Head:
        features = self.features(seen)
        mean, log_std = self(features)
        value = None
        if judged:
            actions = self.squash(mean)
            value = self.returns(self.critics(self.critic_input(features, seen), actions).amin(0))
        return Head(mean, log_std.exp(), value)

    def squash(self, raw: Tensor) -> Tensor:
        return torch.tanh(raw)


def squash(mean: Tensor, log_std: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """Draw actions in [-1, 1] of shape (n, dims), and their log-density, both with gradient.

    `noise` is standard normal; 0 gives the action at the mean.
    """
    raw = mean + log_std.exp() * noise
    # log(1 - tanh(x)^2) = 2 (log 2 - x - softplus(-2 x)), which does not round to log 0. Source:
    # TensorFlow Probability's Tanh bijector.
    log_slope = 2.0 * (math.log(2.0) - raw + functional.logsigmoid(2.0 * raw))
    return torch.tanh(raw), log_prob_gaussian(mean, log_std, raw) - log_slope.sum(-1)


class _TwinCritic(nn.Module):
    def __init__(self, features: int, num_actions: int) -> None:
        super().__init__()
        self.summary = _summary(features)
        self.streams = nn.ModuleList(_hidden_layers(_SUMMARY + num_actions, 1) for _ in range(2))

    def forward(self, features: Tensor, actions: Tensor) -> Tensor:
        x = torch.cat([self.summary(features), actions], dim=-1)
        return torch.stack([stream(x).squeeze(-1) for stream in self.streams])

    def last_layers(self) -> list[nn.Linear]:
        return [cast(nn.Linear, cast(nn.Sequential, stream)[-1]) for stream in self.streams]


def _summary(features: int) -> nn.Module:
    return nn.Sequential(Dense(features, _SUMMARY), nn.LayerNorm(_SUMMARY), nn.Tanh())


def _hidden_layers(width: int, out: int) -> nn.Module:
    return nn.Sequential(
        Dense(width, _WIDTH),
        nn.ReLU(inplace=True),
        Dense(_WIDTH, _WIDTH),
        nn.ReLU(inplace=True),
        Dense(_WIDTH, out),
    )
