"""Our weights as variables of the reference's PPO checkpoints, and back.

The reference has two bodies, for value and policy. Ours share one: an export writes it twice, an
import takes the policy's.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from drcli.base.errors import SettingsError
from drcli.convert.frozen_graph import first_dense_kernel
from drcli.convert.reference_layout import (
    BODIES,
    NETWORKS,
    RESCALER,
    SCOPE,
    differences,
    reference_layout,
)
from drcli.convert.reference_names import Layer, embedders, middleware, policy_head
from drcli.convert.tensorflow.bundle import DATA, INDEX, read_bundle, write_bundle
from drcli.learn.policy import PolicySpec

Array = NDArray[np.float32]
Weights = Mapping[str, Array]
VALUE_HEAD = "network_0/v_values_head_0/output"
LOG_STD = "network_1/ppo_head_0/policy_log_std"

_DISTILL = (
    f"Let {NETWORKS[0]}, which it has, learn from this model with `dr-export droa --distill` or "
    "`dr-export tf-checkpoint --distill`"
)


def refuse_other_networks(spec: PolicySpec, *, is_sac: bool) -> None:
    """SettingsError where layers differ from the reference's."""
    if is_sac:
        raise SettingsError(
            "training_algorithm=sac: our SAC policy has other layers than the reference "
            "simulator's, which would skip them without a word, so it cannot become a TensorFlow "
            "checkpoint.",
            remedy=f"{_DISTILL}. Or train with training_algorithm=clipped_ppo.",
        )
    if spec.network not in NETWORKS:
        raise SettingsError(
            f"neural_network={spec.network} does not exist in the reference simulator, so it "
            "cannot become a TensorFlow checkpoint.",
            remedy=f"{_DISTILL}. Or train with neural_network={NETWORKS[0]}.",
        )
    if spec.stack > 1:
        raise SettingsError(
            f"stack_size={spec.stack}: the reference simulator always shows a network one frame, "
            "so this model cannot become a TensorFlow checkpoint.",
            remedy=f"{_DISTILL}. Or train with stack_size=1 in hyperparameters.json.",
        )


def reference_variables(
    weights: Weights, spec: PolicySpec, sensors: Sequence[str]
) -> dict[str, Array]:
    """All variables by full name.

    Raises:
        SettingsError: The reference has no such network, or a weight is not a number.
    """
    refuse_other_networks(spec, is_sac="policy_head.weight" not in weights)
    found: dict[str, Array] = {}
    for body in BODIES:
        for layer, kernel in _kernels(weights, spec, sensors):
            _add(found, f"{body}{layer.scope}", kernel, weights[f"{layer.ours}.bias"])
        found[body + RESCALER] = np.array(1.0, np.float32)
    _add(found, VALUE_HEAD, *_value_head(weights, spec))
    head = policy_head(continuous=spec.continuous)
    _add(
        found,
        f"{BODIES[1]}{head.scope}",
        weights["policy_head.weight"].T,
        weights["policy_head.bias"],
    )
    if spec.continuous:
        found[LOG_STD] = weights["log_std"].reshape(1, -1)
    _compare(found, spec, sensors)
    return {SCOPE + name: _plain(name, array) for name, array in sorted(found.items())}


def encode_reference_checkpoint(variables: Mapping[str, Array]) -> dict[str, bytes]:
    """`.index` and data file, read back and compared."""
    index, data = write_bundle(variables)
    again = read_bundle(index, data, "the export")
    if again.keys() != variables.keys() or any(
        again[name].tobytes() != array.tobytes() for name, array in variables.items()
    ):
        raise AssertionError("the checkpoint that was written is not the one that is read")
    return {INDEX: index, DATA: data}


def export_notes(weights: Weights, spec: PolicySpec) -> list[str]:
    if spec.state_dims:
        return [
            "critic=state: the critic of this model sees the simulation's state, which the "
            "reference's cannot. Its value head starts at 0 there, so training on costs it some "
            "iterations; the policy is complete."
        ]
    if not weights["returns.scale"]:
        return [
            "The critic of this model has not learned yet, so its value head starts at 0 in the "
            "reference; the policy is complete."
        ]
    return [
        "The reference trains a body for the policy and one for the value; both got the one body "
        "of this model. The value is in units of reward."
    ]


