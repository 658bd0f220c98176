"""The square of the speed times a term of the distance from the middle."""


def reward_function(params):
    """Pay for speed, the more the nearer to the middle."""
    if not params["all_wheels_on_track"]:
        return 1e-3
    off_center = 2.0 * params["distance_from_center"] / params["track_width"]
    return 10.0 * params["speed"] ** 2 * max(0.0, 1.0 - off_center) ** 0.5 + 1e-3
