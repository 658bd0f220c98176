"""The policy at the wheel: pictures in, actions out, nothing to learn."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from drcli.learn import distributions
from drcli.learn.policy import ActorCritic


@dataclass(frozen=True)
class Decision:
    """What the policy chose for n cars, and what the learner will want to know of it.

    Attributes:
        actions: int64 indices of shape (n,), or unclipped float32 values of shape (n, dims).
        log_probs: Log-probability of each action. Shape (n,).
        values: The critic's estimate. Shape (n,).
    """

    actions: NDArray[np.int64] | NDArray[np.float32]
    log_probs: NDArray[np.float32]
    values: NDArray[np.float32]


def decide(
    model: ActorCritic,
    frames: NDArray[np.uint8],
    noise: NDArray[np.float32],
    deterministic: NDArray[np.bool_],
) -> Decision:
    """Choose an action for each car.

    Args:
        model: The network, on the CPU.
        frames: What each car sees. Shape (n, 120, 160).
        noise: Random numbers as `distributions.sample` wants them.
        deterministic: Which cars take the most likely action instead. Shape (n,).
    """
    with torch.inference_mode():
        policy, values = model(torch.from_numpy(frames))
        sampled = distributions.sample(model, policy, torch.from_numpy(noise))
        mask = torch.from_numpy(deterministic)
        if model.spec.continuous:
            mask = mask.unsqueeze(-1)
        actions = torch.where(mask, distributions.most_likely(model, policy), sampled)
        log_probs = distributions.log_prob(model, policy, actions)
    return Decision(actions.numpy(), log_probs.numpy(), values.numpy())
