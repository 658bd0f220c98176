def reward_function(params):
    """Drive on near the middle of the road, and steer no more than needed."""
    # A wheel off the road: nothing else counts.
    if not params["all_wheels_on_track"]:
        return 1e-3

    # 1 on the centre line, 0 at the border.
    from_center = params["distance_from_center"] / (params["track_width"] / 2)
    reward = max(0.0, 1.0 - from_center**2)

    # Full lock costs a fifth, so that the car does not swing from side to side on straights.
    reward *= 1.0 - 0.2 * abs(params["steering_angle"]) / 30.0

    # Otherwise the slowest lap would earn most.
    reward *= params["speed"]
    return float(max(1e-3, reward))
