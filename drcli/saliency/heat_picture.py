"""Draws a saliency map over the picture that it explains."""

import numpy as np
from numpy.typing import NDArray

from drcli.saliency.policy_outputs import Float32s

Picture = NDArray[np.uint8]

_STOPS = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
_COLOURS = np.array(
    [(70, 10, 105), (170, 30, 110), (225, 65, 60), (250, 140, 20), (255, 235, 90)], np.float32
)
"""From nothing to most: violet, red, orange, yellow. Its lightness only rises, so that it can be
read without telling colours apart, as can the blend, which leaves weak places grey."""

_STRONGEST = 0.8
"""Share of the colour where a map is greatest: the picture stays visible below it."""

LEAST_FULL = 1e-6
"""A map whose greatest value is below this is empty: what is left is rounding."""


def full_of(maps: Float32s) -> float:
    """The value that is drawn as most, so that the pictures of an episode can be compared.

    A few single places of a long episode may be far above all others, which would make all pictures
    pale; it is the value that the strongest place of nine pictures in ten does not exceed.
    """
    if not maps.size:
        return 0.0
    return float(np.quantile(maps.reshape(len(maps), -1).max(axis=1), 0.9))


def overlay(frame: Picture, values: Float32s, full: float | None = None) -> Picture:
    """A grey or coloured picture with a map over it.

    Args:
        frame: Grey, or RGB in a third dimension. Shape (rows, columns) or (rows, columns, 3).
        values: The map, not negative. Shape (rows, columns).
        full: The value that is drawn as most; the map's own greatest if left out.

    Returns:
        RGB. Shape (rows, columns, 3).
    """
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
