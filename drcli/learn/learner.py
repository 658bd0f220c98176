"""The learner of a training: one of the algorithms."""

from drcli.learn.ppo import PPO
from drcli.learn.sac import SAC
from drcli.learn.taught import TaughtLearner

Learner = PPO | SAC | TaughtLearner
