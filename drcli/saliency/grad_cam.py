"""Grad-CAM and HiResCAM: where a network's convolutions see evidence.

Sources: Selvaraju et al., 2017, "Grad-CAM: Visual explanations from deep networks via
gradient-based localization"; Draelos and Carin, 2020, "Use HiResCAM instead of Grad-CAM for
faithful explanations of convolutional neural networks".
"""

from collections.abc import Sequence
from typing import cast

import torch
from torch import Tensor, nn

from drcli.learn.encoders import Encoder
from drcli.learn.policy import FRAME_HEIGHT, FRAME_WIDTH, Observation
from drcli.saliency.policy_outputs import (
    ExplainedPolicy,
    Float32s,
    Heads,
    NotExplainable,
    action_table,
    heads_of,
    range_widths,
)
from drcli.saliency.question import Target

LEAST_ROWS = 8
"""Of the convolution that is used. The deep network's last has 3 rows of 6 pixels, too few to tell
a line from the grass beside it.
"""


def grad_cam(
    subject: ExplainedPolicy, seen: Observation, target: Target = "action", *, averaged: bool = True
) -> Float32s:
    """Maps of n observations, not negative, shape (n, 120, 160).

    Grad-CAM averages the slopes of each channel over the picture, and so forgets where it matters.
    HiResCAM (`averaged=False`) suits our networks better: blurring the twentieth of the pixels
    that it marks most moved the actions of the three ready-made models two to five times as far
    (docs/saliency.md).

    Discrete actions: evidence for the action, in units of its logit. Otherwise, the size of
    evidence in either direction, over both dimensions for the action.

    Raises:
        NotExplainable: No gradients, or no critic that sees the picture.
    """
    network = subject.network
    if network is None:
        raise NotExplainable(
            "Grad-CAM needs gradients, which the graph of an engine does not have."
        )
    if target == "value" and not subject.sees_value:
        raise NotExplainable("The critic of this model does not see the picture.")
    with torch.enable_grad(), _Kept(network.body) as kept:
        heads = heads_of(subject, seen)
        total = torch.zeros(())
        features = kept.features()
        scores = _scores(subject, heads, target)
        for number, score in enumerate(scores):
            (slope,) = torch.autograd.grad(
                score.sum(), features, retain_graph=number + 1 < len(scores)
            )
            weights = slope.mean(dim=(2, 3), keepdim=True) if averaged else slope
            evidence = (weights * features.detach()).sum(dim=1)
            signed = target == "action" and heads.logits is not None
            total = total + (evidence.relu() if signed else evidence.abs())
    own = total[: len(seen.frames)]  # a body adds frames to a single one
    maps: Float32s = _over_picture(network.body, own).float().numpy()
    return maps


class _Kept:
    def __init__(self, body: Encoder) -> None:
        self._layer = body.convolutions[_layer(body)]
        self._found: list[Tensor] = []

    def __enter__(self) -> "_Kept":
        def keep(_module: nn.Module, _inputs: object, output: Tensor) -> None:
            self._found.append(output)

        self._hook = self._layer.register_forward_hook(keep)
        return self

    def __exit__(self, *_: object) -> None:
        self._hook.remove()

    def features(self) -> Tensor:
        return self._found[-1]


def _layer(body: Encoder) -> int:
    rows, chosen = FRAME_HEIGHT, 0
    for number, layer in enumerate(body.convolutions):
        convolution = cast(nn.Conv2d, layer)
        rows = (rows - convolution.kernel_size[0]) // convolution.stride[0] + 1
        if rows >= LEAST_ROWS:
            chosen = number
    return chosen


def _over_picture(body: Encoder, evidence: Tensor) -> Tensor:
    """Enlarge a convolution's map, shape (n, rows, columns).

    Without padding it does not reach the border: a pixel stands for the middle of what it sees.
    """
    weights = []
    for axis, pixels in enumerate((FRAME_HEIGHT, FRAME_WIDTH)):
        middle, step = 0.0, 1
        for layer in body.convolutions[: _layer(body) + 1]:
            convolution = cast(nn.Conv2d, layer)
            middle += (convolution.kernel_size[axis] - 1) / 2 * step
            step *= convolution.stride[axis]
        places = (torch.arange(pixels) - middle) / step
        count = evidence.shape[1 + axis]
        distance = (places.clamp(0, count - 1)[:, None] - torch.arange(count)).abs()
        weights.append((1.0 - distance).clamp(min=0.0))
    return weights[0] @ evidence @ weights[1].T


def _scores(subject: ExplainedPolicy, heads: Heads, target: Target) -> Sequence[Tensor]:
    if target == "value":
        assert heads.value is not None
        return [heads.value]
    if heads.logits is not None:
        if target == "action":
            best = heads.logits.argmax(-1, keepdim=True)
            return [heads.logits.gather(-1, best).squeeze(-1)]
        column = torch.from_numpy(action_table(subject.actions)[:, int(target == "speed")])
        return [heads.logits.softmax(-1) @ column.to(heads.logits.dtype)]
    assert heads.mean is not None
    if target == "action":
        return list(heads.mean.unbind(-1))
    dimension = int(target == "speed")
    return [heads.mean[:, dimension] * float(range_widths(subject.actions)[dimension])]
