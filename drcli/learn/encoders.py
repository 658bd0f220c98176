"""Bodies of the networks, by their names in model_metadata.json, and what networks share."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from drcli.learn.policy import FRAME_HEIGHT, FRAME_WIDTH, Observation, PolicySpec

Convolution = tuple[int, int, int | tuple[int, int]]
"""Filters, kernel size and stride; without padding."""


@dataclass(frozen=True)
class Layers:
    """Convolutions, dense layers on every pixel, then on all features, lidar included."""

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
"""For one camera. The first three are the reference's.

The compact one has half the width. Its last convolution halves only the rows, because the road is
found by looking left and right. A forward and backward pass needs 24 instead of 129 MFLOP, and on
one core (minibatches of 64) about a fifth of the time.
"""

STEREO = MONO | {
    "DEEP_CONVOLUTIONAL_NETWORK": Layers(_STEREO),
    "DEEP_CONVOLUTIONAL_NETWORK_DEEP": Layers(_STEREO, dense=(256, 128)),
}
_LIDAR = (256, 256)
"""Source: the reference's lidar branch."""


FEWEST_FRAMES = 2
"""oneDNN adds up a single frame in another order."""

ROWS = {torch.float32: 16, torch.bfloat16: 32}
"""Fewer are slower for 20 cars, more for 4."""


class Dense(nn.Linear):
    """A dense layer that gives a row the same bits in any batch while it is in evaluation mode.

    The shape of a product decides in which order libraries add up, so a car would drive
    differently beside others.
    """

    def forward(self, x: Tensor) -> Tensor:
        weight, bias = self.weight, self.bias
        if self.training or x.is_cuda:
            return functional.linear(x, weight, bias)
        if x.dim() > 2:  # the pixels of one frame are rows enough
            frames = torch.split(x, 1)
            return torch.cat([functional.linear(frame, weight, bias) for frame in frames])
        rows = ROWS[weight.dtype]

        def product(some: Tensor) -> Tensor:
            lacking = rows - len(some)
            # The layout of a row decides as well.
            full = functional.pad(some, (0, 0, 0, lacking)) if lacking else some.contiguous()
            # In this order, few rows take two thirds of the time, and their places do not matter:
            # with AVX2, they do in large products in the other order.
            return torch.addmm(bias.unsqueeze(1), weight, full.t()).t()

        if len(x) <= rows:
            return product(x)[: len(x)]
        return torch.cat([product(some) for some in torch.split(x, rows)])[: len(x)]


