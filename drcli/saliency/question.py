"""What can be asked about a policy. Light: commands read their options with it."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Literal

Target = Literal["action", "steering", "speed", "value"]
"""What a map explains: the chosen action, the steering or the speed that the policy asks for, or
the reward that the critic expects."""

TARGETS: tuple[Target, ...] = ("action", "steering", "speed", "value")

Method = Literal["perturbation", "hires-cam", "grad-cam"]
"""What is blurred and observed, and two views of the network's gradients, of which HiResCAM is the
more faithful one for our networks; see `drcli.saliency.grad_cam`."""

METHODS: tuple[Method, ...] = ("perturbation", "hires-cam", "grad-cam")

SPACINGS = (4, 5, 8, 10, 20)
"""Distances between the patches of a perturbation map that divide the picture's height and width,
pixels."""

FAST_SPACING, FINE_SPACING = 10, 8
"""Those for films and for stills."""

MOST_PICTURES = 200
"""Explained at once: a page with more could not be read, and a browser would be slow."""


@dataclass(frozen=True)
class Question:
    """What is asked about a policy.

    Attributes:
        pictures: How many pictures of the episode, evenly spread over it.
        steps: These steps instead, as a trace counts them: from 1.
        methods: Maps to make.
        target: What they explain.
        spacing: As in `perturbation_maps`.
        seed: Of the episode.
    """

    pictures: int = 12
    steps: Sequence[int] = ()
    methods: Collection[Method] = METHODS
    target: Target = "action"
    spacing: int = FINE_SPACING
    seed: int = 0
