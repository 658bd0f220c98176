"""A corridor around the line ahead, with shapely: is the car in it, and does it look along it?"""

import math

from shapely.geometry import LineString, Point

AHEAD_M = 1.0


def reward_function(params):
    """Pay 10 in the corridor, as much again for looking at the road a metre ahead."""
    line = LineString(params["waypoints"])
    here = Point(params["x"], params["y"])
    if params["is_offtrack"] or not line.buffer(0.4 * params["track_width"]).contains(here):
        return 1e-3
    aim = line.interpolate((line.project(here) + AHEAD_M) % line.length)
    wanted = math.degrees(math.atan2(aim.y - here.y, aim.x - here.x))
    wrong = abs((params["heading"] - wanted + 180.0) % 360.0 - 180.0)
    return 10.0 + 10.0 * max(0.0, 1.0 - wrong / 45.0)
