def reward_function(params):
    """Stay near the middle of the road."""
    # Once a wheel is off the road nothing else counts. Almost zero, so that the next good step
    # still stands out.
    if not params["all_wheels_on_track"]:
        return 1e-3

    # 1 on the centre line, 0 at the border. Squared: a little beside the line costs little, so
    # the car may cut a corner.
    from_center = params["distance_from_center"] / (params["track_width"] / 2)
    return float(max(1e-3, 1.0 - from_center**2))
