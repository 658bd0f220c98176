def reward_function(params):
    """Fast laps: what counts is how quickly the lap is getting done.

    Nothing here says which line to take or how to steer. A car that gets round sooner simply earns
    more with every step, so it finds braking points and short lines by itself.
    """
    STEPS_PER_SECOND = 15.0  # the car decides with every picture of its camera
    USUAL_PACE = 2.0  # m/s that pays 1 a step; a matter of scale only
    FINISH_STEPS = 30.0  # the finish pays like so many further steps at the same pace

    # A wheel over the edge: this step is worth next to nothing. The car may still come back, which
    # is cheaper than slowing down everywhere.
    if params["is_offtrack"] or not params["all_wheels_on_track"]:
        return 1e-3

    # Average speed since the start of this lap, along the centre line. Not the speed that was
    # asked for: a car that slides or winds its way does not get any further.
    metres = params["progress"] / 100.0 * params["track_length"]
    seconds = params["steps"] / STEPS_PER_SECOND  # steps are 2 in the first call
    pace = min(max(metres / seconds, 0.0), 5.0)

    # Squared, so that the last tenth of a second is worth more than the first.
    reward = (pace / USUAL_PACE) ** 2

    # The episode ends at the finish line, and so do its rewards. Without something in return,
    # finishing would look as bad as leaving the road.
    if params["progress"] >= 100.0:
        reward *= 1.0 + FINISH_STEPS
    return float(max(reward, 1e-3))
