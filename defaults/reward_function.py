def reward_function(params):
    """Stay near the middle of the road."""
    # If a wheel is off the road, nothing else counts: the reward is almost zero, so that good
    # steps clearly earn more.
    if not params["all_wheels_on_track"]:
        return 1e-3

    # 1 on the centre line, 0 at the border. Because of the square, a small distance from the line
    # costs little, so the car may cut a corner.
    from_center = params["distance_from_center"] / (params["track_width"] / 2)
    return float(max(1e-3, 1.0 - from_center**2))
