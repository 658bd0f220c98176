"""Observations of cars with cameras only."""

import torch
from torch import Tensor

from drcli.learn.policy import Observation


def camera_only(frames: Tensor) -> Observation:
    """The observation of cars that have neither lidar nor a critic that sees the state."""
    nothing = torch.empty((len(frames), 0), device=frames.device)
    return Observation(frames, nothing, nothing)
