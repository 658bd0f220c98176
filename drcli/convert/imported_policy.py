"""Makes the first checkpoint of a model from a policy of another system."""

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import save as save_tensors
from torch import nn

from drcli.base.errors import SettingsError, shown
from drcli.base.json_record import Fingerprint
from drcli.convert.build_network import load_arrays, policy_spec
from drcli.convert.read_graph import ReadPolicy, read_graph
from drcli.convert.reference_checkpoint import critic_from_variables, ours_from_variables
from drcli.convert.reference_layout import (
    BODIES,
    NETWORKS,
    RESCALER,
    Shape,
    differences,
    reference_layout,
)
from drcli.convert.tensorflow.bundle import Bundle, open_bundle
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.policy import PolicySpec
from drcli.model import keys
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.sensors import CAMERAS, LIDARS, eyes_of, usual_names
from drcli.records.checkpoint import CheckpointRecord, Counters

# Reads a policy from a TensorFlow checkpoint of the reference.


_NAME = re.compile(
    r"(?P<agent>main_level/agent(?:_\d+)?/main/)(?P<copy>online|global)/(?P<rest>.+)"
)
"""Trained alone (`online`) or by several processes (`global`)."""

_SAC = re.compile(r"main_level/agent(?:_\d+)?/(policy|q|v)/")

_SLOTS = re.compile(r".*/(Adam|Adam_1|RMSProp|RMSProp_1|Momentum)")
_REMEDY = "Name a checkpoint that the reference simulator or `dr-export tf-checkpoint` wrote."

_LISTED = 3


@dataclass(frozen=True)
class ReadCheckpoint:
    """A policy from a checkpoint.

    Attributes:
        network: As in model_metadata.json.
        sensors: The camera first.
        eyes: Cameras, 1 or 2.
        scan_dims: 0 without a lidar.
        weights: Under our names, without a critic if `fresh_critic`.
        notes: For the racer.
    """

    network: str
    sensors: tuple[str, ...]
    eyes: int
    scan_dims: int
    num_actions: int
    continuous: bool
    weights: dict[str, NDArray[np.float32]]
    fresh_critic: bool
    notes: list[str] = field(default_factory=list)
    algorithm: str = "clipped_ppo"


def read_reference_checkpoint(
    index: bytes, data: bytes | Sequence[bytes], origin: str
) -> ReadCheckpoint:
    """Read a policy from its `.index` and data files in order.

    Raises:
        SettingsError: It is damaged, or not one of the reference's networks.
    """
    bundle = open_bundle(index, origin)
    names = _names(bundle)
    shapes = {ours: bundle.entries[name].shape or () for ours, name in names.items()}
    sensors = _sensors(shapes, bundle.origin)
    policy = _spec(shapes, sensors, bundle.origin)
    notes: list[str] = []
    variables = {
        ours: _values(bundle, name, data, notes)
        for ours, name in names.items()
        if ours.startswith(BODIES)
    }
    weights = ours_from_variables(variables, policy, sensors)
    critic = critic_from_variables(variables)
    if critic is None:
        notes.append(
            "The critic starts fresh: the reference trains a body of its own for it, and ours uses "
            "the policy's."
        )
    others = len(bundle.entries) - len(variables)
    if others:
        notes.append(f"{others} other variables (optimizer, counters) are not used.")
    return ReadCheckpoint(
        policy.network,
        sensors,
        policy.eyes,
        policy.scan_dims,
        policy.num_actions,
        policy.continuous,
        weights | (critic or {}),
        critic is None,
        notes,
    )


def _names(bundle: Bundle) -> dict[str, str]:
    found: dict[tuple[str, str], dict[str, str]] = {}
    for name in bundle.entries:
        part = _NAME.fullmatch(name)
        if part and not _SLOTS.fullmatch(name):
            found.setdefault((part["agent"], part["copy"]), {})[part["rest"]] = name
    agents = sorted({agent for agent, _ in found})
    if len(agents) > 1:
        _refuse(bundle.origin, f"has several agents: {', '.join(agents)}")
    if agents:
        # `global` is the copy that several processes share; `online` is the one that drives.
        return found.get((agents[0], "online")) or found[agents[0], "global"]
    if any(_SAC.match(name) for name in bundle.entries):
        raise SettingsError(
            f"{bundle.origin} is a SAC model of the reference simulator, whose policy has other "
            "layers than ours.",
            remedy="Race its frozen graph, model_<N>.pb, as it is with `dr-evaluate --model FILE`.",
        )
    some = ", ".join(shown(name) for name in list(bundle.entries)[:_LISTED]) or "nothing"
    return _refuse(bundle.origin, f"has no policy of the reference simulator; it has {some}")


