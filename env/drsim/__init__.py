"""DeepRacer simulation on MuJoCo: cars, camera, tracks, reward parameters and episode rules."""

from drsim.actions import Actions, ContinuousActions, DiscreteActions
from drsim.car import CONTROL_HZ, CarBatch, CarParameters
from drsim.episode import EpisodeRules, Status
from drsim.errors import RewardError, TrackError
from drsim.race import TIME_TRIAL, BotRules, ObstacleRules, Race
from drsim.racer import RacerEnv
from drsim.racer_vector import RacerVectorEnv
from drsim.realism import Realism
from drsim.registration import register
from drsim.reward import (
    RewardFunction,
    RewardParams,
    centre_line_reward,
    checked_reward,
    load_reward_function,
)
from drsim.sensors import Sensors
from drsim.simulation import Simulation
from drsim.step import StepResult
from drsim.track import Track
from drsim.worlds import known_worlds, load_track

__all__ = [
    "CONTROL_HZ",
    "TIME_TRIAL",
    "Actions",
    "BotRules",
    "CarBatch",
    "CarParameters",
    "ContinuousActions",
    "DiscreteActions",
    "EpisodeRules",
    "ObstacleRules",
    "Race",
    "RacerEnv",
    "RacerVectorEnv",
    "Realism",
    "RewardError",
    "RewardFunction",
    "RewardParams",
    "Sensors",
    "Simulation",
    "Status",
    "StepResult",
    "Track",
    "TrackError",
    "centre_line_reward",
    "checked_reward",
    "known_worlds",
    "load_reward_function",
    "load_track",
]

register()
