import math


def reward_function(params):
    """Less steering on straights: a car that zigzags there earns less; in bends it may steer.

    Whether the road is straight is seen from the waypoints, so no track is named here.
    """
    LOOK_AHEAD = 1.5  # metres of road ahead of the car
    STRAIGHT = 10.0  # degrees by which a straight road may turn in that distance
    BEND = 30.0  # from here on it is a bend, and steering is free
    FREE = 5.0  # degrees of steering that cost nothing
    MOST = 20.0  # degrees of steering that cost as much as there is

    if params["is_crashed"] or params["is_offtrack"] or not params["all_wheels_on_track"]:
        return 1e-3

    # The directions of the road here and, some waypoints further on, there.
    here = road_direction(params, 0.0)
    there = road_direction(params, LOOK_AHEAD)
    turn = abs((there - here + 180.0) % 360.0 - 180.0)

    # 1 on a straight, 0 in a bend, and something between where one becomes the other.
    straight = min(max((BEND - turn) / (BEND - STRAIGHT), 0.0), 1.0)
    too_much = min(max((abs(params["steering_angle"]) - FREE) / (MOST - FREE), 0.0), 1.0)

    from_center = params["distance_from_center"] / (params["track_width"] / 2)
    centered = max(1.0 - from_center**2, 0.0)
    return float(max(1e-3, centered * (1.0 - 0.7 * straight * too_much)))


def road_direction(params, metres):
    """Direction of the road in degrees, so many metres ahead of the car."""
    points = params["waypoints"]
    count = len(points)
    first = params["closest_waypoints"][0] % count
    for _ in range(count):
        second = (first + 1) % count
        (x1, y1), (x2, y2) = points[first][:2], points[second][:2]
        length = math.hypot(x2 - x1, y2 - y1)
        # Some tracks have a waypoint twice, and a road that is not a loop ends somewhere.
        metres -= length
        if length > 0.0 and (metres < 0.0 or second == 0):
            return math.degrees(math.atan2(y2 - y1, x2 - x1))
        first = second
    return params["heading"]
