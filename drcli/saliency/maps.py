"""Explanations of what a policy does with pictures."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from drcli.learn.policy import FRAME_HEIGHT, FRAME_WIDTH, Observation
from drcli.saliency.grad_cam import grad_cam
from drcli.saliency.perturbation import lidar_maps, perturbation_maps, unit_of
from drcli.saliency.policy_outputs import (
    ExplainedPolicy,
    Float32s,
    NotExplainable,
    PolicyOutputs,
    outputs_of,
)
from drcli.saliency.question import FINE_SPACING, METHODS, Method, Target

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
