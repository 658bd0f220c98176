"""The networks of PPO: policy and critic on one body, and a teacher that sees the state."""

from typing import NamedTuple, cast

import torch
from torch import Tensor, nn

from drcli.learn import distributions
from drcli.learn.advantages import ReturnScale
from drcli.learn.encoders import Dense, Encoder, Head, Network
from drcli.learn.policy import Observation, PolicySpec

LOG_STD_RANGE = (-20.0, 3.0)
"""Source: the reference's PPO head."""

_CRITIC_WIDTH = 64
EPISODE_DIMS = 2
"""Last values of a teacher's state: for its critic only, because no camera shows them."""

_TEACHER_WIDTH = 128
FIRST_LOG_STD = -0.5


class Output(NamedTuple):
    policy: Tensor
    """Logits, or the mean of the Gaussian. Shape (n, num_actions)."""
    value: Tensor
    """In the critic's own units. Shape (n,)."""


class PolicyAndValue(Network):
    """What policies with a critic have in common.

    `returns` scales the critic, so that large values do not disturb the shared body.
    """

    value_head: nn.Module
    returns: ReturnScale
    log_std: nn.Parameter

    @property
    def block(self) -> int:
        return 1

    def without_critic(self) -> list[Tensor]:
        critic = set(self.value_head.parameters())
        return [parameter for parameter in self.parameters() if parameter not in critic]

    def follow_returns(self, targets: Tensor, values: Tensor) -> None:
        """See `ReturnScale.follow`."""
        last = (
            self.value_head[-1] if isinstance(self.value_head, nn.Sequential) else self.value_head
        )
        size = torch.maximum(targets.abs().mean(), values.abs().mean())
        self.returns.follow(size, cast(nn.Linear, last))

    def act(
        self, seen: Observation, noise: Tensor, deterministic: Tensor, epsilon: float | None
    ) -> tuple[Tensor, Tensor, Tensor]:
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
        if self.spec.continuous:
            return distributions.log_prob_gaussian(policy, self.log_std_bounded(), actions)
        return distributions.log_prob_categorical(policy, actions)

    def entropy(self, policy: Tensor) -> Tensor:
        """In each step, nats. Shape (n,)."""
        if self.spec.continuous:
            one = distributions.entropy_gaussian(self.log_std_bounded())
            return one.expand(policy.shape[0])
        return distributions.entropy_categorical(policy)

    def log_std_bounded(self) -> Tensor:
        return self.log_std.clamp(*LOG_STD_RANGE)


class ActorCritic(PolicyAndValue):
    """Policy and value on one shared body.

    The reference's two take twice the arithmetic. With `state_dims` the value comes from the
    state.
    """

    def __init__(self, spec: PolicySpec) -> None:
        super().__init__()
        self.spec = spec
        self.body = Encoder(spec)
        self.policy_head = Dense(self.body.features, spec.num_actions)
        if spec.state_dims:
            width = _TEACHER_WIDTH if spec.taught else _CRITIC_WIDTH
            self.value_head = _on_state(spec.state_dims, width, 1)
            last = cast(Dense, self.value_head[-1])
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
        if spec.taught:
            self.teacher = _TeacherLayers(spec)

    @property
    def block(self) -> int:
        return self.body.block

    def forward(self, seen: Observation) -> Output:
        # Only the body may use bfloat16: probability ratios need more than its three digits.
        features = self.body(seen).to(self.policy_head.weight.dtype)
        value = self.value_head(seen.state if self.spec.state_dims else features)
        return Output(self.policy_head(features), value.squeeze(-1))

    def head(self, seen: Observation, *, judged: bool = False) -> Head:
        features = self.body(seen).to(self.policy_head.weight.dtype)
        value = None
        if judged:
            of = self.value_head(seen.state if self.spec.state_dims else features)
            value = self.returns(of.squeeze(-1))
        raw = self.policy_head(features)
        std = self.log_std_bounded().exp().expand_as(raw) if self.spec.continuous else None
        return Head(raw, std, value)


class Teacher(PolicyAndValue):
    """A policy that sees the state, and shares the critic with its student.

    (Pinto et al., 2017, "Asymmetric actor critic").
    """

    def __init__(self, student: ActorCritic) -> None:
        super().__init__()
        self.spec = student.spec
        self.layers = student.teacher.layers
        self.value_head, self.returns = student.value_head, student.returns
        if self.spec.continuous:
            self.log_std = student.teacher.log_std

    def forward(self, seen: Observation) -> Output:
        return Output(self.policy(seen.state), self.value_head(seen.state).squeeze(-1))

    def policy(self, state: Tensor) -> Tensor:
        policy: Tensor = self.layers(state[:, :-EPISODE_DIMS])
        return policy


class _TeacherLayers(nn.Module):
    def __init__(self, spec: PolicySpec) -> None:
        super().__init__()
        self.layers = _on_state(spec.state_dims - EPISODE_DIMS, _TEACHER_WIDTH, spec.num_actions)
        last = cast(Dense, self.layers[-1])
        nn.init.zeros_(last.bias)
        _init_rows(last.weight, 0.01)
        if spec.continuous:
            self.log_std = nn.Parameter(torch.full((spec.num_actions,), FIRST_LOG_STD))


def _on_state(inputs: int, width: int, outputs: int) -> nn.Sequential:
    last = Dense(width, outputs)  # first, because equal seeds must go on to give equal weights
    return nn.Sequential(Dense(inputs, width), nn.Tanh(), Dense(width, width), nn.Tanh(), last)


def _init_rows(weight: Tensor, length: float) -> None:
    with torch.no_grad():
        weight.normal_()
        weight.mul_(length / weight.square().sum(dim=1, keepdim=True).sqrt())
