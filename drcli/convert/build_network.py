"""Builds a model's network from its parameter files."""

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.torch import load as load_tensors
from torch import Tensor, nn

from drcli.base.errors import SettingsError
from drcli.learn.algorithms import algorithm_config
from drcli.learn.encoders import Network
from drcli.learn.learner import learner_of
from drcli.learn.policy import PolicySpec
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata

STATE_DIMS, TEACHER_DIMS = 22, 70
"""Repeated here because loading the simulator would cost the trainer 33 MB."""

TEACHER = "teacher."
_OF_CRITIC = (TEACHER, "value_head.", "returns.")
"""Not needed for driving."""


def policy_spec(metadata: ModelMetadata, parameters: Hyperparameters) -> PolicySpec:
    space = metadata.action_space
    return PolicySpec(
        num_actions=space.num_actions,
        continuous=space.continuous,
        network=metadata.neural_network,
        eyes=metadata.eyes,
        stack=parameters.stack_size,
        scan_dims=metadata.scan_dims,
        state_dims=TEACHER_DIMS
        if parameters.taught
        else STATE_DIMS
        if parameters.critic == "state"
        else 0,
        taught=parameters.taught,
    )


def build_policy(metadata: ModelMetadata, parameters: Hyperparameters) -> Network:
    """A network to drive with, without weights."""
    algorithm = metadata.algorithm
    config = algorithm_config(algorithm.config, parameters)
    return learner_of(algorithm).network(policy_spec(metadata, parameters), config).eval()


def load_weights(model: nn.Module, data: bytes, name: str) -> None:
    """Load a safetensors file; SettingsError if it has another network."""
    try:
        model.load_state_dict(_with_own_critic(model, load_tensors(data)))
    except (RuntimeError, SafetensorError) as error:
        what = str(error).strip().splitlines()[-1].strip()
        raise SettingsError(
            f"The weights of {name} do not fit model_metadata.json and hyperparameters.json: "
            f"{what}",
            remedy="Restore the files that the model was trained with, or train a new model under "
            "another DR_LOCAL_S3_MODEL_PREFIX.",
        ) from None


def _with_own_critic(model: nn.Module, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    if not _has_other_critic(model, tensors):
        return tensors
    own = model.state_dict()
    kept = {name: tensor for name, tensor in tensors.items() if not name.startswith(_OF_CRITIC)}
    return {name: tensor for name, tensor in own.items() if name.startswith(_OF_CRITIC)} | kept


def has_own_critic(model: nn.Module, data: bytes) -> bool:
    """Whether `load_weights` keeps the model's own critic, because teachers differ."""
    return _has_other_critic(model, load_tensors(data))


def _has_other_critic(model: nn.Module, tensors: Mapping[str, Tensor]) -> bool:
    own = model.state_dict()
    shapes, others = (
        {name: tensor.shape for name, tensor in each.items() if name.startswith(_OF_CRITIC)}
        for each in (own, tensors)
    )
    taught = any(name.startswith(TEACHER) for name in (*shapes, *others))
    return taught and shapes != others


def weights_of(model: nn.Module) -> dict[str, NDArray[np.float32]]:
    """Copies of all weights by name, float32, on the CPU."""
    return {
        name: tensor.detach().to("cpu", torch.float32).contiguous().numpy().copy()
        for name, tensor in model.state_dict().items()
    }


def load_arrays(model: nn.Module, weights: Mapping[str, NDArray[np.float32]]) -> None:
    """Weights that are not named stay."""
    tensors = {name: torch.from_numpy(np.array(array)) for name, array in weights.items()}
    model.load_state_dict(model.state_dict() | tensors)
