"""Questions about a policy; light to import."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Literal

Target = Literal["action", "steering", "speed", "value"]
TARGETS: tuple[Target, ...] = ("action", "steering", "speed", "value")

Method = Literal["perturbation", "hires-cam", "grad-cam"]
"""See `drcli.view.saliency.maps`."""

METHODS: tuple[Method, ...] = ("perturbation", "hires-cam", "grad-cam")

SPACINGS = (4, 5, 8, 10, 20)
"""Divide the picture's height and width."""

FAST_SPACING, FINE_SPACING = 10, 8
"""For films and stills."""

MOST_PICTURES = 200


@dataclass(frozen=True)
class SaliencyOptions:
    """What is asked about a policy.

    Attributes:
        pictures: Evenly spread.
        steps: Instead, from 1.
        spacing: As in `perturbation_maps`.
    """

    pictures: int = 12
    steps: Sequence[int] = ()
    methods: Collection[Method] = METHODS
    target: Target = "action"
    spacing: int = FINE_SPACING
    seed: int = 0
