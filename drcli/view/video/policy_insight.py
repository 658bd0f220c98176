"""A policy's choices on a recorded lap, and the pixels that moved them."""

from collections.abc import Iterator

import numpy as np
import torch

from drcli.learn.policy import Observation
from drcli.view.saliency.explanation_pictures import full_of, overlay
from drcli.view.saliency.maps import saliency_maps
from drcli.view.saliency.policy_outputs import (
    ExplainedPolicy,
    NotExplainable,
    PolicyOutputs,
    outputs_of,
)
from drcli.view.saliency.saliency_options import Method
from drcli.view.video.film import Insight
from drcli.view.video.recorded_lap import RecordedLap
from drsim.arrays import Bytes, Ints, Singles
from drsim.car.actions import DiscreteActions
from drsim.viewing.car_eye import CarEye

_AT_A_TIME = 64

_NETWORK: tuple[Method, ...] = ("hires-cam",)
_ANY: tuple[Method, ...] = ("perturbation",)
_COARSE = 20
"""Perturbation grid, pixels: one evaluation per place."""


def look_through(
    subject: ExplainedPolicy, eye: CarEye, lap: RecordedLap, *, explain: bool
) -> tuple[Insight, Bytes, tuple[tuple[float, float], ...]]:
    """Show a policy a lap's pictures, made anew from poses; `explain` adds maps.

    Returns:
        What it made of them, the pictures, grey or RGB with maps, and its discrete actions.
    """
    spec, sensors = subject.policy.spec, subject.sensors
    frames = eye.frames(lap.poses, lap.objects, spec.eyes)
    scans = eye.scans(lap.poses, lap.objects, sensors)
    states = np.zeros((len(frames), 0), np.float32)
    outputs = PolicyOutputs.joined(
        [
            outputs_of(
                subject,
                Observation.of_arrays(
                    _stacked(frames, part, spec.stack), scans[part], states[part]
                ),
            )
            for part in _parts(len(frames))
        ]
    )
    asked = np.stack([outputs.steering_deg, outputs.speed_mps], axis=1).astype(np.float64)
    insight = Insight(outputs.probabilities, asked, outputs.low, outputs.high, outputs.value)
    camera = frames[:, 0]
    if explain:
        camera = _explained(subject, frames, scans, states)
    actions: tuple[tuple[float, float], ...] = ()
    if isinstance(subject.actions, DiscreteActions):
        actions = tuple((float(a), float(b)) for a, b in subject.actions.choices)
    return insight, camera, actions


def _parts(count: int) -> Iterator[Ints]:
    """Some pictures at a time: all stacks take gigabytes."""
    for first in range(0, count, _AT_A_TIME):
        yield np.arange(first, min(first + _AT_A_TIME, count))


def _stacked(frames: Bytes, rows: Ints, stack: int) -> Bytes:
    """Oldest first. Shape (len(rows), stack * eyes, 120, 160)."""
    parts = [frames[np.maximum(rows - back, 0)] for back in reversed(range(stack))]
    return np.concatenate(parts, axis=1)


def _explained(
    subject: ExplainedPolicy,
    frames: Bytes,
    scans: Singles,
    states: Singles,
) -> Bytes:
    with torch.inference_mode(False):
        maps = np.concatenate(
            [
                action_maps(
                    subject,
                    _stacked(frames, part, subject.policy.spec.stack),
                    scans[part],
                    states[part],
                )
                for part in _parts(len(frames))
            ]
        )
    full = full_of(maps)
    shown = np.empty((*maps.shape, 3), np.uint8)
    for number, values in enumerate(maps):
        shown[number] = overlay(frames[number, 0], values, full)
    return shown


def action_maps(
    subject: ExplainedPolicy,
    frames: Bytes,
    scans: Singles,
    states: Singles,
) -> Singles:
    """By gradients where there are any, else by perturbation."""
    try:
        found = saliency_maps(subject, frames, scans, states, methods=_NETWORK)
        return np.asarray(found.maps["hires-cam"].max(axis=1))
    except (NotExplainable, KeyError):
        found = saliency_maps(subject, frames, scans, states, methods=_ANY, spacing=_COARSE)
        return np.asarray(found.maps["perturbation"].max(axis=1))