def ours_from_variables(
    variables: Mapping[str, Array], spec: PolicySpec, sensors: Sequence[str]
) -> dict[str, Array]:
    """Our weights from variables named without `SCOPE`.

    Has a critic only if the value's body is the policy's, so that its head fits.
    """
    body = BODIES[1]
    order = embedders(spec, sensors)
    weights: dict[str, Array] = {}
    for embedder in order:
        for layer in embedder.layers:
            weights |= _ours(layer, body, variables)
    for layer in middleware(spec):
        weights |= _ours(layer, body, variables)
    if len(order) > 1 and order[0].is_lidar:
        # The reference joins features in the order of the sensors' names; ours are the camera's
        # before the lidar's.
        rows = weights["body.dense.0.weight"]
        lidar = weights["body.lidar.1.weight"].shape[0]
        weights["body.dense.0.weight"] = _copy(np.hstack([rows[:, lidar:], rows[:, :lidar]]))
    weights |= _ours(policy_head(continuous=spec.continuous), body, variables)
    if spec.continuous:
        weights["log_std"] = _copy(variables[LOG_STD].reshape(-1))
    return weights


def critic_from_variables(variables: Mapping[str, Array]) -> dict[str, Array] | None:
    """In units of reward, if it stands on the policy's body."""
    bodies = [
        {
            name.removeprefix(body): array
            for name, array in variables.items()
            if name.startswith(body)
        }
        for body in BODIES
    ]
    shared = [name for name in bodies[1] if not name.startswith("ppo_head_0/") and name != RESCALER]
    kernel, bias = variables.get(f"{VALUE_HEAD}/kernel"), variables.get(f"{VALUE_HEAD}/bias")
    if kernel is None or bias is None or not kernel.any():
        return None
    for name in shared:
        if name not in bodies[0] or not np.array_equal(bodies[0][name], bodies[1][name]):
            return None
    return {
        "value_head.weight": _copy(kernel.T),
        "value_head.bias": _copy(bias),
        "returns.scale": np.array(1.0, np.float32),
        "returns.weight": np.array(0.0, np.float32),
    }


def _kernels(
    weights: Weights, spec: PolicySpec, sensors: Sequence[str]
) -> list[tuple[Layer, Array]]:
    order = embedders(spec, sensors)
    found = []
    for embedder in order:
        for layer in embedder.layers:
            weight = weights[f"{layer.ours}.weight"]
            found.append((layer, weight.T if weight.ndim == 2 else weight.transpose(2, 3, 1, 0)))
    first, *others = middleware(spec)
    found.append((first, first_dense_kernel(weights, order)))
    found += [(layer, weights[f"{layer.ours}.weight"].T) for layer in others]
    return found


def _value_head(weights: Weights, spec: PolicySpec) -> tuple[Array, Array]:
    """In units of reward; zeros for a critic that sees the state."""
    if spec.state_dims:
        width = weights["policy_head.weight"].shape[1]
        return np.zeros((width, 1), np.float32), np.zeros(1, np.float32)
    scale = float(weights["returns.scale"])
    kernel, bias = (
        (scale * weights[f"value_head.{kind}"].astype(np.float64)).astype(np.float32)
        for kind in ("weight", "bias")
    )
    return kernel.T, bias


def _add(found: dict[str, Array], scope: str, kernel: Array, bias: Array) -> None:
    found[f"{scope}/kernel"] = kernel
    found[f"{scope}/bias"] = bias


def _compare(found: Mapping[str, Array], spec: PolicySpec, sensors: Sequence[str]) -> None:
    wanted = reference_layout(
        spec.network,
        sensors,
        scan_dims=spec.scan_dims,
        num_actions=spec.num_actions,
        continuous=spec.continuous,
    )
    other = differences({name: array.shape for name, array in found.items()}, wanted)
    if other:
        raise SettingsError(
            f"The reference simulator would not read this checkpoint completely: {other[0]}.",
            remedy="Check that model_metadata.json is the one that the model was trained with.",
        )


def _plain(name: str, array: Array) -> Array:
    if not np.isfinite(array).all():
        raise SettingsError(
            f"The weights of this checkpoint are damaged: {name} is not finite.",
            remedy="Choose an earlier checkpoint with -c N.",
        )
    return np.asarray(array, np.float32, order="C")


def _ours(layer: Layer, body: str, variables: Mapping[str, Array]) -> dict[str, Array]:
    kernel = variables[f"{body}{layer.scope}/kernel"]
    weight = kernel.T if kernel.ndim == 2 else kernel.transpose(3, 2, 0, 1)
    bias = variables[f"{body}{layer.scope}/bias"]
    return {f"{layer.ours}.weight": _copy(weight), f"{layer.ours}.bias": _copy(bias)}


def _copy(array: Array) -> Array:
    return np.array(array, np.float32, order="C")
