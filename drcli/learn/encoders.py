"""Bodies of the networks by the names of model_metadata.json: frames and scans to features."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from drcli.learn.policy import FRAME_HEIGHT, FRAME_WIDTH, Observation, PolicySpec


@dataclass(frozen=True)
class Convolution:
    """One convolutional layer with valid padding: filters, kernel size, stride.

    Attributes:
        filters: Channels that come out.
        kernel: Rows and columns of the kernel.
        stride: Of rows and columns, or one for both.
    """

    filters: int
    kernel: int
    stride: int | tuple[int, int]

    @property
    def strides(self) -> tuple[int, int]:
        """Stride of rows and stride of columns."""
        return self.stride if isinstance(self.stride, tuple) else (self.stride, self.stride)


@dataclass(frozen=True)
class Layers:
    """A body: convolutions, then dense layers on every pixel, flattening, then dense layers.

    Attributes:
        convolutions: From the frame on.
        per_pixel: Widths of dense layers that act on the channels of each pixel.
        dense: Widths of dense layers on all features, lidar included; the last one's is the
            number of features.
    """

    convolutions: tuple[Convolution, ...]
    per_pixel: tuple[int, ...] = ()
    dense: tuple[int, ...] = (512,)


def _convolutions(*layers: tuple[int, int, int | tuple[int, int]]) -> tuple[Convolution, ...]:
    return tuple(Convolution(*layer) for layer in layers)


_SHALLOW = Layers(_convolutions((32, 8, 4), (64, 4, 2), (64, 3, 1)))
_STEREO = _convolutions((32, 3, 1), (64, 3, 2), (64, 3, 1), (128, 3, 2), (128, 3, 1))

MONO = {
    "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW": _SHALLOW,
    "DEEP_CONVOLUTIONAL_NETWORK": Layers(
        _convolutions((32, 5, 2), (32, 3, 1), (64, 3, 2), (64, 3, 1)), per_pixel=(64,)
    ),
    "DEEP_CONVOLUTIONAL_NETWORK_DEEP": Layers(
        _convolutions((32, 8, 4), (32, 4, 2), (64, 4, 2), (64, 3, 1)),
        per_pixel=(512, 512),
        dense=(256, 128),
    ),
    "COMPACT_CONVOLUTIONAL_NETWORK": Layers(
        _convolutions((16, 8, 4), (32, 4, 2), (24, 3, (2, 1))), dense=(256,)
    ),
}
"""Bodies for one camera. The first three are the reference's.

The compact one is ours: the first convolutions of the shallow one at half their width, and a last
one that halves the rows once more but not the columns, because the road is found by looking left
and right (taught to tell place and bend of the road, it was ahead of one that halves both). The
dense layer behind it has a tenth of the weights. A forward and backward pass needs less than a
fifth of the arithmetic (24 instead of 129 MFLOP) and, on one core in minibatches of 64, a little
more than a fifth of the time.
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

    Features of the camera are flattened with channels last, which is also TensorFlow's order;
    those of the lidar follow them.

    Attributes:
        features: Length of what comes out.
    """

    def __init__(self, spec: PolicySpec) -> None:
        super().__init__()
        layers = (STEREO if spec.eyes == 2 else MONO)[spec.network]
        channels, height, width = spec.channels, FRAME_HEIGHT, FRAME_WIDTH
        convolutions = []
        for layer in layers.convolutions:
            rows, columns = layer.strides
            convolutions.append(nn.Conv2d(channels, layer.filters, layer.kernel, (rows, columns)))
            height = (height - layer.kernel) // rows + 1
            width = (width - layer.kernel) // columns + 1
            channels = layer.filters
        self.convolutions = nn.ModuleList(convolutions)
        self.per_pixel = _dense(channels, layers.per_pixel)
        channels = (channels, *layers.per_pixel)[-1]
        self.lidar = _dense(spec.scan_dims, _LIDAR if spec.scan_dims else ())
        flat = height * width * channels + (_LIDAR[-1] if spec.scan_dims else 0)
        self.dense = _dense(flat, layers.dense)
        self.features = layers.dense[-1]
        self.register_load_state_dict_pre_hook(_with_present_names)  # type: ignore[no-untyped-call]
        for name, parameter in self.named_parameters():
            if name.endswith("weight"):
                nn.init.xavier_uniform_(parameter)
            else:
                nn.init.zeros_(parameter)

    def forward(self, seen: Observation) -> Tensor:
        """Turn what is perceived into features.

        Args:
            seen: Frames and scans of n steps.

        Returns:
            Shape (n, features).
        """
        first, *others = (cast(nn.Conv2d, layer) for layer in self.convolutions)
        # Channels go last in memory, also a single one: what is laid out so decides for all
        # layers, and they are two to four times as fast. The kernel is scaled instead of the
        # pixels, which saves a pass over the batch. Cutting frames into blocks of 4 x 4 pixels,
        # for a kernel of 2 x 2 on 16 channels, was measured to be no faster.
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


def multiply_adds(encoder: Encoder) -> dict[str, int]:
    """Multiplications with addition that each layer of a body needs for one sample, by its name."""
    height, width = FRAME_HEIGHT, FRAME_WIDTH
    counts = {}
    for name, layer in encoder.named_modules():
        if isinstance(layer, nn.Conv2d):
            height = (height - layer.kernel_size[0]) // layer.stride[0] + 1
            width = (width - layer.kernel_size[1]) // layer.stride[1] + 1
            counts[name] = layer.weight.numel() * height * width
        elif isinstance(layer, nn.Linear):
            times = height * width if name.startswith("per_pixel.") else 1
            counts[name] = layer.weight.numel() * times
    return counts


def _with_present_names(
    encoder: nn.Module, tensors: dict[str, Tensor], prefix: str, *_: object
) -> None:
    """Rename the layers of checkpoints from before there was more than the shallow body."""
    old = {f"conv{number + 1}": f"convolutions.{number}" for number in range(3)} | {
        "dense": "dense.0"
    }
    for before, now in old.items():
        for kind in ("weight", "bias"):
            if f"{prefix}{before}.{kind}" in tensors:
                tensors[f"{prefix}{now}.{kind}"] = tensors.pop(f"{prefix}{before}.{kind}")
