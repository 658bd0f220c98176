"""Draws a saliency map over its picture."""

import numpy as np
from numpy.typing import NDArray

from drcli.saliency.policy_outputs import Float32s

Picture = NDArray[np.uint8]

_STOPS = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
_COLOURS = np.array(
    [(70, 10, 105), (170, 30, 110), (225, 65, 60), (250, 140, 20), (255, 235, 90)], np.float32
)
"""Lightness rises, for colour-blind people."""

_STRONGEST = 0.8
LEAST_FULL = 1e-6
"""Below this, a map is only rounding."""


def full_of(maps: Float32s) -> float:
    """The value drawn as most in an episode.

    Exceeded in one picture of ten at most; single peaks would make all pictures pale.
    """
    if not maps.size:
        return 0.0
    return float(np.quantile(maps.reshape(len(maps), -1).max(axis=1), 0.9))


def overlay(frame: Picture, values: Float32s, full: float | None = None) -> Picture:
    """A map over a grey or RGB picture, as RGB; `full` (None: the maximum) is drawn as most."""
    full = float(values.max(initial=0.0)) if full is None else full
    ground = frame[..., None].repeat(3, axis=2) if frame.ndim == 2 else frame
    if not full > LEAST_FULL:
        return ground.copy()
    share = np.clip(values / full, 0.0, 1.0)
    colour = np.stack([np.interp(share, _STOPS, band) for band in _COLOURS.T], axis=-1)
    weight = (_STRONGEST * np.sqrt(share))[..., None]
    mixed = ground * (1.0 - weight) + colour * weight
    picture: Picture = np.rint(mixed).astype(np.uint8)
    return picture
