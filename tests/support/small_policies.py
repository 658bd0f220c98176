"""Small networks with weights whose actions differ, and model_metadata.json for them."""

import json
from typing import Any

import torch

from drcli.learn.actor_critic import ActorCritic
from drcli.learn.policy import PolicySpec
from drcli.learn.sac_networks import SACAgent
from drcli.model.files.model_metadata import ModelMetadata
from drcli.transfer.export_forms import Network

ACTIONS = [{"steering_angle": angle, "speed": 2.0} for angle in (-20.0, -10.0, 0.0, 10.0, 20.0)]
RANGES = {"steering_angle": {"low": -30, "high": 30}, "speed": {"low": 1, "high": 3}}


def metadata_json(head: str = "discrete", **changes: Any) -> bytes:
    """The file of a model with five actions, or with continuous ones."""
    values = {
        "action_space": ACTIONS if head == "discrete" else RANGES,
        "action_space_type": "discrete" if head == "discrete" else "continuous",
        "sensor": ["FRONT_FACING_CAMERA"],
        "neural_network": "COMPACT_CONVOLUTIONAL_NETWORK",
        "training_algorithm": "sac" if head == "sac" else "clipped_ppo",
        "version": "5",
    }
    return json.dumps({**values, **changes}).encode()


def small_metadata(head: str = "discrete", **changes: Any) -> ModelMetadata:
    """The same, read."""
    return ModelMetadata.from_bytes(metadata_json(head, **changes))


def small_network(metadata: ModelMetadata, *, stack: int = 1) -> Network:
    """A network whose output depends on its input about as much as a trained one's."""
    torch.manual_seed(5)
    space = metadata.action_space
    spec = PolicySpec(
        space.num_actions,
        space.continuous,
        metadata.neural_network,
        metadata.eyes,
        stack,
        metadata.scan_dims,
    )
    model = (SACAgent if metadata.training_algorithm == "sac" else ActorCritic)(spec).eval()
    with torch.no_grad():
        for parameter in model.parameters():
            if parameter.dim() == 1:
                parameter += 0.02 * torch.randn_like(parameter)
            elif parameter.dim() > 1:
                parameter *= 1.3
        if isinstance(model, ActorCritic):
            model.policy_head.weight *= 30.0
    return model
