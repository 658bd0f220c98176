"""What a policy makes of observations."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from statistics import NormalDist
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from drcli.base.errors import SettingsError
from drcli.convert.build_network import build_policy, load_arrays, load_weights
from drcli.convert.policy_file import PolicyFile, read_policy_file
from drcli.convert.read_graph import read_graph
from drcli.convert.runtimes import policy_of_file
from drcli.convert.stored_checkpoint import driving_graph, load_checkpoint
from drcli.drive.build_race import actions_of, sensors_of_model
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.encoders import Head, Network
from drcli.learn.policy import Observation, Policy
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.network_shape import Design
from drcli.model.model_store import ModelStore
from drsim.car.actions import Actions, DiscreteActions
from drsim.sensing.sensors import Sensors

Float32s = NDArray[np.float32]
Float64s = NDArray[np.float64]

_DRAWS = tuple(NormalDist().inv_cdf((draw + 0.5) / 15) for draw in range(15))
"""Normal quantiles for draws of continuous actions, which are cut off at their range."""


@runtime_checkable
class GraphPolicy(Protocol):
    """A policy in an engine, without gradients."""

    def outputs(self, frames: NDArray[np.uint8], scans: Float32s) -> Float32s:
        """As `EnginePolicy.outputs`. Shape (n, num_actions)."""


class NotExplainable(ValueError):
    """The policy lacks what was asked for."""


@dataclass(frozen=True, eq=False)
class ExplainedPolicy:
    """A policy with its metadata.

    Attributes:
        is_complete: Has critic, and spread of continuous actions.
    """

    policy: Policy
    metadata: ModelMetadata
    is_complete: bool = True

    @cached_property
    def actions(self) -> Actions:
        return actions_of(self.metadata)

    @cached_property
    def sensors(self) -> Sensors:
        return sensors_of_model(self.metadata)

    @property
    def network(self) -> Network | None:
        """None without gradients."""
        return self.policy if isinstance(self.policy, Network) else None

    def squash(self, raw: Tensor) -> Tensor:
        return raw if self.network is None else self.network.squash(raw)

    @property
    def sees_value(self) -> bool:
        has_critic = self.network is not None and self.is_complete
        return has_critic and not self.policy.spec.state_dims


@dataclass(frozen=True, eq=False)
class PolicyOutputs:
    """What a policy makes of n observations; None where missing.

    Attributes:
        probabilities: Discrete. Shape (n, num_actions).
        chosen: Likeliest. Shape (n,).
        steering_deg: In an evaluation, left positive. Shape (n,).
        speed_mps: Shape (n,).
        expected: Mean of a training's draws of both. Shape (n, 2).
        low: Above 16 % of continuous draws. Shape (n, 2).
        high: Above 84 %. Shape (n, 2).
        entropy: Discrete, nats. Shape (n,).
        value: Discounted reward. Shape (n,).
    """

    probabilities: Float64s | None
    chosen: NDArray[np.int64] | None
    steering_deg: Float64s
    speed_mps: Float64s
    expected: Float64s
    low: Float64s | None
    high: Float64s | None
    entropy: Float64s | None
    value: Float64s | None

    @staticmethod
    def joined(parts: "Sequence[PolicyOutputs]") -> "PolicyOutputs":
        columns: dict[str, Any] = {
            name: None if first is None else np.concatenate([vars(part)[name] for part in parts])
            for name, first in vars(parts[0]).items()
        }
        return PolicyOutputs(**columns)


def head_of(subject: ExplainedPolicy, seen: Observation) -> Head:
    """Without a value where `seen` lacks the state."""
    policy = subject.policy
    if isinstance(policy, Network):
        judged = subject.is_complete and (not policy.spec.state_dims or seen.state.shape[1] > 0)
        head = policy.head(seen, judged=judged)
        return head if subject.is_complete else head._replace(std=None)
    if isinstance(policy, GraphPolicy):
        values = torch.from_numpy(policy.outputs(seen.frames.numpy(), seen.scan.numpy()))
        raw = values if policy.spec.continuous else values.clamp(min=1e-30).log()
        return Head(raw, None, None)
    raise NotExplainable(f"A policy of the class {type(policy).__name__} cannot be explained.")


def outputs_of(subject: ExplainedPolicy, seen: Observation) -> PolicyOutputs:
    with torch.no_grad():
        raw, std, worth = head_of(subject, seen)
    value = None if worth is None else _array(worth)
    if not subject.policy.spec.continuous:
        logits = raw.double()
        probabilities = _array(logits.softmax(-1))
        chosen = logits.argmax(-1).numpy()
        entropy = -(logits.softmax(-1) * logits.log_softmax(-1)).sum(-1)
        steering_deg, speed_mps = subject.actions.requests(chosen)
        return PolicyOutputs(
            probabilities,
            chosen,
            steering_deg,
            speed_mps,
            probabilities @ action_table(subject.actions),
            None,
            None,
            _array(entropy),
            value,
        )
    expected = _requests(subject, raw)
    steering_deg, speed_mps = expected.T
    low = high = None
    if std is not None:
        low, high = _requests(subject, raw - std), _requests(subject, raw + std)
        draws = [_requests(subject, raw + std * share) for share in _DRAWS]
        expected = np.mean(draws, axis=0)
    return PolicyOutputs(None, None, steering_deg, speed_mps, expected, low, high, None, value)


def action_table(actions: Actions) -> Float64s:
    """Degrees and m/s. Shape (num_actions, 2)."""
    assert isinstance(actions, DiscreteActions)
    return np.asarray(actions.choices, np.float64)


def range_widths(actions: Actions) -> Float64s:
    """Degrees and m/s per unit."""
    assert not isinstance(actions, DiscreteActions)
    ranges: Any = (actions.steering_deg, actions.speed_mps)
    return np.array([(high - low) / 2.0 for low, high in ranges])


def _requests(subject: ExplainedPolicy, raw: Tensor) -> Float64s:
    return np.stack(subject.actions.requests(subject.squash(raw).numpy()), axis=1)


def _array(values: Tensor) -> Float64s:
    array: Float64s = values.detach().double().numpy()
    return array


# Opens policies for explanation.


def open_policy(store: ModelStore, checkpoint: str) -> ExplainedPolicy:
    """The policy of a checkpoint, such as `5_Step-500`.

    Raises:
        ObjectMissing: A file of the model.
        ObjectDamaged: The checkpoint.
        ProblemsError: A parameter file is wrong.
        SettingsError: Weights and parameter files do not fit.
    """
    graph = driving_graph(store, checkpoint)
    if graph is not None:
        return ExplainedPolicy(policy_of_file(graph), graph.metadata, is_complete=False)
    found = load_checkpoint(store, checkpoint)
    design = Design.of_record(store, found.record)
    model = build_policy(design.metadata, design.parameters)
    load_weights(model, found.tensors, found.record.name)
    fresh_critic = bool(found.record.counters.critic_warmup)
    return ExplainedPolicy(model, design.metadata, is_complete=not fresh_critic)


def open_policy_file(path: Path, metadata: Path | None = None) -> ExplainedPolicy:
    """From a frozen graph, ONNX, OpenVINO, TensorFlow Lite or a car's archive.

    Frozen graphs of the reference and ours get gradients, but no critic. Others run in engines.

    Raises:
        SettingsError: File or metadata is missing, damaged, or unfit.
        NotAvailable: The engine is not installed.
    """
    file = read_policy_file(path, metadata)
    policy = _network(file) or policy_of_file(file)
    return ExplainedPolicy(policy, file.metadata, is_complete=False)


def _network(file: PolicyFile) -> ActorCritic | None:
    if file.form != "pb":
        return None
    try:
        found = read_graph(file.data, file.origin)
    except SettingsError:
        return None  # an engine may run it; if not, it says what is wrong with the file
    metadata, space = file.metadata, file.metadata.action_space
    theirs = found.num_actions, found.continuous, found.eyes, found.scan_dims
    if theirs != (space.num_actions, space.continuous, metadata.eyes, metadata.scan_dims):
        return None
    model = ActorCritic(found.spec)
    load_arrays(model, found.weights)
    return model.eval()
