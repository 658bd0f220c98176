def reward_function(params):
    """Fast laps: the faster the car gets round the lap, the more it earns.

    The reward does not say which line to take or how to steer. A faster car simply earns more with
    every step, so it finds braking points and short lines by itself.
    """
    STEPS_PER_SECOND = 15.0  # the car chooses one action for each camera picture
    USUAL_PACE = 2.0  # speed in m/s that earns 1 per step; this only sets the scale
    FINISH_STEPS = 30.0  # the finish earns as much as this many extra steps at the same pace

    # With a wheel off the road, a step earns almost nothing. The car may still come back; this
    # costs less than slowing down everywhere.
    if params["is_offtrack"] or not params["all_wheels_on_track"]:
        return 1e-3

    # Average speed since the start of this lap, along the centre line. Not the requested
    # speed: a car that slides or zigzags makes less progress along the track.
    metres = params["progress"] / 100.0 * params["track_length"]
    seconds = params["steps"] / STEPS_PER_SECOND  # steps are 2 in the first call
    pace = min(max(metres / seconds, 0.0), 5.0)

    # Squared, so that the last tenth of a second is worth more than the first.
    reward = (pace / USUAL_PACE) ** 2

    # The episode ends at the finish line, and so do its rewards. Without an extra reward, finishing
    # would look as bad as leaving the road.
    if params["progress"] >= 100.0:
        reward *= 1.0 + FINISH_STEPS
    return float(max(reward, 1e-3))
