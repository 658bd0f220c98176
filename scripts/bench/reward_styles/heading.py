"""The angle between the car and the next waypoint decides, in steps of a factor."""

import math


def reward_function(params):
    """Pay for looking where the road goes; less where it turns, half for steering hard."""
    before, after = (params["waypoints"][index] for index in params["closest_waypoints"])
    road = math.degrees(math.atan2(after[1] - before[1], after[0] - before[0]))
    wrong = abs((params["heading"] - road + 180.0) % 360.0 - 180.0)
    reward = 100.0
    if wrong > 10.0:
        reward *= 0.5
    if wrong > 25.0:
        reward *= 0.2
    if abs(params["steering_angle"]) > 20.0:
        reward *= 0.8
    return reward if params["all_wheels_on_track"] else 1e-3
