"""The learner of a training: one of the algorithms."""

from drcli.learn.ppo import PPO
from drcli.learn.sac import SAC

Learner = PPO | SAC
