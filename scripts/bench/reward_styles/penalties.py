"""A little for each good step, and -50 for leaving the road."""


def reward_function(params):
    """Pay 1 near the middle; take 5 for a wheel off the road and 50 for the whole car."""
    if params["is_offtrack"] or params["is_crashed"]:
        return -50.0
    if not params["all_wheels_on_track"]:
        return -5.0
    return 1.0 if params["distance_from_center"] < 0.3 * params["track_width"] else 0.2
