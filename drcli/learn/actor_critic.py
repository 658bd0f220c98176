"""The network of PPO: policy and critic on one body."""

from typing import NamedTuple, cast

import torch
from torch import Tensor, nn

from drcli.learn import distributions
from drcli.learn.encoders import Dense, Encoder
from drcli.learn.policy import Observation, PolicySpec
from drcli.learn.return_scale import ReturnScale

LOG_STD_RANGE = (-20.0, 3.0)
"""Bounds of the Gaussian policy's log standard deviation. Source: the reference's PPO head."""

_CRITIC_WIDTH = 64
"""Width of the two hidden layers of a critic that sees the state."""


class Output(NamedTuple):
    """The result of one forward pass."""

    policy: Tensor
    """Logits of the actions, or the mean of the Gaussian. Shape (n, num_actions)."""
    value: Tensor
    """Expected discounted return, in the critic's own units. Shape (n,)."""


class ActorCritic(nn.Module):
    """Policy and value on one shared body.

    The reference trains two bodies, one for the policy and one for the value. Sharing one halves
    the arithmetic and does not change the exported policy. With `state_dims` the value comes from
    the state alone, and the body learns from the policy's gradient only.

    Attributes:
        returns: How much reward a unit of the value head is worth. Without it, errors of large
            values would disturb the shared body, and small ones would not be learned.
    """

    def __init__(self, spec: PolicySpec) -> None:
        super().__init__()
        self.spec = spec
        self.body = Encoder(spec)
        self.policy_head = Dense(self.body.features, spec.num_actions)
        self.value_head: nn.Module
        if spec.state_dims:
            last = Dense(_CRITIC_WIDTH, 1)
            self.value_head = nn.Sequential(
                Dense(spec.state_dims, _CRITIC_WIDTH),
                nn.Tanh(),
                Dense(_CRITIC_WIDTH, _CRITIC_WIDTH),
                nn.Tanh(),
                last,
            )
        else:
            self.value_head = last = Dense(self.body.features, 1)
        nn.init.zeros_(self.policy_head.bias)
        nn.init.zeros_(last.bias)
        _init_rows(last.weight, 1.0)
        self.returns = ReturnScale()
        # All actions are nearly equally likely at the start, so that each one is tried.
        _init_rows(self.policy_head.weight, 0.01)
        if spec.continuous:
            self.log_std = nn.Parameter(torch.zeros(spec.num_actions))

    def forward(self, seen: Observation) -> Output:
        """Evaluate policy and value for n steps."""
        # Only the body may use bfloat16: probability ratios need more than its three digits.
        features = self.body(seen).to(self.policy_head.weight.dtype)
        value = self.value_head(seen.state if self.spec.state_dims else features)
        return Output(self.policy_head(features), value.squeeze(-1))

    def without_critic(self) -> list[Tensor]:
        """The parameters of policy and body: all but those of the critic."""
        critic = set(self.value_head.parameters())
        return [parameter for parameter in self.parameters() if parameter not in critic]

    def follow_returns(self, targets: Tensor, values: Tensor) -> None:
        """Let the critic's units follow the returns of an iteration; see `ReturnScale.follow`.

        Args:
            targets: Returns that the critic should predict, float64. Shape (n,).
            values: Its predictions, float64. Shape (n,).
        """
        last = (
            self.value_head[-1] if isinstance(self.value_head, nn.Sequential) else self.value_head
        )
        size = torch.maximum(targets.abs().mean(), values.abs().mean())
        self.returns.follow(size, cast(nn.Linear, last))

    def act(
        self, seen: Observation, noise: Tensor, deterministic: Tensor, epsilon: float | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Choose actions; see `Policy.act`."""
        policy, value = self(seen)
        if self.spec.continuous:
            drawn = distributions.sample_gaussian(policy, self.log_std_bounded(), noise)
        elif epsilon is None:
            drawn = distributions.sample_categorical(policy, noise[:, 0].contiguous())
        else:
            drawn = distributions.sample_e_greedy(policy, noise, epsilon)
        best = policy if self.spec.continuous else policy.argmax(-1)
        mask = deterministic.unsqueeze(-1) if self.spec.continuous else deterministic
        actions = torch.where(mask, best, drawn)
        return actions, self.log_prob(policy, actions), self.returns(value)

    def log_prob(self, policy: Tensor, actions: Tensor) -> Tensor:
        """Log-probability (density) of actions under a policy output. Shape (n,)."""
        if self.spec.continuous:
            return distributions.log_prob_gaussian(policy, self.log_std_bounded(), actions)
        return distributions.log_prob_categorical(policy, actions)

    def entropy(self, policy: Tensor) -> Tensor:
        """Entropy of the policy in each step, nats. Shape (n,)."""
        if self.spec.continuous:
            one = distributions.entropy_gaussian(self.log_std_bounded())
            return one.expand(policy.shape[0])
        return distributions.entropy_categorical(policy)

    def log_std_bounded(self) -> Tensor:
        """Log standard deviation of the Gaussian policy. Shape (num_actions,)."""
        return self.log_std.clamp(*LOG_STD_RANGE)


def _init_rows(weight: Tensor, length: float) -> None:
    """Draw a kernel whose rows each have the given Euclidean length."""
    with torch.no_grad():
        weight.normal_()
        weight.mul_(length / weight.square().sum(dim=1, keepdim=True).sqrt())
