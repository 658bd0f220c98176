"""The environments by the names that `gymnasium.make` and `gymnasium.make_vec` know."""

from typing import Any

import gymnasium as gym

from drsim.car.actions import ContinuousActions

ENVIRONMENTS: dict[str, dict[str, Any]] = {
    "drsim/DeepRacer-v0": {},
    "drsim/DeepRacerContinuous-v0": {"actions": ContinuousActions((-30.0, 30.0), (1.0, 2.0))},
    "drsim/DeepRacerObjectAvoidance-v0": {"race": "object_avoidance"},
    "drsim/DeepRacerHeadToBot-v0": {"race": "head_to_bot"},
}


def register() -> None:
    """Make the ids known; may be called again."""
    for name, arguments in ENVIRONMENTS.items():
        if name not in gym.registry:
            gym.register(
                name,
                entry_point="drsim.gym.racer:RacerEnv",
                vector_entry_point="drsim.gym.racer_vector:RacerVectorEnv",
                kwargs=arguments,
                # The environment checks its actions and its order of calls by itself.
                order_enforce=False,
                disable_env_checker=True,
            )