def _sensors(shapes: Mapping[str, Shape], origin: str) -> tuple[str, ...]:
    scopes = {name.split("/")[1] for name in shapes if name.startswith(BODIES[1])}
    scopes -= {"middleware_fc_embedder", "ppo_head_0", RESCALER}
    cameras = [name for name in CAMERAS if name in scopes]
    lidars = [name for name in LIDARS if name in scopes]
    unknown = sorted(scopes - {*cameras, *lidars})
    if unknown:
        _refuse(origin, f"has the unknown part network_1/{shown(unknown[0])}")
    if len(cameras) != 1 or len(lidars) > 1:
        names = ", ".join([*cameras, *lidars]) or "no sensor"
        _refuse(origin, f"has {names}; a policy here has one camera and at most one lidar")
    return (*cameras, *lidars)


def _spec(shapes: Mapping[str, Shape], sensors: Sequence[str], origin: str) -> PolicySpec:
    """SettingsError says how the most similar network differs."""
    head = BODIES[1] + "ppo_head_0/"
    heads = [name for name in shapes if name.startswith(head)]
    continuous = any("policy_mean" in name or "policy_log_std" in name for name in heads)
    kernel = f"{head}{'policy_mean' if continuous else 'policy_fc'}/kernel"
    num_actions = (shapes.get(kernel) or (0,))[-1]
    scan_dims = 0
    if len(sensors) > 1:
        scan_dims = (shapes.get(f"{BODIES[1]}{sensors[1]}/Dense_0/kernel") or (0,))[0]
    found = {name: shape for name, shape in shapes.items() if name.startswith(BODIES[1])}
    found.setdefault(BODIES[1] + RESCALER, ())
    fits: list[tuple[list[str], str]] = []
    for network in NETWORKS:
        wanted = reference_layout(
            network,
            sensors,
            scan_dims=scan_dims,
            num_actions=num_actions,
            continuous=continuous,
        )
        policy = {name: shape for name, shape in wanted.items() if name.startswith(BODIES[1])}
        fits.append((differences(found, policy), network))
    other, network = min(fits, key=lambda fit: len(fit[0]))
    if other:
        more = f" (and {len(other) - _LISTED} more differences)" if len(other) > _LISTED else ""
        _refuse(
            f"{origin}.index",
            f"is not a network of the reference simulator. Compared with {network}, the most "
            f"similar one: {'; '.join(other[:_LISTED])}{more}",
        )
    if num_actions < 1 or (len(sensors) > 1 and scan_dims < 1):
        _refuse(origin, "has a layer without inputs or outputs")
    return PolicySpec(num_actions, continuous, network, eyes_of(sensors), scan_dims=scan_dims)


def _values(
    bundle: Bundle, name: str, data: bytes | Sequence[bytes], notes: list[str]
) -> NDArray[np.float32]:
    values: NDArray[Any] = bundle.read(name, data)
    if values.dtype != np.float32:
        if values.dtype.kind != "f":
            _refuse(f"{bundle.origin}.index", f"has weights of {values.dtype}: {shown(name)}")
        note = f"Weights of {values.dtype} were converted to float32."
        if note not in notes:
            notes.append(note)
    with np.errstate(over="ignore"):
        values = values.astype(np.float32, copy=False)
    if not np.isfinite(values).all():
        raise SettingsError(
            f"{bundle.data_names[0]}: {shown(name)} has values that are not finite.",
            remedy="Choose an earlier checkpoint of that model.",
        )
    return values


def _refuse(origin: str, what: str) -> NoReturn:
    raise SettingsError(f"{origin} {what}.", remedy=_REMEDY)


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
        "the sensors ": _sensors_of_policy(metadata.sensor),
        "a lidar of ": f"{metadata.scan_dims} values",
    }


def _sides_of(policy: ReadPolicy) -> dict[str, str]:
    return {
        "training_algorithm=": policy.algorithm,
        "": _actions(policy.num_actions, continuous=policy.continuous),
        "the sensors ": _sensors_of_policy(policy.sensors),
        "a lidar of ": f"{policy.scan_dims} values",
    }


def _actions(count: int, *, continuous: bool) -> str:
    kind = "continuous" if continuous else "discrete"
    return f"{count} {kind} action{'s' * (count != 1)}"


def _sensors_of_policy(names: Sequence[str]) -> str:
    return " and ".join(usual_names(names))
