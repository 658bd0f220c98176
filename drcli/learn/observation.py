"""What a policy perceives at a time, and what its critic may know beside it."""

from typing import NamedTuple

import torch
from torch import Tensor


class Observation(NamedTuple):
    """The input of a network, for n steps.

    Attributes:
        frames: Camera frames, uint8; the oldest frame of a stack first, and in each the left eye
            before the right one. Shape (n, stack * eyes, 120, 160).
        scan: What the lidar told. Shape (n, d), d = 0 without one.
        state: What only the critic may see. Shape (n, k), k = 0 where it sees nothing more.
    """

    frames: Tensor
    scan: Tensor
    state: Tensor


def of_frames(frames: Tensor) -> Observation:
    """The observation of a car that has a camera and nothing else."""
    nothing = torch.empty((len(frames), 0), device=frames.device)
    return Observation(frames, nothing, nothing)
