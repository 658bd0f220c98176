def reward_function(params):
    """Stay near the middle of the road, and get round quickly."""
    # Once the car is off the road nothing else counts. Almost zero, so that the next good step
    # still stands out.
    if params["is_offtrack"] or not params["all_wheels_on_track"]:
        return 1e-3

    # 1 on the centre line, 0 at the border. Squared: a little beside the line costs little, so
    # the car may cut a corner.
    from_center = params["distance_from_center"] / (params["track_width"] / 2)
    staying_on = max(0.0, 1.0 - from_center**2)

    # Percent of the lap that each step has brought so far. Without it a slow car would earn the
    # most, because it collects the rewards of more steps.
    pace = max(0.0, params["progress"]) / params["steps"]

    return float(staying_on * (0.2 + pace))
