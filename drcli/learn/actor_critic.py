"""The networks of PPO: policy and critic on one body, and a teacher that sees the state."""

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

EPISODE_DIMS = 2
"""The last values of a teacher's state are of the episode: its critic needs them to expect the end,
but no camera shows them, so the teacher does not drive by them."""

_TEACHER_WIDTH = 128
"""The same of a teacher, and of the critic that it shares with its student."""

FIRST_LOG_STD = -0.5
"""Log standard deviation of a teacher before it has learned."""


class Output(NamedTuple):
    """The result of one forward pass."""

    policy: Tensor
    """Logits of the actions, or the mean of the Gaussian. Shape (n, num_actions)."""
    value: Tensor
    """Expected discounted return, in the critic's own units. Shape (n,)."""


class PolicyAndValue(nn.Module):
    """What policies with a critic have in common, whatever they see.

    Attributes:
        spec: The shape of the policy.
        value_head: The last layers of the critic.
        returns: How much reward a unit of the value head is worth. Without it, errors of large
            values would disturb the shared body, and small ones would not be learned.
        log_std: Log standard deviation of a Gaussian policy. Shape (num_actions,).
    """

    spec: PolicySpec
    value_head: nn.Module
    returns: ReturnScale
    log_std: nn.Parameter

    @property
    def block(self) -> int:
        """Side of the blocks into which frames are cut for it in bfloat16."""
        return 1

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


class ActorCritic(PolicyAndValue):
    """Policy and value on one shared body.

    The reference trains two bodies, one for the policy and one for the value. Sharing one halves
    the arithmetic and does not change the exported policy. With `state_dims` the value comes from
    the state alone, and the body learns from the policy's gradient only.

    Attributes:
        teacher: The layers of a teacher's policy, and its `log_std`; only with `spec.taught`.
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
        """Side of the blocks into which frames are cut for it in bfloat16."""
        return self.body.block

    def forward(self, seen: Observation) -> Output:
        """Evaluate policy and value for n steps."""
        # Only the body may use bfloat16: probability ratios need more than its three digits.
        features = self.body(seen).to(self.policy_head.weight.dtype)
        value = self.value_head(seen.state if self.spec.state_dims else features)
        return Output(self.policy_head(features), value.squeeze(-1))


class Teacher(PolicyAndValue):
    """A policy that drives by what the simulation knows, on the weights of an `ActorCritic`.

    Both have the same critic: what it has learned of the teacher's returns is a good beginning for
    a student that drives nearly alike (Pinto et al., 2017, "Asymmetric actor critic").
    """

    def __init__(self, student: ActorCritic) -> None:
        super().__init__()
        self.spec = student.spec
        self.layers = student.teacher.layers
        self.value_head, self.returns = student.value_head, student.returns
        if self.spec.continuous:
            self.log_std = student.teacher.log_std

    def forward(self, seen: Observation) -> Output:
        """Evaluate policy and value for n steps; frames and scans are not looked at."""
        return Output(self.policy(seen.state), self.value_head(seen.state).squeeze(-1))

    def policy(self, state: Tensor) -> Tensor:
        """Logits of the actions, or the mean of the Gaussian, by the state. Shape (n, actions)."""
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
    """Two hidden layers on the state."""
    last = Dense(width, outputs)  # first, because equal seeds must go on to give equal weights
    return nn.Sequential(Dense(inputs, width), nn.Tanh(), Dense(width, width), nn.Tanh(), last)


def _init_rows(weight: Tensor, length: float) -> None:
    """Draw a kernel whose rows each have the given Euclidean length."""
    with torch.no_grad():
        weight.normal_()
        weight.mul_(length / weight.square().sum(dim=1, keepdim=True).sqrt())
