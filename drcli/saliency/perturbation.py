"""Perturbation maps: how much blurring a place changes the action.

Idea: Greydanus et al., 2018, "Visualizing and understanding Atari agents". It works for every
engine.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from drcli.learn.policy import FRAME_HEIGHT, FRAME_WIDTH, Observation
from drcli.saliency.policy_outputs import (
    ExplainedPolicy,
    Float32s,
    NotExplainable,
    outputs_of,
    range_widths,
)
from drcli.saliency.question import SPACINGS, Target

BLUR_PX = 8.0
"""Standard deviation; hides lines, which are about 15 pixels wide beside the car."""

_PATCH = 0.75
"""Standard deviation over distance, for even cover."""

_ROWS_AT_A_TIME = 128
"""Their activations stay in the cache."""

_LIDAR_GROUP = 4
"""One ray of 64 matters little."""


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
    sectors = lidar_sectors(subject)
    maps = np.zeros((len(seen.frames), sectors), np.float32)
    hides = torch.eye(sectors, dtype=torch.bool).repeat_interleave(values // sectors, dim=1)
    for step in range(len(seen.frames)):
        scans = torch.where(hides, empty, seen.scan[step])
        frames = seen.frames[step].expand(sectors, -1, -1, -1)
        maps[step] = _change(subject, seen, step, target, frames, scans)
    return maps


def lidar_sectors(subject: ExplainedPolicy) -> int:
    sensors = subject.sensors
    if sensors.lidar == "LIDAR":
        return sensors.num_values // _LIDAR_GROUP
    return sensors.num_values if sensors.lidar == "SECTOR_LIDAR" else sensors.num_sectors


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
