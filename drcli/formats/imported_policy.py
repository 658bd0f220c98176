"""Makes the first checkpoint of a model from a policy of another system."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from safetensors.torch import save as save_tensors
from torch import nn

from drcli.base.errors import SettingsError
from drcli.base.fingerprint import Fingerprint
from drcli.exchange.checkpoint import CheckpointRecord, Counters
from drcli.formats.build_network import load_arrays, policy_spec
from drcli.formats.read_checkpoint import read_reference_checkpoint
from drcli.formats.read_graph import ReadPolicy, read_graph
from drcli.learn.actor_critic import ActorCritic
from drcli.modelfiles.hyperparameters import Hyperparameters
from drcli.modelfiles.model_metadata import LIDARS, SINGLE_CAMERAS, ModelMetadata
from drcli.store import keys

FIRST_STD = 0.25
"""Where a file has none, as a share of half the range. The reference begins with 1, which would
hide what a policy knows, and ends with about this.
"""

CRITIC_WARMUP = 2
"""Updates in which a fresh critic learns alone. Measured with a model of the reference that laps
four of five starts: without them its mean progress fell from 84 to 43 % for five iterations,
with two it stayed above 67 % and reached 94 % in the eighth; five only took longer.
"""

_SEED = 14
"""The same file gives the same weights."""


@dataclass(frozen=True)
class FittedMetadata:
    """Describes a policy, perhaps corrected; `warnings` say what."""

    data: bytes
    metadata: ModelMetadata
    warnings: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class FirstCheckpoint:
    """The weights to begin with, a safetensors file.

    Attributes:
        fresh: What the file did not have and how it begins.
        critic_warmup: As in `Counters`; None if there was a critic.
    """

    tensors: bytes
    fresh: list[str]
    critic_warmup: int | None


def read_frozen_graph(data: bytes, origin: str) -> ReadPolicy:
    """See `read_graph`."""
    return read_graph(data, origin)


def read_bundle_policy(index: bytes, data: Sequence[bytes], origin: str) -> ReadPolicy:
    """Read the reference's checkpoint; SettingsError if it cannot be trained here."""
    found = read_reference_checkpoint(index, data, origin)
    return ReadPolicy(
        network=found.network,
        sensors=found.sensors,
        eyes=found.eyes,
        scan_dims=found.scan_dims,
        num_actions=found.num_actions,
        continuous=found.continuous,
        algorithm=found.algorithm,
        weights=found.weights,
        # A fresh critic is reported by `first_checkpoint`.
        notes=[note for note in found.notes if not note.startswith("The critic ")],
    )


def same_policy(policy: ReadPolicy, graph: ReadPolicy) -> bool:
    """Whether both have exactly the same weights."""
    return all(
        name in policy.weights and np.array_equal(policy.weights[name], array)
        for name, array in graph.weights.items()
    )


def fit_metadata(data: bytes, origin: str, policy: ReadPolicy, model: str) -> FittedMetadata:
    """Check that model_metadata.json describes a policy.

    A wrong network is corrected, because the layers leave no doubt.

    Raises:
        ProblemsError: The file is wrong in itself.
        SettingsError: It describes another policy.
    """
    metadata = ModelMetadata.from_bytes(data, origin)
    remedy = "Give the model_metadata.json that the model was trained with, with --metadata FILE."
    theirs, ours = _sides(metadata), _sides_of(policy)
    for name, written in theirs.items():
        if written != ours[name]:
            raise SettingsError(
                f"{origin} has {name}{written}, but {model} has {name}{ours[name]}.", remedy=remedy
            )
    warnings = []
    camera = next(name for name in metadata.sensor if name not in LIDARS)
    if camera != policy.sensors[0]:
        warnings.append(
            f"{origin} calls the camera {camera}, {model} calls it {policy.sensors[0]}; both mean "
            "the same grey picture."
        )
    if metadata.neural_network != policy.network:
        warnings.append(
            f"{origin} has neural_network={metadata.neural_network}, but the layers of {model} are "
            f"those of {policy.network}: the model here gets the latter."
        )
        values: dict[str, Any] = json.loads(data.decode("utf-8-sig"))
        values["neural_network"] = policy.network
        data = json.dumps(values, indent=2).encode()
        metadata = ModelMetadata.from_bytes(data, origin)
    return FittedMetadata(data, metadata, warnings)


