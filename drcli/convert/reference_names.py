"""Names of a policy's layers in the reference's frozen graphs and checkpoints.

Source: one of each; deep networks and lidars follow from how the reference numbers layers.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from drcli.learn.encoders import MONO, STEREO
from drcli.learn.policy import PolicySpec
from drcli.model.files.sensors import LIDARS

PPO_AGENT = "main_level/agent/main/online"
SAC_AGENT = "main_level/agent/policy/online"
"""Source: the car."""

VALUE_BODY, POLICY_BODY = "network_0", "network_1"
"""The reference trains two bodies; inputs lie below the first one."""

POLICY = "network_1/ppo_head_0/policy"
"""The car looks for this name with SAC too."""


@dataclass(frozen=True)
class Layer:
    """A layer of a policy.

    Attributes:
        ours: `.weight` and `.bias` follow.
        scope: Below the body; `/kernel` and `/bias` follow.
        activation: Its ReLU below the body, if any.
        stride: None for a dense layer.
    """

    ours: str
    scope: str
    activation: str = ""
    stride: tuple[int, int] | None = None


@dataclass(frozen=True)
class Embedder:
    """Makes features."""

    sensor: str
    layers: tuple[Layer, ...]

    @property
    def is_lidar(self) -> bool:
        return self.sensor in LIDARS


def input_name(agent: str, sensor: str) -> str:
    return f"{agent}/{VALUE_BODY}/{sensor}/{sensor}"


def embedders(spec: PolicySpec, sensors: Sequence[str]) -> list[Embedder]:
    """In the order in which the reference joins their features."""
    tables = (STEREO if spec.eyes == 2 else MONO)[spec.network]
    found = []
    for sensor in sorted(sensors):
        layers = []
        if sensor in LIDARS:
            names = [f"body.lidar.{number}" for number in range(2)]
            layers = [_layer(ours, sensor, "Dense", k) for k, ours in enumerate(names)]
        else:
            for k, (_, _, stride) in enumerate(tables.convolutions):
                both = stride if isinstance(stride, tuple) else (stride, stride)
                layers.append(_layer(f"body.convolutions.{k}", sensor, "Conv2d", k, both))
            for k in range(len(tables.per_pixel)):
                number = len(tables.convolutions) + k
                layers.append(_layer(f"body.per_pixel.{k}", sensor, "Dense", number))
        found.append(Embedder(sensor, tuple(layers)))
    return found


def middleware(spec: PolicySpec) -> tuple[Layer, ...]:
    widths = (STEREO if spec.eyes == 2 else MONO)[spec.network].dense
    return tuple(
        _layer(f"body.dense.{k}", "middleware_fc_embedder", "Dense", k) for k in range(len(widths))
    )


def policy_head(*, continuous: bool) -> Layer:
    return Layer("policy_head", f"ppo_head_0/{'policy_mean' if continuous else 'policy_fc'}")


def _layer(
    ours: str, scope: str, kind: str, number: int, stride: tuple[int, int] | None = None
) -> Layer:
    """The reference counts an activation after each layer."""
    activation = f"{scope}/BatchnormActivationDropout_{2 * number + 1}_activation"
    return Layer(ours, f"{scope}/{kind}_{2 * number}", activation, stride)