class Encoder(nn.Module):
    """A body: ReLU after every layer, Glorot-uniform kernels and zero biases as in the reference.

    Channels last (TensorFlow's order), then the lidar.
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
        frames = seen.frames
        if not self.training and len(frames) < FEWEST_FRAMES:
            frames = frames[torch.arange(FEWEST_FRAMES).clamp(max=len(frames) - 1)]
        x = functional.relu(self._first(frames), inplace=True)
        for convolution in self.convolutions[1:]:
            x = functional.relu(convolution(x), inplace=True)
        x = x[: len(seen.frames)].permute(0, 2, 3, 1)
        x = _through(self.per_pixel, x).flatten(1)
        if len(self.lidar):
            x = torch.cat([x, _through(self.lidar, seen.scan.to(x.dtype))], dim=1)
        return _through(self.dense, x)

    @property
    def block(self) -> int:
        return int(cast(nn.Conv2d, self.convolutions[0]).stride[0])

    def _first(self, frames: Tensor) -> Tensor:
        """Channels last, as the first input decides for all layers, is two to four times as fast.

        Blocks are twice to ten times as fast in bfloat16 only, because products get enough
        channels.
        """
        first = cast(nn.Conv2d, self.convolutions[0])
        weight = first.weight / 255.0
        if weight.dtype is torch.bfloat16 and self.block > 1:
            cut = in_blocks(frames, self.block) if frames.dim() == 4 else frames
            count, _, height, width, _ = cut.shape
            pixels = cut.permute(0, 2, 3, 1, 4).reshape(count, height, width, -1).to(weight.dtype)
            return functional.conv2d(
                pixels.permute(0, 3, 1, 2), kernel_in_blocks(weight, self.block), first.bias
            )
        pixels = frames.to(weight.dtype, memory_format=torch.channels_last)
        if pixels.shape[1] == 1:
            pixels = pixels.squeeze(1).unsqueeze(-1).permute(0, 3, 1, 2)
        return functional.conv2d(pixels, weight, first.bias, stride=first.stride)


def compute_in(model: nn.Module, number_format: torch.dtype) -> None:
    """Convert the weights of bodies; heads keep float32.

    What was rounded stays so until weights are loaded again.
    """
    for module in model.modules():
        if isinstance(module, Encoder):
            module.to(number_format)


def in_blocks(frames: Tensor, size: int) -> Tensor:
    """Frames cut into square blocks, whose pixels follow each other row by row.

    From (n, c, height, width) to (n, c, height / size, width / size, size * size), uint8.
    """
    count, channels, height, width = frames.shape
    # Whole rows of blocks are moved as one number each, which is several times as fast.
    rows = frames.contiguous().view(_WHOLE[size])
    rows = rows.view(count, channels, height // size, size, width // size)
    cut = rows.transpose(3, 4).contiguous().view(torch.uint8)
    return cut.view(count, channels, height // size, width // size, size * size)


_WHOLE = {1: torch.uint8, 2: torch.int16, 4: torch.int32, 8: torch.int64}


def kernel_in_blocks(weight: Tensor, size: int) -> Tensor:
    """The kernel of a convolution with stride `size` for frames in blocks.

    From (filters, c, k, k) to (filters, c * size * size, m, m), m * size >= k.
    """
    filters, channels, kernel, _ = weight.shape
    count = -(-kernel // size)
    lacking = count * size - kernel
    if lacking:
        weight = functional.pad(weight, (0, lacking, 0, lacking))
    cut = weight.reshape(filters, channels, count, size, count, size).permute(0, 2, 4, 1, 3, 5)
    return cut.reshape(filters, count, count, -1).permute(0, 3, 1, 2)


def _dense(width: int, widths: Sequence[int]) -> nn.ModuleList:
    return nn.ModuleList(
        Dense(before, after) for before, after in zip((width, *widths), widths, strict=False)
    )


def _through(layers: nn.ModuleList, x: Tensor) -> Tensor:
    for layer in layers:
        x = functional.relu(layer(x), inplace=True)
    return x


def _with_present_names(
    encoder: nn.Module, tensors: dict[str, Tensor], prefix: str, *_: object
) -> None:
    """For checkpoints from when the shallow body was the only one."""
    old = {f"conv{number + 1}": f"convolutions.{number}" for number in range(3)}
    old["dense"] = "dense.0"
    for before, now in old.items():
        for kind in ("weight", "bias"):
            if f"{prefix}{before}.{kind}" in tensors:
                tensors[f"{prefix}{now}.{kind}"] = tensors.pop(f"{prefix}{before}.{kind}")


# What the networks of all algorithms have in common.


class Head(NamedTuple):
    """What a network makes of observations, with gradients.

    Attributes:
        raw: Logits, or means that `Network.squash` makes actions of. Shape (n, num_actions).
        std: Of continuous `raw`, else None. Shape (n, num_actions).
        value: In reward; None where nobody asked. Shape (n,).
    """

    raw: Tensor
    std: Tensor | None
    value: Tensor | None


class Network(nn.Module):
    """A `Policy` that can be trained, exported and explained."""

    spec: PolicySpec
    body: Encoder

    def act(
        self, seen: Observation, noise: Tensor, deterministic: Tensor, epsilon: float | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """See `Policy.act`."""
        raise NotImplementedError

    def head(self, seen: Observation, *, judged: bool = False) -> Head:
        """With a value if it is to be `judged`."""
        raise NotImplementedError

    def squash(self, raw: Tensor) -> Tensor:
        """Continuous actions, nominally in [-1, 1]."""
        return raw

    def outputs(self, seen: Observation) -> Tensor:
        """Probabilities, or continuous actions. Shape (n, num_actions)."""
        raw = self.head(seen).raw
        return self.squash(raw) if self.spec.continuous else raw.softmax(-1)
