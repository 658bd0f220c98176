"""Bell curves of distance, angle and speed, with numpy."""

import numpy as np


def reward_function(params):
    """Pay the product of two bell curves and of the speed."""
    points = np.array(params["waypoints"])
    before, after = points[params["closest_waypoints"]]
    road = np.arctan2(*(after - before)[::-1])
    wrong = np.angle(np.exp(1j * (np.radians(params["heading"]) - road)))
    near = np.exp(-0.5 * (params["distance_from_center"] / (0.2 * params["track_width"])) ** 2)
    straight = np.exp(-0.5 * (wrong / 0.35) ** 2)
    return float(near * straight * params["speed"] * (not params["is_offtrack"]))
