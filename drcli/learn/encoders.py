"""Bodies of the networks, by their names in model_metadata.json: frames and scans to features."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from drcli.learn.policy import FRAME_HEIGHT, FRAME_WIDTH, Observation, PolicySpec

Convolution = tuple[int, int, int | tuple[int, int]]
"""Filters, kernel size and stride of a convolution without padding."""


@dataclass(frozen=True)
class Layers:
    """A body: convolutions, then dense layers on every pixel, flattening, then dense layers.

    Attributes:
        convolutions: The layers from the frame on.
        per_pixel: Widths of dense layers that act on the channels of each pixel.
        dense: Widths of dense layers on all features, lidar included; the last width is the number
            of features.
    """

    convolutions: tuple[Convolution, ...]
    per_pixel: tuple[int, ...] = ()
    dense: tuple[int, ...] = (512,)


_STEREO = ((32, 3, 1), (64, 3, 2), (64, 3, 1), (128, 3, 2), (128, 3, 1))

MONO = {
    "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW": Layers(((32, 8, 4), (64, 4, 2), (64, 3, 1))),
    "DEEP_CONVOLUTIONAL_NETWORK": Layers(
        ((32, 5, 2), (32, 3, 1), (64, 3, 2), (64, 3, 1)), per_pixel=(64,)
    ),
    "DEEP_CONVOLUTIONAL_NETWORK_DEEP": Layers(
        ((32, 8, 4), (32, 4, 2), (64, 4, 2), (64, 3, 1)),
        per_pixel=(512, 512),
        dense=(256, 128),
    ),
    "COMPACT_CONVOLUTIONAL_NETWORK": Layers(
        ((16, 8, 4), (32, 4, 2), (24, 3, (2, 1))), dense=(256,)
    ),
}
"""Bodies for one camera. The first three are the reference's.

The compact one is ours. It has the first convolutions of the shallow one at half their width. Its
last one halves the rows but not the columns, because the road is found by looking left and right
(trained to predict position and curvature of the road, it was better than one that halves both).
Its dense layer has a tenth of the weights. A forward and backward pass needs less than a fifth of
the arithmetic (24 instead of 129 MFLOP) and, on one core in minibatches of 64, a little more than a
fifth of the time.
"""

STEREO = MONO | {
    "DEEP_CONVOLUTIONAL_NETWORK": Layers(_STEREO),
    "DEEP_CONVOLUTIONAL_NETWORK_DEEP": Layers(_STEREO, dense=(256, 128)),
}
"""Bodies for two cameras."""

_LIDAR = (256, 256)
"""Dense layers on a lidar's values. Source: the reference's lidar branch."""


class Encoder(nn.Module):
    """A body: ReLU after every layer, Glorot-uniform kernels and zero biases as in the reference.

    The camera's features are flattened with channels last, which is also TensorFlow's order; the
    lidar's features follow them.

    Attributes:
        features: Number of features that come out.
    """

    def __init__(self, spec: PolicySpec) -> None:
        super().__init__()
        layers = (STEREO if spec.eyes == 2 else MONO)[spec.network]
        channels, height, width = spec.channels, FRAME_HEIGHT, FRAME_WIDTH
        convolutions = []
        for filters, kernel, stride in layers.convolutions:
            convolutions.append(nn.Conv2d(channels, filters, kernel, stride))
            rows, columns = convolutions[-1].stride
            height = (height - kernel) // rows + 1
            width = (width - kernel) // columns + 1
            channels = filters
        self.convolutions = nn.ModuleList(convolutions)
        self.per_pixel = _dense(channels, layers.per_pixel)
        channels = (channels, *layers.per_pixel)[-1]
        self.lidar = _dense(spec.scan_dims, _LIDAR if spec.scan_dims else ())
        flat = height * width * channels + (_LIDAR[-1] if spec.scan_dims else 0)
        self.dense = _dense(flat, layers.dense)
        self.features = layers.dense[-1]
        # The type is ignored because torch has no type for it.
        self.register_load_state_dict_pre_hook(_with_present_names)  # type: ignore[no-untyped-call]
        for name, parameter in self.named_parameters():
            if name.endswith("weight"):
                nn.init.xavier_uniform_(parameter)
            else:
                nn.init.zeros_(parameter)
            if parameter.dim() == 4:
                # oneDNN trains these convolutions two to four times faster with channels last.
                parameter.data = parameter.data.contiguous(memory_format=torch.channels_last)

    def forward(self, seen: Observation) -> Tensor:
        """Features of n observations. Shape (n, features)."""
        first, *others = (cast(nn.Conv2d, layer) for layer in self.convolutions)
        # The memory layout of the first input decides for all layers, and channels last makes them
        # two to four times as fast, even with a single channel. Scaling the kernel instead of the
        # pixels saves a pass over the batch. Cutting frames into blocks of 4 x 4 pixels, for a
        # kernel of 2 x 2 on 16 channels, was not faster.
        pixels = seen.frames.to(first.weight.dtype, memory_format=torch.channels_last)
        if pixels.shape[1] == 1:
            pixels = pixels.squeeze(1).unsqueeze(-1).permute(0, 3, 1, 2)
        x = functional.conv2d(pixels, first.weight / 255.0, first.bias, stride=first.stride)
        x = functional.relu(x, inplace=True)
        for convolution in others:
            x = functional.relu(convolution(x), inplace=True)
        x = x.permute(0, 2, 3, 1)
        x = _through(self.per_pixel, x).flatten(1)
        if len(self.lidar):
            x = torch.cat([x, _through(self.lidar, seen.scan)], dim=1)
        return _through(self.dense, x)


def _dense(width: int, widths: Sequence[int]) -> nn.ModuleList:
    return nn.ModuleList(
        nn.Linear(before, after) for before, after in zip((width, *widths), widths, strict=False)
    )


def _through(layers: nn.ModuleList, x: Tensor) -> Tensor:
    for layer in layers:
        x = functional.relu(layer(x), inplace=True)
    return x


def _with_present_names(
    encoder: nn.Module, tensors: dict[str, Tensor], prefix: str, *_: object
) -> None:
    """Rename the layers of old checkpoints, when the shallow body was the only one."""
    old = {f"conv{number + 1}": f"convolutions.{number}" for number in range(3)}
    old["dense"] = "dense.0"
    for before, now in old.items():
        for kind in ("weight", "bias"):
            if f"{prefix}{before}.{kind}" in tensors:
                tensors[f"{prefix}{now}.{kind}"] = tensors.pop(f"{prefix}{before}.{kind}")