def fit_parameters(
    parameters: Hyperparameters, origin: str, policy: ReadPolicy, model: str
) -> tuple[Hyperparameters, list[str]]:
    """With the policy's frame stack, and a warning if it was another."""
    if parameters.stack_size == policy.stack:
        return parameters, []
    warning = (
        f"{origin} has stack_size={parameters.stack_size}, but {model} sees {policy.stack} "
        f"frame{'s' * (policy.stack > 1)} at a time: the model here gets the latter."
    )
    return parameters.model_copy(update={"stack_size": policy.stack}), [warning]


def first_checkpoint(
    policy: ReadPolicy, metadata: ModelMetadata, parameters: Hyperparameters
) -> FirstCheckpoint:
    """What the policy does not have is fresh."""
    generator = torch.random.get_rng_state()
    torch.manual_seed(_SEED)
    try:
        model = ActorCritic(policy_spec(metadata, parameters))
    finally:
        torch.random.set_rng_state(generator)
    weights = dict(policy.weights)
    fresh = ["The optimizer starts with an empty state."]
    has_critic = "value_head.weight" in weights and parameters.critic == "camera"
    if not has_critic:
        weights = {
            name: array
            for name, array in weights.items()
            if not name.startswith(("value_head.", "returns."))
        }
        fresh.insert(0, _FRESH_CRITIC)
        # A critic that expects nothing disturbs less than one that guesses: until it has learned,
        # the advantages are those of the returns, and no gradient of it reaches the body.
        head = model.value_head
        last = head[-1] if isinstance(head, nn.Sequential) else head
        for parameter in last.parameters():
            nn.init.zeros_(parameter)
    if policy.continuous and "log_std" not in weights:
        weights["log_std"] = np.full(policy.num_actions, math.log(FIRST_STD), np.float32)
        fresh.append(
            "The spread of the actions, which a frozen graph does not have: a standard deviation "
            f"of {FIRST_STD:g}, on a scale on which the range of each action is from -1 to 1."
        )
    load_arrays(model, weights)
    state = {name: tensor.contiguous() for name, tensor in model.state_dict().items()}
    return FirstCheckpoint(save_tensors(state), fresh, None if has_critic else CRITIC_WARMUP)


_FRESH_CRITIC = (
    "The critic: it uses the policy's body here, while the reference trains a body of its own for "
    "it. It learns alone in the first iterations, until it is useful."
)


def first_record(
    name: str, first: FirstCheckpoint, fitted: FittedMetadata, parameters: Hyperparameters
) -> CheckpointRecord:
    inputs = {
        keys.MODEL_METADATA_FILE: fitted.data.decode("utf-8-sig"),
        keys.HYPERPARAMETERS_FILE: parameters.canonical_json(fitted.metadata.training_algorithm),
    }
    counters = Counters(inputs=inputs, critic_warmup=first.critic_warmup)
    return CheckpointRecord(name, Fingerprint.of(first.tensors), counters=counters)


def _sides(metadata: ModelMetadata) -> dict[str, str]:
    space = metadata.action_space
    return {
        "training_algorithm=": metadata.training_algorithm,
        "": _actions(space.num_actions, continuous=space.continuous),
        "the sensors ": _sensors(metadata.sensor),
        "a lidar of ": f"{metadata.scan_dims} values",
    }


def _sides_of(policy: ReadPolicy) -> dict[str, str]:
    return {
        "training_algorithm=": policy.algorithm,
        "": _actions(policy.num_actions, continuous=policy.continuous),
        "the sensors ": _sensors(policy.sensors),
        "a lidar of ": f"{policy.scan_dims} values",
    }


def _actions(count: int, *, continuous: bool) -> str:
    kind = "continuous" if continuous else "discrete"
    return f"{count} {kind} action{'s' * (count != 1)}"


def _sensors(names: Sequence[str]) -> str:
    plain = ["FRONT_FACING_CAMERA" if name in SINGLE_CAMERAS else name for name in names]
    return " and ".join(sorted(plain, key=lambda name: name in LIDARS))
