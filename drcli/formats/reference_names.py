"""Names that the reference simulator gives to the layers of a policy.

Frozen graphs and checkpoints of the reference use the same names. Source: a frozen graph and a
checkpoint of the reference; those of the deep networks and of lidars follow from how the reference
numbers layers, and no file of theirs was at hand.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from drcli.learn.encoders import MONO, STEREO
from drcli.learn.policy import PolicySpec
from drcli.modelfiles.model_metadata import LIDARS

PPO_AGENT = "main_level/agent/main/online"
SAC_AGENT = "main_level/agent/policy/online"
"""Scopes of the two kinds of agents. Source: the car, which looks its inputs up by these names."""

VALUE_BODY, POLICY_BODY = "network_0", "network_1"
"""The reference trains two bodies; inputs lie below the first one."""

POLICY = "network_1/ppo_head_0/policy"
"""The output. The car looks for this name with SAC too."""

SENSORS = ("FRONT_FACING_CAMERA", "LEFT_CAMERA", "observation", "STEREO_CAMERAS", *LIDARS)


@dataclass(frozen=True)
class Layer:
    """A layer of a policy.

    Attributes:
        ours: Its name in our network; `.weight` and `.bias` follow.
        scope: Its name below the body; `/kernel` and `/bias` follow.
        activation: Name of its ReLU below the body, empty if it has none.
        stride: Rows and columns between two windows; None for a dense layer.
    """

    ours: str
    scope: str
    activation: str = ""
    stride: tuple[int, int] | None = None


@dataclass(frozen=True)
class Embedder:
    """The layers that turn one sensor's values into features."""

    sensor: str
    layers: tuple[Layer, ...]

    @property
    def is_lidar(self) -> bool:
        """Whether the sensor gives a row of values instead of a picture."""
        return self.sensor in LIDARS


def input_name(agent: str, sensor: str) -> str:
    """Name of the node that takes a sensor's values."""
    return f"{agent}/{VALUE_BODY}/{sensor}/{sensor}"


def embedders(spec: PolicySpec, sensors: Sequence[str]) -> list[Embedder]:
    """The embedders of a network, in the order in which the reference joins their features.

    `sensors` are those of model_metadata.json.
    """
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
    """The dense layers on all features."""
    widths = (STEREO if spec.eyes == 2 else MONO)[spec.network].dense
    return tuple(
        _layer(f"body.dense.{k}", "middleware_fc_embedder", "Dense", k) for k in range(len(widths))
    )


def policy_head(*, continuous: bool) -> Layer:
    """The last layer of PPO's policy."""
    return Layer("policy_head", f"ppo_head_0/{'policy_mean' if continuous else 'policy_fc'}")


def _layer(
    ours: str, scope: str, kind: str, number: int, stride: tuple[int, int] | None = None
) -> Layer:
    """A layer by its number within its scope.

    The reference's count includes an activation after each layer.
    """
    activation = f"{scope}/BatchnormActivationDropout_{2 * number + 1}_activation"
    return Layer(ours, f"{scope}/{kind}_{2 * number}", activation, stride)
