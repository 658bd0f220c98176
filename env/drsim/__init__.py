"""DeepRacer simulation on MuJoCo: cars, camera, tracks, reward parameters and episode rules."""

from drsim.car.actions import Actions, ContinuousActions, DiscreteActions
from drsim.car.car import CONTROL_HZ, CarBatch
from drsim.car.car_parameters import CAR_SETS, DEFAULT_CAR, CarParameters, CarSet
from drsim.car.conditions import Conditions, Realism
from drsim.episode.episode_rules import EpisodeRules, Status, StepResult
from drsim.episode.load_reward import load_reward_function
from drsim.episode.reward import RewardFunction, RewardParams, centre_line_reward, checked_reward
from drsim.episode.simulation import Simulation
from drsim.errors import DiscardEpisode, RewardError, TrackError
from drsim.gym.racer import RacerEnv, register
from drsim.gym.racer_vector import RacerVectorEnv
from drsim.race.race import TIME_TRIAL, BotRules, ObstacleRules, Race
from drsim.sensing.sensors import Sensors
from drsim.track.track import Track
from drsim.track.worlds import known_worlds, load_track

__all__ = [
    "CAR_SETS",
    "CONTROL_HZ",
    "DEFAULT_CAR",
    "TIME_TRIAL",
    "Actions",
    "BotRules",
    "CarBatch",
    "CarParameters",
    "CarSet",
    "Conditions",
    "ContinuousActions",
    "DiscardEpisode",
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
