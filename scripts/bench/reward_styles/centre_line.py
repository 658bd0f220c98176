"""Bands on both sides of the centre line, each paid a fixed amount."""

BANDS = ((0.1, 1.0), (0.25, 0.5), (0.5, 0.1))
"""Largest distance from the centre line as a share of the road's width, and the pay up to it."""


def reward_function(params):
    """Pay by the band that the car is in."""
    off_center = params["distance_from_center"] / params["track_width"]
    for limit, pay in BANDS:
        if off_center <= limit:
            return pay
    return 1e-3
