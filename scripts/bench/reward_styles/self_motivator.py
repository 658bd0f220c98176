"""Progress per step and the square of the speed, in the hundreds: the most popular style."""


def reward_function(params):
    """Pay for getting on with the lap in few steps, and for asking for speed."""
    if not params["all_wheels_on_track"] or params["steps"] <= 0:
        return 1e-3
    return params["progress"] / params["steps"] * 100.0 + params["speed"] ** 2
