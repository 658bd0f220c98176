"""Explanations of what a policy does with pictures."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from drcli.learn.encoders import Encoder, Head
from drcli.learn.policy import FRAME_HEIGHT, FRAME_WIDTH, Observation
from drcli.view.saliency.policy_outputs import (
    ExplainedPolicy,
    Float32s,
    NotExplainable,
    PolicyOutputs,
    action_table,
    head_of,
    outputs_of,
    range_widths,
)
from drcli.view.saliency.saliency_options import FINE_SPACING, METHODS, SPACINGS, Method, Target

# Grad-CAM and HiResCAM: where a network's convolutions see evidence.
#
# Sources: Selvaraju et al., 2017, "Grad-CAM: Visual explanations from deep networks via
# gradient-based localization"; Draelos and Carin, 2020, "Use HiResCAM instead of Grad-CAM for
# faithful explanations of convolutional neural networks".


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
    kept: list[Tensor] = []

    def keep(_module: nn.Module, _inputs: object, output: Tensor) -> None:
        kept.append(output)

    layer = network.body.convolutions[_layer(network.body)]
    with torch.enable_grad(), layer.register_forward_hook(keep):
        head = head_of(subject, seen)
        total = torch.zeros(())
        features = kept[-1]
        scores = _scores(subject, head, target)
        for number, score in enumerate(scores):
            (slope,) = torch.autograd.grad(
                score.sum(), features, retain_graph=number + 1 < len(scores)
            )
            weights = slope.mean(dim=(2, 3), keepdim=True) if averaged else slope
            evidence = (weights * features.detach()).sum(dim=1)
            signed = target == "action" and not subject.policy.spec.continuous
            total = total + (evidence.relu() if signed else evidence.abs())
    own = total[: len(seen.frames)]  # a body adds frames to a single one
    maps: Float32s = _over_picture(network.body, own).float().numpy()
    return maps


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


def _scores(subject: ExplainedPolicy, head: Head, target: Target) -> Sequence[Tensor]:
    if target == "value":
        assert head.value is not None
        return [head.value]
    if not subject.policy.spec.continuous:
        if target == "action":
            best = head.raw.argmax(-1, keepdim=True)
            return [head.raw.gather(-1, best).squeeze(-1)]
        column = torch.from_numpy(action_table(subject.actions)[:, int(target == "speed")])
        return [head.raw.softmax(-1) @ column.to(head.raw.dtype)]
    mean = subject.squash(head.raw)
    if target == "action":
        return list(mean.unbind(-1))
    dimension = int(target == "speed")
    return [mean[:, dimension] * float(range_widths(subject.actions)[dimension])]


# Perturbation maps: how much blurring a place changes the action.
#
# Idea: Greydanus et al., 2018, "Visualizing and understanding Atari agents". It works for every
# engine.


BLUR_PX = 8.0
"""Standard deviation; hides lines, which are about 15 pixels wide beside the car."""

_PATCH = 0.75
"""Standard deviation over distance, for even cover."""

_ROWS_AT_A_TIME = 128
"""Their activations stay in the cache."""


def perturbation_maps(
    subject: ExplainedPolicy, seen: Observation, target: Target = "action", spacing: int = 8
) -> Float32s:
    """How much blurring around pixels changes the output, in `unit_of(target)`.

    A spacing of SPACINGS takes (120 / spacing) * (160 / spacing) passes for each camera.

    Returns:
        Shape (n, eyes, 120, 160).

    Raises:
        NotExplainable: No critic sees the picture.
        ValueError: The spacing is none of SPACINGS.
    """
    if spacing not in SPACINGS:
        raise ValueError(f"spacing is {spacing}; it must be one of {SPACINGS}.")
    _check(subject, target)
    eyes = subject.policy.spec.eyes
    masks = _masks(spacing)
    maps = np.zeros((len(seen.frames), eyes, FRAME_HEIGHT, FRAME_WIDTH), np.float32)
    rows, columns = FRAME_HEIGHT // spacing, FRAME_WIDTH // spacing
    for step in range(len(seen.frames)):
        frames = seen.frames[step].numpy()
        blurred = _blurred(frames)
        for eye in range(eyes):
            changes = [
                _change(subject, seen, step, target, _hidden(frames, blurred, part, eye, eyes))
                for part in np.array_split(masks, -(-len(masks) // _ROWS_AT_A_TIME))
            ]
            grid = torch.from_numpy(np.concatenate(changes)).view(1, 1, rows, columns)
            whole = functional.interpolate(
                grid.float(), (FRAME_HEIGHT, FRAME_WIDTH), mode="bilinear", align_corners=False
            )
            maps[step, eye] = whole[0, 0].numpy()
    return maps


def lidar_maps(
    subject: ExplainedPolicy, seen: Observation, target: Target = "action"
) -> Float32s | None:
    """Change of the output when a sector meets nothing, counter-clockwise, shape (n, sectors).

    Raises:
        NotExplainable: No critic sees the lidar.
    """
    lidar = subject.sensors.lidar
    if lidar is None:
        return None
    _check(subject, target)
    nothing = np.full((1, len(subject.sensors.lidar_model.bearings_rad)), np.inf, np.float32)
    empty = torch.from_numpy(subject.sensors.process(nothing)[0])
    values = len(empty)
    sectors = subject.sensors.sectors
    maps = np.zeros((len(seen.frames), sectors), np.float32)
    hides = torch.eye(sectors, dtype=torch.bool).repeat_interleave(values // sectors, dim=1)
    for step in range(len(seen.frames)):
        scans = torch.where(hides, empty, seen.scan[step])
        frames = seen.frames[step].expand(sectors, -1, -1, -1)
        maps[step] = _change(subject, seen, step, target, frames, scans)
    return maps


def unit_of(target: Target, *, continuous: bool) -> str:
    if target == "action":
        return "of the range" if continuous else "of the probability"
    return {"steering": "degrees", "speed": "m/s", "value": "reward"}[target]


def _check(subject: ExplainedPolicy, target: Target) -> None:
    if target == "value" and not subject.sees_value:
        raise NotExplainable(
            "The critic of this model does not see the picture."
            if subject.network is not None and subject.is_complete
            else "There is no critic in the file of a policy."
        )


def _masks(spacing: int) -> Float32s:
    """Shape (patches, 120, 160)."""
    row, column = (
        np.exp(
            -0.5
            * ((np.arange(pixels) - np.arange(spacing / 2 - 0.5, pixels, spacing)[:, None]) ** 2)
            / (_PATCH * spacing) ** 2
        ).astype(np.float32)
        for pixels in (FRAME_HEIGHT, FRAME_WIDTH)
    )
    whole = row[:, None, :, None] * column[None, :, None, :]
    return whole.reshape(-1, FRAME_HEIGHT, FRAME_WIDTH)


def _blurred(frames: NDArray[np.uint8]) -> Float32s:
    reach = int(3 * BLUR_PX)
    weights = torch.exp(-0.5 * (torch.arange(-reach, reach + 1) / BLUR_PX) ** 2)
    kernel = (weights / weights.sum()).view(1, 1, 1, -1)
    x = torch.from_numpy(frames.astype(np.float32)).unsqueeze(1)
    x = functional.pad(x, (reach, reach, reach, reach), mode="replicate")
    x = functional.conv2d(functional.conv2d(x, kernel), kernel.transpose(2, 3))
    pixels: Float32s = x.squeeze(1).numpy()
    return pixels


def _hidden(
    frames: NDArray[np.uint8], blurred: Float32s, masks: Float32s, eye: int, eyes: int
) -> Tensor:
    """Shape (patches, ...)."""
    several = np.repeat(frames[None], len(masks), axis=0)
    own = slice(eye, None, eyes)  # all frames of a stack, in each of which the left eye is first
    sharp = frames[own].astype(np.float32)
    mixed = sharp + masks[:, None] * (blurred[own] - sharp)
    several[:, own] = np.rint(mixed).astype(np.uint8)
    return torch.from_numpy(several)


def _change(
    subject: ExplainedPolicy,
    seen: Observation,
    step: int,
    target: Target,
    frames: Tensor,
    scans: Tensor | None = None,
) -> Float32s:
    """Shape (changes,).

    The step itself is in the same batch, as rounding depends on the number of rows.
    """
    count = len(frames) + 1
    scans = seen.scan[step].expand(count - 1, -1) if scans is None else scans
    several = Observation(
        torch.cat([seen.frames[step : step + 1], frames]),
        torch.cat([seen.scan[step : step + 1], scans]),
        seen.state[step].expand(count, -1),
    )
    outputs = outputs_of(subject, several)
    if target == "value":
        assert outputs.value is not None
        difference = np.abs(outputs.value[1:] - outputs.value[0])
    elif target != "action":
        column = int(target == "speed")
        difference = np.abs(outputs.expected[1:, column] - outputs.expected[0, column])
    elif outputs.probabilities is not None:
        # Total variation: the probability that moves to other actions.
        moved = np.abs(outputs.probabilities[1:] - outputs.probabilities[0])
        difference = 0.5 * moved.sum(axis=1)
    else:
        units = np.maximum(range_widths(subject.actions), 1e-9)
        moved = np.abs(outputs.expected[1:] - outputs.expected[0]) / units / 2.0
        difference = moved.mean(axis=1)
    values: Float32s = difference.astype(np.float32)
    return values


_STEPS_AT_A_TIME = 32
"""With gradients: bounds memory."""


@dataclass(frozen=True, eq=False)
class SaliencyMaps:
    """Explanations of n observations.

    Attributes:
        maps: "perturbation": change of the output if a pixel's surroundings are blurred; others:
            evidence, for both cameras. Not negative. Shape (n, eyes, 120, 160).
        lidar: Change if a sector meets nothing; may be None. Shape (n, sectors).
        unit: Of "perturbation" and `lidar`.
    """

    target: Target
    outputs: PolicyOutputs
    maps: Mapping[Method, Float32s]
    lidar: Float32s | None
    unit: str


def saliency_maps(
    subject: ExplainedPolicy,
    frames: NDArray[np.uint8],
    scans: Float32s | None = None,
    states: Float32s | None = None,
    *,
    methods: Collection[Method] = METHODS,
    target: Target = "action",
    spacing: int = FINE_SPACING,
) -> SaliencyMaps:
    """Explain what a policy makes of pictures.

    Args:
        subject: As from `open_policy`.
        frames: Oldest frame of a stack first, left camera before right. Shape (n, stack * eyes,
            120, 160).
        scans: Shape (n, scan_dims).
        states: For the critic. Shape (n, state_dims).
        methods: Perturbation takes hundreds of passes for each observation, others three.
        target: What is explained.
        spacing: As in `perturbation_maps`.

    Raises:
        NotExplainable: Gradients (without perturbation) or a seeing critic are missing.
        ValueError: The arrays do not fit.
    """
    seen = _observation(subject, frames, scans, states)
    by_slopes = [method for method in methods if method != "perturbation"]
    if subject.network is None and len(by_slopes) < len(methods):
        by_slopes = []  # the engine's graph has no gradients, and there is another map
    maps: dict[Method, Float32s] = {}
    lidar = None
    if "perturbation" in methods:
        maps["perturbation"] = perturbation_maps(subject, seen, target, spacing)
        lidar = lidar_maps(subject, seen, target)
    for method in by_slopes:
        parts = [
            grad_cam(
                subject,
                seen.part(slice(begin, begin + _STEPS_AT_A_TIME)),
                target,
                averaged=method == "grad-cam",
            )
            for begin in range(0, len(frames), _STEPS_AT_A_TIME)
        ]
        shared = np.concatenate([np.empty((0, FRAME_HEIGHT, FRAME_WIDTH), np.float32), *parts])
        maps[method] = shared[:, None].repeat(subject.policy.spec.eyes, axis=1)
    return SaliencyMaps(
        target,
        outputs_of(subject, seen),
        maps,
        lidar,
        unit_of(target, continuous=subject.policy.spec.continuous),
    )


def _observation(
    subject: ExplainedPolicy,
    frames: NDArray[np.uint8],
    scans: Float32s | None,
    states: Float32s | None,
) -> Observation:
    spec, count = subject.policy.spec, len(frames)
    shape = (spec.channels, FRAME_HEIGHT, FRAME_WIDTH)
    if frames.dtype != np.uint8 or frames.shape[1:] != shape:
        raise ValueError(
            f"frames are {frames.dtype} of the shape {frames.shape}; the policy takes uint8 of the "
            f"shape (n, {spec.channels}, 120, 160)."
        )
    scans = np.empty((count, 0), np.float32) if scans is None else scans
    states = np.empty((count, 0), np.float32) if states is None else states
    if scans.shape != (count, spec.scan_dims):
        raise ValueError(f"scans have the shape {scans.shape}, not ({count}, {spec.scan_dims}).")
    if states.shape not in ((count, 0), (count, spec.state_dims)):
        raise ValueError(f"states have the shape {states.shape}, not ({count}, {spec.state_dims}).")
    return Observation(
        *(torch.from_numpy(np.ascontiguousarray(array)) for array in (frames, scans, states))
    )


__all__ = [
    "METHODS",
    "ExplainedPolicy",
    "Method",
    "NotExplainable",
    "PolicyOutputs",
    "SaliencyMaps",
    "Target",
    "saliency_maps",
]
