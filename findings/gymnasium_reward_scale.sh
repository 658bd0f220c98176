#!/usr/bin/env bash
# Gymnasium 1.4.0.
#
# What one expects: wrappers.vector.NormalizeReward divides rewards by the spread of discounted returns,
# each of which begins with its episode. When a vector environment resets a finished environment
# (its `autoreset_mode`) makes no difference.
# What happens: in NEXT_STEP, the usual mode, the sum of an episode that was truncated, as by a step
# limit, goes on in the next episode, and so on. If it was terminated, its last step forgets all rewards
# before, and the next episode begins with that step's reward. In SAME_STEP each begins with 0. So the
# same environment teaches with rewards of another scale.
#
# Output seen (each step gives reward 1, an episode has 5 steps, gamma is 1; the sums after each step,
# without steps that only reset):
#
#   NEXT_STEP, truncated: 1 2 3 4 5 | 6 7 8 9 10 | 11 12 13 14 15
#   NEXT_STEP, terminated: 1 2 3 4 1 | 2 3 4 5 1 | 2 3 4 5 1
#   SAME_STEP, truncated: 1 2 3 4 0 | 1 2 3 4 0 | 1 2 3 4 0
#   SAME_STEP, terminated: 1 2 3 4 0 | 1 2 3 4 0 | 1 2 3 4 0
#   reward 1 after 2,000 steps of truncated episodes of 50, gamma 0.99: NEXT_STEP 0.07, SAME_STEP 0.09
#
# It ends with 0 if the behaviour is as stated.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "gymnasium==1.4.0" "numpy==2.4.6"
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import NormalizeReward

NOTHING = np.zeros(1, np.float32)


class Fixed(gym.Env):
    """Gives 1 at each step, for so many steps."""

    observation_space = gym.spaces.Box(0, 1, (1,), np.float32)
    action_space = gym.spaces.Discrete(2)

    def __init__(self, steps: int, end: str) -> None:
        self.steps, self.end, self.at = steps, end, 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at = 0
        return NOTHING, {}

    def step(self, action):
        self.at += 1
        over = self.at == self.steps
        return NOTHING, 1.0, over and self.end == "terminated", over and self.end == "truncated", {}


def driven(mode, end, episodes, steps, gamma):
    """The sums of each episode, and the rewards of all steps that do not reset."""
    made = SyncVectorEnv([lambda: Fixed(steps, end)], autoreset_mode=mode)
    envs, sums, rewards, over = NormalizeReward(made, gamma=gamma), [[]], [], False
    envs.reset(seed=0)
    while len(sums) <= episodes:
        _, reward, terminated, truncated, _ = envs.step(np.zeros(1, np.int64))
        if not (over and mode is AutoresetMode.NEXT_STEP):
            sums[-1].append(float(envs.accumulated_reward[0]))
            rewards.append(float(reward[0]))
        over = bool(terminated[0] or truncated[0])
        if over:
            sums.append([])
    return sums[:episodes], rewards


WANTED = {
    ("NEXT_STEP", "truncated"): [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15],
    ("NEXT_STEP", "terminated"): [1, 2, 3, 4, 1, 2, 3, 4, 5, 1, 2, 3, 4, 5, 1],
    ("SAME_STEP", "truncated"): [1, 2, 3, 4, 0] * 3,
    ("SAME_STEP", "terminated"): [1, 2, 3, 4, 0] * 3,
}
good = True
for (mode, end), wanted in WANTED.items():
    sums, _ = driven(AutoresetMode[mode], end, 3, 5, 1.0)
    print(f"{mode}, {end}:", " | ".join(" ".join(f"{s:g}" for s in one) for one in sums))
    good = good and [s for one in sums for s in one] == wanted
last = {
    mode: driven(AutoresetMode[mode], "truncated", 40, 50, 0.99)[1][-1]
    for mode in ("NEXT_STEP", "SAME_STEP")
}
told = ", ".join(f"{mode} {reward:.2f}" for mode, reward in last.items())
print(f"reward 1 after 2,000 steps of truncated episodes of 50, gamma 0.99: {told}")
sys.exit(not good)
PYTHON
