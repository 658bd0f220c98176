"""PPO in one file, in the style of CleanRL: `python scripts/examples/train_cleanrl.py`.

All cars are driven by one vector environment; nothing of the project but `drsim` is used.
"""

import argparse
import time

import gymnasium as gym
import numpy as np
import torch
from torch import nn
from torch.distributions import Categorical

import drsim  # noqa: F401  makes the ids known to Gymnasium


class Agent(nn.Module):
    """Convolutions that policy and value share."""

    def __init__(self, num_actions: int) -> None:
        super().__init__()
        self.body = nn.Sequential(
            nn.Conv2d(1, 16, 8, stride=4),
            nn.ReLU(),
            nn.Conv2d(16, 32, 4, stride=2),
            nn.ReLU(),
            nn.Conv2d(32, 32, 3, stride=2),
            nn.ReLU(),
            nn.Flatten(),
            nn.LazyLinear(128),
            nn.ReLU(),
        )
        self.policy = nn.Linear(128, num_actions)
        self.value = nn.Linear(128, 1)
        nn.init.normal_(self.policy.weight, std=0.01)

    def forward(self, frames: torch.Tensor) -> tuple[Categorical, torch.Tensor]:
        """Frames (n, 120, 160, 1), uint8, to a policy and values (n,)."""
        hidden = self.body(frames.permute(0, 3, 1, 2).float() / 255.0)
        return Categorical(logits=self.policy(hidden)), self.value(hidden).squeeze(-1)


def main() -> None:
    """Train and print how far the cars get."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--id", default="drsim/DeepRacer-v0", help="environment")
    parser.add_argument("--world", default="reinvent_base")
    parser.add_argument("--total-steps", type=int, default=60_000)
    parser.add_argument("--num-envs", type=int, default=16)
    parser.add_argument("--num-steps", type=int, default=64, help="steps of each car an update")
    parser.add_argument("--seed", type=int, default=0)
    o = parser.parse_args()
    gamma, lam, clip, epochs, minibatch, entropy_weight = 0.95, 0.95, 0.2, 3, 64, 0.01

    torch.set_flush_denormal(True)  # numbers next to 0 slow a processor down many times
    torch.manual_seed(o.seed)
    envs = gym.make_vec(o.id, num_envs=o.num_envs, world=o.world)
    agent = Agent(envs.single_action_space.n)
    frame = torch.from_numpy(envs.reset(seed=o.seed)[0])
    agent(frame)  # makes the lazy layer
    optimizer = torch.optim.Adam(agent.parameters(), lr=5e-4)

    shape = (o.num_steps, o.num_envs)
    frames = torch.zeros((*shape, *frame.shape[1:]), dtype=torch.uint8)
    actions, log_probs, rewards, values, ends, real = (torch.zeros(shape) for _ in range(6))
    over = torch.zeros(o.num_envs)
    farthest: list[float] = []
    started_s, steps = time.perf_counter(), 0
    for update in range(1, max(o.total_steps // (o.num_steps * o.num_envs), 1) + 1):
        for t in range(o.num_steps):
            with torch.no_grad():
                policy, value = agent(frame)
                action = policy.sample()
            frames[t], actions[t], values[t] = frame, action, value
            log_probs[t], real[t] = policy.log_prob(action), 1.0 - over
            seen, reward, terminated, truncated, info = envs.step(action.numpy())
            frame = torch.from_numpy(seen)
            rewards[t] = torch.from_numpy(reward).float()
            # A car that has ended begins anew in the next step, which teaches nothing.
            over = torch.from_numpy(terminated | truncated).float()
            ends[t] = over
            farthest += info["progress"][terminated | truncated].tolist()
        steps += int(real.sum())

        with torch.no_grad():
            following = agent(frame)[1]
        advantages, last = torch.zeros(shape), torch.zeros(o.num_envs)
        for t in reversed(range(o.num_steps)):
            goes_on = 1.0 - ends[t]
            delta = rewards[t] + gamma * following * goes_on - values[t]
            last = delta + gamma * lam * goes_on * last
            advantages[t], following = last, values[t]
        returns = advantages + values

        keep = real.flatten().bool()
        batch = [
            column.flatten(0, 1)[keep]
            for column in (frames, actions, log_probs, advantages, returns)
        ]
        for _ in range(epochs):
            for rows in torch.randperm(len(batch[0])).split(minibatch):
                x, a, old, adv, ret = (column[rows] for column in batch)
                policy, value = agent(x)
                ratio = (policy.log_prob(a) - old).exp()
                adv = (adv - adv.mean()) / (adv.std(correction=0) + 1e-8)
                surrogate = torch.min(ratio * adv, ratio.clamp(1 - clip, 1 + clip) * adv).mean()
                loss = (
                    -surrogate
                    + 0.5 * (value - ret).square().mean()
                    - entropy_weight * policy.entropy().mean()
                )
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimizer.step()

        recent = farthest[-50:]
        spent_s = time.perf_counter() - started_s
        print(
            f"update {update:3d}  {steps:6d} steps  {steps / spent_s:5.0f} steps/s  "
            f"progress {np.mean(recent) if recent else 0.0:5.1f} %  "
            f"laps {sum(p >= 100 for p in recent)}/{len(recent)}",
            flush=True,
        )
    envs.close()


if __name__ == "__main__":
    main()
